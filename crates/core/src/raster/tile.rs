//! What the forward and the backward kernel share: packed splats of a tile, and alpha in base 2.

use super::{MIN_ALPHA, TILE, bin::Bins, project::Splat};
use fearless_simd::{f32x16, prelude::*};
use fearless_simd_macros::simd;

/// Blended channels before features: r, g, b, depth.
pub(super) const BASE_CHANNELS: usize = 4;
/// Floats of a packed splat before its channels: centre x, y, the exponent's A, B, C and log₂ opacity, half height.
pub(super) const GEOMETRY: usize = 7;
/// log₂ of [`MIN_ALPHA`].
pub(super) const MIN_LOG2_ALPHA: f32 = -7.994_353_4;

/// All splats, packed for the kernels: [N][GEOMETRY + channels].
///
/// log₂ alpha = A dx² + B dx dy + C dy² + log₂ opacity, so one base-2 exponential gives alpha.
pub(super) struct Packed {
    pub data: Vec<f32>,
    pub stride: usize,
}

impl Packed {
    pub(super) fn new(splats: &[Splat<f32>], features: &[f32], latent_dim: usize, channels: usize) -> Self {
        use rayon::prelude::*;
        let stride = GEOMETRY + channels;
        let mut data = vec![0.0; splats.len() * stride];
        let half_log2_e = 0.5 * std::f32::consts::LOG2_E;
        data.par_chunks_mut(stride).with_min_len(2048).enumerate().for_each(|(i, out)| {
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
                s.extent[1],
            ];
            out[..GEOMETRY].copy_from_slice(&geometry);
            out[GEOMETRY..GEOMETRY + 3].copy_from_slice(&s.colour);
            out[GEOMETRY + 3] = s.depth;
            let features = &features[i * latent_dim..(i + 1) * latent_dim];
            out[GEOMETRY + BASE_CHANNELS..][..latent_dim].copy_from_slice(features);
        });
        Self { data, stride }
    }

    pub(super) fn splat(&self, i: u32) -> &[f32] {
        &self.data[i as usize * self.stride..(i as usize + 1) * self.stride]
    }
}

/// Channel counts that kernels are compiled for; the blended channels are padded up to one of them.
pub(super) const KERNEL_CHANNELS: [usize; 5] = [4, 7, 8, 12, 20];

/// The smallest compiled channel count for a latent dimension (at most 16).
pub(super) fn padded_channels(latent_dim: usize) -> usize {
    let needed = BASE_CHANNELS + latent_dim;
    KERNEL_CHANNELS.into_iter().find(|&c| c >= needed).unwrap_or(KERNEL_CHANNELS[4])
}

/// Runs `$kernel::<_, CHANNELS>(simd, …)` for the padded channel count on the best instruction set.
macro_rules! dispatch_channels {
    ($channels:expr, $kernel:ident($($argument:expr),* $(,)?)) => {{
        let level = fearless_simd::Level::new();
        match $channels {
            4 => fearless_simd::dispatch!(level, simd => $kernel::<_, 4>(simd, $($argument),*)),
            7 => fearless_simd::dispatch!(level, simd => $kernel::<_, 7>(simd, $($argument),*)),
            8 => fearless_simd::dispatch!(level, simd => $kernel::<_, 8>(simd, $($argument),*)),
            12 => fearless_simd::dispatch!(level, simd => $kernel::<_, 12>(simd, $($argument),*)),
            _ => fearless_simd::dispatch!(level, simd => $kernel::<_, 20>(simd, $($argument),*)),
        }
    }};
}
pub(super) use dispatch_channels;

/// The plane of [`super::Images`] that blended channel `c` goes to: alpha sits between depth and features.
pub(super) const fn plane_of(channel: usize) -> usize {
    if channel < BASE_CHANNELS { channel } else { channel + 1 }
}

/// Rows of a tile (0..16) that a packed splat reaches.
pub(super) fn rows_of(s: &[f32], tile_y: usize) -> std::ops::Range<usize> {
    let (centre, half_height) = (s[1] - ((tile_y * TILE) as f32 + 0.5), s[6]);
    let first = (centre - half_height).ceil().clamp(0.0, TILE as f32);
    let end = ((centre + half_height).floor() + 1.0).clamp(0.0, TILE as f32);
    first as usize..end as usize
}

/// 2^x for x in [-126, 1], relative error below 3e-7: nearest integer by the magic number, then a polynomial.
#[simd]
pub(super) fn exp2<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    const MAGIC: f32 = 12_582_912.0;
    let splat = |v: f32| f32x16::splat(simd, v);
    let shifted = x + MAGIC;
    let r = x - (shifted - MAGIC);
    // ln(2)^k / k! from k = 6 down to 0.
    let mut p = splat(1.540_353e-4);
    for c in [1.333_356e-3, 9.618_129e-3, 5.550_411e-2, 2.402_265e-1, std::f32::consts::LN_2, 1.0] {
        p = p.mul_add(r, splat(c));
    }
    let exponent: fearless_simd::u32x16<S> = shifted.bitcast();
    let mantissa: fearless_simd::u32x16<S> = p.bitcast();
    (mantissa + (exponent << 23)).bitcast()
}

/// log₂ alpha of one packed splat along a row: `dx` from its centre, `dy` at the row.
#[simd]
pub(super) fn log2_alpha<S: Simd>(simd: S, s: &[f32], dx: f32x16<S>, dy: f32) -> f32x16<S> {
    let along = dx.mul_add(f32x16::splat(simd, s[2]), f32x16::splat(simd, s[3] * dy));
    dx.mul_add(along, f32x16::splat(simd, s[4] * dy * dy + s[5]))
}

/// x of the 16 pixel centres of a tile row.
#[simd]
pub(super) fn pixel_centres<S: Simd>(simd: S, tile_x: usize) -> f32x16<S> {
    f32x16::from_fn(simd, |i| (tile_x * TILE + i) as f32 + 0.5)
}

/// Pixels of a tile's columns that lie inside the image (16 but at the right edge).
pub(super) fn columns_inside(tile_x: usize, width: usize) -> usize {
    TILE.min(width - tile_x * TILE)
}

/// Copies the packed splats of a tile next to each other.
pub(super) fn gather_tile(packed: &Packed, bins: &Bins, pairs: std::ops::Range<usize>, local: &mut Vec<f32>) {
    local.clear();
    for &i in &bins.splat[pairs] {
        local.extend_from_slice(packed.splat(i));
    }
}

const _: () = assert!(MIN_ALPHA > 0.0039 && MIN_ALPHA < 0.003_922);
