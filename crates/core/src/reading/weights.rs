//! Weights of PyTorch networks beside the file that they belong to.

use super::{is_present, read_regular};
use std::path::Path;

/// Largest size of such a file in bytes. The autoencoder of embeddings of 768 numbers takes 2 MB.
const MOST_BYTES: u64 = 1 << 26;

/// Reads the file `name` beside `path` by `parse`: safetensors of the contents of `checkpoint`. `None` if
/// there is none. The error says what is wrong, without a full stop.
pub(crate) fn weights_beside<T>(
    path: &Path,
    name: &str,
    checkpoint: &str,
    parse: impl FnOnce(&[u8]) -> Result<T, String>,
) -> Result<Option<T>, String> {
    let path = path.with_file_name(name);
    if !is_present(&path) {
        return Ok(None);
    }
    let read = read_regular(&path, MOST_BYTES).map_err(|e| e.to_string());
    read.and_then(|bytes| parse(&bytes)).map(Some).map_err(|what| {
        format!(
            "{name} beside it cannot be read ({what}); make it in Python with \
             safetensors.torch.save_file(torch.load(\"{checkpoint}\"), \"{name}\")"
        )
    })
}
