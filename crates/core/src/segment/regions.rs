//! Small islands and holes of a mask.

use super::bit_mask::BitMask;
use crate::mask::{Run, Touching, WORD, area, parts};

/// Fills holes and then drops islands of fewer than `min_px` pixels (neighbours over corners count), as
/// Segment Anything's `remove_small_regions` does. If all islands are small, the largest stays. An
/// opening at the image's border is a hole too. `None` if the mask has neither.
pub(super) fn without_small_regions(mask: &BitMask, min_px: usize) -> Option<BitMask> {
    let width = mask.width();
    let (mut rows, columns) = (rows_of(mask), width.div_ceil(WORD));
    let holes = parts(&rows, width, false, Touching::Corners);
    let small: Vec<_> = holes.into_iter().filter(|hole| area(hole) < min_px).flatten().collect();
    small.iter().for_each(|run| flip(&mut rows, columns, run));
    let mut islands = parts(&rows, width, true, Touching::Corners);
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

fn flip(rows: &mut [u64], columns: usize, run: &Run) {
    (run.from..run.to).for_each(|x| rows[run.y * columns + x / WORD] ^= 1 << (x % WORD));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Mask;

    fn mask(rows: &[&str]) -> BitMask {
        BitMask::of(&Mask::drawn(rows)).unwrap()
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
}
