//! Tables that took long to make. Each is kept in a file with a key of everything that it was made from.

use super::files::{from_safetensors, key_of, to_safetensors};
use crate::{
    Error, Result,
    files::write_whole,
    hash::sha256,
    reading::{MOST_BYTES, read_regular},
};
use ndarray::{Array2, ArrayView2, Ix2};
use std::path::Path;

/// Returns one hash over several parts.
pub(super) fn digest(parts: &[&[u8]]) -> String {
    let hashes: Vec<String> = parts.iter().map(|part| sha256(part)).collect();
    sha256(hashes.join("\n").as_bytes())
}

/// Saves a table of some `kind` under a key.
pub(super) fn save(path: &Path, key: &str, kind: &str, table: ArrayView2<'_, f32>) -> Result<()> {
    let tensors = [(kind.to_owned(), table.into_dyn())];
    let bytes = to_safetensors(&tensors, Some(key))
        .map_err(|e| Error::input_at(path, format!("the {kind} cannot be written: {e}"), ""))?;
    write_whole(path, &bytes)
}

/// Loads the table saved under `key`; `None` if there is none or the file is damaged.
pub(super) fn load(path: &Path, key: &str, kind: &str) -> Result<Option<Array2<f32>>> {
    let bytes = match read_regular(path, MOST_BYTES) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Error::io(format!("read the {kind}"), path, e)),
    };
    if key_of(&bytes).as_deref() != Some(key) {
        return Ok(None);
    }
    let table = from_safetensors(&bytes).ok().and_then(|mut tensors| tensors.remove(kind));
    Ok(table.and_then(|table| table.into_dimensionality::<Ix2>().ok()))
}
