//! Names of classes that a text encoder cannot tell apart.

use super::Vocabulary;
use crate::num;

/// Cosine of two embeddings above which no pixel is clearly more like one of them.
const SAME_COSINE: f32 = 0.999;

/// A class by its name.
struct Named<'a> {
    name: &'a str,
    /// The name in the form in which words are compared.
    key: String,
    embedding: &'a [f32],
}

/// Says of the names whose unit embeddings are the same that they will not be found. Classes of one name are
/// found together.
pub(crate) fn names_alike<'a>(classes: impl IntoIterator<Item = (&'a str, &'a [f32])>) -> Vec<String> {
    let mut groups: Vec<Vec<Named<'a>>> = Vec::new();
    for (name, embedding) in classes {
        let phrase = Vocabulary::standard().phrase(name);
        let key = phrase.keys.first().map_or_else(String::new, |key| key.text.clone());
        let is_like = |group: &&mut Vec<Named<'_>>| {
            group.first().is_some_and(|first| num::dot(first.embedding, embedding) > SAME_COSINE)
        };
        match groups.iter_mut().find(is_like) {
            Some(group) if group.iter().any(|other| other.key == key) => {}
            Some(group) => group.push(Named { name, key, embedding }),
            None => groups.push(vec![Named { name, key, embedding }]),
        }
    }
    groups.iter().filter_map(|group| note(group)).collect()
}

/// Says that names are alike; `None` of a single one.
fn note(group: &[Named<'_>]) -> Option<String> {
    let names: Vec<String> = group.iter().map(|class| format!("\"{}\"", class.name)).collect();
    let (last, others) = names.split_last().filter(|(_, others)| !others.is_empty())?;
    let none = if others.len() == 1 { "neither" } else { "none of them" };
    Some(format!(
        "{} and {last} cannot be told apart by this text encoder: {none} will be found by words. Give them names \
         that differ in words.",
        others.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_the_same_embedding_are_told_once() {
        let [x, y, near_x] = [[1.0, 0.0], [0.0, 1.0], [0.9999, 0.0141]];
        let told =
            |classes: &[(&str, [f32; 2])]| names_alike(classes.iter().map(|(name, row)| (*name, &row[..])));
        assert_eq!(
            told(&[("instrument 1", x), ("liver", y), ("instrument 2", near_x)]),
            [
                "\"instrument 1\" and \"instrument 2\" cannot be told apart by this text encoder: neither will be \
              found by words. Give them names that differ in words."
            ]
        );
        let three = told(&[("grade 1", x), ("grade 2", x), ("grade 3", x)]);
        assert_eq!(three.len(), 1);
        assert!(three[0].starts_with("\"grade 1\", \"grade 2\" and \"grade 3\" cannot"), "{three:?}");
        assert!(three[0].contains("none of them will be found"), "{three:?}");
        assert!(told(&[("liver", x), ("fat", y), ("Livers", x)]).is_empty(), "one name is found as one");
    }
}
