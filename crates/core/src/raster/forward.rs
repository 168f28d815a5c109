//! Blending front to back, all channels in one pass (method §4.3); twin of `shaders/raster.wgsl`.

use super::{
    ALPHA_PLANE, FEATURE_PLANE, Images, MAX_ALPHA, MIN_TRANSMITTANCE, TILE,
    bin::Bins,
    project::Splat,
    tile::{
        BASE_CHANNELS, GEOMETRY, MIN_LOG2_ALPHA, Packed, columns_inside, dispatch_channels, exp2,
        gather_tile, log2_alpha, padded_channels, pixel_centres, plane_of, rows_of,
    },
};
use fearless_simd::{f32x16, prelude::*};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Renders splats with `features` ([N][D]; D may be 0) into images of `width × height` pixels.
pub fn raster(
    splats: &[Splat<f32>],
    features: &[f32],
    latent_dim: usize,
    bins: &Bins,
    width: usize,
    height: usize,
) -> Images {
    let channels = padded_channels(latent_dim);
    let packed = Packed::new(splats, features, latent_dim, channels);
    let num_planes = FEATURE_PLANE + latent_dim;
    let mut planes = vec![0.0; num_planes * width * height];
    let mut strips = tile_strips(&mut planes, num_planes, width, height);
    strips.par_iter_mut().enumerate().for_each_init(Scratch::default, |scratch, (tile_y, strip)| {
        let row = StripRow { packed: &packed, bins, tile_y, width };
        dispatch_channels!(channels, raster_strip(&row, scratch, strip.as_mut_slice()));
    });
    Images { width, height, planes }
}

/// Per tile row, the part of every plane it owns.
fn tile_strips(planes: &mut [f32], num_planes: usize, width: usize, height: usize) -> Vec<Vec<&mut [f32]>> {
    let mut strips: Vec<Vec<&mut [f32]>> =
        (0..height.div_ceil(TILE)).map(|_| Vec::with_capacity(num_planes)).collect();
    for plane in planes.chunks_mut((width * height).max(1)) {
        for (strip, rows) in strips.iter_mut().zip(plane.chunks_mut(TILE * width)) {
            strip.push(rows);
        }
    }
    strips
}

/// One row of tiles.
struct StripRow<'a> {
    packed: &'a Packed,
    bins: &'a Bins,
    tile_y: usize,
    width: usize,
}

/// Buffers that a thread reuses from tile to tile.
#[derive(Default)]
struct Scratch {
    /// Packed splats of the tile.
    local: Vec<f32>,
    /// Per row of the tile, offsets into `local` of the splats that reach it, front to back.
    reaching: [Vec<u32>; TILE],
}

#[simd]
fn raster_strip<S: Simd, const CHANNELS: usize>(
    simd: S,
    row: &StripRow<'_>,
    scratch: &mut Scratch,
    strip: &mut [&mut [f32]],
) {
    for tile_x in 0..row.bins.columns {
        let pairs = row.bins.tile(tile_x, row.tile_y);
        if pairs.is_empty() {
            continue;
        }
        gather_tile(row.packed, row.bins, pairs, &mut scratch.local);
        scratch.reaching.iter_mut().for_each(Vec::clear);
        for (k, s) in scratch.local.chunks_exact(row.packed.stride).enumerate() {
            for y in rows_of(s, row.tile_y) {
                scratch.reaching[y].push((k * row.packed.stride) as u32);
            }
        }
        let inside = columns_inside(tile_x, row.width);
        let num_rows = strip[0].len() / row.width;
        for y in 0..num_rows {
            let y_px = (row.tile_y * TILE + y) as f32 + 0.5;
            let out = blend_row::<S, CHANNELS>(simd, &scratch.local, &scratch.reaching[y], tile_x, y_px);
            let at = y * row.width + tile_x * TILE;
            for (k, plane) in strip.iter_mut().enumerate() {
                let values = if k == ALPHA_PLANE {
                    &out[CHANNELS]
                } else {
                    &out[if k < BASE_CHANNELS { k } else { k - 1 }]
                };
                plane[at..at + inside].copy_from_slice(&values[..inside]);
            }
        }
    }
}

/// 16 pixels of one row: blended channels, then alpha. Accumulators stay in registers.
#[simd]
fn blend_row<S: Simd, const CHANNELS: usize>(
    simd: S,
    local: &[f32],
    reaching: &[u32],
    tile_x: usize,
    y_px: f32,
) -> [[f32; TILE]; 21] {
    let zero = f32x16::splat(simd, 0.0);
    let centres = pixel_centres(simd, tile_x);
    let mut sums = [zero; CHANNELS];
    let mut alpha_sum = zero;
    let mut transmittance = f32x16::splat(simd, 1.0);
    for (k, &offset) in reaching.iter().enumerate() {
        let s = &local[offset as usize..offset as usize + GEOMETRY + CHANNELS];
        let log2 = log2_alpha(simd, s, centres - s[0], y_px - s[1]);
        let reached = log2.simd_ge(MIN_LOG2_ALPHA);
        let alpha = reached.select(exp2(simd, log2.max(-126.0)).min(MAX_ALPHA), zero);
        let weight = alpha * transmittance;
        let next = transmittance - weight;
        // A pixel stops for good when its transmittance would fall too low.
        let goes_on = next.simd_ge(MIN_TRANSMITTANCE);
        let weight = goes_on.select(weight, zero);
        transmittance = goes_on.select(next, zero);
        alpha_sum += weight;
        for c in 0..CHANNELS {
            sums[c] = weight.mul_add(f32x16::splat(simd, s[GEOMETRY + c]), sums[c]);
        }
        if k % 8 == 7 && !transmittance.simd_gt(0.0).any_true() {
            break;
        }
    }
    let mut out = [[0.0; TILE]; 21];
    for (o, sum) in out.iter_mut().zip(sums) {
        sum.store_slice(o);
    }
    alpha_sum.store_slice(&mut out[CHANNELS]);
    out
}

const _: () = assert!(plane_of(BASE_CHANNELS) == FEATURE_PLANE);
