//! Assignment of splats to the tiles they touch, front to back; twin of `shaders/bin.wgsl` and the sort.

use super::{MIN_ALPHA, TILE, project::Splat};
use rayon::prelude::*;

/// Splat–tile pairs sorted by tile, then depth (ties by index).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bins {
    /// Number of tiles along x.
    pub columns: usize,
    /// Number of tiles along y.
    pub rows: usize,
    /// Pairs of tile k are `first[k]..first[k + 1]`; `columns * rows + 1` values.
    pub first: Vec<u32>,
    /// Splat index of each pair.
    pub splat: Vec<u32>,
}

impl Bins {
    /// Pairs of the tile in column `x`, row `y`.
    pub fn tile(&self, x: usize, y: usize) -> std::ops::Range<usize> {
        let k = y * self.columns + x;
        self.first[k] as usize..self.first[k + 1] as usize
    }
}

/// Row of tiles and the columns in it that a splat's ellipse touches; see [`tile_spans`].
pub type Span = (usize, std::ops::Range<usize>);

/// Exact set of tiles, row by row, whose pixel centres' rectangle meets the ellipse alpha ≥ [`MIN_ALPHA`].
///
/// In a band of rows the ellipse reaches furthest right at its rightmost point if that lies in the band,
/// else at the band's edge nearest to it; the same holds for the left.
pub fn tile_spans(splat: &Splat<f32>, columns: usize, rows: usize) -> impl Iterator<Item = Span> + use<> {
    let splat = *splat;
    let [a, b, c] = splat.conic;
    let cut = 2.0 * (splat.opacity / MIN_ALPHA).ln();
    let determinant = a * c - b * b;
    let [ex, ey] = splat.extent;
    let [mx, my] = splat.centre;
    // dy at the rightmost point; the leftmost point is opposite.
    let dy_right = -b / c * ex;
    let edge = move |dy: f32, side: f32| {
        let inside = (cut * a - determinant * dy * dy).max(0.0).sqrt();
        (-b * dy + side * inside) / a
    };
    let row_range = if splat.is_visible() { tile_range(my - ey, my + ey, rows) } else { 0..0 };
    row_range.filter_map(move |row| {
        let top = (row * TILE) as f32 + 0.5 - my;
        let (low, high) = (top.max(-ey), (top + (TILE - 1) as f32).min(ey));
        if low > high {
            return None;
        }
        let right = edge(dy_right.clamp(low, high), 1.0);
        let left = edge((-dy_right).clamp(low, high), -1.0);
        let span = tile_range(mx + left, mx + right, columns);
        (!span.is_empty()).then_some((row, span))
    })
}

/// Tiles that have a pixel centre in [low, high].
fn tile_range(low: f32, high: f32, tiles: usize) -> std::ops::Range<usize> {
    let first = (low - 0.5).ceil().max(0.0);
    let last = (high - 0.5).floor().min((tiles * TILE) as f32 - 1.0);
    // Also false for NaN.
    if first <= last { first as usize / TILE..last as usize / TILE + 1 } else { 0..0 }
}

/// Bins all visible splats of an image of `width × height` pixels.
pub fn bin(splats: &[Splat<f32>], width: usize, height: usize) -> Bins {
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    let order = depth_order(splats);
    // Each piece of the depth order is distributed over tile rows, then each tile row over its columns.
    let pieces: Vec<Vec<Vec<RowEntry>>> = order
        .par_chunks(ORDER_PIECE)
        .map(|piece| {
            let mut by_row = vec![Vec::new(); rows];
            for &splat in piece {
                for (row, span) in tile_spans(&splats[splat as usize], columns, rows) {
                    by_row[row].push(RowEntry { splat, first: span.start as u16, end: span.end as u16 });
                }
            }
            by_row
        })
        .collect();
    let binned: Vec<(Vec<u32>, Vec<u32>)> = (0..rows)
        .into_par_iter()
        .map(|row| bin_row(columns, || pieces.iter().flat_map(move |piece| &piece[row])))
        .collect();
    let mut first = Vec::with_capacity(columns * rows + 1);
    let mut total = 0;
    for (counts, _) in &binned {
        for count in counts {
            first.push(total);
            total += count;
        }
    }
    first.push(total);
    let splat = binned.into_iter().map(|(_, splat)| splat).collect::<Vec<_>>().concat();
    Bins { columns, rows, first, splat }
}

/// Number of splats of the depth order that one task distributes over tile rows.
const ORDER_PIECE: usize = 4096;

/// A splat and the tile columns of one row that it touches.
#[derive(Clone, Copy)]
struct RowEntry {
    splat: u32,
    first: u16,
    end: u16,
}

/// Number of pairs in each tile of a row, and the pairs, tile by tile in the order of the entries.
fn bin_row<'a, I: Iterator<Item = &'a RowEntry>>(
    columns: usize,
    entries: impl Fn() -> I,
) -> (Vec<u32>, Vec<u32>) {
    let mut counts = vec![0u32; columns];
    for entry in entries() {
        counts[usize::from(entry.first)..usize::from(entry.end)].iter_mut().for_each(|c| *c += 1);
    }
    let mut total = 0;
    let mut next: Vec<u32> = counts
        .iter()
        .map(|count| {
            total += count;
            total - count
        })
        .collect();
    let mut splat = vec![0; total as usize];
    for entry in entries() {
        for slot in &mut next[usize::from(entry.first)..usize::from(entry.end)] {
            splat[*slot as usize] = entry.splat;
            *slot += 1;
        }
    }
    (counts, splat)
}

/// Visible splats front to back, ties by index. Depths are positive, so their bits sort like the numbers.
fn depth_order(splats: &[Splat<f32>]) -> Vec<u32> {
    let mut keys: Vec<u64> = splats
        .iter()
        .enumerate()
        .filter(|(_, s)| s.is_visible())
        .map(|(i, s)| u64::from(s.depth.to_bits()) << 32 | i as u64)
        .collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|k| k as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn splat(centre: [f32; 2], covariance: [f32; 3], opacity: f32, depth: f32) -> Splat<f32> {
        let [xx, xy, yy] = covariance;
        let det = xx * yy - xy * xy;
        let cut = 2.0 * (opacity / MIN_ALPHA).ln();
        Splat {
            centre,
            conic: [yy / det, -xy / det, xx / det],
            depth,
            opacity,
            colour: [0.0; 3],
            extent: [(cut * xx).sqrt(), (cut * yy).sqrt()],
        }
    }

    fn touches(s: &Splat<f32>, x: usize, y: usize) -> bool {
        s.at_pixel(x, y).1 >= MIN_ALPHA * 1.0001
    }

    proptest! {
        #[test]
        fn no_pixel_that_a_splat_reaches_is_missed(
            cx in -20.0f32..100.0, cy in -20.0f32..80.0, sx in 0.5f32..30.0, sy in 0.5f32..30.0, r in -0.99f32..0.99, o in 0.01f32..0.99,
        ) {
            let s = splat([cx, cy], [sx * sx, r * sx * sy, sy * sy], o, 1.0);
            let (w, h) = (80, 64);
            let bins = bin(&[s], w, h);
            for y in 0..h {
                for x in 0..w {
                    if touches(&s, x, y) {
                        prop_assert!(!bins.tile(x / TILE, y / TILE).is_empty(), "pixel {x},{y}");
                    }
                }
            }
        }
    }

    #[test]
    fn pairs_are_front_to_back_and_ties_by_index() {
        let s = |depth| splat([8.0, 8.0], [4.0, 0.0, 4.0], 0.5, depth);
        let bins = bin(&[s(3.0), s(1.0), s(2.0), s(1.0)], 16, 16);
        assert_eq!(bins.splat, vec![1, 3, 2, 0]);
        assert_eq!(bins.first, vec![0, 4]);
    }

    #[test]
    fn a_thin_diagonal_skips_the_corners_of_its_box() {
        let s = splat([32.0, 32.0], [100.0, 99.0, 100.0], 0.9, 1.0);
        let bins = bin(&[s], 64, 64);
        assert!(bins.tile(3, 0).is_empty() && bins.tile(0, 3).is_empty());
        assert!(!bins.tile(1, 1).is_empty() && !bins.tile(2, 2).is_empty());
    }
}
