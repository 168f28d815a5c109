//! Small islands and holes of a mask, found from runs of pixels instead of pixel by pixel.

use super::bit_mask::{BitMask, WORD};

/// Pixels `from..to` of row `y`.
#[derive(Clone, Copy)]
struct Run {
    y: usize,
    from: usize,
    to: usize,
}

/// Fills holes and then drops islands of fewer than `min_px` pixels (neighbours over corners count), as
/// Segment Anything's `remove_small_regions` does. If all islands are small, the largest stays. An
/// opening at the image's border is a hole too. `None` if the mask has neither.
pub(super) fn without_small_regions(mask: &BitMask, min_px: usize) -> Option<BitMask> {
    let width = mask.width();
    let (mut rows, columns) = (rows_of(mask), width.div_ceil(WORD));
    let holes = parts(&rows, width, false);
    let small: Vec<_> = holes.into_iter().filter(|hole| area(hole) < min_px).flatten().collect();
    small.iter().for_each(|run| flip(&mut rows, columns, run));
    let mut islands = parts(&rows, width, true);
    // The largest stays whatever its size; of equal ones the first.
    let largest = (0..islands.len()).rev().max_by_key(|&i| area(&islands[i]));
    if let Some(largest) = largest {
        islands.swap_remove(largest);
    }
    let dropped: Vec<_> = islands.into_iter().filter(|island| area(island) < min_px).flatten().collect();
    dropped.iter().for_each(|run| flip(&mut rows, columns, run));
    (!small.is_empty() || !dropped.is_empty()).then(|| BitMask::from_rows(width, &rows)).flatten()
}

/// Returns the words of every row of the image.
fn rows_of(mask: &BitMask) -> Vec<u64> {
    let columns = mask.width().div_ceil(WORD);
    let mut rows = vec![0_u64; columns * mask.height()];
    let (bounds, first) = (mask.bounds(), mask.bounds().x / WORD);
    for y in bounds.y..bounds.y + bounds.height {
        let row = mask.row(y);
        rows[y * columns + first..][..row.len()].copy_from_slice(row);
    }
    rows
}

fn area(part: &[Run]) -> usize {
    part.iter().map(|run| run.to - run.from).sum()
}

fn flip(rows: &mut [u64], columns: usize, run: &Run) {
    (run.from..run.to).for_each(|x| rows[run.y * columns + x / WORD] ^= 1 << (x % WORD));
}

/// Returns the connected parts (neighbours over corners count) of the bits equal to `value`, in order of
/// their first runs.
fn parts(rows: &[u64], width: usize, value: bool) -> Vec<Vec<Run>> {
    let columns = width.div_ceil(WORD).max(1);
    let mut runs: Vec<Run> = Vec::new();
    // Each run points to an earlier one of its part, or to itself.
    let mut parents: Vec<usize> = Vec::new();
    let (mut above, mut here) = (0..0, 0..0);
    for (y, row) in rows.chunks_exact(columns).enumerate() {
        (above, here) = (here.clone(), runs.len()..runs.len());
        push_runs(&mut runs, row, width, y, value);
        here.end = runs.len();
        parents.extend(here.clone());
        let mut candidate = above.start;
        for i in here.clone() {
            while candidate < above.end && runs[candidate].to < runs[i].from {
                candidate += 1;
            }
            let touching = (candidate..above.end).take_while(|&k| runs[k].from <= runs[i].to);
            for k in touching {
                join(&mut parents, i, k);
            }
        }
    }
    let _ = above;
    let mut found: Vec<Vec<Run>> = Vec::new();
    let mut part_of = vec![usize::MAX; runs.len()];
    for (i, run) in runs.iter().enumerate() {
        let root = root(&mut parents, i);
        if part_of[root] == usize::MAX {
            part_of[root] = found.len();
            found.push(Vec::new());
        }
        found[part_of[root]].push(*run);
    }
    found
}

/// Adds the runs of one row.
fn push_runs(runs: &mut Vec<Run>, row: &[u64], width: usize, y: usize, value: bool) {
    // Finds the changes of value along the row, which begins as unset.
    let mut at = 0;
    let mut is_set = false;
    let next_change = |at: usize, is_set: bool| {
        let mut k = at / WORD;
        let mut mask = u64::MAX << (at % WORD);
        while k < row.len() {
            let changed = (if is_set { !row[k] } else { row[k] }) & mask;
            if changed != 0 {
                return (k * WORD + changed.trailing_zeros() as usize).min(width);
            }
            (k, mask) = (k + 1, u64::MAX);
        }
        width
    };
    while at < width {
        let to = next_change(at, is_set);
        if is_set == value && to > at {
            runs.push(Run { y, from: at, to });
        }
        (at, is_set) = (to, !is_set);
    }
}

fn root(parents: &mut [usize], mut i: usize) -> usize {
    while parents[i] != i {
        parents[i] = parents[parents[i]];
        i = parents[i];
    }
    i
}

fn join(parents: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b)] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Grid, Mask};
    use proptest::prelude::*;

    fn mask(rows: &[&str]) -> BitMask {
        let data = rows.iter().flat_map(|r| r.chars().map(|c| c == '#')).collect();
        BitMask::of(&Grid::from_vec(rows[0].len(), rows.len(), data)).unwrap()
    }

    #[test]
    fn small_holes_close_and_small_islands_go() {
        let image = mask(&["######...#", "#..###....", "######..##", "........##"]);
        let expected = mask(&["######....", "######....", "######..##", "........##"]);
        assert_eq!(without_small_regions(&image, 3), Some(expected.clone()));
        assert_eq!(without_small_regions(&expected, 3), None, "nothing is left to do");
        let only = mask(&["######....", "######....", "######....", ".........."]);
        assert_eq!(without_small_regions(&image, 5), Some(only));
    }

    #[test]
    fn where_all_is_small_the_largest_stays() {
        let image = mask(&["#....", "..##.", "....."]);
        // There are two islands: (0, 0) and (2, 1) would be connected only through (1, 0), which is not set.
        assert_eq!(without_small_regions(&image, 4), Some(mask(&[".....", "..##.", "....."])));
        assert_eq!(
            without_small_regions(&mask(&["#....", ".##..", "....."]), 3),
            None,
            "one island of three"
        );
        let equal = mask(&["#...#"]);
        assert_eq!(without_small_regions(&equal, 2), Some(mask(&["#...."])));
    }

    #[test]
    fn openings_at_the_border_are_holes_too() {
        assert_eq!(without_small_regions(&mask(&["##.##", "#####"]), 2), Some(mask(&["#####", "#####"])));
    }

    /// Finds parts by flooding, pixel by pixel.
    fn flooded(mask: &Mask, value: bool) -> Vec<usize> {
        let (w, h) = (mask.width as isize, mask.height as isize);
        let mut open: Vec<bool> = mask.data.iter().map(|v| *v == value).collect();
        let mut areas = Vec::new();
        for start in 0..open.len() {
            let mut stack = vec![start as isize];
            let mut area = 0;
            while let Some(i) = stack.pop() {
                if !std::mem::take(&mut open[i as usize]) {
                    continue;
                }
                area += 1;
                let (x, y) = (i % w, i / w);
                let around = (-1..2).flat_map(|dy| (-1..2).map(move |dx| (x + dx, y + dy)));
                stack.extend(
                    around.filter(|(x, y)| (0..w).contains(x) && (0..h).contains(y)).map(|(x, y)| y * w + x),
                );
            }
            areas.extend((area > 0).then_some(area));
        }
        areas
    }

    proptest! {
        #[test]
        fn runs_find_the_parts_that_flooding_finds(width in 1_usize..140, height in 1_usize..9, seed in any::<u64>()) {
            let mixed = |i: usize| (i as u64 + 1).wrapping_mul(seed | 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let is_set = |i: usize| mixed(i) >> 62 != 3;
            let image = Grid::from_vec(width, height, (0..width * height).map(is_set).collect());
            let columns = width.div_ceil(WORD);
            let mut rows = vec![0_u64; columns * height];
            for i in (0..image.data.len()).filter(|&i| image.data[i]) {
                rows[i / width * columns + i % width / WORD] |= 1 << (i % width % WORD);
            }
            for value in [true, false] {
                let found: Vec<usize> = parts(&rows, width, value).iter().map(|part| area(part)).collect();
                prop_assert_eq!(found, flooded(&image, value));
            }
        }
    }
}
