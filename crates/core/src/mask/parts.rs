//! Connected parts of a mask, found from runs of pixels instead of pixel by pixel.

use super::bits::WORD;

/// Pixels `from..to` of row `y`.
#[derive(Clone, Copy)]
pub(crate) struct Run {
    pub(crate) y: usize,
    pub(crate) from: usize,
    pub(crate) to: usize,
}

/// Pixels that count as connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Touching {
    /// Those that share a side: four neighbours.
    Sides,
    /// Those that share a corner, too: eight neighbours.
    Corners,
}

/// Returns the number of pixels of a part.
pub(crate) fn area(part: &[Run]) -> usize {
    part.iter().map(|run| run.to - run.from).sum()
}

/// Returns the connected parts of the bits equal to `value`, in order of their first runs. Rows are whole
/// words.
pub(crate) fn parts(rows: &[u64], width: usize, value: bool, touching: Touching) -> Vec<Vec<Run>> {
    // A run above that ends here still touches over a corner.
    let reach = usize::from(touching == Touching::Corners);
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
            while candidate < above.end && runs[candidate].to + reach <= runs[i].from {
                candidate += 1;
            }
            let touching = (candidate..above.end).take_while(|&k| runs[k].from < runs[i].to + reach);
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
    use crate::{
        grid::Grid,
        mask::{Bits, Mask},
    };
    use proptest::prelude::*;

    /// Finds parts by flooding, pixel by pixel.
    fn flooded(mask: &Mask, value: bool, touching: Touching) -> Vec<usize> {
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
                let steps = (-1..2).flat_map(|dy| (-1..2).map(move |dx| (dx, dy)));
                let is_side = |(dx, dy): &(isize, isize)| dx * dy == 0;
                let counts = steps.filter(|step| touching == Touching::Corners || is_side(step));
                let around = counts.map(|(dx, dy)| (x + dx, y + dy));
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
            let bits = Bits::of_mask(&image);
            for (value, touching) in [true, false].into_iter().flat_map(|v| [(v, Touching::Sides), (v, Touching::Corners)]) {
                let found = parts(bits.rows(), width, value, touching);
                let found: Vec<usize> = found.iter().map(|part| area(part)).collect();
                prop_assert_eq!(found, flooded(&image, value, touching));
            }
        }
    }
}
