//! The frames that training compares with, at full and at half size.

use super::loss::Truth;
use crate::{
    Result,
    prepare::{NO_REGION, Prepared},
    raster::project::Sampling,
    sequence::Sequence,
};

/// Ground truth of one frame at one size; the owned form of [`Truth`].
#[derive(Debug)]
pub struct TrainFrame {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Colours r, g, b, plane after plane, 0–255.
    pub colour: Vec<u8>,
    /// Pixels that are supervised: `true` = supervise.
    pub mask: Vec<bool>,
    /// Depth: z in scene units, 0 where unknown; empty if there is no depth.
    pub depth: Vec<f32>,
    /// Row of the latent table for each pixel, [`NO_REGION`] if none; empty if there are no features.
    pub regions: Vec<u16>,
}

impl TrainFrame {
    /// Decodes frame `i` of a recording at full size.
    pub fn load(sequence: &Sequence, prepared: Option<&Prepared>, i: usize) -> Result<Self> {
        let regions = prepared.map(|p| p.regions(i)).transpose()?.flatten();
        Ok(Self {
            width: sequence.width(),
            height: sequence.height(),
            colour: planar(sequence.frame(i)?.as_raw()),
            mask: sequence.mask(i)?.data,
            depth: sequence.depth(i)?.map_or_else(Vec::new, |d| d.data),
            regions: regions.map_or_else(Vec::new, |r| r.data),
        })
    }

    /// Number of columns and rows.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The frame in the form that the loss reads.
    pub fn truth<'a>(&'a self, latents: &'a [f32], typical_depth: f32) -> Truth<'a> {
        Truth {
            width: self.width,
            height: self.height,
            colour: &self.colour,
            mask: &self.mask,
            depth: &self.depth,
            regions: &self.regions,
            latents,
            typical_depth,
        }
    }

    /// Halves the size. Colours are averaged over 2×2 pixels. A pixel is supervised if all four are.
    /// Depth and region are kept if all four agree (depth within 2 %).
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let four = |x: usize, y: usize| {
            let i = 2 * y * self.width + 2 * x;
            [i, i + 1, i + self.width, i + self.width + 1]
        };
        let pixels = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
        let mean = |plane: &[u8], cell: [usize; 4]| {
            ((cell.iter().map(|i| u32::from(plane[*i])).sum::<u32>() + 2) / 4) as u8
        };
        let planes = self.colour.chunks(self.width * self.height);
        let colour = planes.flat_map(|plane| pixels().map(move |(x, y)| mean(plane, four(x, y)))).collect();
        let mask = pixels().map(|(x, y)| four(x, y).iter().all(|&i| self.mask[i])).collect();
        let agreeing_depth = |cell: [usize; 4]| {
            let values = cell.map(|i| self.depth[i]);
            let (low, high) = values.iter().fold((f32::MAX, 0.0f32), |(l, h), v| (l.min(*v), h.max(*v)));
            if low > 0.0 && high <= 1.02 * low { values.iter().sum::<f32>() / 4.0 } else { 0.0 }
        };
        let agreeing_region = |cell: [usize; 4]| {
            let first = self.regions[cell[0]];
            if cell.iter().all(|&i| self.regions[i] == first) { first } else { NO_REGION }
        };
        let depth = if self.depth.is_empty() {
            Vec::new()
        } else {
            pixels().map(|(x, y)| agreeing_depth(four(x, y))).collect()
        };
        let regions = if self.regions.is_empty() {
            Vec::new()
        } else {
            pixels().map(|(x, y)| agreeing_region(four(x, y))).collect()
        };
        Self { width, height, colour, mask, depth, regions }
    }

    /// Keeps only the pixels of `sampling`.
    pub fn sampled(&self, sampling: Sampling) -> Self {
        let (width, height) = sampling.size(self.width, self.height);
        let (colour, (mask, (depth, regions))) = rayon::join(
            || self.picked(&self.colour, sampling),
            || {
                let small = || (self.picked(&self.depth, sampling), self.picked(&self.regions, sampling));
                rayon::join(|| self.picked(&self.mask, sampling), small)
            },
        );
        Self { width, height, colour, mask, depth, regions }
    }

    /// Sampled pixels of one or more planes; empty if `planes` is.
    fn picked<T: Copy>(&self, planes: &[T], sampling: Sampling) -> Vec<T> {
        let [x, y] = sampling.first;
        let of_plane = |plane| {
            let rows = <[T]>::chunks_exact(plane, self.width).skip(y).step_by(sampling.step);
            rows.flat_map(move |row| row[x..].iter().step_by(sampling.step).copied())
        };
        planes.chunks_exact(self.width * self.height).flat_map(of_plane).collect()
    }

    /// Memory that it takes.
    pub(super) fn bytes(&self) -> usize {
        self.colour.len() + self.mask.len() + 4 * self.depth.len() + 2 * self.regions.len()
    }
}

/// Converts r, g, b from interleaved to plane after plane.
pub(super) fn planar(interleaved: &[u8]) -> Vec<u8> {
    (0..3).flat_map(|c| interleaved.iter().skip(c).step_by(3).copied()).collect()
}
