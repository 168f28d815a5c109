//! Names of prompts in file names.

use crate::hash::sha256;

/// Returns the part of a file name that stands for a prompt: lower-case ASCII letters, digits and hyphens. If
/// several prompts give the same name, or one gives none, `_` and a short hash of the prompt are added.
pub fn slugs<'a>(prompts: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let prompts: Vec<&str> = prompts.into_iter().collect();
    distinct(&prompts, prompts.iter().map(|prompt| slug(prompt)).collect(), "prompt")
}

/// Makes names unique that several texts share, and gives `nameless` to texts without a name. Both get a
/// hash of the text, so that no name depends on the order. Equal texts are numbered.
pub fn distinct(texts: &[&str], names: Vec<String>, nameless: &str) -> Vec<String> {
    // Some file systems do not distinguish upper and lower case.
    let key = |name: &str| name.to_uppercase().to_lowercase();
    let keys: Vec<String> = names.iter().map(|name| key(name)).collect();
    let with_hash = |i: usize, name: &str| {
        let hash = &sha256(texts[i].as_bytes())[..8];
        match texts[..i].iter().filter(|text| **text == texts[i]).count() {
            0 => format!("{name}_{hash}"),
            earlier => format!("{name}_{hash}_{}", earlier + 1),
        }
    };
    let is_unique = |i: usize| keys.iter().filter(|k| **k == keys[i]).count() == 1;
    let name = |(i, name): (usize, String)| match (name.is_empty(), is_unique(i)) {
        (true, _) => with_hash(i, nameless),
        (false, true) => name,
        (false, false) => with_hash(i, &name),
    };
    names.into_iter().enumerate().map(name).collect()
}

fn slug(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    let joined = words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("-");
    joined.chars().take(40).collect::<String>().trim_end_matches('-').to_owned()
}
