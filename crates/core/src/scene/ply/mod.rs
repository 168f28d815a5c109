//! `.ply` files of Gaussians: those of 3-D Gaussian splatting, and the deforming ones of the released code.

mod reference;
mod splats;
mod table;

pub use reference::{LANG_DEFORMATION_FILE, ReferenceWeights};
pub(super) use splats::drop_empty_bands;

use super::{MADE_BY, Problem, Scene};
use table::PlyTable;

/// First bytes of every `.ply`.
pub(super) const MAGIC: &[u8] = b"ply";

/// Tells if the first bytes of a file are those of a `.ply` with the comment of this program.
pub(super) fn is_own(start: &[u8]) -> bool {
    let mut lines = start.split(|byte| *byte == b'\n').take_while(|line| !line.starts_with(b"end_header"));
    let comment = format!("comment {MADE_BY}");
    start.starts_with(MAGIC) && lines.any(|line| line == comment.as_bytes())
}

/// Reads either kind. `weights` returns those of the released code's feature network, which is
/// not in its `.ply`.
pub(super) fn from_bytes(
    bytes: &[u8],
    weights: impl FnOnce() -> Result<Option<ReferenceWeights>, Problem>,
) -> Result<Scene, Problem> {
    let table = PlyTable::from_bytes(bytes)?;
    if table.has_column("coefs_0") {
        let own = ReferenceWeights::from_comments(&table.comments);
        let weights = if own.is_some() { own } else { weights()? };
        reference::from_table(&table, weights)
    } else {
        splats::from_table(&table)
    }
}
