//! Common parts of the forward and the backward kernel: packed splats of a tile, and alpha in base 2.

use super::{MIN_ALPHA, TILE, bin::Bins, project::Splat};
use crate::lanes::LANES;
use fearless_simd::{f32x8, prelude::*};
use fearless_simd_macros::simd;
use std::ops::Range;

/// Number of blocks of [`LANES`] pixels in a row of a tile.
pub(super) const HALVES: usize = TILE / LANES;
/// Number of blocks in a tile; the block at row `y` is `y * HALVES + half`.
pub(super) const BLOCKS: usize = TILE * HALVES;

/// Number of blended channels before features: r, g, b, depth.
pub(super) const BASE_CHANNELS: usize = 4;
/// Floats of a packed splat before its channels: centre x, y, the exponent's A, B, C, log₂ opacity, half
/// width and half height.
pub(super) const GEOMETRY: usize = 8;
/// log₂ of [`MIN_ALPHA`].
pub(super) const MIN_LOG2_ALPHA: f32 = -7.994_353_4;

/// All splats, packed for the kernels: [N][GEOMETRY + channels, in whole vectors].
///
/// log₂ alpha = A dx² + B dx dy + C dy² + log₂ opacity, so one base-2 exponential gives alpha.
#[derive(Clone, Debug, Default)]
pub struct Packed {
    data: Vec<f32>,
    pub(super) stride: usize,
    pub(super) latent_dim: usize,
    /// Number of blended channels, padded to a compiled count.
    pub(super) channels: usize,
}

impl Packed {
    /// Packs splats and their `features`, [N][D]; D may be 0.
    pub fn new(splats: &[Splat<f32>], features: &[f32], latent_dim: usize) -> Self {
        let mut packed = Self::default();
        packed.fill(splats, features, latent_dim);
        packed
    }

    /// Does the work of [`Packed::new`] in its own memory.
    pub fn fill(&mut self, splats: &[Splat<f32>], features: &[f32], latent_dim: usize) {
        use rayon::prelude::*;
        self.latent_dim = latent_dim;
        self.channels = padded_channels(latent_dim);
        let stride = (GEOMETRY + self.channels).next_multiple_of(LANES);
        if self.stride != stride {
            // Values left over from another layout would become padding.
            self.data.clear();
            self.stride = stride;
        }
        self.data.resize(splats.len() * stride, 0.0);
        let half_log2_e = 0.5 * std::f32::consts::LOG2_E;
        self.data.par_chunks_mut(stride).with_min_len(2048).enumerate().for_each(|(i, out)| {
            let s = &splats[i];
            if !s.is_visible() {
                return;
            }
            let [a, b, c] = s.conic;
            let geometry = [
                s.centre[0],
                s.centre[1],
                -half_log2_e * a,
                -2.0 * half_log2_e * b,
                -half_log2_e * c,
                s.opacity.log2(),
                s.extent[0],
                s.extent[1],
            ];
            out[..GEOMETRY].copy_from_slice(&geometry);
            out[GEOMETRY..GEOMETRY + 3].copy_from_slice(&s.colour);
            out[GEOMETRY + 3] = s.depth;
            let features = &features[i * latent_dim..(i + 1) * latent_dim];
            out[GEOMETRY + BASE_CHANNELS..][..latent_dim].copy_from_slice(features);
        });
    }
}

/// Channel counts that kernels are compiled for; the blended channels are padded up to one of them.
const KERNEL_CHANNELS: [usize; 4] = [4, 7, 12, 20];

/// Smallest compiled channel count for a latent dimension (at most 16).
fn padded_channels(latent_dim: usize) -> usize {
    let needed = BASE_CHANNELS + latent_dim;
    KERNEL_CHANNELS.into_iter().find(|&c| c >= needed).unwrap_or(KERNEL_CHANNELS[3])
}

/// Runs `$kernel::<_, CHANNELS>(simd, …)` for the padded channel count on the best instruction set.
macro_rules! dispatch_channels {
    ($channels:expr, $kernel:ident($($argument:expr),* $(,)?)) => {{
        let level = fearless_simd::Level::new();
        match $channels {
            4 => fearless_simd::dispatch!(level, simd => $kernel::<_, 4>(simd, $($argument),*)),
            7 => fearless_simd::dispatch!(level, simd => $kernel::<_, 7>(simd, $($argument),*)),
            12 => fearless_simd::dispatch!(level, simd => $kernel::<_, 12>(simd, $($argument),*)),
            _ => fearless_simd::dispatch!(level, simd => $kernel::<_, 20>(simd, $($argument),*)),
        }
    }};
}
pub(super) use dispatch_channels;

/// Plane of [`super::Images`] that the blended channel belongs to; alpha lies between depth and features.
pub(super) const fn plane_of(channel: usize) -> usize {
    if channel < BASE_CHANNELS { channel } else { channel + 1 }
}

/// Rows of a tile (0..16) that a packed splat reaches, and halves of the rows.
pub(super) fn blocks_of(s: &[f32], tile_x: usize, tile_y: usize) -> (Range<usize>, Range<usize>) {
    let reach = |centre: f32, half: f32, tile: usize| {
        let centre = centre - ((tile * TILE) as f32 + 0.5);
        // Rounds without `ceil` and `floor`, which are function calls on processors for which SSE4.1 is
        // not assumed.
        let low = (centre - half).clamp(0.0, TILE as f32);
        let first = low as usize + usize::from((low as usize as f32) < low);
        let high = (centre + half + 1.0).clamp(0.0, TILE as f32);
        first..high as usize
    };
    let columns = reach(s[0], s[6], tile_x);
    (reach(s[1], s[7], tile_y), columns.start / LANES..columns.end.div_ceil(LANES))
}

/// log₂ alpha of one packed splat along a row, at the distance `dx` from its centre and `dy` of the row.
#[simd]
pub(super) fn log2_alpha<S: Simd>(simd: S, s: &[f32], dx: f32x8<S>, dy: f32) -> f32x8<S> {
    let along = dx.mul_add(f32x8::splat(simd, s[2]), f32x8::splat(simd, s[3] * dy));
    dx.mul_add(along, f32x8::splat(simd, s[4] * dy * dy + s[5]))
}

/// x of the pixel centres of one half of a tile row.
#[simd]
pub(super) fn pixel_centres<S: Simd>(simd: S, tile_x: usize, half: usize) -> f32x8<S> {
    f32x8::from_fn(simd, |i| (tile_x * TILE + half * LANES + i) as f32 + 0.5)
}

/// Number of pixels of a block that lie inside the image: all but at the right edge.
pub(super) fn columns_inside(tile_x: usize, half: usize, width: usize) -> usize {
    LANES.min(width.saturating_sub(tile_x * TILE + half * LANES))
}

/// Copies the packed splats of a tile next to each other.
pub(super) fn gather_tile(packed: &Packed, bins: &Bins, pairs: Range<usize>, local: &mut Vec<f32>) {
    let pairs = &bins.splat[pairs];
    local.resize(pairs.len() * packed.stride, 0.0);
    let vectors = packed.stride / LANES;
    let (from, to) = (packed.data.as_chunks::<LANES>().0, local.as_chunks_mut::<LANES>().0);
    // Copies vector by vector: a copy whose length is unknown to the compiler would be a function call
    // per splat.
    for (&i, to) in pairs.iter().zip(to.chunks_exact_mut(vectors)) {
        to.iter_mut().zip(&from[i as usize * vectors..]).for_each(|(to, from)| *to = *from);
    }
}

const _: () = assert!(MIN_ALPHA > 0.0039 && MIN_ALPHA < 0.003_922);
