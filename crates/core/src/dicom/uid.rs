//! Unique identifiers: those of the standard that are told apart here, and our own, which follow from hashes.

use sha2::{Digest, Sha256};

pub(crate) const IMPLICIT: &str = "1.2.840.10008.1.2";
pub(crate) const EXPLICIT: &str = "1.2.840.10008.1.2.1";
pub(crate) const DEFLATED: &str = "1.2.840.10008.1.2.1.99";
pub(crate) const BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";
/// Segmentation Storage.
pub(crate) const SEGMENTATION: &str = "1.2.840.10008.5.1.4.1.1.66.4";
/// Label Map Segmentation Storage.
pub(crate) const LABEL_MAP: &str = "1.2.840.10008.5.1.4.1.1.66.7";

/// Returns the identifier that stands for `parts`: 2.25. and 122 bits of their SHA-256, in the form of a
/// random UUID (PS3.5, B.2). Equal parts have equal identifiers.
pub(crate) fn of_hash(parts: &[&[u8]]) -> String {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    let digest = hash.finalize();
    let number = digest.iter().take(16).fold(0_u128, |n, &byte| n << 8 | u128::from(byte));
    // Version 4, variant 1 (RFC 9562, 4).
    let number = number & !(0xf << 76) & !(0x3 << 62) | 0x4 << 76 | 0x2 << 62;
    format!("2.25.{number}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_follow_from_what_they_stand_for() {
        let uid = of_hash(&[b"a", b"b"]);
        assert_eq!(uid, of_hash(&[b"a", b"b"]));
        assert_ne!(uid, of_hash(&[b"ab"]));
        assert!(uid.len() <= 64 && uid.bytes().all(|b| b == b'.' || b.is_ascii_digit()));
    }
}
