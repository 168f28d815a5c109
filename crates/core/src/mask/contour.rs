//! The border of a mask as closed lines along the edges of its pixels.

use super::{
    Mask,
    bits::{Bits, WORD, set_bits},
};

/// A corner between pixels: (0, 0) is the image's upper left corner, (width, height) its lower right one.
pub type Corner = (usize, usize);

/// Steps along pixel edges, clockwise: right, down, left, up.
const STEPS: [(isize, isize); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

/// Closed lines around the `true` pixels. Each consists of its corners only, and the first is not
/// repeated at the end.
///
/// The mask lies to the right of the direction of travel: outer borders run clockwise as seen, those of
/// holes counter-clockwise. Filling the lines by either fill rule gives the mask again. Pixels that touch
/// only at a corner have lines of their own.
pub fn contours(mask: &Mask) -> Vec<Vec<Corner>> {
    let mut edges = Edges::of(mask);
    let mut lines = Vec::new();
    for start in std::mem::take(&mut edges.corners) {
        while edges.leaving[start] != 0 {
            lines.push(edges.follow(start));
        }
    }
    lines
}

/// Steps that leave each corner, one bit per step. Steps that were taken are cleared.
struct Edges {
    columns: usize,
    leaving: Vec<u8>,
    /// Corners that a step leaves, in ascending order.
    corners: Vec<usize>,
}

impl Edges {
    /// Finds the steps that have a pixel of the mask to their right and none to their left, 64 corners at once.
    fn of(mask: &Mask) -> Self {
        let bits = Bits::of_mask(mask);
        let columns = mask.width + 1;
        let mut edges = Self { columns, leaving: vec![0; columns * (mask.height + 1)], corners: Vec::new() };
        for y in 0..=mask.height {
            let above = if y > 0 { bits.row(y - 1) } else { &[] };
            let below = if y < mask.height { bits.row(y) } else { &[] };
            for k in 0..columns.div_ceil(WORD) {
                // Pixels to the upper and lower right of 64 corners, then those to the left.
                let [ur, lr] = [above, below].map(|row| word(row, k));
                let [ul, ll] = [(above, ur), (below, lr)].map(|(row, right)| {
                    right << 1 | k.checked_sub(1).map_or(0, |k| word(row, k)) >> (WORD - 1)
                });
                let steps = [lr & !ur, ll & !lr, ul & !ll, ur & !ul];
                for x in set_bits(&[steps.into_iter().fold(0, |all, step| all | step)]) {
                    let corner = y * columns + k * WORD + x;
                    edges.corners.push(corner);
                    edges.leaving[corner] = (0..4).map(|step| ((steps[step] >> x & 1) as u8) << step).sum();
                }
            }
        }
        edges
    }

    /// Returns the line through the corner with index `start` and removes its edges.
    fn follow(&mut self, start: usize) -> Vec<Corner> {
        let mut line = Vec::new();
        let (mut at, mut last) = (start, None);
        loop {
            let step = self.turn(at, last);
            if last != Some(step) {
                line.push((at % self.columns, at / self.columns));
            }
            self.leaving[at] &= !(1 << step);
            let (dx, dy) = STEPS[step];
            at = at.wrapping_add_signed(dx + dy * self.columns as isize);
            last = Some(step);
            if at == start {
                return line;
            }
        }
    }

    /// Chooses the next step. If two lines meet at a corner, it is the sharper right turn, which stays at
    /// the same pixel.
    fn turn(&self, at: usize, last: Option<usize>) -> usize {
        let first = last.map_or(0, |step| step + 1);
        let ways = (0..4).map(|k| (first + 4 - k) % 4);
        ways.into_iter().find(|step| self.leaving[at] >> step & 1 == 1).unwrap_or(0)
    }
}

/// Returns a word of a row of bits; beyond its end nothing is set.
fn word(row: &[u64], k: usize) -> u64 {
    row.get(k).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use proptest::prelude::*;

    /// Twice the area to the right of the line.
    fn doubled_area(line: &[Corner]) -> i64 {
        let next = line.iter().cycle().skip(1);
        let part = |(a, b): (&Corner, &Corner)| a.0 as i64 * b.1 as i64 - b.0 as i64 * a.1 as i64;
        line.iter().zip(next).map(part).sum()
    }

    /// Pixels with an odd number of vertical edges to their left.
    fn filled(lines: &[Vec<Corner>], width: usize, height: usize) -> Mask {
        let mut mask = Grid::filled(width, height, false);
        for line in lines {
            for (a, b) in line.iter().zip(line.iter().cycle().skip(1)).filter(|(a, b)| a.0 == b.0) {
                for y in a.1.min(b.1)..a.1.max(b.1) {
                    (a.0..width).for_each(|x| mask.set(x, y, !mask.at(x, y)));
                }
            }
        }
        mask
    }

    #[test]
    fn a_rectangle_is_four_corners_clockwise() {
        let mask = Grid::from_vec(4, 3, (0..12).map(|i| (1..3).contains(&(i % 4)) && i < 8).collect());
        assert_eq!(contours(&mask), [[(1, 0), (3, 0), (3, 2), (1, 2)]]);
    }

    #[test]
    fn holes_run_the_other_way_and_corners_do_not_join() {
        let ring = Grid::from_vec(3, 3, (0..9).map(|i| i != 4).collect());
        let lines = contours(&ring);
        assert_eq!(lines.iter().map(|l| doubled_area(l)).collect::<Vec<_>>(), [18, -2]);
        let diagonal = Grid::from_vec(2, 2, vec![true, false, false, true]);
        assert_eq!(contours(&diagonal).len(), 2);
    }

    #[test]
    fn nothing_has_no_border() {
        assert!(contours(&Grid::filled(5, 4, false)).is_empty());
        assert!(contours(&Grid::filled(0, 0, true)).is_empty());
    }

    proptest! {
        #[test]
        fn the_lines_filled_are_the_mask(width in 1_usize..140, height in 1_usize..9, seed in any::<u64>()) {
            let mixed = |i: usize| (i as u64 + 1).wrapping_mul(seed | 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let is_set = |i: usize| mixed(i) >> 63 == 1;
            let mask = Grid::from_vec(width, height, (0..width * height).map(is_set).collect());
            let lines = contours(&mask);
            prop_assert_eq!(filled(&lines, width, height), mask.clone());
            let area: i64 = lines.iter().map(|l| doubled_area(l)).sum();
            prop_assert_eq!(area, 2 * mask.count() as i64);
        }
    }
}
