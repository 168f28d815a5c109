//! A small animated GIF of the overlays, for slides.

use super::{Series, SeriesPlan};
use crate::{
    export::{
        frame::{FrameContent, small_size},
        stamp,
    },
    files::WholeFile,
};
use std::io::{self, BufWriter};

/// Largest number of columns.
const MAX_WIDTH: u32 = 480;
/// Largest number of pictures; of longer exports every second, third, ... frame is shown.
const MAX_PICTURES: usize = 250;
/// Most pictures per second: viewers slow down faster GIFs.
const MAX_SPEED: f64 = 50.0;
/// Speed of the colour choice, from 1 (best and slowest) to 30.
const COLOUR_SPEED: i32 = 10;

pub(super) struct Gif {
    encoder: gif::Encoder<BufWriter<WholeFile>>,
    /// One in this many frames is shown.
    step: usize,
    /// Times at which frames appear, and the end, hundredths of a second. Rounding errors do not add up.
    starts: Vec<f64>,
    added: usize,
}

impl Gif {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Self> {
        let size = small_size((plan.size.0 as u32, plan.size.1 as u32), MAX_WIDTH);
        let speed = f64::from(plan.provenance.playing_speed());
        let step = plan.frames.len().div_ceil(MAX_PICTURES).max((speed / MAX_SPEED).ceil() as usize);
        let too_large = |_| io::Error::other("the frames are too large for a GIF");
        let (width, height) =
            (u16::try_from(size.0).map_err(too_large)?, u16::try_from(size.1).map_err(too_large)?);
        let mut encoder =
            gif::Encoder::new(BufWriter::new(file), width, height, &[]).map_err(io::Error::other)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(io::Error::other)?;
        let starts = plan.provenance.starts(plan.frames).into_iter().map(|s| (100.0 * s).round()).collect();
        Ok(Self { encoder, step, starts, added: 0 })
    }
}

impl Series for Gif {
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        let i = self.added;
        self.added += 1;
        if !i.is_multiple_of(self.step) {
            return Ok(());
        }
        let mut small = frame.small_overlay(MAX_WIDTH);
        if frame.provenance.options.captions {
            frame.write_caption(&mut small);
        }
        if frame.provenance.options.stamp {
            stamp::stamp(&mut small);
        }
        let mut picture = gif::Frame::from_rgb_speed(
            small.width() as u16,
            small.height() as u16,
            small.as_raw(),
            COLOUR_SPEED,
        );
        let [start, end] = [i, i + self.step].map(|i| self.starts[i.min(self.starts.len() - 1)]);
        let duration = end - start;
        picture.delay = duration.max(100.0 / MAX_SPEED) as u16;
        self.encoder.write_frame(&picture).map_err(io::Error::other)
    }

    fn finish(self: Box<Self>) -> io::Result<WholeFile> {
        Ok(self.encoder.into_inner().map_err(io::Error::other)?.into_inner()?)
    }
}
