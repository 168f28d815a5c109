//! Class lists: EndoVis18's and our own `labels.json`, `[[classes]]` of `sequence.toml`.

use crate::{Error, Result, annotations::Annotation, reading::read_text};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeSet, path::Path};

/// A kind of tissue or instrument.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Class {
    /// Value in a [`LabelMap`](super::LabelMap).
    pub id: u8,
    /// Name in plain lower-case words, e.g. "abdominal wall"; also the prompt that finds it.
    pub name: String,
    /// Display colour (sRGB).
    pub colour: [u8; 3],
}

/// The id of a pixel whose class is unknown.
pub const NO_LABEL: u8 = 255;

/// One entry of a class list; EndoVis18's spellings `classid` and `color` are understood too.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassEntry {
    /// The value of this class in the label files, 0–254 (255 is "unknown").
    #[serde(alias = "classid")]
    pub id: u8,
    /// Plain words, also used as the prompt that finds it.
    pub name: String,
    /// Display colour (sRGB); chosen from a fixed list if absent.
    #[serde(alias = "color", default, skip_serializing_if = "Option::is_none")]
    pub colour: Option<[u8; 3]>,
}

/// Colours that are distinct on tissue and for colour-blind eyes (Okabe and Ito), used in turn where no
/// colour is given.
const COLOURS: [[u8; 3]; 7] = [
    [86, 180, 233],
    [0, 158, 115],
    [204, 121, 167],
    [0, 114, 178],
    [240, 228, 66],
    [230, 159, 0],
    [213, 94, 0],
];

/// Returns the colour of the class at a place of a list that gives none.
pub fn class_colour(place: usize) -> [u8; 3] {
    COLOURS[place % COLOURS.len()]
}

/// Checks a class list and turns its names into plain lower-case words.
pub(super) fn from_entries(entries: &[ClassEntry], path: &Path) -> Result<Vec<Class>> {
    let mut classes: Vec<Class> = Vec::with_capacity(entries.len());
    for (i, entry) in entries.iter().enumerate() {
        let name = plain_words(&entry.name);
        if entry.id == NO_LABEL || classes.iter().any(|c| c.id == entry.id) {
            return Err(Error::input_at(
                path,
                format!("the class \"{name}\" has the id {}, which is taken", entry.id),
                "Ids must differ and lie between 0 and 254; 255 means \"unknown\".",
            ));
        }
        if name.is_empty() {
            let what = format!("the class {} has the name \"{}\"", entry.id, entry.name);
            return Err(Error::input_at(path, what, "A name needs a word."));
        }
        if let Some(first) = classes.iter().position(|c| c.name == name) {
            return Err(same_words(&entries[first].name, &entry.name, path));
        }
        classes.push(Class { id: entry.id, name, colour: entry.colour.unwrap_or(class_colour(i)) });
    }
    Ok(classes)
}

/// Creates the error about two classes of which nothing but signs, spaces or capitals tell the names apart.
fn same_words(first: &str, second: &str, path: &Path) -> Error {
    let what = format!("the classes \"{first}\" and \"{second}\" are the same in plain words");
    Error::input_at(path, what, "Give them names that differ in words.")
}

/// Reads a `labels.json`: a list of [`ClassEntry`].
pub(super) fn read_json(path: &Path) -> Result<Vec<Class>> {
    let text = read_text(path).map_err(|e| Error::io("read the class list", path, e))?;
    let entries: Vec<ClassEntry> = serde_json::from_str(&text).map_err(|e| {
        Error::input_at(
            path,
            format!("the class list cannot be read: {e}"),
            "It is a list of entries like {\"id\": 1, \"name\": \"liver\", \"colour\": [255, 114, 114]}.",
        )
    })?;
    from_entries(&entries, path)
}

/// Returns the classes that annotations name, in the order of their names. Those that are `known` keep id and
/// colour, the others get the lowest ids that are free.
pub(super) fn named(annotations: &[Annotation], known: &[Class], path: &Path) -> Result<Vec<Class>> {
    let names: BTreeSet<String> = annotations.iter().map(|a| plain_words(&a.name)).collect();
    let old = |name: &str| known.iter().find(|class| class.name == name);
    let taken: Vec<u8> = names.iter().filter_map(|name| old(name)).map(|class| class.id).collect();
    let mut free = (1..NO_LABEL).filter(|id| !taken.contains(id));
    let mut entries = Vec::new();
    for name in names {
        let (id, colour) = match old(&name) {
            Some(class) => (Some(class.id), Some(class.colour)),
            None => (free.next(), None),
        };
        let id = id.ok_or_else(|| Error::input_at(path, "there are more than 254 names", "At most 254."))?;
        entries.push(ClassEntry { id, name, colour });
    }
    from_entries(&entries, path)
}

/// Turns a name into plain lower-case words. "Kidney_Parenchyma", "kidney-parenchyma" and
/// "KidneyParenchyma" all become "kidney parenchyma". A hyphen stays after a single letter ("l-hook").
pub fn plain_words(name: &str) -> String {
    let mut words = String::with_capacity(name.len());
    let mut after_lower_case = false;
    for c in name.chars() {
        if c.is_uppercase() && after_lower_case {
            words.push(' ');
        }
        after_lower_case = c.is_lowercase();
        let mut last = words.chars().rev();
        let is_letter = |c: Option<char>| c.is_some_and(|c| c != ' ');
        let after_single_letter = is_letter(last.next()) && !is_letter(last.next());
        match c {
            '-' if after_single_letter => words.push('-'),
            '_' | '-' => words.push(' '),
            _ => words.extend(c.to_lowercase()),
        }
    }
    words.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns `true` if two names are one: capitals, spaces, hyphens and underscores do not count.
pub fn is_same_name(a: &str, b: &str) -> bool {
    letters(a) == letters(b)
}

/// Returns the part of a name that names which are one have in common: its plain words, joined.
pub(crate) fn letters(name: &str) -> String {
    plain_words(name).replace([' ', '-'], "")
}

/// Words for things that a surgeon holds, in the singular; a plural with -s is recognised too.
const INSTRUMENTS: [&str; 26] = [
    "instrument",
    "tool",
    "grasper",
    "forceps",
    "hook",
    "cautery",
    "electrocautery",
    "scissors",
    "clipper",
    "clip",
    "clamp",
    "stapler",
    "retractor",
    "trocar",
    "probe",
    "suction",
    "irrigator",
    "needle",
    "driver",
    "shaft",
    "wrist",
    "clasper",
    "sealer",
    "bipolar",
    "monopolar",
    "scalpel",
];

/// Returns `true` if `words` name an instrument, such as "l-hook electrocautery". Used where nobody said
/// which classes are instruments.
pub fn names_instrument(words: &str) -> bool {
    let words = words.split(|c: char| !c.is_alphanumeric()).map(str::to_lowercase);
    words.into_iter().any(|w| INSTRUMENTS.iter().any(|i| w == *i || w.strip_suffix('s') == Some(i)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_names_become_plain_words() {
        for (name, words) in [
            ("Kidney_Parenchyma", "kidney parenchyma"),
            ("suction-instrument", "suction instrument"),
            ("AbdominalWall", "abdominal wall"),
            ("L-hook Electrocautery", "l-hook electrocautery"),
            ("US probe", "us probe"),
            ("  fat ", "fat"),
        ] {
            assert_eq!(plain_words(name), words);
        }
    }

    #[test]
    fn capitals_spaces_and_hyphens_make_no_other_name() {
        for other in ["Gallbladder", "gall bladder", "GALL_BLADDER", " gall-bladder "] {
            assert!(is_same_name("gallbladder", other), "{other}");
        }
        assert!(is_same_name("l-hook", "L hook") && !is_same_name("liver", "livers"));
    }

    #[test]
    fn names_that_signs_alone_tell_apart_are_refused() {
        let path = Path::new("labels.json");
        let entry = |(id, name): (u8, &str)| ClassEntry { id, name: name.into(), colour: None };
        let listed = |names: [&str; 2]| from_entries(&[(1, names[0]), (2, names[1])].map(entry), path);
        let text = listed(["tumour -", "tumour _"]).unwrap_err().to_string();
        assert!(text.contains("\"tumour -\" and \"tumour _\" are the same in plain words"), "{text}");
        assert!(listed(["tumour +", "tumour -"]).is_ok());
    }

    #[test]
    fn instruments_are_known_by_their_names() {
        for name in
            ["grasper", "L-hook Electrocautery", "instrument shaft", "clamps", "US probe", "suturing needle"]
        {
            assert!(names_instrument(name), "{name}");
        }
        for name in ["liver", "gallbladder", "hepatic vein", "black background", "clipped duct", ""] {
            assert!(!names_instrument(name), "{name}");
        }
    }
}
