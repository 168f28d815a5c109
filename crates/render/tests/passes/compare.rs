//! Comparers of GPU results with those of the Rust twins. Both compute the same smooth functions, and
//! agree there to a few roundings. Where a threshold decides (alpha < 1/255, transmittance < 1e-4, an
//! ellipse that just touches a tile), a rounding may turn the decision. Such differences are checked to
//! be as small as the threshold and rare.

use surgtpgs_core::{
    deform::Deformed,
    raster::{ALPHA_PLANE, DEPTH_PLANE, Images, MIN_ALPHA, TILE, bin::Bins, project::Splat},
};

pub(crate) type Verdict = Result<(), String>;

/// Largest difference allowed: `absolute + relative · |expected|`.
#[derive(Clone, Copy)]
pub(crate) struct Tolerance {
    pub absolute: f32,
    pub relative: f32,
}

/// Tolerance of smooth functions. WGSL allows exp an error of 3 + 2|x| units in the last place and
/// division 2.5. A sum of a dozen terms of size 1 adds as many roundings: some 30 · 6e-8.
pub(crate) const SMOOTH: Tolerance = Tolerance { absolute: 2e-6, relative: 4e-6 };

pub(crate) fn close(name: &str, found: &[f32], expected: &[f32], tolerance: Tolerance) -> Verdict {
    if found.len() != expected.len() {
        return Err(format!("{name}: {} values, expected {}", found.len(), expected.len()));
    }
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        // Negated so that NaN fails.
        if !((f - e).abs() <= tolerance.absolute + tolerance.relative * e.abs()) {
            return Err(format!("{name}[{i}]: found {f}, expected {e}"));
        }
    }
    Ok(())
}

pub(crate) fn deformed(found: &Deformed, expected: &Deformed) -> Verdict {
    close("means", found.means.as_flattened(), expected.means.as_flattened(), SMOOTH)?;
    close("rotations", found.rotations.as_flattened(), expected.rotations.as_flattened(), SMOOTH)?;
    // Scales may be tiny, so that only their ratio is meaningful.
    let ratio = Tolerance { absolute: 0.0, relative: 5e-6 };
    close("scales", found.scales.as_flattened(), expected.scales.as_flattened(), ratio)?;
    close("opacities", &found.opacities, &expected.opacities, SMOOTH)?;
    close("colours", found.colours.as_flattened(), expected.colours.as_flattened(), SMOOTH)?;
    close("features", &found.features, &expected.features, SMOOTH)
}

pub(crate) fn splats(found: &[Splat<f32>], expected: &[Splat<f32>]) -> Verdict {
    if found.len() != expected.len() {
        return Err(format!("{} splats, expected {}", found.len(), expected.len()));
    }
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        splat(f, e).map_err(|reason| format!("splat {i}: {reason}"))?;
    }
    Ok(())
}

fn splat(f: &Splat<f32>, e: &Splat<f32>) -> Verdict {
    if f.is_visible() != e.is_visible() {
        return Err(format!("visible {}, expected {}", f.is_visible(), e.is_visible()));
    }
    let smooth = Tolerance { absolute: 1e-5, relative: 1e-5 };
    close("depth", &[f.depth], &[e.depth], smooth)?;
    close("opacity", &[f.opacity], &[e.opacity], smooth)?;
    close("colour", &f.colour, &e.colour, smooth)?;
    // At up to some 1000 px from the origin the centre has roundings of 6e-5 px.
    close("centre", &f.centre, &e.centre, Tolerance { absolute: 3e-4, relative: 1e-6 })?;
    // log(opacity / MIN_ALPHA) loses digits if its argument is near 1, but the extent is small there too.
    close("extent", &f.extent, &e.extent, Tolerance { absolute: 2e-3, relative: 1e-4 })?;
    // det = xx yy − xy² cancels for a thin ellipse: its rounding grows with xx yy / det, the same in a conic.
    let [a, b, c] = e.conic.map(f64::from);
    let cancellation = (a * c / (a * c - b * b).max(f64::MIN_POSITIVE)).min(1e6) as f32;
    let size = e.conic[0].max(e.conic[2]);
    let conic = Tolerance { absolute: 2e-6 * cancellation * size, relative: 1e-5 };
    close("conic", &f.conic, &e.conic, conic)
}

/// Checks that the lists of a tile hold the same splats in the same order, except splats that reach no
/// pixel centre in it.
pub(crate) fn bins(found: &Bins, expected: &Bins, splats: &[Splat<f32>]) -> Verdict {
    if (found.columns, found.rows) != (expected.columns, expected.rows) {
        return Err(format!("{}×{} tiles", found.columns, found.rows));
    }
    for (y, x) in (0..found.rows).flat_map(|y| (0..found.columns).map(move |x| (y, x))) {
        let lists = [found, expected].map(|bins| {
            let list = bins.splat[bins.tile(x, y)].iter().copied();
            list.filter(|&i| reaches(&splats[i as usize], x, y)).collect::<Vec<u32>>()
        });
        if lists[0] != lists[1] {
            return Err(format!("tile {x},{y}: found {:?}, expected {:?}", lists[0], lists[1]));
        }
    }
    // Splats that reach no pixel only cost time, but must be rare.
    let extra = found.splat.len().abs_diff(expected.splat.len());
    if extra * 200 > expected.splat.len() + 200 {
        return Err(format!("{} pairs, expected {}", found.splat.len(), expected.splat.len()));
    }
    Ok(())
}

/// Returns `true` if a splat certainly reaches a pixel centre of a tile; the margin covers f32 against f64.
fn reaches(splat: &Splat<f32>, tile_x: usize, tile_y: usize) -> bool {
    let [a, b, c] = splat.conic.map(f64::from);
    (0..TILE * TILE).any(|k| {
        let centre = [tile_x * TILE + k % TILE, tile_y * TILE + k / TILE];
        let d: [f64; 2] = std::array::from_fn(|i| centre[i] as f64 + 0.5 - f64::from(splat.centre[i]));
        let q = a * d[0] * d[0] + 2.0 * b * d[0] * d[1] + c * d[1] * d[1];
        f64::from(splat.opacity) * (-0.5 * q).exp() >= f64::from(MIN_ALPHA) * 1.001
    })
}

/// Allowed differences of images, in units of a plane's largest value.
#[derive(Clone, Copy)]
pub(crate) struct ImageTolerance {
    /// Largest difference of nearly all values.
    pub interior: f32,
    /// Share of the values that may differ more, because a threshold decided otherwise.
    pub boundary_fraction: f32,
    /// Largest difference of these: a contribution of 1/255 more or less also dims the splats behind it.
    pub boundary: f32,
}

/// Tolerance for the same splats and lists: exp2 by polynomial against the GPU's exp, a few hundred
/// contributions summed.
pub(crate) const SAME_SPLATS: ImageTolerance =
    ImageTolerance { interior: 2e-5, boundary_fraction: 0.01, boundary: 2.5 * MIN_ALPHA };

/// Tolerance for the whole chain: conics of needles differ as much as [`splats`] allows.
pub(crate) const WHOLE_CHAIN: ImageTolerance =
    ImageTolerance { interior: 1e-4, boundary_fraction: 0.02, boundary: 4.0 * MIN_ALPHA };

pub(crate) fn images(found: &Images, expected: &Images, tolerance: ImageTolerance) -> Verdict {
    let sizes = [found, expected].map(|i| (i.width, i.height, i.planes.len()));
    if sizes[0] != sizes[1] {
        return Err(format!("sizes {:?}, expected {:?}", sizes[0], sizes[1]));
    }
    let pixels = expected.width * expected.height;
    for k in 0..expected.planes.len() / pixels.max(1) {
        plane(found.plane(k), expected.plane(k), tolerance)
            .map_err(|reason| format!("{}: {reason}", name(k)))?;
    }
    Ok(())
}

fn plane(found: &[f32], expected: &[f32], tolerance: ImageTolerance) -> Verdict {
    let largest = expected.iter().fold(1.0f32, |m, v| m.max(v.abs()));
    let mut beyond = 0;
    let mut shift = 0.0f64;
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        let difference = (f - e) / largest;
        if !(difference.abs() <= tolerance.boundary) {
            return Err(format!("pixel {i}: found {f}, expected {e}"));
        }
        beyond += usize::from(difference.abs() > tolerance.interior);
        shift += f64::from(difference);
    }
    let allowed = (tolerance.boundary_fraction * found.len() as f32).ceil() as usize;
    if beyond > allowed {
        return Err(format!("{beyond} of {} pixels differ, {allowed} may", found.len()));
    }
    // Thresholds err to both sides. A bias would show in the mean.
    let shift = (shift / found.len() as f64).abs() as f32;
    if shift > tolerance.interior {
        return Err(format!("shifted by {shift} on average"));
    }
    Ok(())
}

fn name(k: usize) -> String {
    match k {
        0..3 => ["red", "green", "blue"][k].into(),
        DEPTH_PLANE => "depth".into(),
        ALPHA_PLANE => "alpha".into(),
        _ => format!("feature {}", k - ALPHA_PLANE - 1),
    }
}

/// Compares pictures of 8 bits: a rounding may fall to either side of a half, one level apart, in few
/// channels.
pub(crate) fn pictures(found: &image::RgbImage, expected: &image::RgbImage) -> Verdict {
    if found.dimensions() != expected.dimensions() {
        return Err(format!("{:?}, expected {:?}", found.dimensions(), expected.dimensions()));
    }
    let mut off = 0;
    for (i, (f, e)) in found.as_raw().iter().zip(expected.as_raw()).enumerate() {
        if f.abs_diff(*e) > 1 {
            return Err(format!("channel {i}: found {f}, expected {e}"));
        }
        off += usize::from(f != e);
    }
    let allowed = found.as_raw().len() / 200;
    if off > allowed { Err(format!("{off} channels differ by a level, {allowed} may")) } else { Ok(()) }
}

/// Compares whole frames that were made on different machines. A score beside a threshold may fall to the
/// other side of it, which moves a border by a pixel; a blended colour may be off as [`WHOLE_CHAIN`] allows.
pub(crate) fn frames(found: &image::RgbImage, expected: &image::RgbImage) -> Verdict {
    if found.dimensions() != expected.dimensions() {
        return Err(format!("{:?}, expected {:?}", found.dimensions(), expected.dimensions()));
    }
    let differences = || found.as_raw().iter().zip(expected.as_raw()).map(|(f, e)| f.abs_diff(*e));
    let (beyond, allowed) = (differences().filter(|d| *d > 2).count(), found.as_raw().len() / 100);
    if beyond > allowed {
        return Err(format!("{beyond} channels differ by more than two levels, {allowed} may"));
    }
    // A bias would show in the mean of the others.
    let others = differences().filter(|d| *d <= 2).map(f64::from);
    let mean = others.sum::<f64>() / found.as_raw().len().max(1) as f64;
    if mean > 0.25 { Err(format!("the channels differ by {mean:.2} levels on average")) } else { Ok(()) }
}
