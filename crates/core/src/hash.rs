//! SHA-256 hashes in hexadecimal, the form in which they are written to files.

use crate::{Error, Result, reading::open_regular};
use sha2::{Digest, Sha256};
use std::path::Path;

/// Returns the hash of `bytes`.
pub fn sha256(bytes: &[u8]) -> String {
    format!("{:x}", Sha256::digest(bytes))
}

/// Returns the hash of a file, which is streamed.
pub fn file_sha256(path: &Path) -> Result<String> {
    let fail = |e| Error::io("read the file", path, e);
    let mut hash = Sha256::new();
    std::io::copy(&mut open_regular(path).map_err(fail)?, &mut hash).map_err(fail)?;
    Ok(format!("{:x}", hash.finalize()))
}

/// Returns an error with `hint` if the bytes of the file at `path` are not those that were written.
pub(crate) fn require_sha256(path: &Path, bytes: &[u8], expected: &str, hint: &str) -> Result<()> {
    if sha256(bytes) == expected {
        return Ok(());
    }
    Err(Error::input_at(path, "the file is damaged or was changed: its checksum differs", hint))
}
