//! Shapes of annotations and marks, and their pixels.

use crate::{
    grid::Mask,
    mask::{Runs, compressed},
};
use std::sync::Arc;

/// Point in pixels from the upper left corner; the centre of pixel (i, j) is (i + 0.5, j + 0.5).
pub type Point = [f32; 2];

/// The marked pixels of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// All pixels near a point.
    Click {
        /// The point.
        point_px: Point,
        /// Distance up to which pixels count.
        radius_px: f32,
    },
    /// All pixels near a line from point to point.
    Stroke {
        /// The points, at least one.
        points_px: Vec<Point>,
        /// Distance up to which pixels count.
        radius_px: f32,
    },
    /// All pixels inside a closed line, by the even-odd rule.
    Polygon {
        /// The corners, at least three.
        points_px: Vec<Point>,
    },
    /// All pixels inside a rectangle.
    Box {
        /// Two opposite corners.
        corners_px: [Point; 2],
    },
    /// The pixels that are `true`.
    Mask(Arc<Runs>),
}

impl From<&Mask> for Shape {
    fn from(mask: &Mask) -> Self {
        Self::Mask(Arc::new(Runs::of(mask)))
    }
}

impl Shape {
    /// Returns the reason why a picture of this size cannot have the shape, if there is one.
    pub(crate) fn problem(&self, width: usize, height: usize) -> Option<String> {
        let points = match self {
            Self::Click { point_px, .. } => std::slice::from_ref(point_px),
            Self::Stroke { points_px, .. } | Self::Polygon { points_px } => points_px,
            Self::Box { corners_px } => corners_px,
            Self::Mask(mask) => return problem_of_mask(mask, width, height),
        };
        if let Some([x, y]) = points.iter().find(|p| !p.iter().all(|v| v.is_finite())) {
            return Some(format!("the point ({x}, {y}) is made of numbers that are not finite"));
        }
        let is_inside =
            |[x, y]: &&Point| (0.0..=width as f32).contains(x) && (0.0..=height as f32).contains(y);
        if let Some([x, y]) = points.iter().find(|p| !is_inside(p)) {
            return Some(format!("the point ({x}, {y}) is outside the picture of {width}×{height} pixels"));
        }
        match self {
            Self::Click { radius_px: r, .. } | Self::Stroke { radius_px: r, .. }
                if !(r.is_finite() && (0.0..=(width + height) as f32).contains(r)) =>
            {
                Some(format!("its radius of {r} px is no radius inside the picture"))
            }
            Self::Stroke { points_px, .. } if points_px.is_empty() => Some("it has no point".into()),
            Self::Polygon { points_px } if points_px.len() < 3 => {
                Some(format!("a polygon has three corners or more, not {}", points_px.len()))
            }
            _ if self.pixels(width, height).count() == 0 => Some("it covers no pixel".into()),
            _ => None,
        }
    }

    /// Returns `true` if the shape has a border that somebody drew, `false` if it only points at something.
    pub fn is_outlined(&self) -> bool {
        matches!(self, Self::Polygon { .. } | Self::Box { .. } | Self::Mask(_))
    }

    /// Returns the area of an outline, px, as if its line did not cross itself; 0 for other shapes.
    pub fn area_px(&self) -> f32 {
        match self {
            Self::Click { .. } | Self::Stroke { .. } => 0.0,
            Self::Polygon { points_px } => {
                let next = points_px.iter().cycle().skip(1);
                let twice: f32 = points_px.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum();
                0.5 * twice.abs()
            }
            Self::Box { corners_px: [a, b] } => ((b[0] - a[0]) * (b[1] - a[1])).abs(),
            Self::Mask(runs) => runs.lengths().iter().skip(1).step_by(2).sum::<u32>() as f32,
        }
    }

    /// Returns the shape as text; the same shapes have equal texts.
    pub(crate) fn written(&self) -> String {
        match self {
            Self::Mask(mask) => {
                let (width, height) = mask.size();
                format!("Mask {width}×{height} {}", compressed(mask.lengths()))
            }
            Self::Box { corners_px: [a, b] } => {
                // It is the same box from any two opposite corners.
                let low = [a[0].min(b[0]), a[1].min(b[1])];
                let high = [a[0].max(b[0]), a[1].max(b[1])];
                format!("{:?}", Self::Box { corners_px: [low, high] })
            }
            other => format!("{other:?}"),
        }
    }

    /// Returns the marked pixels of a picture of this size.
    pub fn pixels(&self, width: usize, height: usize) -> Mask {
        let mut mask = Mask::filled(width, height, false);
        match self {
            Self::Click { point_px, radius_px } => draw_line(&mut mask, *point_px, *point_px, *radius_px),
            Self::Stroke { points_px, radius_px } => {
                let first = points_px.first().into_iter();
                for (from, to) in first.chain(points_px).zip(points_px) {
                    draw_line(&mut mask, *from, *to, *radius_px);
                }
            }
            Self::Polygon { points_px } => fill(&mut mask, points_px),
            Self::Box { corners_px: [[x0, y0], [x1, y1]] } => {
                fill(&mut mask, &[[*x0, *y0], [*x1, *y0], [*x1, *y1], [*x0, *y1]]);
            }
            Self::Mask(runs) => mask = runs.mask(),
        }
        mask
    }
}

fn problem_of_mask(mask: &Runs, width: usize, height: usize) -> Option<String> {
    if mask.size() != (width, height) {
        let found = format!("{}×{}", mask.size().0, mask.size().1);
        return Some(format!("its mask has {found} pixels, the frames have {width}×{height}"));
    }
    mask.is_empty().then(|| "its mask is empty".into())
}

/// Sets the pixels whose centre is within `radius` of a line, and the pixels that its ends lie in.
fn draw_line(mask: &mut Mask, from: Point, to: Point, radius: f32) {
    let reach = |a: f32, b: f32, size: usize| {
        let low = (a.min(b) - radius - 0.5).max(0.0) as usize;
        let high = (a.max(b) + radius + 0.5).max(0.0) as usize;
        low.min(size)..(high + 1).min(size)
    };
    let way = [to[0] - from[0], to[1] - from[1]];
    let length_2 = way[0] * way[0] + way[1] * way[1];
    for y in reach(from[1], to[1], mask.height) {
        for x in reach(from[0], to[0], mask.width) {
            let centre = [x as f32 + 0.5 - from[0], y as f32 + 0.5 - from[1]];
            let along = (centre[0] * way[0] + centre[1] * way[1]) / length_2.max(f32::MIN_POSITIVE);
            let share = along.clamp(0.0, 1.0);
            let (dx, dy) = (centre[0] - share * way[0], centre[1] - share * way[1]);
            if dx * dx + dy * dy <= radius * radius {
                mask.set(x, y, true);
            }
        }
    }
    for [x, y] in [from, to] {
        let (x, y) = ((x as usize).min(mask.width - 1), (y as usize).min(mask.height - 1));
        mask.set(x, y, true);
    }
}

/// Sets the pixels whose centre is inside a closed line, by the even-odd rule.
fn fill(mask: &mut Mask, corners: &[Point]) {
    let mut crossings: Vec<f32> = Vec::new();
    for y in 0..mask.height {
        let at = y as f32 + 0.5;
        crossings.clear();
        let next = corners.iter().cycle().skip(1);
        for ([x0, y0], [x1, y1]) in corners.iter().zip(next) {
            if (*y0 <= at) != (*y1 <= at) {
                crossings.push(x0 + (at - y0) / (y1 - y0) * (x1 - x0));
            }
        }
        crossings.sort_unstable_by(f32::total_cmp);
        for pair in crossings.as_chunks::<2>().0 {
            // Centres from the left crossing up to the right one.
            let first = (pair[0] - 0.5).ceil().max(0.0) as usize;
            let end = ((pair[1] - 0.5).ceil().max(0.0) as usize).min(mask.width);
            (first..end).for_each(|x| mask.set(x, y, true));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(shape: &Shape) -> Vec<String> {
        let mask = shape.pixels(6, 4);
        let line = |y| mask.row(y).iter().map(|v| if *v { '#' } else { '.' }).collect();
        (0..4).map(line).collect()
    }

    #[test]
    fn shapes_cover_the_pixels_whose_centres_they_hold() {
        let square = Shape::Box { corners_px: [[1.0, 3.0], [4.0, 1.0]] };
        assert_eq!(picture(&square), ["......", ".###..", ".###..", "......"]);
        let triangle = Shape::Polygon { points_px: vec![[0.0, 0.0], [6.0, 0.0], [0.0, 4.0]] };
        assert_eq!(picture(&triangle), ["#####.", "####..", "##....", "#....."]);
        let line = Shape::Stroke { points_px: vec![[0.5, 0.5], [3.5, 0.5], [3.5, 3.5]], radius_px: 0.0 };
        assert_eq!(picture(&line), ["####..", "...#..", "...#..", "...#.."]);
        let click = Shape::Click { point_px: [2.5, 1.5], radius_px: 1.0 };
        assert_eq!(picture(&click), ["..#...", ".###..", "..#...", "......"]);
        let corner = Shape::Click { point_px: [6.0, 4.0], radius_px: 0.0 };
        assert_eq!(picture(&corner)[3], ".....#");
    }

    #[test]
    fn areas_are_those_of_the_pixels() {
        let square = Shape::Box { corners_px: [[1.0, 3.0], [4.0, 1.0]] };
        let corners = vec![[1.0, 1.0], [4.0, 1.0], [4.0, 3.0], [1.0, 3.0]];
        let mask = Shape::from(&square.pixels(6, 4));
        for shape in [square, Shape::Polygon { points_px: corners }, mask] {
            assert_eq!((shape.area_px(), shape.pixels(6, 4).count()), (6.0, 6));
        }
        assert_eq!(Shape::Click { point_px: [2.5, 1.5], radius_px: 1.0 }.area_px(), 0.0);
    }

    #[test]
    fn what_cannot_be_on_a_picture_is_told() {
        let problem = |shape: Shape| shape.problem(6, 4).unwrap_or_default();
        let click = |x, y, radius_px| Shape::Click { point_px: [x, y], radius_px };
        assert_eq!(problem(click(6.0, 4.0, 0.0)), "");
        assert!(problem(click(6.5, 1.0, 1.0)).contains("outside the picture of 6×4"));
        assert!(problem(click(f32::NAN, 1.0, 1.0)).contains("not finite"));
        assert!(problem(click(1.0, 1.0, -1.0)).contains("radius"));
        assert!(problem(click(1.0, 1.0, f32::INFINITY)).contains("radius"));
        assert!(problem(Shape::Polygon { points_px: vec![[0.0; 2]; 2] }).contains("three corners"));
        assert!(problem(Shape::Box { corners_px: [[1.0; 2]; 2] }).contains("no pixel"));
        assert!(problem(Shape::Stroke { points_px: vec![], radius_px: 1.0 }).contains("no point"));
        let mask = |w| Shape::from(&Mask::filled(w, 4, false));
        assert!(problem(mask(5)).contains("5×4") && problem(mask(6)).contains("empty"));
    }
}
