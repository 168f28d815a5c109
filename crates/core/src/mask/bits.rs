//! A mask as bits, 64 pixels per word: many pixels are eroded and dilated at once.

use super::Mask;
use crate::grid::Grid;
use rayon::prelude::*;

/// Number of pixels in a word.
pub(crate) const WORD: usize = u64::BITS as usize;

/// The mask, row by row in whole words; bits beyond the last column are 0.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Bits {
    width: usize,
    words_per_row: usize,
    words: Vec<u64>,
}

impl Bits {
    /// Makes a mask of `width` × `height` pixels; `is_set` is asked for each pixel's index.
    pub(crate) fn of(width: usize, height: usize, is_set: impl Fn(usize) -> bool + Sync) -> Self {
        let words_per_row = width.div_ceil(WORD);
        let mut words = vec![0; words_per_row * height];
        words.par_chunks_mut(words_per_row.max(1)).with_min_len(16).enumerate().for_each(|(y, row)| {
            for (k, word) in row.iter_mut().enumerate() {
                let columns = k * WORD..((k + 1) * WORD).min(width);
                *word = columns.rev().fold(0, |word, x| word << 1 | u64::from(is_set(y * width + x)));
            }
        });
        Self { width, words_per_row, words }
    }

    /// Packs a mask.
    pub(crate) fn of_mask(mask: &Mask) -> Self {
        Self::of(mask.width, mask.height, |i| mask.data[i])
    }

    /// Words of all rows, one after the other.
    pub(crate) fn rows(&self) -> &[u64] {
        &self.words
    }

    /// Words of a row.
    pub(crate) fn row(&self, y: usize) -> &[u64] {
        &self.words[y * self.words_per_row..(y + 1) * self.words_per_row]
    }

    /// Pixels that are set and whose four neighbours are set too; everything outside the image counts as set.
    pub(crate) fn eroded(&self) -> Self {
        self.with_neighbours(u64::MAX, |a, b| a & b)
    }

    /// Pixels that are set or have a neighbour that is set.
    pub(crate) fn dilated(&self) -> Self {
        self.with_neighbours(0, |a, b| a | b)
    }

    /// Pixels that are set here and not in `other`; both have the same size.
    pub(crate) fn without(&self, other: &Self) -> Self {
        let words = self.words.iter().zip(&other.words).map(|(a, b)| a & !b).collect();
        Self { words, ..*self }
    }

    /// Unpacks the bits into a mask.
    pub(crate) fn to_mask(&self) -> Mask {
        let height = self.words.len() / self.words_per_row.max(1);
        let mut mask = Grid::filled(self.width, height, false);
        for (y, row) in mask.data.chunks_exact_mut(self.width.max(1)).enumerate() {
            set_bits(self.row(y)).for_each(|x| row[x] = true);
        }
        mask
    }

    /// Combines each pixel with its neighbours; words outside the image are `outside`.
    fn with_neighbours(&self, outside: u64, join: impl Fn(u64, u64) -> u64 + Sync) -> Self {
        let (columns, rows) = (self.words_per_row, self.words.len() / self.words_per_row.max(1));
        // Mask of the bits in a row's last word that are pixels.
        let tail = u64::MAX >> ((WORD - self.width % WORD) % WORD);
        let inside = |k: usize| if k + 1 == columns { tail } else { u64::MAX };
        let word = |y: isize, k: isize| {
            let is_there = (0..rows as isize).contains(&y) && (0..columns as isize).contains(&k);
            if !is_there {
                return outside;
            }
            let (y, k) = (y as usize, k as usize);
            self.words[y * columns + k] | (outside & !inside(k))
        };
        let mut words = vec![0; self.words.len()];
        words.par_iter_mut().with_min_len(1024).enumerate().for_each(|(i, out)| {
            let (y, k) = ((i / columns) as isize, (i % columns) as isize);
            let here = word(y, k);
            let left = here << 1 | word(y, k - 1) >> (WORD - 1);
            let right = here >> 1 | word(y, k + 1) << (WORD - 1);
            let beside = join(left, right);
            let all = join(join(here, beside), join(word(y - 1, k), word(y + 1, k)));
            *out = all & inside(k as usize);
        });
        Self { words, ..*self }
    }
}

/// Indices of the bits that are set in the words of a row.
pub(crate) fn set_bits(words: &[u64]) -> impl Iterator<Item = usize> {
    words.iter().enumerate().flat_map(|(k, &word)| {
        let mut left = word;
        std::iter::from_fn(move || {
            let bit = (left != 0).then(|| left.trailing_zeros() as usize);
            left &= left.wrapping_sub(1);
            bit.map(|bit| k * WORD + bit)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plainly(mask: &Mask, outside: bool, all: bool) -> Mask {
        let (w, h) = (mask.width as isize, mask.height as isize);
        let at = |x: isize, y: isize| {
            if (0..w).contains(&x) && (0..h).contains(&y) { mask.at(x as usize, y as usize) } else { outside }
        };
        let value = |i: isize| {
            let (x, y) = (i % w, i / w);
            let five = [at(x, y), at(x - 1, y), at(x + 1, y), at(x, y - 1), at(x, y + 1)];
            if all { five.iter().all(|v| *v) } else { five.iter().any(|v| *v) }
        };
        Grid::from_vec(mask.width, mask.height, (0..w * h).map(value).collect())
    }

    proptest! {
        #[test]
        fn bits_do_what_pixels_do(width in 1_usize..140, height in 1_usize..6, seed in any::<u64>()) {
            let is_set = |i: usize| (i as u64).wrapping_mul(seed | 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 62 != 0;
            let bits = Bits::of(width, height, is_set);
            let mask = bits.to_mask();
            prop_assert_eq!(&mask.data, &(0..width * height).map(is_set).collect::<Vec<_>>());
            prop_assert_eq!(bits.eroded().to_mask(), plainly(&mask, true, true));
            prop_assert_eq!(bits.dilated().to_mask(), plainly(&mask, false, false));
            let pairs = bits.dilated().to_mask().data.into_iter().zip(&mask.data);
            let ring: Vec<bool> = pairs.map(|(dilated, own)| dilated && !own).collect();
            prop_assert_eq!(bits.dilated().without(&bits).to_mask().data, ring);
        }
    }

    #[test]
    fn nothing_stays_nothing() {
        let none = Bits::of(0, 0, |_| true);
        assert_eq!(none.eroded().dilated().to_mask().data.len(), 0);
        assert_eq!(Bits::of(5, 0, |_| true).eroded().to_mask().height, 0);
    }
}
