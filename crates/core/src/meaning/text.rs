//! Words in the form in which they are compared: lower case, singular, American spelling.

use unicode_normalization::UnicodeNormalization;

/// Splits text into words in their compared form. All but letters, digits and apostrophes separates.
pub fn tokens(text: &str) -> Vec<String> {
    let text = text.nfkc().collect::<String>().to_lowercase().replace('’', "'");
    text.split(|c: char| !c.is_alphanumeric() && c != '\'')
        .map(|word| word.strip_suffix("'s").unwrap_or(word))
        .flat_map(|word| word.split('\''))
        .filter(|word| !word.is_empty())
        .map(|word| american(singular(word)))
        .collect()
}

/// Turns a plural into its singular by its ending; words of up to three letters stay.
fn singular(word: &str) -> String {
    let length = word.chars().count();
    if length <= 3 || ["ss", "us", "is"].iter().any(|end| word.ends_with(end)) {
        return word.to_owned();
    }
    if length > 4 {
        if let Some(stem) = word.strip_suffix("ies") {
            return format!("{stem}y");
        }
        if ["ses", "xes", "ches", "shes", "zes"].iter().any(|end| word.ends_with(end)) {
            return word[..word.len() - 2].to_owned();
        }
        if ["ri", "li", "ni", "mi", "ti"].iter().any(|end| word.ends_with(end)) {
            return format!("{}us", &word[..word.len() - 1]);
        }
    }
    word.strip_suffix('s').unwrap_or(word).to_owned()
}

/// Stems in which British English writes ae or oe.
const DIPHTHONGS: [&str; 10] =
    ["haem", "caec", "oedem", "oesoph", "anaes", "paed", "faec", "foet", "orrhoe", "gynae"];

/// Spells a word the American way. Some real words change too ("exercize"); all that matters is that both
/// spellings end as one.
fn american(mut word: String) -> String {
    if word.chars().count() < 4 {
        return word;
    }
    if DIPHTHONGS.iter().any(|stem| word.contains(stem)) {
        word = word.replace("ae", "e").replace("oe", "e");
    }
    if word.len() > 4 && word.ends_with("our") {
        word.replace_range(word.len() - 2.., "r");
    } else if word.ends_with("bre") || word.ends_with("tre") {
        word.replace_range(word.len() - 2.., "er");
    }
    let end = ["ise", "ised", "ising", "isation", "iser"].iter().find(|end| word.ends_with(*end));
    if let Some(end) = end {
        let s = word.len() - end.len() + 1;
        word.replace_range(s..=s, "z");
    }
    word
}

#[cfg(test)]
mod tests {
    use super::tokens;

    #[test]
    fn spellings_of_a_word_end_as_one() {
        let same = [
            ("Gall-Bladders", "gall bladder"),
            ("gallbladder's wall", "gallbladder wall"),
            ("the surgeons’ hands", "the surgeon hand"),
            ("black_background", "black background"),
            ("biopsies biopsy", "biopsy biopsy"),
            ("boxes meshes masses", "box mesh mass"),
            ("uteri", "uterus"),
            ("haemorrhage, oesophagus; tumour", "hemorrhage esophagus tumor"),
            ("fibre centre", "fiber center"),
            ("cauterised cauterising", "cauterized cauterizing"),
            ("gas bus four", "gas bus four"),
            ("ﬁbrin ＬＩＶＥＲ", "fibrin liver"),
            ("Äste 胆嚢", "äste 胆嚢"),
            (" .!? ' 's", ""),
        ];
        for (words, expected) in same {
            assert_eq!(tokens(words).join(" "), expected, "{words}");
        }
    }
}
