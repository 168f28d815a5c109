//! Clicks and boxes that become the masks of the objects they point at.

use super::{
    Mark, Marks,
    notes::{is_inside, lies_outside},
};
use crate::{
    Result,
    annotations::Shape,
    grid::Mask,
    segment::{PointSegmenter, Pointed, pointed_mask},
};
use image::RgbImage;
use std::collections::BTreeMap;

impl Mark {
    /// Returns the place that the mark points at; `None` if it shows all of its pixels by itself.
    pub fn pointed(&self) -> Option<Pointed> {
        match self.shape {
            Shape::Click { point_px, .. } => Some(Pointed::Point(point_px)),
            Shape::Box { corners_px } => Some(Pointed::Box(corners_px)),
            Shape::Stroke { .. } | Shape::Polygon { .. } | Shape::Mask(_) => None,
        }
    }

    /// Returns the mark with the mask of the object that it points at, on the picture that `segmenter` read
    /// last, of `size` (columns, rows). The mask ends where the endoscope's picture does: `field_of_view` is
    /// `true` inside of that, and may have another size. Where nothing is found, outside, and of another kind,
    /// the mark stays as it is.
    pub fn with_mask(
        &self,
        segmenter: &mut dyn PointSegmenter,
        size: [usize; 2],
        field_of_view: &Mask,
    ) -> Result<Self> {
        let inside = field_of_view.sampled(size[0], size[1]);
        let Some(place) = self.pointed().filter(|_| !lies_outside(self, size, &inside)) else {
            return Ok(self.clone());
        };
        let Some(found) = pointed_mask(segmenter, size, place)? else { return Ok(self.clone()) };
        let mut mask = found.to_mask();
        mask.data.iter_mut().enumerate().for_each(|(i, marked)| *marked &= is_inside(&inside, i));
        let is_empty = mask.count() == 0;
        Ok(if is_empty { self.clone() } else { Self { shape: Shape::from(&mask), ..self.clone() } })
    }
}

impl Marks {
    /// Returns the marks, those that point at an object with its mask, see [`Mark::with_mask`]. `picture`
    /// returns a frame; it is asked once for each frame with such marks.
    pub fn with_masks(
        self,
        segmenter: &mut dyn PointSegmenter,
        field_of_view: &Mask,
        mut picture: impl FnMut(usize) -> Result<RgbImage>,
    ) -> Result<Self> {
        let mut marks = self.marks;
        let mut pointing: BTreeMap<usize, Vec<&mut Mark>> = BTreeMap::new();
        for mark in marks.iter_mut().filter(|mark| mark.pointed().is_some()) {
            pointing.entry(mark.frame).or_default().push(mark);
        }
        for (frame, on_frame) in pointing {
            let picture = picture(frame)?;
            segmenter.set_image(&picture)?;
            let size = [picture.width() as usize, picture.height() as usize];
            for mark in on_frame {
                *mark = mark.with_mask(segmenter, size, field_of_view)?;
            }
        }
        Ok(Self::unchecked(marks))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::tests::ByColour;
    use image::Rgb;

    /// A grey tool of 40×30 pixels on tissue, further right on each frame.
    fn picture(frame: usize) -> RgbImage {
        let from = 20 + 10 * frame as u32;
        RgbImage::from_fn(128, 96, |x, y| match (from..from + 40).contains(&x) && (30..60).contains(&y) {
            true => Rgb([120, 130, 140]),
            false => Rgb([200, 40, 40]),
        })
    }

    fn click(frame: usize, add: bool, point_px: [f32; 2]) -> Mark {
        Mark::new(frame, "tool", add, Shape::Click { point_px, radius_px: 2.0 })
    }

    #[test]
    fn what_points_becomes_a_mask_and_what_was_drawn_stays() {
        let stroke = Shape::Stroke { points_px: vec![[5.0, 5.0], [30.0, 5.0]], radius_px: 3.0 };
        let marks = vec![
            click(2, true, [60.0, 45.0]),
            Mark::new(0, "tissue", true, stroke),
            click(0, true, [40.0, 45.0]),
            Mark::new(2, "tool", false, Shape::Box { corners_px: [[38.0, 28.0], [82.0, 62.0]] }),
        ];
        let mut segmenter = ByColour::new(|_, _| 0.9);
        let mut read = Vec::new();
        let masked = Marks::unchecked(marks.clone())
            .with_masks(&mut segmenter, &Mask::default(), |frame| {
                read.push(frame);
                Ok(picture(frame))
            })
            .unwrap();
        assert_eq!(read, [0, 2], "each frame is read once");
        assert_eq!(masked.all()[1], marks[1]);
        for (k, from) in [(0, 40), (2, 20), (3, 40)] {
            let (old, new) = (&marks[k], &masked.all()[k]);
            assert_eq!((old.frame, &old.name, old.add), (new.frame, &new.name, new.add));
            let pixels = new.shape.pixels(128, 96);
            assert!(pixels.at(from + 20, 45) && !pixels.at(from - 6, 45) && !pixels.at(from + 46, 45), "{k}");
        }
        assert_eq!(masked.standing().count(), 2, "the click and the box that denies it are one mask");
    }

    #[test]
    fn a_mark_on_nothing_stays_as_it_is() {
        let mut segmenter = ByColour::new(|_, _| 0.9);
        segmenter.set_image(&RgbImage::from_pixel(128, 96, Rgb([90; 3]))).unwrap();
        let mark = click(0, true, [9.0, 9.0]);
        assert_eq!(mark.with_mask(&mut segmenter, [128, 96], &Mask::default()).unwrap(), mark);
    }

    #[test]
    fn nothing_outside_of_the_endoscope_s_picture_is_asked_for_or_marked() {
        let mut segmenter = ByColour::new(|_, _| 0.9);
        segmenter.set_image(&picture(0)).unwrap();
        // What the endoscope shows begins in the middle of the tool.
        let seen = Mask::from_vec(128, 96, (0..128 * 96).map(|i| i % 128 >= 40).collect());
        let outside = click(0, true, [30.0, 45.0]);
        assert_eq!(outside.with_mask(&mut segmenter, [128, 96], &seen).unwrap(), outside);
        let tool = click(0, true, [50.0, 45.0]).with_mask(&mut segmenter, [128, 96], &seen).unwrap();
        let pixels = tool.shape.pixels(128, 96);
        assert!(pixels.at(50, 45) && pixels.at(40, 45) && !pixels.at(39, 45) && !pixels.at(30, 45));
    }
}
