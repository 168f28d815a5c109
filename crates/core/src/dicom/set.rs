//! Data sets in memory: the attributes that were asked for.

use super::tag::Tag;
use crate::reading::Piece;

/// Beginning of a change of the character set within a text (PS3.5, 6.1.2.5).
const ESCAPE: u8 = 0x1b;

/// The attributes that were kept, in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Set {
    pub(crate) elements: Vec<(Tag, Value)>,
}

/// The value of an attribute.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Bytes(Vec<u8>),
    Items(Vec<Set>),
    /// Pixels that lie in the file as they are.
    Stored(Piece),
    /// Pixels that lie in the file in fragments; the first is the table of offsets.
    Fragments(Vec<Piece>),
}

impl Set {
    pub(crate) fn value(&self, tag: Tag) -> Option<&Value> {
        self.elements.iter().find(|(t, _)| *t == tag).map(|(_, value)| value)
    }

    /// Returns the bytes of an attribute.
    pub(crate) fn bytes(&self, tag: Tag) -> Option<&[u8]> {
        match self.value(tag) {
            Some(Value::Bytes(bytes)) => Some(bytes),
            _ => None,
        }
    }

    /// Returns a text without the padding around it; `None` if it is missing or empty.
    pub(crate) fn text(&self, tag: Tag) -> Option<String> {
        without_padding(&String::from_utf8_lossy(self.bytes(tag)?))
    }

    /// Returns a text that is in Latin-1, see [`Self::text`].
    pub(crate) fn latin_text(&self, tag: Tag) -> Option<String> {
        let text: String = self.bytes(tag)?.iter().map(|&byte| char::from(byte)).collect();
        without_padding(&text)
    }

    /// Returns `true` if a text is in UTF-8, or missing.
    pub(crate) fn is_utf8(&self, tag: Tag) -> bool {
        let bytes = self.bytes(tag).unwrap_or_default();
        str::from_utf8(bytes).is_ok() && !bytes.contains(&ESCAPE)
    }

    /// Returns the numbers of a decimal or integer string; those that cannot be read are NaN.
    pub(crate) fn numbers(&self, tag: Tag) -> Vec<f64> {
        let Some(text) = self.text(tag) else { return Vec::new() };
        text.split('\\').map(|number| number.trim().parse().unwrap_or(f64::NAN)).collect()
    }

    /// Returns the first number of a string; `None` unless it is finite and above 0.
    pub(crate) fn positive(&self, tag: Tag) -> Option<f64> {
        self.numbers(tag).first().copied().filter(|v| v.is_finite() && *v > 0.0)
    }

    /// Returns the 16-bit numbers of an attribute.
    pub(crate) fn shorts(&self, tag: Tag) -> Vec<u16> {
        let bytes = self.bytes(tag).unwrap_or_default();
        bytes.as_chunks::<2>().0.iter().map(|pair| u16::from_le_bytes(*pair)).collect()
    }

    /// Returns the first 16-bit number of an attribute.
    pub(crate) fn short(&self, tag: Tag) -> Option<u16> {
        self.bytes(tag)?.first_chunk().map(|pair| u16::from_le_bytes(*pair))
    }

    /// Returns the 32-bit numbers of an attribute.
    pub(crate) fn longs(&self, tag: Tag) -> Vec<u32> {
        let bytes = self.bytes(tag).unwrap_or_default();
        bytes.as_chunks::<4>().0.iter().map(|four| u32::from_le_bytes(*four)).collect()
    }

    /// Returns the items of a sequence; none if it is missing.
    pub(crate) fn items(&self, tag: Tag) -> &[Set] {
        match self.value(tag) {
            Some(Value::Items(items)) => items,
            _ => &[],
        }
    }

    /// Returns the only or first item of a sequence.
    pub(crate) fn item(&self, tag: Tag) -> Option<&Set> {
        self.items(tag).first()
    }
}

fn without_padding(text: &str) -> Option<String> {
    let text = text.trim_matches(|c: char| c == '\0' || c == ' ');
    (!text.is_empty()).then(|| text.to_owned())
}
