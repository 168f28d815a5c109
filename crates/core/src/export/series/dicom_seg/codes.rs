//! Codes for what segments show: SNOMED CT where the program's words have one, else a private scheme.

use crate::{export::ExportPrompt, meaning::Vocabulary, sequence::plain_words};

/// A coded concept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Code {
    pub(super) value: String,
    pub(super) scheme: &'static str,
    pub(super) meaning: String,
}

/// SNOMED CT.
const SNOMED: &str = "SCT";
/// Codes of the standard itself.
pub(super) const DICOM: &str = "DCM";
/// Our own scheme. Private ones begin with 99 (PS3.3, 8.2).
const PRIVATE: &str = "99SURGTPGS";

pub(super) const BACKGROUND: (&str, &str) = ("125040", "Background");

/// Category of a concept.
#[derive(Clone, Copy)]
enum Category {
    Structure,
    Tissue,
    Substance,
    Object,
}

impl Category {
    fn code(self) -> Code {
        let (value, meaning) = match self {
            Self::Structure => ("91723000", "Anatomical Structure"),
            Self::Tissue => ("85756007", "Tissue"),
            Self::Substance => ("91720002", "Body Substance"),
            Self::Object => ("260787004", "Physical object"),
        };
        of(SNOMED, value, meaning)
    }
}

/// Words that have a code in SNOMED CT: names of concepts of the vocabulary, and others that it knows.
const KNOWN: [(&str, &str, &str, Category); 51] = {
    use Category::{Object, Structure, Substance, Tissue};
    [
        ("aorta", "15825003", "Aorta", Structure),
        ("appendix", "66754008", "Appendix", Structure),
        ("artery", "51114001", "Artery", Structure),
        ("bile", "70150004", "Bile", Substance),
        ("bile duct", "28273000", "Bile duct", Structure),
        ("bladder", "89837001", "Bladder", Structure),
        ("blood", "87612001", "Blood", Substance),
        ("blood clot", "75753009", "Blood clot", Substance),
        ("blood vessel", "59820001", "Blood Vessel", Structure),
        ("bone", "272673000", "Bone", Structure),
        ("broad ligament", "34411009", "Broad ligament", Structure),
        ("caecum", "32713005", "Cecum", Structure),
        ("catheter", "19923001", "Catheter", Object),
        ("cecum", "32713005", "Cecum", Structure),
        ("clip", "77720000", "Clip", Object),
        ("colon", "71854001", "Colon", Structure),
        ("common bile duct", "79741001", "Common bile duct", Structure),
        ("connective tissue", "21793004", "Connective tissue", Tissue),
        ("diaphragm", "5798000", "Diaphragm", Structure),
        ("duodenum", "38848004", "Duodenum", Structure),
        ("esophagus", "32849002", "Esophagus", Structure),
        ("fallopian tube", "31435000", "Fallopian tube", Structure),
        ("fat", "55603005", "Fat", Tissue),
        ("gallbladder", "28231008", "Gallbladder", Structure),
        ("heart", "80891009", "Heart", Structure),
        ("hepatic artery", "76015000", "Hepatic artery", Structure),
        ("hepatic vein", "8993003", "Hepatic vein", Structure),
        ("ileum", "34516001", "Ileum", Structure),
        ("inferior vena cava", "64131007", "Inferior vena cava", Structure),
        ("jejunum", "21306003", "Jejunum", Structure),
        ("kidney", "64033007", "Kidney", Structure),
        ("large intestine", "14742008", "Large intestine", Structure),
        ("ligament", "52082005", "Ligament", Structure),
        ("liver", "10200004", "Liver", Structure),
        ("lung", "39607008", "Lung", Structure),
        ("lymph node", "59441001", "Lymph node", Structure),
        ("muscle", "71616004", "Muscle", Structure),
        ("nerve", "91728009", "Nerve", Structure),
        ("oesophagus", "32849002", "Esophagus", Structure),
        ("omentum", "27398004", "Omentum", Structure),
        ("ovary", "15497006", "Ovary", Structure),
        ("pancreas", "15776009", "Pancreas", Structure),
        ("portal vein", "32764006", "Portal vein", Structure),
        ("prostate", "41216001", "Prostate", Structure),
        ("small intestine", "30315005", "Small intestine", Structure),
        ("spleen", "78961009", "Spleen", Structure),
        ("stomach", "69695003", "Stomach", Structure),
        ("ureter", "87953007", "Ureter", Structure),
        ("uterus", "35039007", "Uterus", Structure),
        ("vein", "29092000", "Vein", Structure),
        ("vessel", "59820001", "Blood Vessel", Structure),
    ]
};

/// Returns the category and the type of what a prompt finds. Its own words count before the concept that they
/// belong to, which may be wider.
pub(super) fn of_prompt(prompt: &ExportPrompt) -> (Code, Code) {
    let vocabulary = Vocabulary::standard();
    let words = plain_words(&prompt.text);
    let name =
        vocabulary.concept_of(&prompt.text).map(|concept| vocabulary.concepts()[concept].name.as_str());
    let known = |name: &str| KNOWN.iter().find(|(known, ..)| *known == name);
    match known(&words).or_else(|| known(name?)) {
        Some((_, value, meaning, category)) => (category.code(), of(SNOMED, value, meaning)),
        None => {
            let category = if prompt.is_instrument { Category::Object } else { Category::Tissue };
            (category.code(), private(&prompt.text))
        }
    }
}

pub(super) fn of(scheme: &'static str, value: &str, meaning: &str) -> Code {
    Code { value: value.to_owned(), scheme, meaning: meaning.to_owned() }
}

/// Returns the private code of a text: a part of its hash, because values have 16 characters.
fn private(text: &str) -> Code {
    let value = crate::hash::sha256(text.as_bytes())[..16].to_uppercase();
    Code { value, scheme: PRIVATE, meaning: text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_that_are_known_have_public_codes() {
        let prompt = |text: &str, is_instrument| ExportPrompt {
            text: text.into(),
            threshold: 0.5,
            colour: [0; 3],
            negatives: Vec::new(),
            is_instrument,
            certainty: None,
            stands_for: None,
        };
        for text in ["gallbladder", "gall bladder", "Gallbladder"] {
            assert_eq!(of_prompt(&prompt(text, false)).1, of(SNOMED, "28231008", "Gallbladder"), "{text}");
        }
        let (category, kind) = of_prompt(&prompt("grasper", true));
        assert_eq!((category.meaning.as_str(), kind.scheme), ("Physical object", PRIVATE));
        assert_eq!((kind.value.len(), kind.meaning.as_str()), (16, "grasper"));
    }

    #[test]
    fn every_word_with_a_code_is_in_the_vocabulary() {
        let vocabulary = Vocabulary::standard();
        for (name, ..) in KNOWN {
            assert!(vocabulary.concept_of(name).is_some(), "{name}");
        }
        assert!(KNOWN.is_sorted_by_key(|(name, ..)| *name));
    }
}
