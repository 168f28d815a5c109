//! Compares the gradients of a whole step with finite differences of its f64 twin, and tests the
//! trainer's promises.

use super::{
    LossWeights, Truth,
    chain::{self, FrameState, Gradients},
    frames::TrainFrame,
    loss,
    optimiser::{Optimiser, own_basis_gradients},
    settings::{Profile, TrainSettings},
};
use crate::{
    camera::{Camera, Twist},
    deform::{
        BasisShape, COLOUR_CHANNEL, Deformation, Deformed, FeatureNet, GATE_CHANNEL, GATE_SLOPE,
        MEAN_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL, basis, deform_by, gate_feature, move_geometry,
        num_channels,
    },
    gaussian::Gaussians,
    raster::{
        Packed,
        backward::raster_backward,
        bin::bin,
        forward::raster,
        project::{CameraView, project, project_all, view_colour},
        reference::ReferenceInput,
    },
    real::Real,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

const WIDTH: usize = 24;
const HEIGHT: usize = 18;
const DIM: usize = 3;
const BASES: usize = 4;
const TIME: f32 = 0.4;

/// Variants of training under test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Variant {
    /// Gaussian bases as in the paper's formulas.
    Formulas,
    /// The defaults of training.
    Splines,
    /// The released code's variant: own quartic bases, gate on the scale channels, its loss.
    Released,
}

struct Fixture {
    variant: Variant,
    camera: Camera,
    gaussians: Gaussians,
    deformation: Deformation,
    frame: TrainFrame,
    latents: Vec<f32>,
}

/// Broad, faint Gaussians: every pixel lies inside every ellipse, so that no cut-off is near.
fn fixture(variant: Variant) -> Fixture {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut camera = Camera::with_field_of_view(WIDTH as u32, HEIGHT as u32, 60.0);
    camera.camera_from_world = glam::Affine3A::from_rotation_y(0.1);
    let n = 7;
    let mut near = |scale: f32| rng.random_range(-scale..scale);
    let gaussians = Gaussians {
        means: (0..n).map(|i| [near(1.0), near(0.8), 9.0 + 0.4 * i as f32]).collect(),
        rotations: (0..n).map(|_| [1.0, near(0.5), near(0.5), near(0.5)]).collect(),
        log_scales: (0..n).map(|_| [1.9 + near(0.2), 1.8 + near(0.2), 1.7 + near(0.2)]).collect(),
        opacity_logits: (0..n).map(|_| -0.8 + near(0.3)).collect(),
        colours: (0..n).map(|_| [near(0.6), near(0.6), near(0.6)]).collect(),
        sh_rest: (0..n * 9).map(|_| near(0.2)).collect(),
        sh_degree: 1,
        features: (0..n * DIM).map(|_| near(1.0)).collect(),
        latent_dim: DIM,
    };
    let mut deformation = Deformation::at_rest(n, DIM, BASES, 0.3, GATE_SLOPE);
    deformation.weights.iter_mut().for_each(|w| *w = near(0.1));
    if variant == Variant::Splines {
        deformation.shape = BasisShape::Spline;
    }
    if variant == Variant::Released {
        deformation.shape = BasisShape::Quartic;
        deformation.gate_channel = SCALE_CHANNEL;
        deformation = deformation.with_own_bases();
        deformation.centres.iter_mut().for_each(|c| *c += near(0.05));
        deformation.widths.iter_mut().for_each(|w| *w += near(0.05));
    }
    deformation.feature_weight.iter_mut().for_each(|w| *w = near(0.5));
    deformation.feature_bias.iter_mut().for_each(|w| *w = near(0.5));
    let pixels = WIDTH * HEIGHT;
    let frame = TrainFrame {
        width: WIDTH,
        height: HEIGHT,
        colour: (0..3 * pixels).map(|_| rng.random()).collect(),
        mask: (0..pixels).map(|i| i % 7 != 3).collect(),
        depth: (0..pixels).map(|i| if i % 5 == 0 { 0.0 } else { rng.random_range(8.0..14.0) }).collect(),
        regions: (0..pixels).map(|i| (i % 3) as u16).collect(),
    };
    let latents = (0..3 * DIM).map(|_| rng.random_range(-1.0..1.0)).collect();
    Fixture { variant, camera, gaussians, deformation, frame, latents }
}

impl Fixture {
    fn truth(&self) -> Truth<'_> {
        self.frame.truth(&self.latents, 10.0)
    }

    fn weights(&self) -> LossWeights {
        let released = self.variant == Variant::Released;
        LossWeights {
            raw_depth: released,
            pooled_regions: released,
            unmasked_variation: released,
            min_region_px: 5,
            region_smoothness: 0.3,
            total_variation: 0.2,
            ..LossWeights::default()
        }
    }

    /// All parameters in one list, group after group.
    fn parameters(&self) -> Vec<(&'static str, Vec<f64>)> {
        let wide = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
        let (g, d) = (&self.gaussians, &self.deformation);
        vec![
            ("means", wide(g.means.as_flattened())),
            ("rotations", wide(g.rotations.as_flattened())),
            ("log-scales", wide(g.log_scales.as_flattened())),
            ("opacity", wide(&g.opacity_logits)),
            ("colours", wide(g.colours.as_flattened())),
            ("colour bands", wide(&g.sh_rest)),
            ("features", wide(&g.features)),
            ("basis weights", wide(&d.weights)),
            ("network", wide(&[d.feature_weight.clone(), d.feature_bias.clone()].concat())),
            ("basis centres", wide(&d.centres)),
            ("basis widths", wide(&d.widths)),
            ("camera", vec![0.0; 6]),
        ]
    }

    /// Loss of a step in f64, as a function of all parameters.
    fn twin(&self, p: &[(&'static str, Vec<f64>)]) -> f64 {
        let [
            means,
            rotations,
            log_scales,
            opacity,
            colours,
            bands,
            features,
            weights,
            net,
            centres,
            widths,
            motion,
        ] = std::array::from_fn(|k| p[k].1.as_slice());
        let (n, stride, time) = (self.gaussians.len(), self.deformation.stride, f64::from(TIME));
        let motion = Twist::of(std::array::from_fn(|k| motion[k]));
        let view = CameraView::<f64>::new(&self.camera).moved(&motion);
        let (net_weight, net_bias) = net.split_at(DIM * (DIM + 1));
        let net =
            FeatureNet { weight: net_weight, bias: net_bias, slope: f64::from(self.deformation.gate_slope) };
        let block = n * stride;
        let value = |at: usize| {
            let own = if self.deformation.is_shared() { at / block } else { at };
            basis(self.deformation.shape, time, centres[own], widths[own])
        };
        let mut deformed_features = vec![0.0; n * DIM];
        let mut splats = Vec::new();
        for i in 0..n {
            let psi: Vec<f64> = (0..stride)
                .map(|c| {
                    let at = |b: usize| b * block + i * stride + c;
                    (0..BASES).map(|b| value(at(b)) * weights[at(b)]).sum()
                })
                .collect();
            let three = |v: &[f64]| [v[3 * i], v[3 * i + 1], v[3 * i + 2]];
            let rotation = std::array::from_fn(|k| rotations[4 * i + k]);
            let moved = move_geometry(three(means), rotation, three(log_scales), &psi);
            let band0 = std::array::from_fn(|c| colours[3 * i + c] + psi[COLOUR_CHANNEL + c]);
            let colour = view_colour(&view, moved.geometry.mean, band0, 1, &bands[9 * i..9 * i + 9]);
            splats.push(project(&view, &moved.geometry, opacity[i].sigmoid(), colour));
            let gate = &psi[self.deformation.gate_channel..self.deformation.gate_channel + DIM];
            let out = &mut deformed_features[i * DIM..(i + 1) * DIM];
            gate_feature(&net, &features[i * DIM..(i + 1) * DIM], gate, time, out);
        }
        let input = ReferenceInput {
            splats: &splats,
            features: &deformed_features,
            latent_dim: DIM,
            width: WIDTH,
            height: HEIGHT,
        };
        loss(&input.forward(), &self.truth(), &self.weights()).0.total()
    }

    /// Gradients that training uses.
    fn gradients(&self) -> Gradients {
        let (gaussians, deformation) = (&self.gaussians, &self.deformation);
        let psi = deformation.psi(gaussians.len(), TIME);
        let mut deformed = Deformed::default();
        deform_by(gaussians, deformation, &psi, TIME, true, &mut deformed);
        let splats = project_all(gaussians, &deformed, &self.camera);
        let bins = bin(&splats, WIDTH, HEIGHT);
        let packed = Packed::new(&splats, &deformed.features, DIM);
        let images = raster(&packed, &bins, WIDTH, HEIGHT);
        let (_, g_planes) = loss(&images.planes, &self.truth(), &self.weights());
        let (g_splats, g_features) = raster_backward(&splats, &packed, &bins, &images, &g_planes);
        let state = FrameState {
            gaussians,
            deformation,
            psi: &psi,
            deformed: &deformed,
            splats: &splats,
            camera: &self.camera,
            time: TIME,
        };
        let mut gradients = Gradients::default();
        assert!(chain::backward(&state, &g_splats, &g_features, &mut gradients));
        gradients
    }

    /// Gradients that training uses, in the order of [`Fixture::parameters`].
    fn flat_gradients(&self) -> Vec<Vec<f32>> {
        let mut g = self.gradients();
        let at_rest = g.psi.clone();
        g.fold_gate(&self.deformation, DIM);
        let own = |k: usize| -> Vec<f32> {
            let of_basis = |b| own_basis_gradients(&self.deformation, b, &g.psi, TIME);
            (0..BASES).flat_map(|b| of_basis(b).into_iter().map(move |g| g[k])).collect()
        };
        let of_weights = if self.deformation.is_shared() {
            let (values, _) = self.deformation.basis_values(TIME);
            values.iter().flat_map(|v| g.psi.iter().map(move |p| v * p)).collect()
        } else {
            own(0)
        };
        let rows = || at_rest.chunks_exact(self.deformation.stride);
        let channels = |range: Range<usize>| rows().flat_map(|row| row[range.clone()].to_vec()).collect();
        vec![
            channels(MEAN_CHANNEL..ROTATION_CHANNEL),
            channels(ROTATION_CHANNEL..SCALE_CHANNEL),
            channels(SCALE_CHANNEL..COLOUR_CHANNEL),
            g.opacity_logits.clone(),
            channels(COLOUR_CHANNEL..GATE_CHANNEL),
            g.sh_rest.clone(),
            g.features.clone(),
            of_weights,
            g.net.clone(),
            // Shared centres and widths are fixed.
            if self.deformation.is_shared() { Vec::new() } else { own(1) },
            if self.deformation.is_shared() { Vec::new() } else { own(2) },
            g.camera.to_array().to_vec(),
        ]
    }
}

/// Tolerance: 1e-3 of the value, or of the group's root mean square if the value itself is near zero.
const TOLERANCE: f64 = 1e-3;

#[test]
fn every_parameter_matches_finite_differences_of_the_f64_twin() {
    for variant in [Variant::Formulas, Variant::Splines, Variant::Released] {
        let fixture = fixture(variant);
        let mut parameters = fixture.parameters();
        for (group, analytic) in fixture.flat_gradients().iter().enumerate() {
            if !analytic.is_empty() {
                compare_group(&fixture, &mut parameters, group, analytic);
            }
        }
    }
}

fn compare_group(
    fixture: &Fixture,
    parameters: &mut [(&'static str, Vec<f64>)],
    group: usize,
    analytic: &[f32],
) {
    let name = parameters[group].0;
    let stride = fixture.deformation.stride;
    let is_padding = |k: usize| name.starts_with("basis") && k % stride >= num_channels(DIM);
    let checked: Vec<usize> = (0..analytic.len()).filter(|k| !is_padding(*k)).collect();
    let mut numeric = vec![0.0; analytic.len()];
    for &k in &checked {
        let mut at = |h: f64| {
            let before = parameters[group].1[k];
            parameters[group].1[k] = before + h;
            let value = fixture.twin(&*parameters);
            parameters[group].1[k] = before;
            value
        };
        numeric[k] = (at(1e-6) - at(-1e-6)) / 2e-6;
    }
    let rms = (numeric.iter().map(|v| v * v).sum::<f64>() / checked.len() as f64).sqrt();
    assert!(rms > 0.0, "{:?}: {name} have no gradient to test", fixture.variant);
    for &k in &checked {
        let error = (f64::from(analytic[k]) - numeric[k]).abs();
        assert!(
            error <= TOLERANCE * numeric[k].abs().max(rms),
            "{:?}: {name} {k}: {} against {}, root mean square {rms}",
            fixture.variant,
            analytic[k],
            numeric[k]
        );
    }
}

#[test]
fn the_released_schedule_has_the_published_values() {
    let paper = TrainSettings::of(Profile::Paper);
    let rate =
        |step: f64| f64::from(paper.rates.mean) * f64::from(paper.rates.final_share).powf(step / 3000.0);
    assert!((rate(0.0) - 1.6e-3).abs() < 1e-9 && (rate(3000.0) - 5.06e-5).abs() < 1e-7);
    let sum: f64 = (0..3000).map(|step| rate(f64::from(step))).sum();
    assert!((sum - 1.345).abs() < 2e-3, "{sum}");
    let densified: Vec<usize> = (1..=3000).filter(|step| paper.densifies_at(*step)).collect();
    assert_eq!((densified[0], densified[1], densified.len()), (600, 700, 25));
}

#[test]
fn at_the_end_everything_but_features_is_at_rest() {
    let fixture = fixture(Variant::Splines);
    let (mut gaussians, mut deformation) = (fixture.gaussians.clone(), fixture.deformation.clone());
    let mut optimiser = Optimiser::new(&gaussians, &deformation);
    let (settings, now) = (TrainSettings::default(), (TIME, 1.0, 0.05));
    optimiser.step(&mut gaussians, &mut deformation, &mut fixture.gradients(), &settings, now);
    assert!(deformation.weights == fixture.deformation.weights);
    assert!(gaussians.features != fixture.gaussians.features);
    gaussians.features.clone_from(&fixture.gaussians.features);
    assert!(gaussians == fixture.gaussians);
}

#[test]
fn gradients_do_not_depend_on_the_number_of_threads() {
    let fixture = fixture(Variant::Splines);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fixture.gradients())
    };
    assert_eq!(on(1), on(3));
}
