//! Writing files: completely or not at all, never into or over inputs of a run, and over earlier results
//! only on request.
//!
//! ```text
//! Inputs ─▶ OutputFolder::claim | OutputFile::claim ─▶ write_whole, WholeFile ─▶ finish: the result is in its place
//!                   (lock, record)                     (temporary, sync, rename)
//! ```
//!
//! A folder that this program fills holds a record of its files, `.surgtpgs`. Only files listed in a
//! record are ever replaced.

mod encoded;
mod lock;
mod output;
mod output_file;
mod paths;
mod place;
mod record;
mod temporary;
#[cfg(test)]
mod tests;
mod whole;

pub use encoded::{npy, png};
pub use lock::Lock;
pub use output::{Claim, Earlier, OutputFolder, claim_collection};
pub use output_file::{FileClaim, OutputFile};
pub use paths::{absolute_path, full_path, located_path};
pub use place::{Inputs, require_apart};
pub(crate) use record::{PREPARED_FILE, is_prepared, is_taken, kind_of_result};
pub use record::{is_aside, is_free_folder, unfinished_kind};
pub use whole::{WholeFile, write_whole, write_whole_with};
