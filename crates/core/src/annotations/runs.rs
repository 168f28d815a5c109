//! Run lengths of a mask as COCO files and files of marks hold them.

use crate::mask::{Runs, compressed, decompressed};

/// Run lengths of the columns of a mask, as they are written.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub(crate) struct RunsEntry {
    /// Height and width.
    size: [usize; 2],
    counts: Counts,
}

/// Lengths of runs, compressed or as numbers.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
enum Counts {
    Compressed(String),
    Numbers(Vec<u32>),
}

impl From<&Runs> for RunsEntry {
    fn from(runs: &Runs) -> Self {
        let (width, height) = runs.size();
        Self { size: [height, width], counts: Counts::Compressed(compressed(runs.lengths())) }
    }
}

impl RunsEntry {
    /// Returns the runs; `None` if they do not come to the size.
    pub(crate) fn runs(&self) -> Option<Runs> {
        let [height, width] = self.size;
        match &self.counts {
            Counts::Compressed(text) => Runs::new(width, height, &decompressed(text)?),
            Counts::Numbers(lengths) => Runs::new(width, height, lengths),
        }
    }
}
