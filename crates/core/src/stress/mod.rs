//! Scenes that break renderers, for the tests of every renderer and for `surgtpgs bench stress`.

mod clip;
mod invariance;

pub use clip::small_clip;
#[cfg(test)]
pub(crate) use clip::{made_up_encoder, one_hot};
pub use invariance::{Invariance, invariances};

use crate::{
    camera::Camera,
    deform::{BasisShape, Deformation, GATE_SLOPE},
    gaussian::Gaussians,
    raster::{ALPHA_PLANE, DEPTH_PLANE, Images, NEAR, reference::reference_frame},
    scene::Scene,
};

/// A scene with one kind of difficulty.
pub struct Case {
    /// Kind of the difficulty.
    pub family: &'static str,
    /// Scene to render.
    pub scene: Scene,
    /// Camera to render from.
    pub camera: Camera,
    /// Time to render at, usually 0 to 1.
    pub time: f32,
}

/// Latent numbers per feature.
const DIM: usize = 3;

/// An ordinary scene of `n` Gaussians 2 to 6 units in front of the camera, which move, turn and change.
pub fn ordinary(n: usize) -> Scene {
    // Numbers in -1..1 without a pattern, the same in each run.
    let wave = |i: usize, k: usize| ((i * 7919 + k * 104_729) as f32 * 0.618_034).sin();
    let gaussians = Gaussians {
        means: (0..n).map(|i| [2.0 * wave(i, 0), 1.5 * wave(i, 1), 4.0 + 2.0 * wave(i, 2)]).collect(),
        rotations: (0..n).map(|i| [1.0, wave(i, 3), wave(i, 4), wave(i, 5)]).collect(),
        log_scales: (0..n).map(|i| [6, 7, 8].map(|k| -1.8 + 0.6 * wave(i, k))).collect(),
        opacity_logits: (0..n).map(|i| 1.5 * wave(i, 9)).collect(),
        colours: (0..n).map(|i| [10, 11, 12].map(|k| wave(i, k))).collect(),
        features: (0..n * DIM).map(|i| wave(i, 13)).collect(),
        latent_dim: DIM,
        ..Default::default()
    };
    let mut deformation = Deformation::at_rest(n, DIM, 5, 0.25, GATE_SLOPE);
    deformation.shape = BasisShape::Spline;
    deformation.weights.iter_mut().enumerate().for_each(|(i, w)| *w = 0.05 * wave(i, 14));
    deformation.feature_weight.iter_mut().enumerate().for_each(|(i, w)| *w = 0.3 * wave(i, 15));
    Scene::seen_by(camera(64, 48), gaussians, deformation)
}

fn camera(width: u32, height: u32) -> Camera {
    Camera::with_field_of_view(width, height, 60.0)
}

/// Number of Gaussians of an ordinary case.
const N: usize = 150;

/// All cases but [`a_million`].
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let mut add = |family, time, size: (u32, u32), change: &dyn Fn(&mut Gaussians, &mut Deformation)| {
        let mut scene = ordinary(N);
        change(&mut scene.gaussians, &mut scene.deformation);
        cases.push(Case { family, scene, camera: camera(size.0, size.1), time });
    };
    const USUAL: (u32, u32) = (64, 48);
    add("ordinary", 0.3, USUAL, &|_, _| {});
    shapes(&mut |family, change| add(family, 0.3, USUAL, change));
    places(&mut |family, change| add(family, 0.3, USUAL, change));
    not_numbers(&mut |family, change| add(family, 0.3, USUAL, change));
    for size in [(1, 1), (17, 1), (1, 33), (37, 53), (16, 16)] {
        add("1 × 1 and odd image sizes", 0.3, size, &|_, _| {});
    }
    for time in [-1.0, -1e-3, 1.0, 1.001, 5.0, 1e30, -1e30] {
        add("time outside the recording", time, USUAL, &|_, _| {});
    }
    add("no Gaussian at all", 0.3, USUAL, &|g, d| {
        (*g, *d) = (
            Gaussians { latent_dim: DIM, ..Default::default() },
            Deformation::at_rest(0, DIM, 5, 0.2, GATE_SLOPE),
        );
    });
    cases
}

/// A million small Gaussians, one in 25 of them in view: software adapters end a loop after 65,535
/// rounds, and the f64 twin should take only seconds.
pub fn a_million() -> Case {
    let mut scene = ordinary(1_000_000);
    scene.gaussians.log_scales.iter_mut().for_each(|s| *s = s.map(|v| v - 3.0));
    scene.gaussians.means.iter_mut().for_each(|[x, y, _]| (*x, *y) = (5.0 * *x, 5.0 * *y));
    Case { family: "a million Gaussians", scene, camera: camera(24, 16), time: 0.3 }
}

type Add<'a> = dyn FnMut(&'static str, &dyn Fn(&mut Gaussians, &mut Deformation)) + 'a;

fn shapes(add: &mut Add<'_>) {
    for (long, short) in [(0.5, -9.0), (1.5, -12.0), (2.5, -15.0)] {
        add("needles", &|g, _| g.log_scales.iter_mut().for_each(|s| *s = [long, short, short]));
        add("pancakes", &|g, _| g.log_scales.iter_mut().for_each(|s| *s = [long, long, short]));
    }
    for size in [-15.0, -40.0, -1e30] {
        add("next to no size", &|g, _| g.log_scales.iter_mut().for_each(|s| *s = [size; 3]));
    }
    for size in [4.0, 9.0, 15.0, 40.0, 1e30] {
        add("larger than the world", &|g, _| g.log_scales.iter_mut().step_by(9).for_each(|s| *s = [size; 3]));
    }
    add("zero quaternions", &|g, d| {
        g.rotations.iter_mut().for_each(|q| *q = [0.0; 4]);
        d.weights.fill(0.0);
    });
    add("quaternions of any length", &|g, _| {
        let factors = [1e-18, 1e-6, 1e6, 1e18];
        g.rotations.iter_mut().enumerate().for_each(|(i, q)| *q = q.map(|v| v * factors[i % 4]));
    });
    for logit in [-1e30, -40.0, -5.6, 5.0, 20.0, 40.0, 1e30] {
        add("opacity at both ends", &|g, _| g.opacity_logits.fill(logit));
    }
}

fn places(add: &mut Add<'_>) {
    add("at and behind the near plane", &|g, d| {
        d.weights.fill(0.0);
        g.means.iter_mut().enumerate().for_each(|(i, m)| m[2] = NEAR * (1.0 + (i as f32 - 75.0) * 5e-3));
    });
    add("behind the camera", &|g, _| g.means.iter_mut().for_each(|m| m[2] = -m[2]));
    for far in [1e4, 1e12, 1e30] {
        add("far away", &|g, _| g.means.iter_mut().step_by(2).for_each(|m| *m = m.map(|v| v * far)));
    }
    add("identical depths", &|g, d| {
        d.weights.fill(0.0);
        g.means.iter_mut().for_each(|m| m[2] = 4.0);
    });
    add("all in one place", &|g, d| {
        d.weights.fill(0.0);
        g.means.fill([0.1, -0.1, 4.0]);
    });
    for size in [1e3, 1e20] {
        add("motion without bounds", &|_, d| d.weights.iter_mut().for_each(|w| *w *= size));
    }
    add("colours beyond 0 and 1", &|g, _| {
        g.colours.iter_mut().for_each(|c| *c = c.map(|v| 1e4 * v));
    });
}

fn not_numbers(add: &mut Add<'_>) {
    const FAMILY: &str = "not a number in one field";
    let some = 20..60;
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        add(FAMILY, &|g, _| g.means[some.clone()].iter_mut().for_each(|v| v[1] = bad));
        add(FAMILY, &|g, _| g.rotations[some.clone()].iter_mut().for_each(|v| v[2] = bad));
        add(FAMILY, &|g, _| g.log_scales[some.clone()].iter_mut().for_each(|v| v[0] = bad));
        add(FAMILY, &|g, _| g.opacity_logits[some.clone()].fill(bad));
        add(FAMILY, &|g, _| g.colours[some.clone()].iter_mut().for_each(|v| v[1] = bad));
        add(FAMILY, &|g, _| g.features[some.clone()].fill(bad));
        add(FAMILY, &|_, d| d.weights.iter_mut().step_by(97).for_each(|w| *w = bad));
        add(FAMILY, &|_, d| d.feature_bias[1] = bad);
    }
}

/// Difference of an image from its f64 twin.
#[derive(Clone, Copy, Debug, Default)]
pub struct Difference {
    /// Number of values that are not finite.
    pub not_finite: usize,
    /// Largest difference up to [`CUT_OFF`], relative to 1 (10 for depth) or to the value if that is
    /// larger. Larger differences are left out: if f32 and f64 fall on different sides of a cut-off, a
    /// whole contribution differs.
    pub largest: f64,
    /// Share of values whose difference is beyond [`CUT_OFF`].
    pub beyond: f64,
}

/// Smallest difference that must come from falling on another side of a cut-off.
pub const CUT_OFF: f64 = 1e-3;

/// Largest share of a picture's values that may fall on another side of a cut-off.
pub const MAX_BEYOND: f64 = 1e-3;

/// Compares rendered images with those of the f64 twin.
pub fn compare(images: &Images, case: &Case) -> Difference {
    difference(images, &reference_frame(&case.scene, &case.camera, case.time))
}

/// Compares rendered images with the expected values of their planes.
fn difference(images: &Images, expected: &[f64]) -> Difference {
    let pixels = images.width * images.height;
    let mut found = Difference::default();
    let mut counted = 0;
    for (i, (&value, &expected)) in images.planes.iter().zip(expected).enumerate() {
        found.not_finite += usize::from(!value.is_finite());
        // A value that is not a number in f64 has no right answer.
        if !expected.is_finite() {
            continue;
        }
        let plane = i / pixels.max(1);
        let scale = if plane == DEPTH_PLANE { 10.0 } else { 1.0 };
        let difference = (f64::from(value) - expected).abs() / expected.abs().max(scale);
        counted += 1;
        if difference <= CUT_OFF {
            found.largest = found.largest.max(difference);
        } else {
            found.beyond += 1.0;
        }
        debug_assert!(plane != ALPHA_PLANE || (-1e-6..=1.0 + 1e-6).contains(&expected));
    }
    found.beyond /= f64::max(1.0, f64::from(counted));
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::{CpuRenderer, Renderer};

    #[test]
    fn the_cpu_renders_every_case_like_the_f64_twin() {
        let mut wrong = Vec::new();
        for (k, case) in cases().iter().chain([&a_million()]).enumerate() {
            let images = CpuRenderer::default().render(&case.scene, &case.camera, case.time, true).unwrap();
            let found = compare(&images, case);
            if found.not_finite > 0 || found.beyond > MAX_BEYOND {
                wrong.push(format!("case {k}, {}: {found:?}", case.family));
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    /// Optimisations must not change a bit of the picture. Tested only on systems with the same exp and sin.
    #[test]
    #[cfg(all(target_arch = "x86_64", target_os = "linux", target_env = "gnu"))]
    fn frames_are_the_same_bytes_as_ever() {
        use sha2::{Digest, Sha256};
        if !(is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")) {
            return;
        }
        let mut hash = Sha256::new();
        for (n, size, time) in [(400, (96, 64), 0.0), (900, (61, 47), 0.37), (30, (16, 16), 1.0)] {
            let mut renderer = CpuRenderer::default();
            let images = renderer.render(&ordinary(n), &camera(size.0, size.1), time, true).unwrap();
            images.planes.iter().for_each(|v| hash.update(v.to_le_bytes()));
        }
        let found: String = hash.finalize()[..8].iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(found, "39864ee561b946f7");
    }

    #[test]
    fn a_wrong_picture_is_noticed() {
        let case = &cases()[0];
        let mut images = CpuRenderer::default().render(&case.scene, &case.camera, case.time, true).unwrap();
        images.planes[..400].iter_mut().for_each(|v| *v += 0.01);
        images.planes[500] = f32::NAN;
        let found = compare(&images, case);
        assert!(found.beyond > MAX_BEYOND && found.not_finite == 1, "{found:?}");
    }
}
