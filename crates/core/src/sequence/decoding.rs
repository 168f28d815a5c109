//! The decoder that the videos of one recording share: one at a time is decoded, and frames that came out
//! are kept.

use crate::Result;
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
    running: Option<R>,
    cache: Cache,
}

impl<R> Default for Decoding<R> {
    fn default() -> Self {
        Self { path: PathBuf::new(), running: None, cache: Cache::default() }
    }
}

/// A decoder in the middle of a video.
pub(super) trait Position {
    /// Returns the frame that comes out next.
    fn next_frame(&self) -> usize;
}

impl<R: Position> Decoding<R> {
    /// Returns frame `index` of a video; `None` if the decoder leaves it out. It goes on from where it is if its
    /// next frame is not before `earliest`, and is started anew otherwise. `advance` puts frames that come out
    /// into the cache.
    pub(super) fn frame(
        &mut self,
        path: &Path,
        (earliest, index): (usize, usize),
        start: impl FnOnce() -> Result<R>,
        mut advance: impl FnMut(&mut R, &mut Cache) -> Result<()>,
    ) -> Result<Option<RgbImage>> {
        if self.path != path {
            // What is of another video is forgotten.
            *self = Self { path: path.to_owned(), ..Self::default() };
        }
        if let Some(frame) = self.cache.get(index) {
            return Ok(Some(frame.clone()));
        }
        let is_on_the_way = |running: &R| (earliest..=index).contains(&running.next_frame());
        let mut running = match self.running.take().filter(is_on_the_way) {
            Some(running) => running,
            None => start()?,
        };
        while running.next_frame() <= index {
            advance(&mut running, &mut self.cache)?;
        }
        self.running = Some(running);
        Ok(self.cache.get(index).cloned())
    }
}

/// Cache of decoded frames; those farthest from the last request are removed first.
#[derive(Debug, Default)]
pub(super) struct Cache {
    frames: BTreeMap<usize, RgbImage>,
    bytes: usize,
}

impl Cache {
    fn get(&self, index: usize) -> Option<&RgbImage> {
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
