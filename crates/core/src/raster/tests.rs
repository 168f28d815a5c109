//! Compares the kernels with the plain f64 reference, and the reference's gradient with finite differences.

use super::{
    MIN_ALPHA, Packed,
    backward::raster_backward,
    bin::bin,
    forward::raster,
    project::{Sampling, Splat, SplatGradient},
    reference::{Cut, ReferenceInput},
};
use crate::real::Real;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random_splats(n: usize, width: usize, height: usize, seed: u64) -> Vec<Splat<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n)
        .map(|_| {
            let (sx, sy): (f32, f32) = (rng.random_range(0.6..12.0), rng.random_range(0.6..12.0));
            let r: f32 = rng.random_range(-0.95..0.95);
            let [xx, xy, yy] = [sx * sx, r * sx * sy, sy * sy];
            let det = xx * yy - xy * xy;
            let opacity: f32 = rng.random_range(0.01..1.0);
            let cut = 2.0 * (opacity / MIN_ALPHA).ln();
            Splat {
                centre: [
                    rng.random_range(-8.0..width as f32 + 8.0),
                    rng.random_range(-8.0..height as f32 + 8.0),
                ],
                conic: [yy / det, -xy / det, xx / det],
                depth: rng.random_range(1.0..9.0),
                opacity,
                colour: std::array::from_fn(|_| rng.random_range(0.0..1.0)),
                extent: [(cut * xx).sqrt(), (cut * yy).sqrt()],
            }
        })
        .collect()
}

fn random_values(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// Largest difference, and the share of values that differ by more than `tolerance`.
fn compare(a: &[f32], b: &[f64], tolerance: f64) -> (f64, f64) {
    assert_eq!(a.len(), b.len());
    let differences: Vec<f64> = a.iter().zip(b).map(|(x, y)| (f64::from(*x) - y).abs()).collect();
    let beyond = differences.iter().filter(|d| !(**d <= tolerance)).count();
    (differences.iter().copied().fold(0.0, f64::max), beyond as f64 / a.len().max(1) as f64)
}

/// Largest share of values that may differ. A pixel seldom lies within rounding of a cut-off (alpha at 1/255,
/// transmittance at 1e-4) and falls on the other side in f32. It may then differ by one whole contribution.
const BOUNDARY_SHARE: f64 = 2e-4;

#[test]
fn the_kernel_agrees_with_the_reference() {
    for (dim, width, height, n) in [
        (0, 64, 48, 200),
        (3, 70, 45, 300),
        (4, 33, 17, 60),
        (7, 50, 50, 100),
        (16, 40, 20, 80),
        (3, 1, 1, 5),
        (3, 20, 20, 0),
    ] {
        let splats = random_splats(n, width, height, 1);
        let features = random_values(n * dim, 2);
        let images =
            raster(&Packed::new(&splats, &features, dim), &bin(&splats, width, height), width, height);
        let wide: Vec<_> = splats.iter().map(Splat::widened).collect();
        let features: Vec<f64> = features.iter().map(|&v| f64::from(v)).collect();
        let reference = ReferenceInput { splats: &wide, features: &features, latent_dim: dim, width, height };
        let (worst, beyond) = compare(&images.planes, &reference.forward(), 2e-5);
        assert!(beyond <= BOUNDARY_SHARE && worst < 0.05, "D {dim}: worst {worst}, {beyond} beyond");
    }
}

#[test]
fn the_comparison_can_fail() {
    let splats = random_splats(50, 32, 32, 1);
    let mut moved = splats.clone();
    moved[7].opacity *= 0.9;
    let images = raster(&Packed::new(&moved, &[], 0), &bin(&moved, 32, 32), 32, 32);
    let wide: Vec<_> = splats.iter().map(Splat::widened).collect();
    let reference = ReferenceInput { splats: &wide, features: &[], latent_dim: 0, width: 32, height: 32 };
    let (_, beyond) = compare(&images.planes, &reference.forward(), 2e-5);
    assert!(beyond > BOUNDARY_SHARE);
}

fn flatten<T: Real + Into<f64>>(gradients: &[SplatGradient<T>]) -> Vec<f64> {
    gradients.iter().flat_map(|g| g.to_array().map(Into::into)).collect()
}

#[test]
fn the_backward_kernel_agrees_with_the_reference() {
    for (dim, width, height, n) in
        [(0, 64, 48, 120), (3, 70, 45, 200), (8, 40, 33, 80), (12, 40, 20, 50), (3, 20, 20, 0)]
    {
        let splats = random_splats(n, width, height, 5);
        let features = random_values(n * dim, 6);
        let bins = bin(&splats, width, height);
        let packed = Packed::new(&splats, &features, dim);
        let images = raster(&packed, &bins, width, height);
        let g_planes = random_values(images.planes.len(), 7);
        let (g_splats, g_features) = raster_backward(&splats, &packed, &bins, &images, &g_planes);
        let wide: Vec<_> = splats.iter().map(Splat::widened).collect();
        let features: Vec<f64> = features.iter().map(|&v| f64::from(v)).collect();
        let reference = ReferenceInput { splats: &wide, features: &features, latent_dim: dim, width, height };
        let g_planes: Vec<f64> = g_planes.iter().map(|&v| f64::from(v)).collect();
        let (r_splats, r_features) = reference.backward(&g_planes);
        let (kernel, truth) = (flatten(&g_splats), flatten(&r_splats));
        for k in 0..10 {
            let column = |v: &[f64]| v.iter().skip(k).step_by(10).copied().collect::<Vec<_>>();
            assert_close(&column(&kernel), &column(&truth), &format!("D {dim}, gradient {k}"));
        }
        assert_close(&g_features.iter().map(|&v| f64::from(v)).collect::<Vec<_>>(), &r_features, "features");
    }
}

/// Checks that the relative L2 difference is below 2e-3. Rounding is far below; the limit allows for a
/// pixel on the other side of a cut-off.
fn assert_close(a: &[f64], b: &[f64], what: &str) {
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let error = norm(&mut a.iter().zip(b).map(|(x, y)| x - y));
    let scale = norm(&mut b.iter().copied());
    assert!(error <= 2e-3 * scale + 1e-12, "{what}: {error} of {scale}");
}

#[test]
fn the_reference_gradient_matches_finite_differences() {
    // Large, faint splats: every pixel lies inside every ellipse, far from all cut-offs.
    let mut splats: Vec<Splat<f64>> = random_splats(6, 10, 8, 3).iter().map(Splat::widened).collect();
    for (i, s) in splats.iter_mut().enumerate() {
        s.conic = [0.01 + 0.002 * i as f64, 0.003, 0.012];
        s.opacity = 0.2 + 0.1 * i as f64;
        s.centre = [2.0 + i as f64, 5.0 - 0.5 * i as f64];
        s.depth = 1.0 + i as f64;
        s.extent = [50.0, 50.0];
    }
    let features: Vec<f64> = random_values(12, 4).iter().map(|&v| f64::from(v)).collect();
    let g: Vec<f64> = random_values(7 * 80, 9).iter().map(|&v| f64::from(v)).collect();
    let input = |splats: &[Splat<f64>], features: &[f64]| {
        let images = ReferenceInput { splats, features, latent_dim: 2, width: 10, height: 8 }.forward();
        images.iter().zip(&g).map(|(a, b)| a * b).sum::<f64>()
    };
    let (g_splats, g_features) =
        ReferenceInput { splats: &splats, features: &features, latent_dim: 2, width: 10, height: 8 }
            .backward(&g);
    let h = 1e-6;
    let edits: [fn(&mut Splat<f64>, f64); 10] = [
        |s, h| s.centre[0] += h,
        |s, h| s.centre[1] += h,
        |s, h| s.conic[0] += h,
        |s, h| s.conic[1] += h,
        |s, h| s.conic[2] += h,
        |s, h| s.depth += h,
        |s, h| s.opacity += h,
        |s, h| s.colour[0] += h,
        |s, h| s.colour[1] += h,
        |s, h| s.colour[2] += h,
    ];
    let analytic = flatten(&g_splats);
    for i in 0..splats.len() {
        for (k, edit) in edits.iter().enumerate() {
            let at = |h: f64| {
                let mut moved = splats.clone();
                edit(&mut moved[i], h);
                input(&moved, &features)
            };
            let numeric = (at(h) - at(-h)) / (2.0 * h);
            assert!(
                (analytic[i * 10 + k] - numeric).abs() < 1e-6 * (1.0 + numeric.abs()),
                "splat {i}, gradient {k}"
            );
        }
    }
    for k in 0..features.len() {
        let at = |h: f64| {
            let mut moved = features.clone();
            moved[k] += h;
            input(&splats, &moved)
        };
        assert!((g_features[k] - (at(h) - at(-h)) / (2.0 * h)).abs() < 1e-7, "feature {k}");
    }
}

#[test]
fn poisoned_and_extreme_splats_leave_images_finite() {
    let mut splats = random_splats(40, 32, 32, 1);
    splats[0].conic = [1e30, 0.0, 1e30];
    splats[1].conic = [1e-30, 0.0, 1e-30];
    splats[2].opacity = 1.0;
    splats[3].extent = [0.0, 0.0];
    splats[3].centre = [f32::NAN, f32::NAN];
    let bins = bin(&splats, 32, 32);
    let packed = Packed::new(&splats, &[], 0);
    let images = raster(&packed, &bins, 32, 32);
    assert!(images.planes.iter().all(|v| v.is_finite()));
    let g = vec![1.0; images.planes.len()];
    let (g_splats, _) = raster_backward(&splats, &packed, &bins, &images, &g);
    assert!(flatten(&g_splats).iter().all(|v| v.is_finite()));
}

/// With smooth cuts the gradient is right everywhere, even for splats that fade out, saturate and hide
/// others.
#[test]
fn the_reference_gradient_is_right_across_the_cuts() {
    let (width, height, dim) = (9, 7, 2);
    let splats: Vec<Splat<f64>> = random_splats(14, width, height, 21).iter().map(Splat::widened).collect();
    let splats: Vec<Splat<f64>> = splats
        .into_iter()
        .enumerate()
        .map(|(i, s)| Splat { opacity: [0.006, 0.995, 0.5][i % 3], ..s })
        .collect();
    let features: Vec<f64> = random_values(14 * dim, 22).iter().map(|v| f64::from(*v)).collect();
    let pull: Vec<f64> =
        random_values((5 + dim) * width * height, 23).iter().map(|v| f64::from(*v)).collect();
    let value = |splats: &[Splat<f64>]| {
        let input = ReferenceInput { splats, features: &features, latent_dim: dim, width, height };
        input.forward_with(Cut::Smooth).iter().zip(&pull).map(|(a, b)| a * b).sum::<f64>()
    };
    let input = ReferenceInput { splats: &splats, features: &features, latent_dim: dim, width, height };
    let (analytic, _) = input.backward_with(Cut::Smooth, &pull);
    let mut compared = 0;
    for (i, g) in analytic.iter().enumerate() {
        let mut check = |name: &str, analytic: f64, edit: &dyn Fn(&mut Splat<f64>, f64)| {
            let at = |h: f64| {
                let mut moved = splats.clone();
                edit(&mut moved[i], h);
                value(&moved)
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!(
                (analytic - numeric).abs() <= 1e-4 * numeric.abs().max(0.1),
                "{name} of {i}: {analytic} against {numeric}"
            );
            compared += usize::from(numeric.abs() > 1e-3);
        };
        for k in 0..2 {
            check("centre", g.centre[k], &|s, h| s.centre[k] += h);
        }
        for k in 0..3 {
            check("conic", g.conic[k], &|s, h| s.conic[k] += h);
        }
        check("opacity", g.opacity, &|s, h| s.opacity += h);
    }
    assert!(compared > 40, "only {compared} gradients to compare");
}

#[test]
fn every_second_pixel_is_what_the_whole_image_has_there() {
    let (width, height) = (45, 34);
    let splats = random_splats(120, width, height, 31);
    let features = random_values(120 * 3, 32);
    let whole = raster(&Packed::new(&splats, &features, 3), &bin(&splats, width, height), width, height);
    for first in [[0, 0], [1, 0], [0, 1], [1, 1]] {
        let sampling = Sampling { step: 2, first };
        let (w, h) = sampling.size(width, height);
        let mut moved = splats.clone();
        moved.iter_mut().for_each(|s| sampling.apply(s));
        let part = raster(&Packed::new(&moved, &features, 3), &bin(&moved, w, h), w, h);
        let mut beyond = 0;
        for k in 0..8 {
            for y in 0..h {
                for x in 0..w {
                    let at = (first[1] + 2 * y) * width + first[0] + 2 * x;
                    beyond += usize::from((part.plane(k)[y * w + x] - whole.plane(k)[at]).abs() > 2e-4);
                }
            }
        }
        assert!(beyond <= 8, "{beyond} values differ");
    }
}
