//! A mask of an image as bits inside its bounding box. Hundreds of masks fit into memory, and two are
//! compared 64 pixels at a time.

use crate::{
    grid::{Grid, Mask},
    mask::{Bits, PixelRect, WORD, set_bits},
};

/// A mask with at least one pixel. Words begin at multiples of 64 columns of the image, so that those of
/// two masks are aligned.
#[derive(Clone, Debug, PartialEq)]
pub struct BitMask {
    width: usize,
    height: usize,
    bounds: PixelRect,
    area_px: usize,
    /// Rows of the bounding box, each in whole words; bits outside the box are 0.
    words: Vec<u64>,
}

impl BitMask {
    /// Creates a mask from the rows of a whole image of `width` columns, each in `width / 64` words
    /// rounded up; `None` for an empty mask. Bits beyond the last column must be 0.
    pub(super) fn from_rows(width: usize, rows: &[u64]) -> Option<Self> {
        let columns = width.div_ceil(WORD).max(1);
        let is_used = |row: &[u64]| row.iter().any(|&word| word != 0);
        let first = rows.chunks_exact(columns).position(is_used)?;
        let last = rows.chunks_exact(columns).rposition(is_used)?;
        let used = &rows[first * columns..(last + 1) * columns];
        let (mut left, mut right, mut area_px) = (usize::MAX, 0, 0);
        for row in used.chunks_exact(columns).filter(|row| is_used(row)) {
            let (low, high) = (row.iter().position(|&w| w != 0)?, row.iter().rposition(|&w| w != 0)?);
            left = left.min(low * WORD + row[low].trailing_zeros() as usize);
            right = right.max(high * WORD + (WORD - 1 - row[high].leading_zeros() as usize));
            area_px += row[low..=high].iter().map(|word| word.count_ones() as usize).sum::<usize>();
        }
        let bounds = PixelRect { x: left, y: first, width: right - left + 1, height: last - first + 1 };
        let words =
            used.chunks_exact(columns).flat_map(|row| row[left / WORD..=right / WORD].to_vec()).collect();
        Some(Self { width, height: rows.len() / columns, bounds, area_px, words })
    }

    /// Creates a mask of the `true` pixels; `None` if there are none.
    pub fn of(mask: &Mask) -> Option<Self> {
        Self::from_rows(mask.width, Bits::of_mask(mask).rows())
    }

    /// Returns the number of columns of the image.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the number of rows of the image.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns the smallest rectangle around the pixels.
    pub fn bounds(&self) -> PixelRect {
        self.bounds
    }

    /// Returns the number of pixels.
    pub fn area_px(&self) -> usize {
        self.area_px
    }

    /// Returns `true` if the pixel (x, y) of the image is in the mask.
    pub fn has(&self, x: usize, y: usize) -> bool {
        let first = self.bounds.x / WORD;
        let is_inside = (self.bounds.y..self.bounds.y + self.bounds.height).contains(&y)
            && (first..first + self.columns()).contains(&(x / WORD));
        is_inside && self.row(y)[x / WORD - first] >> (x % WORD) & 1 == 1
    }

    /// Iterates over every pixel as (x, y), row by row.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, usize)> {
        let start = self.bounds.x / WORD * WORD;
        let rows = self.words.chunks_exact(self.columns()).zip(self.bounds.y..);
        rows.flat_map(move |(row, y)| set_bits(row).map(move |x| (start + x, y)))
    }

    /// Converts the mask to one value per pixel.
    pub fn to_mask(&self) -> Mask {
        let mut mask = Grid::filled(self.width, self.height, false);
        self.pixels().for_each(|(x, y)| mask.set(x, y, true));
        mask
    }

    /// Returns the number of pixels in both masks, which belong to one image.
    pub fn intersection_px(&self, other: &Self) -> usize {
        let rows = self.bounds.y.max(other.bounds.y)
            ..(self.bounds.y + self.bounds.height).min(other.bounds.y + other.bounds.height);
        let (a, b) = (self.bounds.x / WORD, other.bounds.x / WORD);
        let (from, to) = (a.max(b), (a + self.columns()).min(b + other.columns()));
        if from >= to {
            return 0;
        }
        let both = |y| {
            let pairs = self.row(y)[from - a..to - a].iter().zip(&other.row(y)[from - b..to - b]);
            pairs.map(|(a, b)| (a & b).count_ones() as usize).sum::<usize>()
        };
        rows.map(both).sum()
    }

    /// Returns |a ∩ b| / |a ∪ b|.
    pub fn iou(&self, other: &Self) -> f64 {
        let both = self.intersection_px(other);
        both as f64 / (self.area_px + other.area_px - both) as f64
    }

    /// Returns the words of image row `y`, which must be inside the bounding box. The first word is the
    /// one that holds the left border of the box.
    pub(super) fn row(&self, y: usize) -> &[u64] {
        let columns = self.columns();
        &self.words[(y - self.bounds.y) * columns..][..columns]
    }

    /// Returns the number of words in a row.
    fn columns(&self) -> usize {
        (self.bounds.x + self.bounds.width - 1) / WORD - self.bounds.x / WORD + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask;
    use proptest::prelude::*;

    fn speckled(width: usize, height: usize, seed: u64, shift: u32) -> Mask {
        let mixed = |i: usize| (i as u64 + 1).wrapping_mul(seed | 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let is_set = |i: usize| mixed(i) >> shift == 0;
        Grid::from_vec(width, height, (0..width * height).map(is_set).collect())
    }

    proptest! {
        #[test]
        fn bits_say_what_pixels_say(
            width in 1_usize..200, height in 1_usize..7, seeds in any::<[u64; 2]>(), shift in 61_u32..64,
        ) {
            let (a, b) = (speckled(width, height, seeds[0], shift), speckled(width, height, seeds[1], shift));
            let (Some(bits), Some(other)) = (BitMask::of(&a), BitMask::of(&b)) else {
                prop_assert!(a.count() == 0 || b.count() == 0);
                return Ok(());
            };
            prop_assert_eq!(bits.to_mask(), a.clone());
            prop_assert_eq!(Some(bits.bounds()), mask::bounding_box(&a));
            prop_assert_eq!(bits.area_px(), a.count());
            let both = a.data.iter().zip(&b.data).filter(|(a, b)| **a && **b).count();
            prop_assert_eq!(bits.intersection_px(&other), both);
            prop_assert_eq!(Some(bits.iou(&other)), mask::iou(&a, &b));
            prop_assert!((0..width * height).all(|i| bits.has(i % width, i / width) == a.data[i]));
            prop_assert!(!bits.has(width + 70, 0) && !bits.has(0, height + 1));
        }
    }

    #[test]
    fn an_empty_mask_is_none() {
        assert_eq!(BitMask::of(&Grid::filled(5, 4, false)), None);
        assert_eq!(BitMask::of(&Grid::filled(0, 0, true)), None);
    }

    #[test]
    fn masks_that_do_not_meet_share_nothing() {
        let at = |x: usize, y: usize| {
            let mut mask = Grid::filled(300, 20, false);
            mask.set(x, y, true);
            BitMask::of(&mask).unwrap()
        };
        assert_eq!(at(2, 3).intersection_px(&at(290, 3)), 0);
        assert_eq!(at(2, 3).intersection_px(&at(2, 9)), 0);
        assert_eq!(at(2, 3).intersection_px(&at(2, 3)), 1);
    }
}
