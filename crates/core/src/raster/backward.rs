//! From gradients of the images to gradients of the splats: a front-to-back replay per tile into one slot per
//! splat–tile pair, then a gather in fixed order. No atomics, so the sums are the same for any thread count.
//!
//! Per pixel the replay needs two numbers whatever the channels: transmittance T and
//! `rest` = Σ over the splats not yet visited of wⱼ (cⱼ · g), which starts as (image · g). Then
//! ∂L/∂αᵢ = Tᵢ (cᵢ · g) − rest / (1 − αᵢ).

use super::{
    ALPHA_PLANE, FEATURE_PLANE, Images, MAX_ALPHA, MIN_TRANSMITTANCE, TILE,
    bin::Bins,
    project::{Splat, SplatGradient},
    tile::{
        BASE_CHANNELS, GEOMETRY, MIN_LOG2_ALPHA, Packed, columns_inside, dispatch_channels, exp2,
        gather_tile, log2_alpha, padded_channels, pixel_centres, rows_of,
    },
};
use fearless_simd::{f32x16, prelude::*};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Floats of a slot before its channels: moments 1, x, y, xx, xy, yy of ∂L/∂(exponent) about the splat's centre.
const MOMENTS: usize = 6;

/// Gradients of every splat (and of its features, [N][D]) given `g_planes`, shaped as `images.planes`.
pub fn raster_backward(
    splats: &[Splat<f32>],
    features: &[f32],
    bins: &Bins,
    images: &Images,
    g_planes: &[f32],
) -> (Vec<SplatGradient<f32>>, Vec<f32>) {
    let latent_dim = images.latent_dim();
    let channels = padded_channels(latent_dim);
    let packed = Packed::new(splats, features, latent_dim, channels);
    let slot = MOMENTS + channels;
    let mut slots = vec![0.0; bins.splat.len() * slot];
    let job = Job { packed: &packed, bins, images, g_planes };
    tile_row_slots(&mut slots, bins, slot).into_par_iter().enumerate().for_each_init(
        Scratch::default,
        |scratch, (tile_y, slots)| {
            dispatch_channels!(channels, replay_strip(&job, scratch, tile_y, slots));
        },
    );
    gather(splats, bins, &slots, slot, latent_dim)
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

struct Job<'a> {
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
    /// Gradient of each blended channel, then of alpha: [channels + 1][16 rows][16].
    g: Vec<f32>,
    /// T, then `rest`: [2][16 rows][16].
    state: Vec<f32>,
}

#[simd]
fn replay_strip<S: Simd, const CHANNELS: usize>(
    simd: S,
    job: &Job<'_>,
    scratch: &mut Scratch,
    tile_y: usize,
    slots: &mut [f32],
) {
    let slot = MOMENTS + CHANNELS;
    let first_pair = job.bins.first[tile_y * job.bins.columns] as usize;
    for tile_x in 0..job.bins.columns {
        let pairs = job.bins.tile(tile_x, tile_y);
        if pairs.is_empty() {
            continue;
        }
        gather_tile(job.packed, job.bins, pairs.clone(), &mut scratch.local);
        load_tile::<CHANNELS>(job, scratch, tile_x, tile_y);
        let slots = &mut slots[(pairs.start - first_pair) * slot..(pairs.end - first_pair) * slot];
        replay_tile::<S, CHANNELS>(simd, job, scratch, (tile_x, tile_y), slots);
    }
}

/// Loads the gradients of a tile and starts its state; pixels outside the image have no gradient.
fn load_tile<const CHANNELS: usize>(job: &Job<'_>, scratch: &mut Scratch, tile_x: usize, tile_y: usize) {
    const PIXELS: usize = TILE * TILE;
    let (width, height) = (job.images.width, job.images.height);
    let n = width * height;
    scratch.g.clear();
    scratch.g.resize((CHANNELS + 1) * PIXELS, 0.0);
    scratch.state.clear();
    scratch.state.resize(2 * PIXELS, 1.0);
    let (transmittance, rest) = scratch.state.split_at_mut(PIXELS);
    rest.fill(0.0);
    transmittance.fill(1.0);
    let inside = columns_inside(tile_x, width);
    for plane in 0..FEATURE_PLANE + job.images.latent_dim() {
        let channel = match plane {
            ALPHA_PLANE => CHANNELS,
            p if p < BASE_CHANNELS => p,
            p => p - 1,
        };
        for y in 0..TILE.min(height - tile_y * TILE) {
            let from = plane * n + (tile_y * TILE + y) * width + tile_x * TILE;
            let g = &job.g_planes[from..from + inside];
            scratch.g[channel * PIXELS + y * TILE..][..inside].copy_from_slice(g);
            let image = &job.images.planes[from..from + inside];
            for ((rest, g), value) in rest[y * TILE..].iter_mut().zip(g).zip(image) {
                *rest += g * value;
            }
        }
    }
}

#[simd]
fn replay_tile<S: Simd, const CHANNELS: usize>(
    simd: S,
    job: &Job<'_>,
    scratch: &mut Scratch,
    (tile_x, tile_y): (usize, usize),
    slots: &mut [f32],
) {
    let centres = pixel_centres(simd, tile_x);
    let stride = job.packed.stride;
    let mut live_rows = u32::MAX;
    for (s, out) in scratch.local.chunks_exact(stride).zip(slots.chunks_exact_mut(MOMENTS + CHANNELS)) {
        let rows = rows_of(s, tile_y);
        let dx = centres - s[0];
        let sums = replay_splat::<S, CHANNELS>(
            simd,
            s,
            dx,
            rows,
            tile_y,
            &scratch.g,
            &mut scratch.state,
            &mut live_rows,
        );
        reduce_into::<S, CHANNELS>(simd, sums, dx, out);
        if live_rows & 0xFFFF == 0 {
            break;
        }
    }
}

/// Lane-wise sums of one splat over the rows of a tile: ∂L/∂(exponent) times 1, dy, dy², then the channels.
struct Sums<S: Simd, const CHANNELS: usize> {
    power: [f32x16<S>; 3],
    channels: [f32x16<S>; CHANNELS],
}

#[simd]
#[expect(
    clippy::too_many_arguments,
    reason = "the state of one tile, kept in separate slices for the registers' sake"
)]
fn replay_splat<S: Simd, const CHANNELS: usize>(
    simd: S,
    s: &[f32],
    dx: f32x16<S>,
    rows: std::ops::Range<usize>,
    tile_y: usize,
    g: &[f32],
    state: &mut [f32],
    live_rows: &mut u32,
) -> Sums<S, CHANNELS> {
    const PIXELS: usize = TILE * TILE;
    let zero = f32x16::splat(simd, 0.0);
    let mut sums = Sums { power: [zero; 3], channels: [zero; CHANNELS] };
    let (transmittances, rests) = state.split_at_mut(PIXELS);
    for y in rows {
        if *live_rows & (1 << y) == 0 {
            continue;
        }
        let dy = (tile_y * TILE + y) as f32 + 0.5 - s[1];
        let transmittance = f32x16::from_slice(simd, &transmittances[y * TILE..y * TILE + TILE]);
        let log2 = log2_alpha(simd, s, dx, dy);
        let raw = exp2(simd, log2.max(-126.0));
        let reached = log2.simd_ge(MIN_LOG2_ALPHA);
        let alpha = reached.select(raw.min(MAX_ALPHA), zero);
        let weight = alpha * transmittance;
        let next = transmittance - weight;
        let goes_on = next.simd_ge(MIN_TRANSMITTANCE);
        let weight = goes_on.select(weight, zero);
        let next = goes_on.select(next, zero);
        next.store_slice(&mut transmittances[y * TILE..y * TILE + TILE]);
        if !goes_on.any_true() {
            *live_rows &= !(1 << y);
        }
        let row =
            |c: usize| f32x16::from_slice(simd, &g[c * PIXELS + y * TILE..c * PIXELS + y * TILE + TILE]);
        let mut value = row(CHANNELS);
        for c in 0..CHANNELS {
            let g = row(c);
            value = g.mul_add(f32x16::splat(simd, s[GEOMETRY + c]), value);
            sums.channels[c] = weight.mul_add(g, sums.channels[c]);
        }
        let rest = f32x16::from_slice(simd, &rests[y * TILE..y * TILE + TILE]) - weight * value;
        rest.store_slice(&mut rests[y * TILE..y * TILE + TILE]);
        let g_alpha = transmittance * value - rest / (1.0 - alpha);
        // No gradient through a clamped alpha, nor where the pixel had stopped.
        let counts = goes_on & raw.simd_le(MAX_ALPHA);
        let g_power = counts.select(g_alpha * alpha, zero);
        sums.power[0] += g_power;
        sums.power[1] = g_power.mul_add(f32x16::splat(simd, dy), sums.power[1]);
        sums.power[2] = g_power.mul_add(f32x16::splat(simd, dy * dy), sums.power[2]);
    }
    sums
}

/// dx is the same on every row, so the moments in x follow from the lane-wise sums.
#[simd]
fn reduce_into<S: Simd, const CHANNELS: usize>(
    simd: S,
    sums: Sums<S, CHANNELS>,
    dx: f32x16<S>,
    out: &mut [f32],
) {
    let [p, py, pyy] = sums.power;
    let px = p * dx;
    let moments = [p, px, py, px * dx, py * dx, pyy];
    let zero = f32x16::splat(simd, 0.0);
    let mut block = [zero; 16];
    for start in (0..MOMENTS + CHANNELS).step_by(16) {
        let end = (start + 16).min(MOMENTS + CHANNELS);
        for k in start..end {
            block[k - start] = if k < MOMENTS { moments[k] } else { sums.channels[k - MOMENTS] };
        }
        let total = transpose_sum(simd, block).to_array();
        out[start..end].copy_from_slice(&total[..end - start]);
    }
}

/// Lane k of the result is the sum over the lanes of `v[k]`.
#[simd]
fn transpose_sum<S: Simd>(simd: S, v: [f32x16<S>; 16]) -> f32x16<S> {
    // Interleaving a and b halves what is left to add; pairing k with k + half keeps the order.
    let mut level = v;
    let mut half = 8;
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

/// Sums the slots of each splat, in the order of its tiles, into gradients.
fn gather(
    splats: &[Splat<f32>],
    bins: &Bins,
    slots: &[f32],
    slot: usize,
    latent_dim: usize,
) -> (Vec<SplatGradient<f32>>, Vec<f32>) {
    let (first, pair) = pairs_by_splat(splats.len(), bins);
    let mut g_features = vec![0.0; splats.len() * latent_dim];
    let mut g_splats = vec![SplatGradient::default(); splats.len()];
    let unit = latent_dim.max(1);
    // A scene without features still needs one chunk per splat.
    let mut no_features = vec![0.0; if latent_dim == 0 { splats.len() } else { 0 }];
    let feature_rows = if latent_dim == 0 { &mut no_features } else { &mut g_features };
    g_splats.par_iter_mut().zip(feature_rows.par_chunks_mut(unit)).with_min_len(1024).enumerate().for_each(
        |(i, (g, g_feature))| {
            let mut sum = [0.0f32; MOMENTS + 20];
            for &p in &pair[first[i] as usize..first[i + 1] as usize] {
                for (total, v) in sum.iter_mut().zip(&slots[p as usize * slot..(p as usize + 1) * slot]) {
                    *total += v;
                }
            }
            *g = splat_gradient(&splats[i], &sum);
            g_feature[..latent_dim]
                .copy_from_slice(&sum[MOMENTS + BASE_CHANNELS..MOMENTS + BASE_CHANNELS + latent_dim]);
        },
    );
    (g_splats, g_features)
}

/// The moments are linear in what they came from.
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

/// Pairs grouped by splat, each group in tile order: counting sort.
fn pairs_by_splat(n: usize, bins: &Bins) -> (Vec<u32>, Vec<u32>) {
    let mut first = vec![0u32; n + 1];
    for &i in &bins.splat {
        first[i as usize + 1] += 1;
    }
    for i in 1..=n {
        first[i] += first[i - 1];
    }
    let mut next = first.clone();
    let mut pair = vec![0u32; bins.splat.len()];
    for (p, &i) in bins.splat.iter().enumerate() {
        pair[next[i as usize] as usize] = p as u32;
        next[i as usize] += 1;
    }
    (first, pair)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposed_sums_keep_their_lanes() {
        let level = fearless_simd::Level::new();
        let sums = fearless_simd::dispatch!(level, simd => {
            let v: [f32x16<_>; 16] = std::array::from_fn(|k| f32x16::from_fn(simd, |lane| (k * 100 + lane) as f32));
            transpose_sum(simd, v).to_array()
        });
        for (k, sum) in sums.iter().enumerate() {
            assert_eq!(*sum, (k * 1600 + 120) as f32);
        }
    }
}
