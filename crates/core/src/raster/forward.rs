//! Blending front to back, all channels in one pass (method §4.3); twin of `shaders/raster.wgsl`.

use super::{
    ALPHA_PLANE, FEATURE_PLANE, Images, MAX_ALPHA, MIN_TRANSMITTANCE, TILE,
    bin::Bins,
    tile::{
        BASE_CHANNELS, BLOCKS, GEOMETRY, HALVES, MIN_LOG2_ALPHA, Packed, blocks_of, columns_inside,
        dispatch_channels, gather_tile, log2_alpha, pixel_centres, plane_of,
    },
};
use crate::lanes::{LANES, exp2};
use fearless_simd::{f32x8, prelude::*};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Renders splats into images of `width × height` pixels.
pub fn raster(packed: &Packed, bins: &Bins, width: usize, height: usize) -> Images {
    let mut images = Images { width, height, planes: Vec::new() };
    raster_into(packed, bins, &mut images);
    images
}

/// Does the work of [`raster`] into images whose size is given and whose memory is reused.
pub fn raster_into(packed: &Packed, bins: &Bins, images: &mut Images) {
    let num_planes = FEATURE_PLANE + packed.latent_dim;
    let (width, height) = (images.width, images.height);
    images.planes.resize(num_planes * width * height, 0.0);
    let mut strips = tile_strips(&mut images.planes, num_planes, width, height);
    strips.par_iter_mut().enumerate().for_each_init(Scratch::default, |scratch, (tile_y, strip)| {
        let row = StripRow { packed, bins, tile_y, width };
        dispatch_channels!(packed.channels, raster_strip(&row, scratch, strip.as_mut_slice()));
    });
}

/// Splits every plane into the parts of the tile rows.
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

/// Memory of one row of tiles.
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
    /// Offsets into `local` of the splats that reach each block, front to back: [BLOCKS][splats of the tile].
    reaching: Vec<u32>,
    /// Number of splats that reach each block.
    counts: [usize; BLOCKS],
}

impl Scratch {
    fn load(&mut self, row: &StripRow<'_>, tile_x: usize) {
        let pairs = row.bins.tile(tile_x, row.tile_y);
        let most = pairs.len();
        gather_tile(row.packed, row.bins, pairs, &mut self.local);
        self.counts.fill(0);
        if self.reaching.len() < BLOCKS * most {
            self.reaching.resize(BLOCKS * most, 0);
        }
        let stride = row.packed.stride;
        for (k, s) in self.local.chunks_exact(stride).enumerate() {
            let (rows, halves) = blocks_of(s, tile_x, row.tile_y);
            for y in rows {
                for half in halves.clone() {
                    let block = y * HALVES + half;
                    self.reaching[block * most + self.counts[block]] = (k * stride) as u32;
                    self.counts[block] += 1;
                }
            }
        }
    }

    fn reaching(&self, block: usize, most: usize) -> &[u32] {
        &self.reaching[block * most..block * most + self.counts[block]]
    }
}

#[simd]
fn raster_strip<S: Simd, const CHANNELS: usize>(
    simd: S,
    row: &StripRow<'_>,
    scratch: &mut Scratch,
    strip: &mut [&mut [f32]],
) {
    let num_rows = strip[0].len() / row.width;
    for tile_x in 0..row.bins.columns {
        let most = row.bins.tile(tile_x, row.tile_y).len();
        scratch.load(row, tile_x);
        for block in 0..num_rows * HALVES {
            let (y, half) = (block / HALVES, block % HALVES);
            let inside = columns_inside(tile_x, half, row.width);
            if inside == 0 {
                continue;
            }
            let reaching = scratch.reaching(block, most);
            let at = y * row.width + tile_x * TILE + half * LANES;
            if reaching.is_empty() {
                strip.iter_mut().for_each(|plane| plane[at..at + inside].fill(0.0));
                continue;
            }
            let y_px = (row.tile_y * TILE + y) as f32 + 0.5;
            let centres = pixel_centres(simd, tile_x, half);
            let out = blend_block::<S, CHANNELS>(simd, &scratch.local, reaching, centres, y_px);
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

/// Blends the pixels of one block: blended channels, then alpha. Accumulators stay in registers.
#[simd]
fn blend_block<S: Simd, const CHANNELS: usize>(
    simd: S,
    local: &[f32],
    reaching: &[u32],
    centres: f32x8<S>,
    y_px: f32,
) -> [[f32; LANES]; 21] {
    let zero = f32x8::splat(simd, 0.0);
    let mut sums = [zero; CHANNELS];
    let mut alpha_sum = zero;
    let mut transmittance = f32x8::splat(simd, 1.0);
    for (k, &offset) in reaching.iter().enumerate() {
        let s = &local[offset as usize..offset as usize + GEOMETRY + CHANNELS];
        let log2 = log2_alpha(simd, s, centres - s[0], y_px - s[1]);
        let reached = log2.simd_ge(MIN_LOG2_ALPHA);
        let alpha = reached.select(exp2(simd, log2).min(MAX_ALPHA), zero);
        let weight = alpha * transmittance;
        let next = transmittance - weight;
        // A pixel stops for good if its transmittance would fall too low.
        let goes_on = next.simd_ge(MIN_TRANSMITTANCE);
        let weight = goes_on.select(weight, zero);
        transmittance = goes_on.select(next, zero);
        alpha_sum += weight;
        for c in 0..CHANNELS {
            sums[c] = weight.mul_add(f32x8::splat(simd, s[GEOMETRY + c]), sums[c]);
        }
        if k % 8 == 7 && !transmittance.simd_gt(0.0).any_true() {
            break;
        }
    }
    let mut out = [[0.0; LANES]; 21];
    for (o, sum) in out.iter_mut().zip(sums) {
        sum.store_slice(o);
    }
    alpha_sum.store_slice(&mut out[CHANNELS]);
    out
}

const _: () = assert!(plane_of(BASE_CHANNELS) == FEATURE_PLANE);
