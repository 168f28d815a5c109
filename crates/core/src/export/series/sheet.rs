//! One picture with small overlays of evenly spread frames of the export, and a legend of their colours.

use super::{Series, SeriesPlan};
use crate::{
    export::{
        ExportPrompt, Provenance, caption,
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
        let (legend, legend_rows) = legend(plan.provenance, width);
        let below_tiles = rows * (tile.1 + LINE) + GAP;
        let height = below_tiles + legend_rows * LINE + footer;
        let mut picture = RgbImage::new(width, height);
        for Entry { words, colour, left, row } in &legend {
            caption::write_entry(&mut picture, words, *colour, (*left, below_tiles + row * LINE), WORDS);
        }
        if footer > 0 {
            lettering::write(&mut picture, stamp::WORDS, (GAP, height - LINE), WORDS);
        }
        Self { file, picture, tile, columns, shown }
    }
}

/// A prompt of the legend.
struct Entry {
    words: String,
    colour: [u8; 3],
    left: u32,
    row: u32,
}

/// Returns the places of the prompts in a legend of `width` columns, and the number of its rows: none where
/// no names are wanted.
fn legend(provenance: &Provenance, width: u32) -> (Vec<Entry>, u32) {
    let prompts = if provenance.options.captions { &provenance.prompts[..] } else { &[] };
    let (mut left, mut row) = (GAP, 0);
    let place = |prompt: &ExportPrompt| {
        let words = caption::prompt_words(prompt);
        let taken = caption::entry_px(&words, WORDS) + GAP;
        if left > GAP && left + taken > width {
            (left, row) = (GAP, row + 1);
        }
        let entry = Entry { words, colour: prompt.colour, left, row };
        left += taken;
        entry
    };
    let entries: Vec<Entry> = prompts.iter().map(place).collect();
    let rows = entries.last().map_or(0, |last| last.row + 1);
    (entries, rows)
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
