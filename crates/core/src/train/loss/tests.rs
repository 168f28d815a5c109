//! Compares the loss with finite differences and with values computed by hand.

use super::*;
use crate::prepare::NO_REGION;
use crate::train::frames::TrainFrame;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WIDTH: usize = 7;
const HEIGHT: usize = 6;
const N: usize = WIDTH * HEIGHT;

struct Fixture {
    frame: TrainFrame,
    latents: Vec<f32>,
    planes: Vec<f64>,
}

fn fixture() -> Fixture {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut planes: Vec<f64> = (0..8 * N).map(|_| rng.random_range(0.1..0.9)).collect();
    for i in 0..N {
        planes[ALPHA_PLANE * N + i] = rng.random_range(0.6..1.0);
        planes[DEPTH_PLANE * N + i] = rng.random_range(20.0..60.0);
    }
    let frame = TrainFrame {
        width: WIDTH,
        height: HEIGHT,
        colour: (0..3 * N).map(|_| rng.random_range(0..255)).collect(),
        mask: (0..N).map(|i| i % 5 != 2).collect(),
        depth: (0..N).map(|i| if i % 4 == 0 { 0.0 } else { rng.random_range(20.0..60.0) }).collect(),
        regions: (0..N).map(|i| if i % 9 == 0 { NO_REGION } else { (i % 3) as u16 }).collect(),
    };
    Fixture { frame, latents: (0..9).map(|_| rng.random_range(-1.0..1.0)).collect(), planes }
}

impl Fixture {
    fn truth(&self) -> Truth<'_> {
        self.frame.truth(&self.latents, 40.0)
    }
}

#[test]
fn every_term_matches_finite_differences() {
    let f = fixture();
    let none = LossWeights {
        depth: 0.0,
        total_variation: 0.0,
        features: 0.0,
        region_smoothness: 0.0,
        min_region_px: 5,
        ..LossWeights::default()
    };
    let all = LossWeights {
        depth: 1.0,
        total_variation: 0.3,
        features: 1.0,
        region_smoothness: 0.5,
        min_region_px: 5,
        ..LossWeights::default()
    };
    for weights in [
        none.clone(),
        LossWeights { absolute: 1.0, square: 0.0, ..none.clone() },
        LossWeights { depth: 1.0, ..none.clone() },
        LossWeights { total_variation: 0.3, ..none.clone() },
        LossWeights { features: 1.0, ..none.clone() },
        LossWeights { features: 1.0, region_smoothness: 1.0, ..none.clone() },
        LossWeights { depth: 1.0, total_variation: 0.3, raw_depth: true, ..none.clone() },
        LossWeights { features: 1.0, region_smoothness: 1.0, pooled_regions: true, ..none.clone() },
        LossWeights { features: 1.0, total_variation: 0.3, unmasked_variation: true, ..none },
        all,
    ] {
        let (_, g) = loss(&f.planes, &f.truth(), &weights);
        for i in 0..f.planes.len() {
            let at = |h: f64| {
                let mut planes = f.planes.clone();
                planes[i] += h;
                loss(&planes, &f.truth(), &weights).0.total()
            };
            let h = 1e-7;
            let numeric = (at(h) - at(-h)) / (2.0 * h);
            assert!((g[i] - numeric).abs() < 1e-6, "value {i}: {} against {numeric}, {weights:?}", g[i]);
        }
    }
}

#[test]
fn a_perfect_picture_of_flat_regions_costs_nothing() {
    let mut f = fixture();
    f.frame.colour = vec![51; 3 * N];
    for c in 0..3 {
        f.planes[c * N..(c + 1) * N].fill(0.2);
    }
    f.frame.depth = vec![40.0; N];
    f.planes[DEPTH_PLANE * N..(DEPTH_PLANE + 1) * N].fill(40.0);
    f.planes[ALPHA_PLANE * N..(ALPHA_PLANE + 1) * N].fill(1.0);
    f.frame.regions = vec![1; N];
    for d in 0..3 {
        f.planes[(FEATURE_PLANE + d) * N..][..N].fill(f64::from(f.latents[3 + d]));
    }
    let (terms, g) = loss(&f.planes, &f.truth(), &LossWeights { min_region_px: 5, ..LossWeights::default() });
    assert!(terms.total().abs() < 1e-9, "{terms:?}");
    assert!(g.iter().all(|v| v.abs() < 1e-9), "and pulls nowhere");
}

#[test]
fn what_is_masked_out_has_no_gradient() {
    let f = fixture();
    let (_, g) = loss(&f.planes, &f.truth(), &LossWeights::default());
    for (k, v) in g.iter().enumerate() {
        assert!(f.frame.mask[k % N] || *v == 0.0, "plane {} pixel {}", k / N, k % N);
    }
    let empty = vec![false; N];
    let (terms, g) = loss(&f.planes, &Truth { mask: &empty, ..f.truth() }, &LossWeights::default());
    assert!(terms.total() == 0.0 && g.iter().all(|v| *v == 0.0));
}

#[test]
fn small_regions_are_left_alone() {
    let f = fixture();
    let at = |min_region_px| {
        loss(&f.planes, &f.truth(), &LossWeights { min_region_px, ..LossWeights::default() }).0.region
    };
    assert!(at(2) > 0.0);
    assert_eq!(at(1000), 0.0);
}

/// An image of 4×4 pixels and one region: the first feature alternates between 0 and 2, the second is 3
/// everywhere.
#[test]
fn variation_and_smoothness_as_computed_by_hand() {
    const PIXELS: usize = 16;
    let mut planes = vec![0.0f64; (FEATURE_PLANE + 2) * PIXELS];
    for i in 0..PIXELS {
        // Red has a step between the second and the third column.
        planes[i] = f64::from(u8::from(i % 4 >= 2));
        planes[FEATURE_PLANE * PIXELS + i] = 2.0 * (i % 2) as f64;
        planes[(FEATURE_PLANE + 1) * PIXELS + i] = 3.0;
    }
    let (colour, mask, regions) = (vec![0; 3 * PIXELS], vec![true; PIXELS], vec![0; PIXELS]);
    let truth = Truth {
        width: 4,
        height: 4,
        colour: &colour,
        mask: &mask,
        depth: &[],
        regions: &regions,
        latents: &[0.0, 3.0],
        typical_depth: 1.0,
    };
    let weights = LossWeights { min_region_px: 16, ..LossWeights::default() };
    let (terms, _) = loss(&planes, &truth, &weights);
    // Half of the red values miss by 1: |1| weighs 0.3, 1² weighs 10.
    assert!((terms.colour - 10.3 * 0.5 / 3.0).abs() < 1e-6);
    assert!((terms.features - 8.0 * 2.0 / 32.0).abs() < 1e-8);
    // There are four steps of 1 in red, and three steps of 2 in each row of the first feature.
    let variation = 0.01 * (4.0 / 48.0 + 24.0 / 32.0);
    assert!((terms.total_variation - variation).abs() < 1e-8);
    // Each channel has its own mean: deviations 1 and 0, averaged over two channels.
    assert!((terms.region - 0.01 * 0.5).abs() < 1e-8);
    // The common mean is 2: deviations 2 or 0, and 1.
    let (pooled, _) = loss(&planes, &truth, &LossWeights { pooled_regions: true, ..weights.clone() });
    assert!((pooled.region - 0.01).abs() < 1e-8);
    let (small, _) = loss(&planes, &truth, &LossWeights { min_region_px: 17, ..weights });
    assert_eq!(small.region, 0.0);
}
