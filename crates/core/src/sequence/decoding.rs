//! The decoder that the videos of one recording share: one at a time is decoded, and frames that came out
//! are kept.

use image::RgbImage;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Memory for decoded frames of one recording: 100 of 640×512 pixels. Stepping back further begins at a key
/// frame again, once for as many frames.
const CACHE_BYTES: usize = 96 << 20;

/// A decoder in the middle of a video, `R`, and what came out of it.
#[derive(Debug)]
pub(super) struct Decoding<R> {
    /// The video that is decoded.
    path: PathBuf,
    pub(super) running: Option<R>,
    pub(super) cache: Cache,
}

impl<R> Default for Decoding<R> {
    fn default() -> Self {
        Self { path: PathBuf::new(), running: None, cache: Cache::default() }
    }
}

impl<R> Decoding<R> {
    /// Forgets what is of another video than this one.
    pub(super) fn turn_to(&mut self, path: &Path) {
        if self.path != path {
            *self = Self { path: path.to_owned(), ..Self::default() };
        }
    }
}

/// Cache of decoded frames; those farthest from the last request are removed first.
#[derive(Debug, Default)]
pub(super) struct Cache {
    frames: BTreeMap<usize, RgbImage>,
    bytes: usize,
}

impl Cache {
    pub(super) fn get(&self, index: usize) -> Option<&RgbImage> {
        self.frames.get(&index)
    }

    /// Adds a frame that was decoded on the way to `wanted`.
    pub(super) fn insert(&mut self, index: usize, frame: RgbImage, wanted: usize) {
        self.bytes += frame.as_raw().len();
        if let Some(old) = self.frames.insert(index, frame) {
            self.bytes -= old.as_raw().len();
        }
        while self.bytes > CACHE_BYTES && self.frames.len() > 1 {
            let (Some((&low, _)), Some((&high, _))) =
                (self.frames.first_key_value(), self.frames.last_key_value())
            else {
                return;
            };
            let farthest = if wanted.abs_diff(low) > wanted.abs_diff(high) { low } else { high };
            self.bytes -= self.frames.remove(&farthest).map_or(0, |f| f.as_raw().len());
        }
    }
}
