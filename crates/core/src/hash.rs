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
