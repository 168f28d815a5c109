//! Run lengths of a mask as COCO writes them: column by column, beginning with a run of `false`.

use super::Mask;

/// Lengths of the runs, alternating `false` and `true`; the first is 0 if the mask begins with `true`.
pub fn column_runs(mask: &Mask) -> Vec<u32> {
    let mut runs = vec![0];
    let mut value = false;
    for x in 0..mask.width {
        for y in 0..mask.height {
            if mask.at(x, y) != value {
                value = !value;
                runs.push(0);
            }
            if let Some(run) = runs.last_mut() {
                *run += 1;
            }
        }
    }
    runs
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

/// Inverse of [`column_runs`]; `None` if the sum of the runs is not the number of pixels.
pub fn from_column_runs(width: usize, height: usize, runs: &[u32]) -> Option<Mask> {
    let total: u64 = runs.iter().map(|run| u64::from(*run)).sum();
    if total != (width * height) as u64 {
        return None;
    }
    let mut mask = Mask::filled(width, height, false);
    let mut at = 0;
    for (i, &run) in runs.iter().enumerate() {
        let next = at + run as usize;
        if i % 2 == 1 {
            (at..next).for_each(|k| mask.set(k / height, k % height, true));
        }
        at = next;
    }
    Some(mask)
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
        assert_eq!(from_column_runs(2, 2, &[1, 2]), None);
        assert_eq!(from_column_runs(2, 2, &[u32::MAX, 2]), None);
    }

    proptest! {
        #[test]
        fn the_compressed_form_reads_back(runs in prop::collection::vec(0_u32..2_000_000, 0..40)) {
            prop_assert_eq!(decompressed(&compressed(&runs)), Some(runs));
        }

        #[test]
        fn runs_read_back(width in 0_usize..9, height in 0_usize..9, seed in any::<u64>()) {
            let mask = of(width, height, |x, y| seed.rotate_left((7 * x + 13 * y) as u32) & 5 == 1);
            prop_assert_eq!(from_column_runs(width, height, &column_runs(&mask)), Some(mask));
        }
    }
}
