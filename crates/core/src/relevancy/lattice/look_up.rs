//! From latents to scores, eight points at a time.

use super::{
    table::ScoreTable,
    tree::{EXTENT, FINE, FINE_PER_UNIT, MAX_LEVEL, Place, Spot, Tree, numbers},
};
use crate::{
    lanes::{LANES, exp2, load_block},
    mask::set_bits,
    relevancy::Points,
};
use fearless_simd::{Level, dispatch, f32x8, i32x8, prelude::*, u32x8};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Number of points that one thread looks up at once.
const POINTS_AT_ONCE: usize = 8192;

/// Points that a pass did not decide, and the cells they need.
#[derive(Default)]
pub(super) struct Open {
    /// Cells that were needed but are not tabulated; sorted, without repetition.
    pub(super) missing: Vec<Place>,
    /// Points in those cells.
    pub(super) waiting: Vec<usize>,
    /// Points that no cell can decide.
    pub(super) undecided: Vec<usize>,
}

/// Writes the scores of `points` for each table. Scores are 0 in holes, and undefined at the points of
/// [`Open`].
pub(super) fn look_up(
    tree: &Tree,
    tables: &[ScoreTable],
    points: &Points<'_>,
    scores: &mut [Vec<f32>],
) -> Open {
    let level = Level::new();
    let mut strips: Vec<Vec<&mut [f32]>> = Vec::new();
    strips.resize_with(points.len().div_ceil(POINTS_AT_ONCE), || Vec::with_capacity(tables.len()));
    for scores in scores {
        let parts = scores.chunks_mut(POINTS_AT_ONCE);
        strips.iter_mut().zip(parts).for_each(|(strip, part)| strip.push(part));
    }
    let parts: Vec<Open> = strips
        .into_par_iter()
        .enumerate()
        .map(|(i, mut strip)| {
            let mut open = Open::default();
            let first = i * POINTS_AT_ONCE;
            dispatch!(level, simd => look_up_strip(simd, tree, tables, points, first, &mut strip, &mut open));
            open
        })
        .collect();
    let mut all = Open::default();
    for part in parts {
        all.missing.extend(part.missing);
        all.waiting.extend(part.waiting);
        all.undecided.extend(part.undecided);
    }
    all.missing.sort_unstable();
    all.missing.dedup();
    all
}

#[simd]
fn look_up_strip<S: Simd>(
    simd: S,
    tree: &Tree,
    tables: &[ScoreTable],
    points: &Points<'_>,
    first: usize,
    strip: &mut [&mut [f32]],
    open: &mut Open,
) {
    let len = strip.first().map_or(0, |s| s.len());
    for start in (0..len).step_by(LANES) {
        let (at, inside) = (first + start, LANES.min(len - start));
        let alpha = load(simd, points.alpha(), at, inside);
        let is_live = alpha.simd_ge(points.min_alpha());
        if !is_live.any_true() {
            strip.iter_mut().for_each(|scores| scores[start..start + inside].fill(0.0));
            continue;
        }
        let x = load(simd, points.plane(0), at, inside);
        let y = load(simd, points.plane(1), at, inside);
        let z = load(simd, points.plane(2), at, inside);
        let shortest = alpha * Points::MIN_LENGTH;
        // NaN is not live either.
        let is_live = is_live & (x * x + y * y + z * z).simd_ge(shortest * shortest);
        let scale = f32x8::splat(simd, FINE_PER_UNIT) / alpha;
        let middle = f32x8::splat(simd, EXTENT * FINE_PER_UNIT);
        let fine = [x.mul_add(scale, middle), y.mul_add(scale, middle), z.mul_add(scale, middle)];
        // Written so that NaN is outside.
        let is_inside = |v: f32x8<S>| v.simd_ge(0.0) & v.simd_lt(FINE as f32);
        let in_cube = is_inside(fine[0]) & is_inside(fine[1]) & is_inside(fine[2]);
        let found = locate(simd, tree, fine, (is_live & in_cube).to_bitmask(), open);
        let mut undecided = is_live & !in_cube;
        for (table, scores) in tables.iter().zip(strip.iter_mut()) {
            let margin = interpolate(simd, &table.polynomials, &found);
            let is_known = margin.simd_eq(margin);
            undecided |= is_live & !is_known;
            let score = sigmoid(simd, margin * table.temperature);
            let score = is_live.select(score, f32x8::splat(simd, 0.0)).to_array();
            scores[start..start + inside].copy_from_slice(&score[..inside]);
        }
        let undecided = undecided.to_bitmask() & !found.missing;
        if undecided | found.missing != 0 {
            open.waiting.extend(set_bits(&[found.missing]).map(|lane| at + lane));
            open.undecided.extend(set_bits(&[undecided]).map(|lane| at + lane));
        }
    }
}

/// Loads eight values from index `at` on. If fewer are `inside`, the others are 0.
#[inline(always)]
fn load<S: Simd>(simd: S, values: &[f32], at: usize, inside: usize) -> f32x8<S> {
    match values[at..].first_chunk() {
        Some(block) if inside == LANES => f32x8::load_array_ref(simd, block),
        _ => f32x8::load_array(simd, load_block(&values[at..], inside)),
    }
}

/// The cells of eight points.
struct Found<S: Simd> {
    /// Leaves of the points; `u32::MAX` if there is none.
    leaves: [u32; LANES],
    /// Positions in the leaves, 0–1.
    within: [f32x8<S>; 3],
    /// Points whose cells must be tabulated, one bit each.
    missing: u64,
}

/// Finds the cells of the points whose bit is set in `wanted`. Positions are in units of the finest cells.
#[simd]
fn locate<S: Simd>(simd: S, tree: &Tree, fine: [f32x8<S>; 3], wanted: u64, open: &mut Open) -> Found<S> {
    let whole = fine.map(|v| {
        let whole: i32x8<S> = i32x8::truncate_from(v.max(0.0).min(FINE as f32 - 1.0));
        whole
    });
    let cells = whole.map(|v| {
        let cell: u32x8<S> = v.bitcast();
        cell
    });
    let numbers = numbers(cells).map(|v| v.to_array());
    let mut leaves = [u32::MAX; LANES];
    // Number of times that a finest cell must be doubled to get the cell.
    let mut doublings = [0; LANES];
    let mut missing = 0;
    for lane in 0..LANES {
        if wanted >> lane & 1 == 0 {
            continue;
        }
        match tree.at(numbers.map(|n| n[lane])) {
            Spot::Leaf(leaf, level) => {
                leaves[lane] = leaf;
                doublings[lane] = i32::from(MAX_LEVEL) - level as i32;
            }
            Spot::Empty(_) if tree.is_frozen() => {}
            Spot::Empty(level) => {
                missing |= 1 << lane;
                let place = Place::of(cells.map(|c| c.to_array()[lane]), level);
                if open.missing.last() != Some(&place) {
                    open.missing.push(place);
                }
            }
        }
    }
    let doublings = i32x8::load_array(simd, doublings);
    let corner_mask = i32x8::splat(simd, -1) << doublings;
    // 2 to the power of -doublings, built from its bits.
    let shrink: f32x8<S> = ((127 - doublings) << 23).bitcast();
    let within = [0, 1, 2].map(|k| {
        let corner: f32x8<S> = f32x8::float_from(whole[k] & corner_mask);
        (fine[k] - corner) * shrink
    });
    Found { leaves, within, missing }
}

/// Margins at eight places; NaN where they must be decoded instead.
#[simd]
fn interpolate<S: Simd>(simd: S, polynomials: &[[f32; 8]], found: &Found<S>) -> f32x8<S> {
    const UNKNOWN: [f32; 8] = [f32::NAN; 8];
    let of = |leaf: u32| polynomials.get(leaf as usize).unwrap_or(&UNKNOWN);
    let one = found.leaves[0];
    let c: [f32x8<S>; 8] = if found.leaves.iter().all(|&leaf| leaf == one) {
        let c = of(one);
        std::array::from_fn(|k| f32x8::splat(simd, c[k]))
    } else {
        transpose(simd, found.leaves.map(|leaf| f32x8::load_array_ref(simd, of(leaf))))
    };
    let [x, y, z] = found.within;
    let low = z.mul_add(c[3], c[2]).mul_add(y, z.mul_add(c[1], c[0]));
    let high = z.mul_add(c[7], c[6]).mul_add(y, z.mul_add(c[5], c[4]));
    high.mul_add(x, low)
}

/// Transposes: lane k of vector j of the result is lane j of `rows[k]`.
#[simd]
fn transpose<S: Simd>(simd: S, rows: [f32x8<S>; LANES]) -> [f32x8<S>; LANES] {
    let _ = simd;
    let mut vectors = rows;
    // Interleaving k with k + 4 moves one bit of the row's index into the lane's index. Three rounds move
    // all bits.
    for _ in 0..LANES.ilog2() {
        let before = vectors;
        for k in 0..LANES / 2 {
            (vectors[2 * k], vectors[2 * k + 1]) = before[k].interleave(before[k + LANES / 2]);
        }
    }
    vectors
}

/// 1 / (1 + e^-x), never 0; undefined if x is NaN.
#[simd]
fn sigmoid<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    let one = f32x8::splat(simd, 1.0);
    let power = (x * -std::f32::consts::LOG2_E).max(-126.0).min(126.0);
    one / (one + exp2(simd, power))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposed_vectors_swap_rows_and_lanes() {
        let level = Level::new();
        let columns = dispatch!(level, simd => {
            let rows = std::array::from_fn(|row| f32x8::from_fn(simd, |lane| (row * 10 + lane) as f32));
            transpose(simd, rows).map(|v| v.to_array())
        });
        for (j, column) in columns.iter().enumerate() {
            assert_eq!(*column, std::array::from_fn(|k| (k * 10 + j) as f32));
        }
    }
}
