//! Positions of the points at which a network is asked: a grid on the image and on overlapping crops of it.

use super::MaskSettings;
use crate::mask::PixelRect;

/// A window of the image and the number of points along its sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crop {
    pub window: PixelRect,
    pub points_per_side: usize,
}

/// Returns the whole `area`, then the crops of each layer, 2ⁱ along each side in layer i, as Segment
/// Anything's `generate_crop_boxes` places them.
pub(super) fn crops(area: PixelRect, settings: &MaskSettings) -> Vec<Crop> {
    let mut crops = vec![Crop { window: area, points_per_side: settings.points_per_side }];
    for layer in 1..=settings.crop_layers {
        let n = 1_usize << layer;
        let short = area.width.min(area.height) as f32;
        let overlap = (settings.crop_overlap * short * 2.0 / n as f32) as usize;
        let length = |whole: usize| (overlap * (n - 1) + whole).div_ceil(n);
        let (width, height) = (length(area.width), length(area.height));
        let points_per_side = (settings.points_per_side / settings.crop_points_divisor.pow(layer)).max(1);
        for column in 0..n {
            for row in 0..n {
                let (x, y) = ((width - overlap) * column, (height - overlap) * row);
                let window = PixelRect {
                    x: area.x + x,
                    y: area.y + y,
                    width: width.min(area.width - x),
                    height: height.min(area.height - y),
                };
                crops.push(Crop { window, points_per_side });
            }
        }
    }
    crops
}

impl Crop {
    /// Returns the points of the grid in pixels of the window, row by row.
    pub(super) fn points(&self) -> Vec<[f32; 2]> {
        let n = self.points_per_side;
        let at = |i: usize, length: usize| (i as f32 + 0.5) / n as f32 * length as f32;
        (0..n * n).map(|i| [at(i % n, self.window.width), at(i / n, self.window.height)]).collect()
    }

    /// Returns `true` if a mask ends at a border of the window that is not a border of the whole `area`:
    /// the object continues beyond it.
    pub(super) fn cuts(&self, bounds: PixelRect, area: PixelRect) -> bool {
        /// Distance that counts as near, in pixels.
        const NEAR_PX: usize = 20;
        // Masks use their last pixels and windows their ends, as in Segment Anything.
        let sides = |r: PixelRect, last: usize| [r.x, r.y, r.x + r.width - last, r.y + r.height - last];
        let (found, window, area) = (sides(bounds, 1), sides(self.window, 0), sides(area, 0));
        (0..4).any(|i| found[i].abs_diff(window[i]) <= NEAR_PX && found[i].abs_diff(area[i]) > NEAR_PX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rect(x: usize, y: usize, width: usize, height: usize) -> PixelRect {
        PixelRect { x, y, width, height }
    }

    /// The results of Segment Anything's `generate_crop_boxes((480, 854), 1, 512 / 1500)`.
    #[test]
    fn crops_are_those_of_segment_anything() {
        let settings = MaskSettings::paper();
        let windows: Vec<_> = crops(rect(0, 0, 854, 480), &settings).iter().map(|c| c.window).collect();
        let expected = [
            rect(0, 0, 854, 480),
            rect(0, 0, 509, 322),
            rect(0, 159, 509, 321),
            rect(346, 0, 508, 322),
            rect(346, 159, 508, 321),
        ];
        assert_eq!(windows, expected);
        assert_eq!(crops(rect(0, 0, 854, 480), &MaskSettings { crop_layers: 0, ..settings }).len(), 1);
    }

    #[test]
    fn points_are_in_the_middle_of_their_cells() {
        let crop = Crop { window: rect(5, 5, 80, 40), points_per_side: 2 };
        assert_eq!(crop.points(), [[20.0, 10.0], [60.0, 10.0], [20.0, 30.0], [60.0, 30.0]]);
    }

    #[test]
    fn masks_that_go_on_beyond_their_crop_are_told_from_those_at_the_image_border() {
        let whole = rect(0, 0, 800, 400);
        let crop = Crop { window: rect(0, 0, 500, 300), points_per_side: 1 };
        assert!(crop.cuts(rect(100, 100, 390, 50), whole), "ends near the crop's right border");
        assert!(!crop.cuts(rect(0, 0, 100, 100), whole), "the corner is the image's");
        assert!(!crop.cuts(rect(100, 100, 300, 100), whole));
        let image = Crop { window: whole, points_per_side: 1 };
        assert!(!image.cuts(whole, whole));
    }
}
