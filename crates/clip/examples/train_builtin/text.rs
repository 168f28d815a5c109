//! Text as the network reads it, and a tokenizer file that splits text in the same way.

use serde_json::{Value, json};

/// Number of character ids: padding, space, a–z, digit, anything else.
pub const NUM_CHARS: usize = 30;
/// Number of trigram codes.
pub const NUM_CODES: usize = NUM_CHARS * NUM_CHARS * NUM_CHARS;
const SPACE: usize = 1;
const DIGIT: usize = 28;
const STRANGE: usize = 29;

/// Codes of the overlapping trigrams of a text with a space at either end.
pub fn trigrams(text: &str) -> impl Iterator<Item = usize> {
    let mut ids = vec![SPACE];
    for c in text.chars().flat_map(char::to_lowercase) {
        let id = match c {
            'a'..='z' => 2 + c as usize - 'a' as usize,
            c if c.is_numeric() => DIGIT,
            c if c.is_alphabetic() => STRANGE,
            _ => SPACE,
        };
        if id != SPACE || ids.last() != Some(&SPACE) {
            ids.push(id);
        }
    }
    if ids.last() != Some(&SPACE) {
        ids.push(SPACE);
    }
    (2..ids.len()).map(move |i| (ids[i - 2] * NUM_CHARS + ids[i - 1]) * NUM_CHARS + ids[i])
}

/// `tokenizer.json`: lower case, no accents, one id per letter, a space at either end.
pub fn tokenizer_json() -> String {
    let mut vocabulary = serde_json::Map::from_iter([("[PAD]".into(), json!(0)), (" ".into(), json!(SPACE))]);
    vocabulary.extend(('a'..='z').zip(2..).map(|(letter, id)| (letter.to_string(), json!(id))));
    vocabulary.extend([("0".into(), json!(DIGIT)), ("[UNK]".into(), json!(STRANGE))]);
    let replace =
        |pattern: &str, by: &str| json!({"type": "Replace", "pattern": {"Regex": pattern}, "content": by});
    let edge = json!({"SpecialToken": {"id": " ", "type_id": 0}});
    let single = json!([edge, {"Sequence": {"id": "A", "type_id": 0}}, edge]);
    let tokenizer: Value = json!({
        "version": "1.0",
        "truncation": null,
        "padding": null,
        "added_tokens": [],
        "normalizer": {"type": "Sequence", "normalizers": [
            {"type": "NFKD"},
            {"type": "StripAccents"},
            {"type": "Lowercase"},
            replace(r"\p{N}", "0"),
            replace(r"[^\p{L}0]+", " "),
            {"type": "Strip", "strip_left": true, "strip_right": true},
        ]},
        "pre_tokenizer": {"type": "Split", "pattern": {"Regex": r"[\s\S]"}, "behavior": "Isolated", "invert": false},
        "post_processor": {
            "type": "TemplateProcessing",
            "single": single,
            "pair": [edge, {"Sequence": {"id": "A", "type_id": 0}}, edge, {"Sequence": {"id": "B", "type_id": 0}}, edge],
            "special_tokens": {" ": {"id": " ", "ids": [SPACE], "tokens": [" "]}},
        },
        "decoder": null,
        "model": {"type": "WordLevel", "vocab": vocabulary, "unk_token": "[UNK]"},
    });
    format!("{tokenizer:#}\n")
}
