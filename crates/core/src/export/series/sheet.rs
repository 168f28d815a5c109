//! One picture with small overlays of evenly spread frames of the export.

use super::{Series, SeriesPlan};
use crate::{
    export::{
        caption,
        frame::{FrameContent, small_size},
        lettering, pictures, stamp,
    },
    files::WholeFile,
};
use image::{RgbImage, imageops};
use std::io::{self, Write};

/// Largest number of tiles; [`IN_A_ROW`] of them stand side by side.
const MAX_TILES: usize = 24;
const IN_A_ROW: usize = 6;
/// Largest number of columns of a tile, px.
const TILE_WIDTH: u32 = 320;
/// Space between tiles, px.
const GAP: u32 = 4;
/// Height of the words below a tile, px.
const WORDS: u32 = 16;
/// Height of the line below a tile, px.
const LINE: u32 = WORDS + GAP;

pub(super) struct Sheet {
    file: WholeFile,
    picture: RgbImage,
    tile: (u32, u32),
    columns: usize,
    /// Frames that are shown, in order.
    shown: Vec<usize>,
}

impl Sheet {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> Self {
        let count = plan.frames.len();
        let tiles = count.min(MAX_TILES);
        // The first and the last frame are included.
        let shown = (0..tiles).map(|k| plan.frames[k * (count - 1) / (tiles - 1).max(1)]).collect();
        let tile = small_size((plan.size.0 as u32, plan.size.1 as u32), TILE_WIDTH);
        let columns = tiles.min(IN_A_ROW);
        let rows = tiles.div_ceil(columns) as u32;
        let footer = if plan.provenance.options.stamp { LINE } else { 0 };
        let width = columns as u32 * (tile.0 + GAP) + GAP;
        let height = rows * (tile.1 + LINE) + GAP + footer;
        let mut picture = RgbImage::new(width, height);
        if footer > 0 {
            lettering::write(&mut picture, stamp::WORDS, (GAP, height - LINE), WORDS);
        }
        Self { file, picture, tile, columns, shown }
    }
}

impl Series for Sheet {
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        let Some(k) = self.shown.iter().position(|&shown| shown == frame.frame) else { return Ok(()) };
        let (column, row) = ((k % self.columns) as u32, (k / self.columns) as u32);
        let left = GAP + column * (self.tile.0 + GAP);
        let top = GAP + row * (self.tile.1 + LINE);
        imageops::replace(&mut self.picture, &frame.small_overlay(TILE_WIDTH), left.into(), top.into());
        let words = caption::frame_words(frame.frame, frame.provenance.shown_seconds(frame.frame));
        lettering::write(&mut self.picture, &words, (left, top + self.tile.1 + GAP), WORDS);
        Ok(())
    }

    fn finish(self: Box<Self>) -> io::Result<WholeFile> {
        let mut file = self.file;
        let bytes = pictures::png(self.picture).map_err(io::Error::other)?;
        file.write_all(&bytes)?;
        Ok(file)
    }
}
