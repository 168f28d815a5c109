//! Class lists: EndoVis18's and our own `labels.json`, `[[classes]]` of `sequence.toml`, and how the
//! pixels of label files become class ids.

use super::{Class, LabelMap, NO_LABEL, read};
use crate::{Error, Result, grid::Grid};
use image::DynamicImage;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

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

/// Distinct on tissue and for colour-blind eyes (Okabe and Ito), used in turn where no colour is given.
const COLOURS: [[u8; 3]; 7] = [
    [86, 180, 233],
    [0, 158, 115],
    [204, 121, 167],
    [0, 114, 178],
    [240, 228, 66],
    [230, 159, 0],
    [213, 94, 0],
];

/// Checks a class list and brings names into plain lower-case words.
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
        if name.is_empty() || classes.iter().any(|c| c.name == name) {
            return Err(Error::input_at(
                path,
                format!("the class {} has the name \"{name}\"", entry.id),
                "Names must not be empty and must differ.",
            ));
        }
        classes.push(Class {
            id: entry.id,
            name,
            colour: entry.colour.unwrap_or(COLOURS[i % COLOURS.len()]),
        });
    }
    Ok(classes)
}

/// Reads a `labels.json`: a list of [`ClassEntry`].
pub(super) fn read_json(path: &Path) -> Result<Vec<Class>> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io("read the class list", path, e))?;
    let entries: Vec<ClassEntry> = serde_json::from_str(&text).map_err(|e| {
        Error::input_at(
            path,
            format!("the class list cannot be read: {e}"),
            "It is a list of entries like {\"id\": 1, \"name\": \"liver\", \"colour\": [255, 114, 114]}.",
        )
    })?;
    from_entries(&entries, path)
}

/// "Kidney_Parenchyma", "kidney-parenchyma" and "KidneyParenchyma" all become "kidney parenchyma"; a hyphen
/// stays after a single letter ("l-hook").
pub fn plain_words(name: &str) -> String {
    let mut words = String::with_capacity(name.len());
    let mut after_lower_case = false;
    for c in name.chars() {
        if c.is_uppercase() && after_lower_case {
            words.push(' ');
        }
        after_lower_case = c.is_lowercase();
        let after_single_letter = words.rsplit(' ').next().is_some_and(|word| word.chars().count() == 1);
        match c {
            '-' if after_single_letter => words.push('-'),
            '_' | '-' => words.push(' '),
            _ => words.extend(c.to_lowercase()),
        }
    }
    words.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Words that stand for something a surgeon holds, as singular and plain plural.
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

/// Whether words name an instrument, such as "l-hook electrocautery"; used where nobody said so.
pub fn names_instrument(words: &str) -> bool {
    let words = words.split(|c: char| !c.is_alphanumeric()).map(str::to_lowercase);
    words.into_iter().any(|w| INSTRUMENTS.iter().any(|i| w == *i || w.strip_suffix('s') == Some(i)))
}

/// Where the labels of one frame are.
#[derive(Clone, Debug)]
pub(super) enum LabelFiles {
    /// One picture whose values, or colours, name the classes.
    Picture(PathBuf),
    /// One mask per class id (non-zero = this class); later ones win.
    PerClass(Vec<(u8, PathBuf)>),
}

/// How the values of a label picture name classes.
#[derive(Clone, Debug)]
pub(super) enum LabelCoding {
    /// A grey picture holds class ids; a coloured one the classes' display colours.
    IdsOrColours,
    /// The first channel holds codes: (code, class id).
    Codes(&'static [(u8, u8)]),
}

impl LabelFiles {
    /// Class ids per pixel; what names no class of the list is [`NO_LABEL`].
    pub(super) fn read(
        &self,
        coding: &LabelCoding,
        classes: &[Class],
        (width, height): (usize, usize),
    ) -> Result<LabelMap> {
        match self {
            Self::Picture(path) => {
                let picture = read::picture(path)?;
                let size = (picture.width() as usize, picture.height() as usize);
                read::expect_size(path, size, (width, height))?;
                Ok(decode(picture, coding, classes))
            }
            Self::PerClass(files) => {
                let mut labels = Grid::filled(width, height, NO_LABEL);
                for (id, path) in files {
                    let mask = read::first_channel(path)?;
                    read::expect_size(path, (mask.width, mask.height), (width, height))?;
                    for (label, _) in labels.data.iter_mut().zip(&mask.data).filter(|(_, m)| **m != 0) {
                        *label = *id;
                    }
                }
                Ok(labels)
            }
        }
    }

    /// The files, for messages.
    pub(super) fn paths(&self) -> Vec<&Path> {
        match self {
            Self::Picture(path) => vec![path],
            Self::PerClass(files) => files.iter().map(|(_, path)| path.as_path()).collect(),
        }
    }
}

fn decode(picture: DynamicImage, coding: &LabelCoding, classes: &[Class]) -> LabelMap {
    let mut id_of_value = [NO_LABEL; 256];
    match coding {
        LabelCoding::IdsOrColours if picture.color().has_color() => return decode_colours(picture, classes),
        LabelCoding::IdsOrColours => classes.iter().for_each(|c| id_of_value[usize::from(c.id)] = c.id),
        LabelCoding::Codes(codes) => {
            codes.iter().for_each(|&(code, id)| id_of_value[usize::from(code)] = id);
        }
    }
    read::first_channel_of(picture).map(|&v| id_of_value.get(usize::from(v)).copied().unwrap_or(NO_LABEL))
}

fn decode_colours(picture: DynamicImage, classes: &[Class]) -> LabelMap {
    let picture = picture.into_rgb8();
    let id = |colour: [u8; 3]| classes.iter().find(|c| c.colour == colour).map_or(NO_LABEL, |c| c.id);
    // Neighbours mostly share a class: ask again only where the colour changes.
    let mut last = ([0; 3], id([0; 3]));
    let data = picture.pixels().map(|p| {
        if p.0 != last.0 {
            last = (p.0, id(p.0));
        }
        last.1
    });
    Grid::from_vec(picture.width() as usize, picture.height() as usize, data.collect())
}

#[cfg(test)]
mod tests {
    use super::{names_instrument, plain_words};

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
