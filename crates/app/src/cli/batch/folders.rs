//! Folder names made from names of recordings: in any script, and independent of the order in the jobs file.

use surgtpgs_core::export::distinct;
use unicode_normalization::{UnicodeNormalization, char::is_combining_mark};

/// Largest number of letters and bytes of a name, so that it fits wherever files are copied to.
const MAX_LETTERS: usize = 40;
const MAX_BYTES: usize = 120;

/// Returns a folder name for each recording: the recording's name in lower-case letters and digits of any
/// script, with `-` for all else. A short hash of the recording's name is added where two folders would have
/// the same name, or where no name is left that every system allows.
pub(super) fn folder_names(recordings: &[&str]) -> Vec<String> {
    distinct(recordings, recordings.iter().map(|name| folder_name(name)).collect(), "recording")
}

fn folder_name(recording: &str) -> String {
    let composed: String = recording.nfc().collect();
    let lower: String = composed.to_lowercase().nfc().collect();
    let is_kept = |c: char| c.is_alphanumeric() || is_combining_mark(c);
    let words: Vec<&str> = lower.split(|c| !is_kept(c)).filter(|word| !word.is_empty()).collect();
    let mut name = String::new();
    for c in words.join("-").chars().take(MAX_LETTERS) {
        if name.len() + c.len_utf8() > MAX_BYTES {
            break;
        }
        name.push(c);
    }
    name.truncate(name.trim_end_matches('-').len());
    if is_reserved(&name) { String::new() } else { name }
}

/// Returns `true` if Windows takes the name for a device.
fn is_reserved(name: &str) -> bool {
    let port = |kind: &str| {
        name.strip_prefix(kind).is_some_and(|n| n.chars().count() == 1 && n.chars().all(char::is_numeric))
    };
    ["con", "prn", "aux", "nul"].contains(&name) || port("com") || port("lpt")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_any_script_stay_readable() {
        let names =
            ["Clip 7, left!", "Müller Ö", "Пациент №7", "患者七", "مريض ٧", "מטופל", "रोगी सात", "ผู้ป่วย 7"];
        let folders = folder_names(&names);
        assert_eq!(
            folders,
            ["clip-7-left", "müller-ö", "пациент-7", "患者七", "مريض-٧", "מטופל", "रोगी-सात", "ผู้ป่วย-7"]
        );
        let turned = folder_names(&names.into_iter().rev().collect::<Vec<_>>());
        assert!(turned.iter().rev().eq(&folders), "the order makes no difference");
        // The ü as a letter and an accent, as some systems write it.
        assert_eq!(folder_names(&["Mu\u{308}ller"]), ["müller"]);
    }

    #[test]
    fn no_two_are_the_same_and_all_can_be_made() {
        let long = "胆".repeat(300);
        let names = ["A b", "a-B", "!!!", "CON", "com1", "é", "e\u{301}", &long, "../..", "ς", "σ"];
        let folders = folder_names(&names);
        let distinct: std::collections::BTreeSet<_> = folders.iter().map(|f| f.to_uppercase()).collect();
        assert_eq!(distinct.len(), names.len(), "{folders:?}");
        assert!(folders[0].starts_with("a-b_") && folders[3].starts_with("recording_"), "{folders:?}");
        let place = tempfile::tempdir().unwrap();
        for folder in &folders {
            assert!(folder.len() <= 140 && !folder.contains(['/', '.']), "{folder}");
            std::fs::create_dir(place.path().join(folder)).unwrap();
        }
        let turned = folder_names(&names.into_iter().rev().collect::<Vec<_>>());
        assert!(turned.iter().rev().eq(&folders), "the order makes no difference");
    }
}
