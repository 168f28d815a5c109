//! Rectangles that are black in every frame, whatever the files show there: names and numbers that were burnt
//! in. They count as outside of the field of view, so that nothing is learned or found there either.

use crate::{
    Error,
    grid::{Grid, Mask},
};
use image::{Rgb, RgbImage};
use serde::{Deserialize, Serialize};
use std::{fmt, str::FromStr};

/// A rectangle of every frame that is hidden, in pixels of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HiddenRectangle {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

impl HiddenRectangle {
    /// Returns the rows and the columns that lie inside of a picture.
    fn within(&self, (width, height): (usize, usize)) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let right = self.x.saturating_add(self.width).min(width);
        let bottom = self.y.saturating_add(self.height).min(height);
        (self.y.min(bottom)..bottom, self.x.min(right)..right)
    }
}

impl fmt::Display for HiddenRectangle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{},{}", self.x, self.y, self.width, self.height)
    }
}

impl FromStr for HiddenRectangle {
    type Err = Error;

    /// Reads `x,y,width,height`.
    fn from_str(text: &str) -> Result<Self, Error> {
        let numbers: Result<Vec<usize>, _> = text.split(',').map(|number| number.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, width, height]) => Ok(Self { x, y, width, height }),
            _ => {
                Err(Error::input(format!("\"{text}\" is no rectangle"), "Write x,y,width,height in pixels."))
            }
        }
    }
}

/// Returns an error in words unless every rectangle has an area and begins inside of the frames.
pub(super) fn require_inside(hidden: &[HiddenRectangle], size: (usize, usize)) -> Result<(), String> {
    let is_empty = |range: &std::ops::Range<usize>| range.is_empty();
    let outside = hidden.iter().find(|rectangle| {
        let (rows, columns) = rectangle.within(size);
        is_empty(&rows) || is_empty(&columns)
    });
    match outside {
        Some(rectangle) => Err(format!(
            "the rectangle {rectangle} (x, y, width, height) hides nothing of frames of {}×{}",
            size.0, size.1
        )),
        None => Ok(()),
    }
}

/// Makes the rectangles of a picture of the recording's size black.
pub fn blacken(picture: &mut RgbImage, hidden: &[HiddenRectangle]) {
    let size = (picture.width() as usize, picture.height() as usize);
    for rectangle in hidden {
        let (rows, columns) = rectangle.within(size);
        for y in rows {
            columns.clone().for_each(|x| picture.put_pixel(x as u32, y as u32, Rgb([0; 3])));
        }
    }
}

/// Sets the rectangles of an image to one value.
pub(super) fn fill<T: Copy>(image: &mut Grid<T>, hidden: &[HiddenRectangle], value: T) {
    for rectangle in hidden {
        let (rows, columns) = rectangle.within((image.width, image.height));
        for y in rows {
            let row = y * image.width;
            image.data[row + columns.start..row + columns.end].fill(value);
        }
    }
}

/// Leaves the rectangles out of a mask.
pub(super) fn leave_out(mask: &mut Mask, hidden: &[HiddenRectangle]) {
    fill(mask, hidden, false);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_are_cut_at_the_border() {
        let rectangle: HiddenRectangle = "2, 1,9,1".parse().unwrap();
        assert_eq!(rectangle.to_string(), "2,1,9,1");
        let mut picture = RgbImage::from_pixel(4, 3, Rgb([9; 3]));
        blacken(&mut picture, &[rectangle]);
        let black: Vec<_> =
            picture.enumerate_pixels().filter(|(.., p)| p.0 == [0; 3]).map(|(x, y, _)| (x, y)).collect();
        assert_eq!(black, [(2, 1), (3, 1)]);
        assert!(
            require_inside(&[rectangle], (4, 3)).is_ok() && require_inside(&[rectangle], (2, 3)).is_err()
        );
        for wrong in ["", "1,2,3", "1,2,3,-4", "a,b,c,d"] {
            assert!(wrong.parse::<HiddenRectangle>().is_err(), "{wrong}");
        }
    }
}
