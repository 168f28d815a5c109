//! Masks of a frame on disk: JSON with run lengths as pycocotools reads them.

use super::{BitMask, FoundMask, FrameMasks};
use crate::{
    Error, Result,
    files::write_whole,
    mask,
    reading::{MOST_BYTES, read_regular},
};
use std::path::Path;

const AGAIN: &str = "Remove the file; its masks are then made anew.";

/// Contents of a file.
#[derive(serde::Serialize, serde::Deserialize)]
struct Stored {
    /// Key of everything that the masks were made from.
    key: String,
    width: usize,
    height: usize,
    default: Vec<Entry>,
    small: Vec<Entry>,
    medium: Vec<Entry>,
    large: Vec<Entry>,
}

/// One mask; the names are those of Segment Anything's records.
#[derive(serde::Serialize, serde::Deserialize)]
struct Entry {
    segmentation: Segmentation,
    predicted_iou: f32,
    stability_score: f32,
}

/// Run lengths down the columns, compressed as COCO does, with [rows, columns].
#[derive(serde::Serialize, serde::Deserialize)]
struct Segmentation {
    size: [usize; 2],
    counts: String,
}

impl FrameMasks {
    /// Writes the masks to `path`; `key` identifies everything that they were made from.
    pub fn save(&self, path: &Path, key: &str) -> Result<()> {
        let entry = |found: &FoundMask| Entry {
            segmentation: Segmentation {
                size: [self.height, self.width],
                counts: mask::compressed(&mask::column_runs(&found.mask.to_mask())),
            },
            predicted_iou: found.predicted_iou,
            stability_score: found.stability,
        };
        let [default, small, medium, large] = self.levels.each_ref().map(|l| l.iter().map(entry).collect());
        let (width, height) = (self.width, self.height);
        let stored = Stored { key: key.to_owned(), width, height, default, small, medium, large };
        let text = serde_json::to_vec(&stored)
            .map_err(|e| Error::input_at(path, format!("the masks cannot be written: {e}"), ""))?;
        write_whole(path, &text)
    }

    /// Reads the masks that were saved under `key`; `None` if there is no file or it has another key. A
    /// damaged file is an error.
    pub fn load(path: &Path, key: &str) -> Result<Option<Self>> {
        let text = match read_regular(path, MOST_BYTES) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io("read the masks", path, e)),
        };
        let stored: Stored = serde_json::from_slice(&text)
            .map_err(|e| Error::input_at(path, format!("the masks cannot be understood: {e}"), AGAIN))?;
        if stored.key != key {
            return Ok(None);
        }
        let (width, height) = (stored.width, stored.height);
        let found = |entry: Entry| {
            let runs = mask::decompressed(&entry.segmentation.counts)?;
            let mask = BitMask::of(&mask::Runs::new(width, height, &runs)?.mask())?;
            Some(FoundMask { mask, predicted_iou: entry.predicted_iou, stability: entry.stability_score })
        };
        let level = |entries: Vec<Entry>| entries.into_iter().map(found).collect::<Option<Vec<_>>>();
        let levels = [stored.default, stored.small, stored.medium, stored.large].map(level);
        let [Some(default), Some(small), Some(medium), Some(large)] = levels else {
            return Err(Error::input_at(path, "the masks do not have the size of the image", AGAIN));
        };
        Ok(Some(Self { width, height, levels: [default, small, medium, large] }))
    }
}
