//! Parts of images that are outside the endoscope's field of view.

use std::ops::Range;
use surgtpgs_core::grid::Mask;

/// Pixels outside the field of view, for images of one size.
#[derive(Default)]
pub(super) struct Outside {
    size: (usize, usize),
    ranges: Vec<Range<usize>>,
}

impl Outside {
    /// Returns the pixels as runs; none without a mask. The mask is sampled at the images' size.
    pub(super) fn ranges(&mut self, size: (usize, usize), field_of_view: &Mask) -> &[Range<usize>] {
        if self.size != size {
            self.size = size;
            self.ranges = outside(size, field_of_view);
        }
        &self.ranges
    }
}

pub(super) fn outside((width, height): (usize, usize), field_of_view: &Mask) -> Vec<Range<usize>> {
    let mut ranges: Vec<Range<usize>> = Vec::new();
    for (i, is_inside) in field_of_view.sampled(width, height).data.into_iter().enumerate() {
        if is_inside {
            continue;
        }
        match ranges.last_mut() {
            Some(last) if last.end == i => last.end = i + 1,
            _ => ranges.push(i..i + 1),
        }
    }
    ranges
}

pub(super) fn blank(values: &mut [f32], ranges: &[Range<usize>]) {
    ranges.iter().for_each(|range| values[range.clone()].fill(0.0));
}
