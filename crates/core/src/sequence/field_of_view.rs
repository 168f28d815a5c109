//! The part of the frames that shows the patient: a disc, a rectangle, or everything.
//!
//! Areas that are never bright are border. The lit area is the largest connected region whose brightest
//! value over several frames reaches [`LIT`]. A circle is fitted to its outline (random triples, then
//! least squares on the points that agree). If none fits, the bounding rectangle is taken.

use crate::grid::{Grid, Mask};
use image::RgbImage;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Channel value from which a pixel counts as lit.
const LIT: u8 = 20;
/// Distance inside the found outline at which supervision starts, as a share of the smaller side (at
/// least 2 pixels): the outline is blurred by optics and compression.
const MARGIN: f64 = 0.006;
/// Smallest share of the frame that a border hides. Smaller ones are ignored.
const SMALLEST_BORDER: f64 = 0.005;
/// Smallest share of the frame that the lit area must cover. Smaller ones are too little to judge by.
const SMALLEST_LIT: f64 = 0.15;
/// Share of outline points that must lie on the circle.
const CIRCLE_AGREEMENT: f64 = 0.6;
/// Number of random triples tried; with half of the points on the circle, 1 − (1 − ⅛)²⁰⁰ ≈ 1 −
/// 10⁻¹² of success.
const TRIPLES: usize = 200;

/// Shape and place of the picture in the frame, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// No border.
    Whole,
    /// Centre and radius; the bounds also hold, for pictures cut at the top and bottom.
    Disc(Circle, Bounds),
    /// A rectangle.
    Rectangle(Bounds),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Circle {
    x: f64,
    y: f64,
    radius: f64,
}

/// First and one-past-last column and row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bounds {
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
}

/// A found field of view.
#[derive(Debug)]
pub(super) struct FieldOfView {
    pub shape: Shape,
    /// `true` inside.
    pub mask: Mask,
}

impl FieldOfView {
    pub(super) fn whole(width: usize, height: usize) -> Self {
        Self { shape: Shape::Whole, mask: Grid::filled(width, height, true) }
    }

    /// Looks for a border in some frames of one recording, all `width × height`. If there is none, because of a
    /// single frame that may be a title or of another camera, looks for what at least two frames light.
    pub(super) fn detect(width: usize, height: usize, frames: impl IntoIterator<Item = RgbImage>) -> Self {
        let mut num_lit = vec![0_usize; width * height];
        let mut num_frames = 0;
        for frame in frames {
            num_frames += 1;
            for (lit, pixel) in num_lit.iter_mut().zip(frame.pixels()) {
                *lit += usize::from(pixel.0.iter().any(|v| *v >= LIT));
            }
        }
        let lit_by = |fewest: usize| {
            Self::of_lit(&Grid::from_vec(width, height, num_lit.iter().map(|n| *n >= fewest).collect()))
        };
        let found = lit_by(1);
        if found.shape == Shape::Whole && num_frames > 2 { lit_by(2) } else { found }
    }

    fn of_lit(lit: &Mask) -> Self {
        let (width, height) = (lit.width, lit.height);
        let outline = Outline::of_largest_region(lit);
        let shape = outline.shape();
        let mask = shape.mask(width, height);
        let hidden = (mask.data.len() - mask.count()) as f64;
        if shape == Shape::Whole || hidden < SMALLEST_BORDER * mask.data.len() as f64 {
            return Self::whole(width, height);
        }
        Self { shape, mask }
    }

    /// Radius of the disc, px; `None` if there is none.
    pub(super) fn disc_radius_px(&self) -> Option<f64> {
        match self.shape {
            Shape::Disc(circle, _) => Some(circle.radius),
            Shape::Whole | Shape::Rectangle(_) => None,
        }
    }

    /// Describes the field of view in words, for the report.
    pub(super) fn describe(&self) -> String {
        let share = 100.0 * self.mask.share();
        match self.shape {
            Shape::Whole => "the whole frame".to_owned(),
            Shape::Disc(c, _) => format!(
                "round, centre ({:.0}, {:.0}), radius {:.0} pixels, {share:.0} % of the frame",
                c.x, c.y, c.radius
            ),
            Shape::Rectangle(b) => format!(
                "columns {} to {}, rows {} to {}, {share:.0} % of the frame",
                b.left,
                b.right - 1,
                b.top,
                b.bottom - 1
            ),
        }
    }
}

impl Shape {
    fn mask(&self, width: usize, height: usize) -> Mask {
        let margin = (MARGIN * width.min(height) as f64).max(2.0);
        let (bounds, circle) = match *self {
            Self::Whole => return Grid::filled(width, height, true),
            Self::Disc(circle, bounds) => (bounds, Some(circle)),
            Self::Rectangle(bounds) => (bounds, None),
        };
        // A side on the frame's own edge has no border to keep away from.
        let inset = margin.ceil() as usize;
        let low = |at: usize| if at == 0 { 0 } else { at + inset };
        let high = |at: usize, end: usize| if at == end { end } else { at.saturating_sub(inset) };
        let columns = low(bounds.left)..high(bounds.right, width);
        let rows = low(bounds.top)..high(bounds.bottom, height);
        let inside_circle = |x: usize, y: usize| {
            circle.is_none_or(|c| c.distance(x as f64 + 0.5, y as f64 + 0.5) <= c.radius - margin)
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data = pixels.map(|(x, y)| columns.contains(&x) && rows.contains(&y) && inside_circle(x, y));
        Grid::from_vec(width, height, data.collect())
    }
}

impl Circle {
    fn distance(&self, x: f64, y: f64) -> f64 {
        (x - self.x).hypot(y - self.y)
    }

    /// Least squares of x² + y² + a·x + b·y + c = 0 (Kåsa 1976); `None` for points on a line.
    fn fit(points: &[(f64, f64)]) -> Option<Self> {
        let n = points.len() as f64;
        let (sx, sy) = points.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
        let (mx, my) = (sx / n, sy / n);
        let [mut uu, mut uv, mut vv, mut uz, mut vz, mut zz] = [0.0; 6];
        for &(x, y) in points {
            let (u, v) = (x - mx, y - my);
            let z = u * u + v * v;
            uu += u * u;
            uv += u * v;
            vv += v * v;
            uz += u * z;
            vz += v * z;
            zz += z;
        }
        let determinant = uu * vv - uv * uv;
        if points.len() < 3 || determinant <= 1e-9 * (uu + vv).powi(2) {
            return None;
        }
        let (u, v) = (0.5 * (uz * vv - vz * uv) / determinant, 0.5 * (vz * uu - uz * uv) / determinant);
        Some(Self { x: mx + u, y: my + v, radius: (u * u + v * v + zz / n).sqrt() })
    }
}

/// The outermost pixels of the lit region.
struct Outline {
    width: usize,
    height: usize,
    /// Number of pixels of the region.
    area: usize,
    bounds: Bounds,
    /// Points between lit and dark; none lies on the frame's own edge.
    points: Vec<(f64, f64)>,
}

impl Outline {
    fn of_largest_region(lit: &Mask) -> Self {
        let (region, area) = largest_region(lit);
        let (width, height) = (lit.width, lit.height);
        let mut bounds = Bounds { left: width, right: 0, top: height, bottom: 0 };
        let mut points = Vec::new();
        let mut columns = vec![None; width];
        for y in 0..height {
            let row = region.row(y);
            let (Some(first), Some(last)) = (row.iter().position(|&v| v), row.iter().rposition(|&v| v))
            else {
                continue;
            };
            bounds = Bounds {
                left: bounds.left.min(first),
                right: bounds.right.max(last + 1),
                top: bounds.top.min(y),
                bottom: y + 1,
            };
            for (column, _) in columns.iter_mut().zip(row).filter(|(_, lit)| **lit) {
                column.get_or_insert((y, y)).1 = y;
            }
            let middle = y as f64 + 0.5;
            points.extend((first > 0).then_some((first as f64, middle)));
            points.extend((last + 1 < width).then_some((last as f64 + 1.0, middle)));
        }
        for (x, column) in columns.into_iter().enumerate() {
            let Some((top, bottom)) = column else { continue };
            let middle = x as f64 + 0.5;
            points.extend((top > 0).then_some((middle, top as f64)));
            points.extend((bottom + 1 < height).then_some((middle, bottom as f64 + 1.0)));
        }
        Self { width, height, area, bounds, points }
    }

    fn shape(&self) -> Shape {
        if (self.area as f64) < SMALLEST_LIT * (self.width * self.height) as f64 {
            return Shape::Whole;
        }
        match self.circle() {
            Some(circle) => Shape::Disc(circle, self.bounds),
            None => Shape::Rectangle(self.bounds),
        }
    }

    fn circle(&self) -> Option<Circle> {
        let small = self.width.min(self.height) as f64;
        let tolerance = (0.008 * small).max(2.0);
        if (self.points.len() as f64) < 0.2 * small {
            return None;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut best: (usize, Option<Circle>) = (0, None);
        for _ in 0..TRIPLES {
            let triple = [(); 3].map(|()| self.points[rng.random_range(0..self.points.len())]);
            let Some(circle) = Circle::fit(&triple).filter(|c| self.plausible(c)) else { continue };
            let agreeing = self.agreeing(&circle, tolerance).len();
            if agreeing > best.0 {
                best = (agreeing, Some(circle));
            }
        }
        let mut circle = best.1?;
        for _ in 0..3 {
            circle = Circle::fit(&self.agreeing(&circle, tolerance))?;
        }
        let agreement = self.agreeing(&circle, tolerance).len() as f64 / self.points.len() as f64;
        (agreement >= CIRCLE_AGREEMENT && self.plausible(&circle)).then_some(circle)
    }

    fn agreeing(&self, circle: &Circle, tolerance: f64) -> Vec<(f64, f64)> {
        let near = |p: &&(f64, f64)| (circle.distance(p.0, p.1) - circle.radius).abs() <= tolerance;
        self.points.iter().filter(near).copied().collect()
    }

    /// Returns `true` if the circle can be an endoscopic picture: roughly centred in the frame, and not
    /// smaller than the lit area.
    fn plausible(&self, circle: &Circle) -> bool {
        let (width, height) = (self.width as f64, self.height as f64);
        let radius = circle.radius;
        (0.2 * width.min(height)..1.5 * width.max(height)).contains(&radius)
            && (0.2 * width..0.8 * width).contains(&circle.x)
            && (0.2 * height..0.8 * height).contains(&circle.y)
            && std::f64::consts::PI * radius * radius >= 0.95 * self.area as f64
    }
}

/// Returns the largest 4-connected region of `true`, and its number of pixels.
fn largest_region(mask: &Mask) -> (Mask, usize) {
    let (width, height) = (mask.width, mask.height);
    let mut region_of = vec![0_u32; mask.data.len()];
    let (mut best, mut best_area, mut regions) = (0, 0, 0);
    let mut open = Vec::new();
    for start in 0..mask.data.len() {
        if !mask.data[start] || region_of[start] != 0 {
            continue;
        }
        regions += 1;
        region_of[start] = regions;
        open.push(start);
        let mut area = 0;
        while let Some(i) = open.pop() {
            area += 1;
            let (x, y) = (i % width, i / width);
            let neighbours = [
                (x > 0).then(|| i - 1),
                (x + 1 < width).then_some(i + 1),
                (y > 0).then(|| i - width),
                (y + 1 < height).then_some(i + width),
            ];
            for j in neighbours.into_iter().flatten().filter(|&j| mask.data[j]) {
                if region_of[j] == 0 {
                    region_of[j] = regions;
                    open.push(j);
                }
            }
        }
        if area > best_area {
            (best, best_area) = (regions, area);
        }
    }
    (Grid::from_vec(width, height, region_of.iter().map(|&r| r != 0 && r == best).collect()), best_area)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// Draws dim tissue inside, sensor noise outside, and a dark tool that touches the outline.
    fn draw(width: u32, height: u32, inside: impl Fn(f64, f64) -> bool) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let noise = ((x * 7 + y * 13) % 9) as u8;
            let tool = x > width / 2 && y.abs_diff(height / 2) < height / 16;
            if inside(f64::from(x) + 0.5, f64::from(y) + 0.5) && !tool {
                Rgb([90 + noise, 30, 25])
            } else {
                Rgb([noise, noise / 2, 3])
            }
        })
    }

    fn detect(image: RgbImage) -> FieldOfView {
        FieldOfView::detect(image.width() as usize, image.height() as usize, [image])
    }

    #[test]
    fn one_frame_without_a_border_among_others_does_not_count() {
        let round = || draw(320, 200, |x, y| (x - 150.0).hypot(y - 104.0) < 90.0);
        let title = draw(320, 200, |_, _| true);
        let found = FieldOfView::detect(320, 200, [round(), title, round(), round()]);
        assert!(matches!(found.shape, Shape::Disc(..)), "{}", found.describe());
    }

    #[test]
    fn finds_a_disc_off_the_centre_and_cut_by_the_frame() {
        let found = detect(draw(320, 200, |x, y| (x - 150.0).hypot(y - 104.0) < 130.0));
        let Shape::Disc(circle, _) = found.shape else { panic!("{found:?}") };
        assert!((circle.x - 150.0).abs() < 1.0 && (circle.y - 104.0).abs() < 1.0, "{circle:?}");
        assert!((circle.radius - 130.0).abs() < 1.0, "{circle:?}");
        assert!(found.mask.at(150, 100) && !found.mask.at(10, 100) && !found.mask.at(310, 100));
        assert!(found.mask.at(300 - 60, 100), "the dark tool lies inside");
        assert!(!found.mask.at(21, 104), "a margin is kept");
    }

    #[test]
    fn finds_a_letterbox_and_keeps_the_frames_own_edges() {
        let found = detect(draw(300, 200, |_, y| (30.0..170.0).contains(&y)));
        assert_eq!(found.shape, Shape::Rectangle(Bounds { left: 0, right: 300, top: 30, bottom: 170 }));
        assert!(found.mask.at(0, 100) && found.mask.at(299, 100));
        assert!(!found.mask.at(150, 31) && found.mask.at(150, 40) && !found.mask.at(150, 168));
    }

    #[test]
    fn without_a_border_everything_is_inside() {
        for image in [
            draw(160, 120, |_, _| true),
            RgbImage::new(160, 120),
            // One dark corner is a shadow, not a border.
            draw(160, 120, |x, y| x + y > 40.0),
        ] {
            assert_eq!(detect(image).mask.count(), 160 * 120);
        }
    }

    #[test]
    fn lettering_in_the_border_is_not_part_of_the_picture() {
        let mut image = draw(320, 200, |x, y| (x - 160.0).hypot(y - 100.0) < 95.0);
        for (x, y) in (2..40).flat_map(|x| (5..15).map(move |y| (x, y))) {
            image.put_pixel(x, y, Rgb([255; 3]));
        }
        let found = detect(image);
        assert!(matches!(found.shape, Shape::Disc(..)) && !found.mask.at(10, 10));
    }
}
