//! Lengths in the picture: always in pixels, in space where there is depth, in millimetres only with a scale.

use crate::viewer::backend::Lens;
use surgtpgs_core::grid::Grid;

/// Size of a scene unit in the world, and the source of this knowledge.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Scale {
    pub(crate) mm_per_unit: f64,
    /// One standard deviation, as share of the scale.
    pub(crate) relative_uncertainty: f64,
    /// Source of the scale, in words.
    pub(crate) source: String,
    /// Pixels per millimetre, if nothing else is known. Lengths are then measured in the picture, as if
    /// everything lay at one distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) px_per_mm: Option<f64>,
}

/// A length between two points of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Measurement {
    pub(crate) pixels: f64,
    pub(crate) in_space: Result<Length, NoLength>,
}

/// A length in space, in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Length {
    pub(crate) units: f64,
    /// One standard deviation, from the spread of depth around both ends and from the accuracy of pointing.
    pub(crate) uncertainty: f64,
    /// `true` if depth jumps at one end, which may then belong to what lies behind.
    pub(crate) is_at_edge: bool,
}

/// Reason why there is no length in space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoLength {
    /// There is no reconstruction, or it has no camera.
    NoDepth,
    /// Nothing was reconstructed at one of the ends.
    NoSurface,
}

/// Number of pixels to each side of an end whose depths are its spread of depth.
const AROUND: usize = 2;
/// Spread of depth, as share of the depth, above which it is a jump.
const EDGE: f64 = 0.05;
/// One standard deviation of a person's pointing, pixels.
const POINTING_PX: f64 = 0.5;

/// Measures from one point of the picture to another. Both are shares of its `size` (width and height in
/// pixels). `depth` may have another size.
pub(crate) fn measure(
    [from, to]: [[f32; 2]; 2],
    size: (usize, usize),
    depth: Option<&Grid<f32>>,
    lens: Option<Lens>,
) -> Measurement {
    let px = |p: [f32; 2]| [f64::from(p[0]) * size.0 as f64, f64::from(p[1]) * size.1 as f64];
    let (a, b) = (px(from), px(to));
    let pixels = (a[0] - b[0]).hypot(a[1] - b[1]);
    let in_space = match (depth.filter(|d| !d.data.is_empty()), lens) {
        (Some(depth), Some(lens)) => match (end(from, a, depth), end(to, b, depth)) {
            (Some(from), Some(to)) => Ok(length(from, to, lens)),
            _ => Err(NoLength::NoSurface),
        },
        _ => Err(NoLength::NoDepth),
    };
    Measurement { pixels, in_space }
}

/// An end of a line: its position, its depth, and the uncertainty of that depth.
#[derive(Clone, Copy)]
struct End {
    px: [f64; 2],
    z: f64,
    spread: f64,
}

fn end(share: [f32; 2], px: [f64; 2], depth: &Grid<f32>) -> Option<End> {
    let at = |share: f32, n: usize| ((share * n as f32) as usize).min(n - 1);
    let (x, y) = (at(share[0], depth.width), at(share[1], depth.height));
    let rows = y.saturating_sub(AROUND)..(y + AROUND + 1).min(depth.height);
    let columns = x.saturating_sub(AROUND)..(x + AROUND + 1).min(depth.width);
    let around = rows.flat_map(|y| depth.row(y)[columns.clone()].iter());
    let known: Vec<f64> = around.filter(|d| **d > 0.0 && d.is_finite()).map(|d| f64::from(*d)).collect();
    let z = f64::from(depth.at(x, y));
    if !(z > 0.0 && z.is_finite()) {
        return None;
    }
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    let variance = known.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / known.len() as f64;
    Some(End { px, z, spread: variance.sqrt() })
}

fn length(a: End, b: End, lens: Lens) -> Length {
    let point = |e: End, z: f64| {
        let x = (e.px[0] - f64::from(lens.cx)) / f64::from(lens.fx);
        let y = (e.px[1] - f64::from(lens.cy)) / f64::from(lens.fy);
        [x * z, y * z, z]
    };
    let between = |za: f64, zb: f64| {
        let (p, q) = (point(a, za), point(b, zb));
        (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f64>().sqrt()
    };
    let by_a = (between(a.z + a.spread, b.z) - between(a.z - a.spread, b.z)) / 2.0;
    let by_b = (between(a.z, b.z + b.spread) - between(a.z, b.z - b.spread)) / 2.0;
    let pointing = [a, b].map(|e| POINTING_PX * e.z / f64::from(lens.fx));
    let variance: f64 = [by_a, by_b, pointing[0], pointing[1]].iter().map(|s| s * s).sum();
    Length {
        units: between(a.z, b.z),
        uncertainty: variance.sqrt(),
        is_at_edge: [a, b].iter().any(|e| e.spread > EDGE * e.z),
    }
}

impl Scale {
    /// Makes a scale from a length in space that is `mm` long in the world; `None` if that is impossible.
    pub(crate) fn from_known(length: Length, mm: f64, frame: usize) -> Option<Self> {
        let is_possible = mm.is_finite() && mm > 0.0 && length.units > 0.0;
        is_possible.then(|| Self {
            mm_per_unit: mm / length.units,
            relative_uncertainty: length.uncertainty / length.units,
            source: format!("a known length of {mm} mm on frame {}", frame + 1),
            px_per_mm: None,
        })
    }

    /// Makes a scale from a number of pixels per millimetre; `None` if that is impossible.
    pub(crate) fn from_px_per_mm(px_per_mm: f64) -> Option<Self> {
        let scale = Self {
            mm_per_unit: 0.0,
            relative_uncertainty: 0.0,
            source: format!("{px_per_mm} pixels in a millimetre, as typed"),
            px_per_mm: Some(px_per_mm),
        };
        scale.is_possible().then_some(scale)
    }

    /// Returns `true` if the scale can be used. Files may hold any values.
    pub(crate) fn is_possible(&self) -> bool {
        let share = self.relative_uncertainty;
        let scale = self.px_per_mm.unwrap_or(self.mm_per_unit);
        scale.is_finite() && scale > 0.0 && share.is_finite() && share >= 0.0
    }
}

impl Measurement {
    /// Formats the pixels, then the length in space: in millimetres with a scale, else in scene units.
    pub(crate) fn text(&self, scale: Option<&Scale>) -> String {
        let pixels = format!("{:.1} px", self.pixels);
        if let Some(px_per_mm) = scale.and_then(|s| s.px_per_mm) {
            // Without ±: how far away things are is not known, and matters most.
            return format!("{pixels}  ·  {:.1} mm if all is equally far away", self.pixels / px_per_mm);
        }
        let Ok(length) = self.in_space else { return pixels };
        let (value, uncertainty, unit) = match scale {
            Some(scale) => {
                let mm = length.units * scale.mm_per_unit;
                let own = length.uncertainty * scale.mm_per_unit;
                (mm, own.hypot(mm * scale.relative_uncertainty), "mm")
            }
            None => (length.units, length.uncertainty, "scene units"),
        };
        format!("{pixels}  ·  {} {unit}", with_uncertainty(value, uncertainty))
    }
}

/// Formats a value with its uncertainty, e.g. "12.3 ± 0.4", with as many digits as the uncertainty allows.
fn with_uncertainty(value: f64, uncertainty: f64) -> String {
    let digits =
        if uncertainty > 0.0 { (1.0 - uncertainty.log10().floor()).clamp(0.0, 6.0) - 1.0 } else { 2.0 };
    let digits = digits.max(0.0) as usize;
    format!("{value:.digits$} ± {uncertainty:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Lens = Lens { fx: 100.0, fy: 100.0, cx: 50.0, cy: 50.0 };

    fn flat(z: f32) -> Grid<f32> {
        Grid::filled(100, 100, z)
    }

    #[test]
    fn a_line_on_a_plane_facing_the_camera_is_as_long_as_its_pixels_say() {
        let line = [[0.205, 0.505], [0.505, 0.905]];
        let found = measure(line, (100, 100), Some(&flat(20.0)), Some(LENS));
        assert!((found.pixels - 50.0).abs() < 1e-4);
        let length = found.in_space.unwrap();
        // 50 px at 20 units, focal length 100 px
        assert!((length.units - 10.0).abs() < 1e-5);
        let pointing = (2.0 * (POINTING_PX * 0.2).powi(2)).sqrt();
        assert!((length.uncertainty - pointing).abs() < 1e-9 && !length.is_at_edge);
        assert_eq!(found.text(None), "50.0 px  ·  10.0 ± 0.1 scene units");
    }

    #[test]
    fn depth_counts_and_its_spread_is_uncertainty() {
        let mut depth = flat(20.0);
        (0..100).for_each(|y| (50..100).for_each(|x| depth.set(x, y, 30.0)));
        let found = measure([[0.305, 0.505], [0.705, 0.505]], (100, 100), Some(&depth), Some(LENS));
        let (x0, x1) = ((30.5 - 50.0) * 0.2, (70.5 - 50.0) * 0.3);
        let expected = f64::hypot(x1 - x0, 10.0);
        assert!((found.in_space.unwrap().units - expected).abs() < 1e-4);
        let edge = measure([[0.305, 0.505], [0.505, 0.505]], (100, 100), Some(&depth), Some(LENS));
        let edge = edge.in_space.unwrap();
        assert!(edge.is_at_edge && edge.uncertainty > 1.0, "{edge:?}");
    }

    #[test]
    fn millimetres_need_a_scale_and_carry_its_uncertainty() {
        let line = [[0.205, 0.505], [0.505, 0.905]];
        let found = measure(line, (100, 100), Some(&flat(20.0)), Some(LENS));
        assert!(!found.text(None).contains("mm"));
        let scale = Scale::from_known(found.in_space.unwrap(), 8.0, 11).unwrap();
        assert!((scale.mm_per_unit - 0.8).abs() < 1e-6);
        assert!(scale.source.contains("8 mm on frame 12"));
        // The 0.14 of 10 units counts twice, in this measurement and in the calibration: 8 mm · 0.014 · √2
        assert_eq!(found.text(Some(&scale)), "50.0 px  ·  8.0 ± 0.2 mm");
        for mm in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(Scale::from_known(found.in_space.unwrap(), mm, 0), None);
        }
    }

    #[test]
    fn pixels_in_a_millimetre_measure_in_the_picture_alone() {
        let scale = Scale::from_px_per_mm(10.0).unwrap();
        let found = measure([[0.0, 0.0], [0.3, 0.4]], (100, 100), None, None);
        assert_eq!(found.text(Some(&scale)), "50.0 px  ·  5.0 mm if all is equally far away");
        assert!(scale.is_possible() && scale.source.contains("10 pixels"));
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(Scale::from_px_per_mm(wrong), None);
        }
    }

    #[test]
    fn without_depth_there_are_pixels_alone() {
        let line = [[0.0, 0.0], [1.0, 1.0]];
        assert_eq!(measure(line, (30, 40), None, Some(LENS)).in_space, Err(NoLength::NoDepth));
        assert_eq!(measure(line, (30, 40), Some(&flat(9.0)), None).in_space, Err(NoLength::NoDepth));
        let hole = measure(line, (30, 40), Some(&flat(0.0)), Some(LENS));
        assert_eq!((hole.in_space, hole.text(None)), (Err(NoLength::NoSurface), "50.0 px".to_owned()));
        let nan = measure(line, (30, 40), Some(&flat(f32::NAN)), Some(LENS));
        assert_eq!(nan.in_space, Err(NoLength::NoSurface));
        assert_eq!(measure(line, (0, 0), Some(&Grid::filled(0, 0, 1.0)), Some(LENS)).pixels, 0.0);
    }
}
