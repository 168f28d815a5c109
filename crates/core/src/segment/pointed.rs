//! The mask of one object that somebody points at.

use super::{
    BitMask, MaskSettings, PointSegmenter, generate::checked, regions::without_small_regions,
    upsample::Upsampler,
};
use crate::{Result, mask::PixelRect};

/// A place on a picture that an object is at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pointed {
    /// A point (x, y) on the object, in pixels.
    Point([f32; 2]),
    /// Two opposite corners of a box around the object, in pixels.
    Box([[f32; 2]; 2]),
}

/// Returns the mask of the object at a place of the picture that `segmenter` read last, of `size` (columns,
/// rows): of its answers, the one that fits the place and is rated best. `None` if it finds nothing there, or
/// hardly anything else.
pub fn pointed_mask(
    segmenter: &mut dyn PointSegmenter,
    size: [usize; 2],
    place: Pointed,
) -> Result<Option<BitMask>> {
    let settings = MaskSettings::default();
    let within = |at: [f32; 2]| [0, 1].map(|axis| at[axis].clamp(0.0, size[axis] as f32 - 0.5));
    let prediction = match place {
        Pointed::Point(at) => segmenter.predict(&[vec![within(at)]], None)?,
        Pointed::Box(corners) => segmenter.predict_box(corners.map(within))?,
    };
    let prediction = checked(prediction, 1)?;
    let [width, height] = size;
    let whole = PixelRect { x: 0, y: 0, width, height };
    let upsampler = Upsampler::new(size, whole, prediction.size, prediction.extent);
    let most_px = settings.max_share * (width * height) as f32;
    let maps = prediction.logits.chunks_exact(prediction.size[0] * prediction.size[1]);
    let answer = |(logits, rating): (&[f32], &f32)| {
        let mask = upsampler.measure(logits, settings.stability_offset)?.mask;
        let fits = place.fit(&mask);
        (fits > 0.0 && mask.area_px() as f32 <= most_px).then_some((fits * rating, mask))
    };
    let answers = maps.zip(&prediction.predicted_iou).filter_map(answer);
    let best = answers.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, mask)| mask);
    Ok(best.map(|mask| without_small_regions(&mask, settings.min_region_px).unwrap_or(mask)))
}

impl Pointed {
    /// Returns how well a mask fits the place, 0–1: whether it covers the point, or the overlap of its own box
    /// with this one.
    fn fit(self, mask: &BitMask) -> f32 {
        match self {
            Self::Point([x, y]) => {
                let last = |at: f32, size: usize| (at.max(0.0) as usize).min(size - 1);
                f32::from(u8::from(mask.has(last(x, mask.width()), last(y, mask.height()))))
            }
            Self::Box([a, b]) => {
                let own = mask.bounds();
                let bounds = [[own.x, own.width], [own.y, own.height]].map(|[from, len]| {
                    let (from, len) = (from as f32, len as f32);
                    [from, from + len]
                });
                let (mut common, mut areas) = (1.0, [1.0, 1.0]);
                for (axis, [from, to]) in bounds.into_iter().enumerate() {
                    let (low, high) = (a[axis].min(b[axis]), a[axis].max(b[axis]));
                    common *= (to.min(high) - from.max(low)).max(0.0);
                    areas = [areas[0] * (to - from), areas[1] * (high - low)];
                }
                common / (areas[0] + areas[1] - common).max(f32::MIN_POSITIVE)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{super::tests::ByColour, *};
    use image::{Rgb, RgbImage};

    const SIZE: [usize; 2] = [128, 96];

    /// A grey tool of 40×30 pixels on tissue; a small shine on it is of a similar colour.
    fn picture() -> RgbImage {
        RgbImage::from_fn(128, 96, |x, y| match (x, y) {
            (50..60, 40..50) => Rgb([140, 140, 150]),
            (40..80, 30..60) => Rgb([120, 130, 140]),
            _ => Rgb([200, 40, 40]),
        })
    }

    fn found(rating: fn(Rgb<u8>, usize) -> f32, place: Pointed) -> Option<PixelRect> {
        let mut segmenter = ByColour::new(rating);
        segmenter.set_image(&picture()).unwrap();
        pointed_mask(&mut segmenter, SIZE, place).unwrap().map(|mask| mask.bounds())
    }

    fn is_near(found: Option<PixelRect>, wanted: [usize; 4]) -> bool {
        found.is_some_and(|b| {
            [b.x, b.y, b.width, b.height].iter().zip(wanted).all(|(a, b)| a.abs_diff(b) <= 3)
        })
    }

    #[test]
    fn a_point_becomes_the_object_that_it_is_on() {
        let tool = found(|_, _| 0.9, Pointed::Point([70.0, 55.0]));
        assert!(is_near(tool, [40, 30, 40, 30]), "{tool:?}");
        assert!(
            found(|_, _| 0.9, Pointed::Point([500.0, -3.0])).is_some(),
            "beside the picture is its border"
        );
    }

    #[test]
    fn a_box_takes_the_answer_that_fills_it() {
        let tool = found(|_, _| 0.9, Pointed::Box([[82.0, 62.0], [38.0, 28.0]]));
        assert!(is_near(tool, [40, 30, 40, 30]), "{tool:?}");
        let part = found(|_, _| 0.9, Pointed::Box([[49.0, 39.0], [61.0, 51.0]]));
        assert!(is_near(part, [50, 40, 10, 10]), "{part:?}");
    }

    #[test]
    fn the_whole_picture_is_no_object() {
        let mut segmenter = ByColour::new(|_, _| 0.9);
        segmenter.set_image(&RgbImage::from_pixel(128, 96, Rgb([90; 3]))).unwrap();
        assert_eq!(pointed_mask(&mut segmenter, SIZE, Pointed::Point([5.0, 5.0])).unwrap(), None);
    }
}
