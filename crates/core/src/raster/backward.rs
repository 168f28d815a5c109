//! From gradients of the images to gradients of the splats. Each tile replays its splats front to back
//! and writes one slot per splat–tile pair. The slots are then summed in fixed order. There are no
//! atomics, so the sums are the same for any thread count.
//!
//! For any number of channels the replay needs two numbers per pixel: transmittance T and `rest` = Σ over
//! the splats not yet visited of wⱼ (cⱼ · g), which starts as (image · g). Then ∂L/∂αᵢ = Tᵢ (cᵢ · g) −
//! rest / (1 − αᵢ).

use super::{
    ALPHA_PLANE, FEATURE_PLANE, Images, MAX_ALPHA, MIN_TRANSMITTANCE, TILE,
    bin::Bins,
    project::{Splat, SplatGradient},
    tile::{
        BASE_CHANNELS, BLOCKS, GEOMETRY, HALVES, MIN_LOG2_ALPHA, Packed, blocks_of, columns_inside,
        dispatch_channels, gather_tile, log2_alpha, pixel_centres,
    },
};
use crate::lanes::{LANES, exp2, load_block};
use fearless_simd::{f32x8, prelude::*};
use fearless_simd_macros::simd;
use rayon::prelude::*;
use std::ops::Range;

/// Floats of a slot before its channels: the moments 1, x, y, xx, xy, yy of ∂L/∂(exponent) about the
/// splat's centre.
const MOMENTS: usize = 6;

/// Number of floats of a slot.
fn slot_width(channels: usize) -> usize {
    (MOMENTS + channels).next_multiple_of(LANES)
}

/// Gradients of every splat (and of its features, [N][D]) given `g_planes`, shaped as `images.planes`.
pub fn raster_backward(
    splats: &[Splat<f32>],
    packed: &Packed,
    bins: &Bins,
    images: &Images,
    g_planes: &[f32],
) -> (Vec<SplatGradient<f32>>, Vec<f32>) {
    raster_backward_with(splats, packed, bins, images, g_planes, &mut Vec::new())
}

/// Does the work of [`raster_backward`] with the caller's memory for the slots.
pub fn raster_backward_with(
    splats: &[Splat<f32>],
    packed: &Packed,
    bins: &Bins,
    images: &Images,
    g_planes: &[f32],
    slots: &mut Vec<f32>,
) -> (Vec<SplatGradient<f32>>, Vec<f32>) {
    let slot = slot_width(packed.channels);
    slots.resize(bins.splat.len() * slot, 0.0);
    let job = BackwardInput { packed, bins, images, g_planes };
    tile_row_slots(slots, bins, slot).into_par_iter().enumerate().for_each_init(
        Scratch::default,
        |scratch, (tile_y, slots)| {
            dispatch_channels!(packed.channels, replay_strip(&job, scratch, tile_y, slots));
        },
    );
    gather(splats, bins, slots, slot, packed.latent_dim)
}

/// Splits the slots (sorted by tile) into one piece per tile row.
fn tile_row_slots<'a>(mut slots: &'a mut [f32], bins: &Bins, slot: usize) -> Vec<&'a mut [f32]> {
    (0..bins.rows)
        .map(|row| {
            let pairs = (bins.first[(row + 1) * bins.columns] - bins.first[row * bins.columns]) as usize;
            let (piece, rest) = std::mem::take(&mut slots).split_at_mut(pairs * slot);
            slots = rest;
            piece
        })
        .collect()
}

struct BackwardInput<'a> {
    packed: &'a Packed,
    bins: &'a Bins,
    images: &'a Images,
    g_planes: &'a [f32],
}

/// Buffers that a thread reuses from tile to tile.
#[derive(Default)]
struct Scratch {
    /// Packed splats of the tile.
    local: Vec<f32>,
    /// State of each block: gradient of each blended channel, then of alpha; then T and `rest`.
    /// [BLOCKS][channels + 3][LANES].
    state: Vec<f32>,
}

#[simd]
fn replay_strip<S: Simd, const CHANNELS: usize>(
    simd: S,
    job: &BackwardInput<'_>,
    scratch: &mut Scratch,
    tile_y: usize,
    slots: &mut [f32],
) {
    let slot = slot_width(CHANNELS);
    let first_pair = job.bins.first[tile_y * job.bins.columns] as usize;
    for tile_x in 0..job.bins.columns {
        let pairs = job.bins.tile(tile_x, tile_y);
        if pairs.is_empty() {
            continue;
        }
        let slots = &mut slots[(pairs.start - first_pair) * slot..(pairs.end - first_pair) * slot];
        let live = load_tile::<CHANNELS>(job, scratch, tile_x, tile_y);
        gather_tile(job.packed, job.bins, pairs, &mut scratch.local);
        replay_tile::<S, CHANNELS>(simd, job.packed.stride, scratch, (tile_x, tile_y), live, slots);
    }
}

/// Loads the gradients of a tile and starts its state. Returns a bit for each block that has gradients.
fn load_tile<const CHANNELS: usize>(
    job: &BackwardInput<'_>,
    scratch: &mut Scratch,
    tile_x: usize,
    tile_y: usize,
) -> u32 {
    let (width, height) = (job.images.width, job.images.height);
    let n = width * height;
    scratch.state.clear();
    scratch.state.resize(BLOCKS * (CHANNELS + 3) * LANES, 0.0);
    let mut live = 0;
    for (block, state) in scratch.state.chunks_exact_mut((CHANNELS + 3) * LANES).enumerate() {
        let (y, half) = (tile_y * TILE + block / HALVES, block % HALVES);
        let inside = columns_inside(tile_x, half, width);
        if y >= height || inside == 0 {
            continue;
        }
        let mut rest = [0.0f32; LANES];
        let mut largest = [0.0f32; LANES];
        for plane in 0..FEATURE_PLANE + job.packed.latent_dim {
            let channel = match plane {
                ALPHA_PLANE => CHANNELS,
                p if p < BASE_CHANNELS => p,
                p => p - 1,
            };
            let from = plane * n + y * width + tile_x * TILE + half * LANES;
            let g = load_block(&job.g_planes[from..], inside);
            let value = load_block(&job.images.planes[from..], inside);
            for i in 0..LANES {
                rest[i] += g[i] * value[i];
                largest[i] = g[i].abs().max(largest[i]);
            }
            state[channel * LANES..(channel + 1) * LANES].copy_from_slice(&g);
        }
        state[(CHANNELS + 1) * LANES..(CHANNELS + 2) * LANES].fill(1.0);
        state[(CHANNELS + 2) * LANES..].copy_from_slice(&rest);
        // Not `largest > 0`: NaN must reach the gradients, so that it is noticed there.
        live |= u32::from(largest.iter().zip(&rest).any(|(g, r)| *g != 0.0 || r.is_nan())) << block;
    }
    live
}

#[simd]
fn replay_tile<S: Simd, const CHANNELS: usize>(
    simd: S,
    stride: usize,
    scratch: &mut Scratch,
    (tile_x, tile_y): (usize, usize),
    mut live: u32,
    slots: &mut [f32],
) {
    let centres: [f32x8<S>; HALVES] = [pixel_centres(simd, tile_x, 0), pixel_centres(simd, tile_x, 1)];
    let mut out = slots.chunks_exact_mut(slot_width(CHANNELS));
    for s in scratch.local.chunks_exact(stride) {
        // No pixel is supervised, or all are covered by the splats in front.
        if live == 0 {
            break;
        }
        let Some(out) = out.next() else { break };
        let (rows, halves) = blocks_of(s, tile_x, tile_y);
        let mut sums = Sums::<S, CHANNELS>::zero(simd);
        for half in halves {
            let dx = centres[half] - s[0];
            replay_half(simd, s, dx, (rows.clone(), half), tile_y, &mut scratch.state, &mut live, &mut sums);
        }
        reduce_into::<S, CHANNELS>(simd, sums, out);
    }
    out.for_each(|slot| slot.fill(0.0));
}

/// Lane-wise sums of one splat over a tile: [`MOMENTS`] of ∂L/∂(exponent), then the channels.
struct Sums<S: Simd, const CHANNELS: usize> {
    moments: [f32x8<S>; MOMENTS],
    channels: [f32x8<S>; CHANNELS],
}

impl<S: Simd, const CHANNELS: usize> Sums<S, CHANNELS> {
    #[inline(always)]
    fn zero(simd: S) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        Self { moments: [zero; MOMENTS], channels: [zero; CHANNELS] }
    }
}

/// Adds one splat's sums over the rows of one half of a tile; `dx` is the distance from its centre. There
/// are two loops, so that neither runs out of registers: the first computes weights and ∂L/∂(exponent) of
/// each row, the second the sums.
#[simd]
#[expect(clippy::too_many_arguments, reason = "one tile's state in separate pieces, for the registers' sake")]
fn replay_half<S: Simd, const CHANNELS: usize>(
    simd: S,
    s: &[f32],
    dx: f32x8<S>,
    (rows, half): (Range<usize>, usize),
    tile_y: usize,
    state: &mut [f32],
    live: &mut u32,
    sums: &mut Sums<S, CHANNELS>,
) {
    let zero = f32x8::splat(simd, 0.0);
    let size = (CHANNELS + 3) * LANES;
    let s = &s[..GEOMETRY + CHANNELS];
    let mut replayed = [(0, 0.0, zero, zero); TILE];
    let mut count = 0;
    for y in rows {
        let block = y * HALVES + half;
        if *live & (1 << block) != 0 {
            let dy = ((tile_y * TILE + y) as i32 as f32 + 0.5) - s[1];
            let state = &mut state[block * size..(block + 1) * size];
            let (weight, g_power, goes_on) = replay_row::<S, CHANNELS>(simd, s, dx, dy, state);
            *live &= !(u32::from(!goes_on) << block);
            replayed[count] = (block * size, dy, weight, g_power);
            count += 1;
        }
    }
    let (mut power, mut power_y, mut power_yy) = (zero, zero, zero);
    let mut channels = sums.channels;
    for &(at, dy, weight, g_power) in &replayed[..count] {
        let g = &state[at..at + CHANNELS * LANES];
        for c in 0..CHANNELS {
            let g = f32x8::from_slice(simd, &g[c * LANES..(c + 1) * LANES]);
            channels[c] = weight.mul_add(g, channels[c]);
        }
        let moment = g_power * dy;
        power += g_power;
        power_y += moment;
        power_yy = moment.mul_add(f32x8::splat(simd, dy), power_yy);
    }
    sums.channels = channels;
    // dx is the same on every row of the half.
    let power_x = power * dx;
    let added = [power, power_x, power_y, power_x * dx, power_y * dx, power_yy];
    for (moment, added) in sums.moments.iter_mut().zip(added) {
        *moment += added;
    }
}

/// Replays one splat on one block. Returns its weights, ∂L/∂(exponent), and `true` if any pixel of the
/// block goes on.
#[simd]
fn replay_row<S: Simd, const CHANNELS: usize>(
    simd: S,
    s: &[f32],
    dx: f32x8<S>,
    dy: f32,
    state: &mut [f32],
) -> (f32x8<S>, f32x8<S>, bool) {
    let zero = f32x8::splat(simd, 0.0);
    let (g, pixel) = state.split_at_mut((CHANNELS + 1) * LANES);
    let (transmittances, rests) = pixel.split_at_mut(LANES);
    let transmittance = f32x8::from_slice(simd, transmittances);
    let log2 = log2_alpha(simd, s, dx, dy);
    let raw = exp2(simd, log2);
    let reached = log2.simd_ge(MIN_LOG2_ALPHA);
    let alpha = reached.select(raw.min(MAX_ALPHA), zero);
    let weight = alpha * transmittance;
    let next = transmittance - weight;
    let goes_on = next.simd_ge(MIN_TRANSMITTANCE);
    let weight = goes_on.select(weight, zero);
    goes_on.select(next, zero).store_slice(transmittances);
    let row = |c: usize| f32x8::from_slice(simd, &g[c * LANES..(c + 1) * LANES]);
    let mut value = row(CHANNELS);
    for c in 0..CHANNELS {
        value = row(c).mul_add(f32x8::splat(simd, s[GEOMETRY + c]), value);
    }
    let rest = f32x8::from_slice(simd, rests) - weight * value;
    rest.store_slice(rests);
    let g_alpha = transmittance * value - rest / (1.0 - alpha);
    // There is no gradient through a clamped alpha, nor at a pixel that has stopped.
    let counts = goes_on & raw.simd_le(MAX_ALPHA);
    (weight, counts.select(g_alpha * alpha, zero), goes_on.any_true())
}

#[simd]
fn reduce_into<S: Simd, const CHANNELS: usize>(simd: S, sums: Sums<S, CHANNELS>, out: &mut [f32]) {
    let zero = f32x8::splat(simd, 0.0);
    for start in (0..MOMENTS + CHANNELS).step_by(LANES) {
        let mut block = [zero; LANES];
        for k in start..(start + LANES).min(MOMENTS + CHANNELS) {
            block[k - start] = if k < MOMENTS { sums.moments[k] } else { sums.channels[k - MOMENTS] };
        }
        transpose_sum(simd, block).store_slice(&mut out[start..start + LANES]);
    }
}

/// Transposes and sums: lane k of the result is the sum over the lanes of `v[k]`.
#[simd]
fn transpose_sum<S: Simd>(simd: S, v: [f32x8<S>; LANES]) -> f32x8<S> {
    // Interleaving a and b halves the number of vectors to add. Pairing k with k + half keeps the order.
    let mut level = v;
    let mut half = LANES / 2;
    while half > 0 {
        for k in 0..half {
            let (low, high) = level[k].interleave(level[k + half]);
            level[k] = low + high;
        }
        half /= 2;
    }
    let _ = simd;
    level[0]
}

/// Sums the slots of each splat, in the order of its tiles, into gradients. Every thread walks over all
/// pairs and takes those of its own splats. That is cheaper than an index from splats to pairs, and the
/// order of the sums is the same.
fn gather(
    splats: &[Splat<f32>],
    bins: &Bins,
    slots: &[f32],
    slot: usize,
    latent_dim: usize,
) -> (Vec<SplatGradient<f32>>, Vec<f32>) {
    let n = splats.len();
    let share = n.div_ceil(rayon::current_num_threads()).max(1);
    let features = MOMENTS + BASE_CHANNELS..MOMENTS + BASE_CHANNELS + latent_dim;
    let pieces: Vec<(Vec<SplatGradient<f32>>, Vec<f32>)> = splats
        .par_chunks(share)
        .enumerate()
        .map(|(piece, splats)| {
            let mut sums = vec![0.0; splats.len() * slot];
            for (&i, from) in bins.splat.iter().zip(slots.chunks_exact(slot)) {
                let k = (i as usize).wrapping_sub(piece * share);
                if k < splats.len() {
                    let sum = &mut sums[k * slot..(k + 1) * slot];
                    sum.iter_mut().zip(from).for_each(|(total, v)| *total += v);
                }
            }
            let gradients = splats.iter().zip(sums.chunks_exact(slot));
            (
                gradients.map(|(splat, sum)| splat_gradient(splat, sum)).collect(),
                sums.chunks_exact(slot).flat_map(|sum| sum[features.clone()].iter().copied()).collect(),
            )
        })
        .collect();
    let (g_splats, g_features): (Vec<_>, Vec<_>) = pieces.into_iter().unzip();
    (g_splats.concat(), g_features.concat())
}

/// Gradient of a splat from its sums; the moments are linear in the gradients that they sum up.
fn splat_gradient(splat: &Splat<f32>, sum: &[f32]) -> SplatGradient<f32> {
    let [m, mx, my, mxx, mxy, myy] = [sum[0], sum[1], sum[2], sum[3], sum[4], sum[5]];
    let [a, b, c] = splat.conic;
    SplatGradient {
        centre: [a * mx + b * my, b * mx + c * my],
        conic: [-0.5 * mxx, -mxy, -0.5 * myy],
        opacity: if splat.opacity > 0.0 { m / splat.opacity } else { 0.0 },
        colour: [sum[MOMENTS], sum[MOMENTS + 1], sum[MOMENTS + 2]],
        depth: sum[MOMENTS + 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposed_sums_keep_their_lanes() {
        let level = fearless_simd::Level::new();
        let sums = fearless_simd::dispatch!(level, simd => {
            let v: [f32x8<_>; LANES] = std::array::from_fn(|k| f32x8::from_fn(simd, |lane| (k * 100 + lane) as f32));
            transpose_sum(simd, v).to_array()
        });
        for (k, sum) in sums.iter().enumerate() {
            assert_eq!(*sum, (k * 800 + 28) as f32);
        }
    }
}
