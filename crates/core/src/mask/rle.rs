//! Run lengths of a mask as COCO writes them: column by column, beginning with a run of `false`.

use super::Mask;
use crate::camera::MAX_IMAGE_PIXELS;

/// A mask as run lengths of its columns. It takes as much memory as the mask has borders.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Runs {
    width: usize,
    height: usize,
    lengths: Vec<u32>,
}

impl Runs {
    /// Takes the runs of a mask.
    pub fn of(mask: &Mask) -> Self {
        Self::placed(mask, (0, 0), (mask.width, mask.height))
    }

    /// Takes the runs of a picture of `size` that shows `part` at `(left, top)` and is `false` elsewhere. The
    /// part must lie inside.
    pub(crate) fn placed(part: &Mask, (left, top): (usize, usize), size: (usize, usize)) -> Self {
        let (width, height) = size;
        let mut lengths = Lengths::default();
        lengths.push(false, left * height);
        for x in 0..part.width {
            lengths.push(false, top);
            (0..part.height).for_each(|y| lengths.push(part.at(x, y), 1));
            lengths.push(false, height - top - part.height);
        }
        lengths.push(false, (width - left - part.width) * height);
        Self { width, height, lengths: lengths.0 }
    }

    /// Takes run lengths, alternating `false` and `true`; `None` if their sum is not the number of pixels, or no
    /// picture has as many.
    pub fn new(width: usize, height: usize, lengths: &[u32]) -> Option<Self> {
        let total: u64 = lengths.iter().map(|run| u64::from(*run)).sum();
        if total != width.checked_mul(height)? as u64 || total > MAX_IMAGE_PIXELS as u64 {
            return None;
        }
        let mut merged = Lengths::default();
        lengths.iter().enumerate().for_each(|(i, run)| merged.push(i % 2 == 1, *run as usize));
        Some(Self { width, height, lengths: merged.0 })
    }

    /// Returns columns and rows of the mask.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Returns the lengths of the runs, alternating `false` and `true`; only the first may be 0.
    pub fn lengths(&self) -> &[u32] {
        &self.lengths
    }

    /// Returns `true` if no pixel is `true`.
    pub fn is_empty(&self) -> bool {
        self.lengths.len() < 2
    }

    /// Returns the mask.
    pub fn mask(&self) -> Mask {
        let mut mask = Mask::filled(self.width, self.height, false);
        let mut at = 0;
        for (i, &run) in self.lengths.iter().enumerate() {
            let next = at + run as usize;
            if i % 2 == 1 {
                (at..next).for_each(|k| mask.set(k / self.height, k % self.height, true));
            }
            at = next;
        }
        mask
    }
}

/// Run lengths while they are collected.
struct Lengths(Vec<u32>);

impl Default for Lengths {
    fn default() -> Self {
        Self(vec![0])
    }
}

impl Lengths {
    /// Adds `count` pixels of one value.
    fn push(&mut self, value: bool, count: usize) {
        if count == 0 {
            return;
        }
        if value != self.0.len().is_multiple_of(2) {
            self.0.push(0);
        }
        if let Some(run) = self.0.last_mut() {
            *run += count as u32;
        }
    }
}

/// Lengths of the runs, alternating `false` and `true`; the first is 0 if the mask begins with `true`.
pub fn column_runs(mask: &Mask) -> Vec<u32> {
    Runs::of(mask).lengths
}

/// Text form of run lengths that COCO calls compressed. From the fourth on, each length is stored as the
/// difference from the one two before it. Each letter holds five bits, the lowest first. A sixth bit says
/// that more letters follow. `0` stands for no bit set.
pub fn compressed(runs: &[u32]) -> String {
    let mut text = String::new();
    for (i, &run) in runs.iter().enumerate() {
        let before = if i > 2 { i64::from(runs[i - 2]) } else { 0 };
        let mut left = i64::from(run) - before;
        loop {
            let bits = (left & 31) as u8;
            left >>= 5;
            // The fifth bit is the sign of the rest.
            let is_last = left == if bits & 16 == 0 { 0 } else { -1 };
            text.push(char::from(b'0' + bits + if is_last { 0 } else { 32 }));
            if is_last {
                break;
            }
        }
    }
    text
}

/// Inverse of [`compressed`]; `None` for a text that it does not make.
pub fn decompressed(text: &str) -> Option<Vec<u32>> {
    let mut runs: Vec<i64> = Vec::new();
    let (mut value, mut shift) = (0_i64, 0);
    for letter in text.bytes() {
        let letter = i64::from(letter.checked_sub(b'0').filter(|l| *l < 64)?);
        if shift > 30 {
            return None;
        }
        value |= (letter & 31) << shift;
        shift += 5;
        if letter & 32 != 0 {
            continue;
        }
        if letter & 16 != 0 {
            value |= -1 << shift;
        }
        let before = if runs.len() > 2 { runs[runs.len() - 2] } else { 0 };
        runs.push(value + before);
        (value, shift) = (0, 0);
    }
    let runs = runs.into_iter().map(|run| u32::try_from(run).ok()).collect();
    if shift == 0 { runs } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use proptest::prelude::*;

    fn of(width: usize, height: usize, is_set: impl Fn(usize, usize) -> bool) -> Mask {
        Grid::from_vec(width, height, (0..width * height).map(|i| is_set(i % width, i / width)).collect())
    }

    /// The texts are those that pycocotools 2.0.11 makes of these masks; `tests/oracle` prints them.
    #[test]
    fn the_compressed_form_is_that_of_pycocotools() {
        let texts = [
            (of(7, 5, |x, y| y > x || x == 6), PYCOCOTOOLS[0]),
            (of(40, 24, |x, y| 3 * x + 5 * y < 90 && (x + 2 * y) % 7 > 1), PYCOCOTOOLS[1]),
            (of(130, 90, |x, y| x * x + 3 * y * y < 9_000 && (x < 40 || y > 20)), PYCOCOTOOLS[2]),
            (of(6, 4, |_, _| true), PYCOCOTOOLS[3]),
            (of(6, 4, |_, _| false), PYCOCOTOOLS[4]),
        ];
        for (mask, text) in texts {
            assert_eq!(compressed(&column_runs(&mask)), text);
        }
    }

    const PYCOCOTOOLS: [&str; 5] = [
        "142O1O1O64",
        "131O010O016OJ10O010O61JO010O016OJ10O010O70I0010O017NI20O010O8OH1010O0190GO010O:0F10O0190GO010O:0F10O00;0E0010O;OE20O00<OD1010O=1CO00>0B10N>2BO00>0B10N?1A000?OA20N`00@10Ob02^ONb01^OOb02^ONb01^OOc012O[O0d0030V8",
        "0g1S1000000000000000000000000000000O100000000000000O10000000000O100000000O1000000Of0[O00000O10000O10000O10000O10000O100O100O100O100O100O100O100O1O100O1O100O1O1O100O1O1O1O1O1O1O1O1Nae3",
        "0h0",
        "h0",
    ];

    #[test]
    fn runs_go_down_the_columns() {
        assert_eq!(column_runs(&of(3, 2, |x, y| (x, y) == (1, 0))), [2, 1, 3]);
        assert_eq!(column_runs(&of(2, 3, |x, _| x == 0)), [0, 3, 3]);
        assert_eq!(column_runs(&of(0, 3, |_, _| true)), [0]);
    }

    #[test]
    fn texts_that_are_none_are_refused() {
        for text in ["h", "é", "~~", "PPPPPPPPPPPPP0"] {
            assert_eq!(decompressed(text), None, "{text}");
        }
        assert_eq!(decompressed(""), Some(vec![]));
        assert_eq!(Runs::new(2, 2, &[1, 2]), None);
        assert_eq!(Runs::new(2, 2, &[u32::MAX, 2]), None);
    }

    #[test]
    fn a_part_lies_where_it_is_placed() {
        let part = of(2, 2, |x, y| (x, y) != (1, 0));
        let whole = of(5, 4, |x, y| [(2, 1), (2, 2), (3, 2)].contains(&(x, y)));
        assert_eq!(Runs::placed(&part, (2, 1), (5, 4)), Runs::of(&whole));
    }

    proptest! {
        #[test]
        fn the_compressed_form_reads_back(runs in prop::collection::vec(0_u32..2_000_000, 0..40)) {
            prop_assert_eq!(decompressed(&compressed(&runs)), Some(runs));
        }

        #[test]
        fn runs_read_back(width in 0_usize..9, height in 0_usize..9, seed in any::<u64>()) {
            let mask = of(width, height, |x, y| seed.rotate_left((7 * x + 13 * y) as u32) & 5 == 1);
            let runs = Runs::of(&mask);
            prop_assert_eq!(runs.mask(), mask.clone());
            prop_assert_eq!(runs.is_empty(), mask.count() == 0);
            let split: Vec<u32> = runs.lengths().iter().flat_map(|run| [run / 2, 0, run - run / 2]).collect();
            prop_assert_eq!(Runs::new(width, height, &split), Some(runs));
        }
    }
}
