//! Tests each pass of a training step by itself: its twin gets the values that the device computed before it.

use crate::{
    compare::{self, SAME_SPLATS},
    fixture::{Recipe, gpu, moved_camera, numbers, scene},
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use surgtpgs_core::{
    deform::{BasisShape, Deformed, SCALE_CHANNEL, deform_by},
    prepare::NO_REGION,
    raster::{
        Packed,
        backward::raster_backward,
        bin::bin,
        forward::raster,
        project::{Sampling, project_into},
    },
    train::{
        Context, FrameState, Gradients, LearningRates, LossWeights, Model, StepPlan, StepView, TrainBackend,
        TrainFrame, TrainSettings, chain_backward, loss,
    },
};
use surgtpgs_render::{GpuBackend, StepTrace};

const WIDTH: usize = 75;
const HEIGHT: usize = 50;
const ROWS: usize = 4;
const TIME: f32 = 0.37;

/// One step to be taken and examined.
pub(crate) struct Step {
    pub model: Model,
    pub settings: TrainSettings,
    latents: Vec<f32>,
    pub plan: StepPlan,
}

impl Step {
    pub(crate) fn new(recipe: Recipe, sampling: Sampling, weights: LossWeights) -> Self {
        let scene = scene(recipe);
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let settings = TrainSettings {
            loss: LossWeights { min_region_px: 40, region_smoothness: 0.3, total_variation: 0.2, ..weights },
            sh_every: 100,
            rates: LearningRates { cooldown: 0.8, ..TrainSettings::default().rates },
            ..TrainSettings::default()
        };
        let camera = moved_camera(WIDTH as u32, HEIGHT as u32);
        let view = StepView { camera, time: TIME, half: false, sampling, progress: 0.3 };
        let frame = Arc::new(frame(rng));
        let latents = numbers(rng, ROWS * recipe.latent_dim, 1.0);
        let model = Model::new((*scene.gaussians).clone(), (*scene.deformation).clone());
        Self { model, settings, latents, plan: StepPlan { index: 0, frame, view, step: 120, updates: true } }
    }

    /// A step with bases of each Gaussian's own and the gate on scale, as in the released code.
    fn released() -> Self {
        let recipe =
            Recipe { num_gaussians: 700, shape: BasisShape::Quartic, is_shared: false, ..Recipe::default() };
        let mut step = Self::new(recipe, Sampling::ALL, LossWeights::default());
        step.model.deformation.gate_channel = SCALE_CHANNEL;
        step
    }

    pub(crate) fn context(&self) -> Context<'_> {
        Context { settings: &self.settings, latents: &self.latents, typical_depth: 3.0, world_per_px: 0.05 }
    }

    /// Takes the step on the device; returns its trace and the model after it.
    fn run(&self, backend: &mut GpuBackend) -> (StepTrace, Model) {
        let mut model = self.model.clone();
        let trace = backend.trace(&mut model, self.plan.clone(), &self.context()).unwrap();
        backend.finish(&mut model, &self.context()).unwrap();
        (trace, model)
    }
}

/// A frame of random colours: some pixels masked, some without depth or region; regions large and small.
fn frame(rng: &mut ChaCha8Rng) -> TrainFrame {
    let n = WIDTH * HEIGHT;
    let region = |i: usize| match i % WIDTH {
        0..30 => 0,
        30..60 => 1,
        60..74 => 2,
        _ => 3,
    };
    TrainFrame {
        width: WIDTH,
        height: HEIGHT,
        colour: (0..3 * n).map(|_| rng.random()).collect(),
        mask: (0..n).map(|i| i % 7 != 3).collect(),
        depth: (0..n).map(|i| if i % 5 == 0 { 0.0 } else { rng.random_range(1.0..6.0) }).collect(),
        regions: (0..n).map(|i| if i % 11 == 0 { NO_REGION } else { region(i) }).collect(),
    }
}

/// Checks that ‖found − expected‖ / ‖expected‖ is within the tolerance.
pub(crate) fn close_as_a_whole(name: &str, found: &[f32], expected: &[f32], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{name}");
    let square = |v: f64| v * v;
    let size: f64 = expected.iter().map(|v| square(f64::from(*v))).sum();
    let error: f64 = found.iter().zip(expected).map(|(f, e)| square(f64::from(*f) - f64::from(*e))).sum();
    let relative = (error / size.max(1e-30)).sqrt();
    // Written so that NaN fails.
    assert!(relative <= tolerance, "{name}: relative error {relative:.2e}, size {:.2e}", size.sqrt());
}

fn all_steps() -> Vec<Step> {
    let sparse = Sampling { step: 2, first: [1, 0] };
    let released = LossWeights {
        raw_depth: true,
        pooled_regions: true,
        unmasked_variation: true,
        ..LossWeights::default()
    };
    let recipe = |latent_dim, sh_degree| Recipe {
        num_gaussians: 700,
        latent_dim,
        sh_degree,
        shape: BasisShape::Spline,
        ..Recipe::default()
    };
    vec![
        Step::new(recipe(0, 0), Sampling::ALL, LossWeights::default()),
        Step::new(recipe(3, 1), sparse, LossWeights::default()),
        Step::new(recipe(3, 3), Sampling::ALL, released),
        Step::new(recipe(7, 2), sparse, LossWeights::default()),
        Step::new(recipe(16, 0), Sampling::ALL, LossWeights::default()),
        Step::released(),
        Step::new(Recipe { is_shared: false, ..recipe(3, 0) }, sparse, LossWeights::default()),
        Step::new(
            Recipe { is_shared: false, shape: BasisShape::Gaussian, ..recipe(0, 1) },
            Sampling::ALL,
            LossWeights::default(),
        ),
    ]
}

#[test]
fn every_pass_of_a_step_equals_its_twin() {
    let Some(gpu) = gpu() else { return };
    for step in all_steps() {
        let mut backend = GpuBackend::new(gpu.clone()).unwrap();
        eprintln!("D = {}, {:?}", step.model.gaussians.latent_dim, step.plan.view.sampling);
        let (trace, after) = step.run(&mut backend);
        let (psi, deformed) = picture(&step, &trace);
        check_loss(&step, &trace);
        check_backward(&step, &trace);
        check_chain(&step, &trace, &psi, &deformed);
        check_update(&step, &trace, &after);
    }
}

/// Computes everything up to the picture, of the sampled pixels only.
fn picture(step: &Step, trace: &StepTrace) -> (Vec<f32>, Deformed) {
    let Model { gaussians, deformation, .. } = &step.model;
    let view = &step.plan.view;
    let psi = deformation.psi(gaussians.len(), TIME);
    let mut deformed = Deformed::default();
    deform_by(gaussians, deformation, &psi, TIME, true, &mut deformed);
    let mut splats = Vec::new();
    project_into(gaussians, &deformed, &view.camera, view.sampling, &mut splats);
    // The place of a culled splat has no meaning.
    splats.iter_mut().filter(|s| !s.is_visible()).for_each(|s| *s = Default::default());
    compare::splats(&trace.splats, &splats).unwrap();
    let packed = Packed::new(&trace.splats, &trace.features, gaussians.latent_dim);
    let (width, height) = (trace.images.width, trace.images.height);
    let expected = raster(&packed, &bin(&trace.splats, width, height), width, height);
    compare::images(&trace.images, &expected, SAME_SPLATS).unwrap();
    (psi, deformed)
}

fn check_loss(step: &Step, trace: &StepTrace) {
    let sampling = step.plan.view.sampling;
    let frame = step.plan.frame.sampled(sampling);
    let context = step.context();
    let truth = frame.truth(context.latents, context.typical_depth);
    let weights = context.loss_weights(&step.plan.view);
    let (terms, g) = loss(&trace.images.planes, &truth, &weights);
    for (found, expected) in trace.terms.values().into_iter().zip(terms.values()) {
        assert!((found - expected).abs() <= 2e-5 * expected.abs() + 1e-9, "{:?} {terms:?}", trace.terms);
    }
    if step.model.gaussians.latent_dim > 0 {
        assert!(terms.features > 0.0 && terms.region > 0.0);
    }
    close_as_a_whole("gradient of the picture", &trace.g_planes, &g, 1e-4);
}

fn check_backward(step: &Step, trace: &StepTrace) {
    let sampling = step.plan.view.sampling;
    let packed = Packed::new(&trace.splats, &trace.features, step.model.gaussians.latent_dim);
    let bins = bin(&trace.splats, trace.images.width, trace.images.height);
    let (mut g_splats, g_features) =
        raster_backward(&trace.splats, &packed, &bins, &trace.images, &trace.g_planes);
    g_splats.iter_mut().for_each(|g| sampling.apply_backward(g));
    let names = ["x", "y", "xx", "xy", "yy", "depth", "opacity", "red", "green", "blue"];
    for (k, name) in names.into_iter().enumerate() {
        let number = |g: &[surgtpgs_core::raster::project::SplatGradient<f32>]| -> Vec<f32> {
            g.iter().map(|g| g.to_array()[k]).collect()
        };
        close_as_a_whole(name, &number(&trace.g_splats), &number(&g_splats), BACKWARD);
    }
    close_as_a_whole("features", &trace.g_features, &g_features, BACKWARD);
}

/// Tolerance for f32 on another side of a cut-off, where a whole contribution differs.
const BACKWARD: f64 = 2e-3;

fn check_chain(step: &Step, trace: &StepTrace, psi: &[f32], deformed: &Deformed) {
    let state = FrameState {
        gaussians: &step.model.gaussians,
        deformation: &step.model.deformation,
        psi,
        deformed,
        splats: &trace.splats,
        camera: &step.plan.view.camera,
        time: TIME,
    };
    let mut expected = Gradients::default();
    assert!(chain_backward(&state, &trace.g_splats, &trace.g_features, &mut expected));
    let bands = step.model.gaussians.sh_bands();
    let learned = step.settings.learned_bands(bands, step.plan.step);
    expected.sh_rest.chunks_exact_mut((bands * 3).max(1)).for_each(|row| row[learned * 3..].fill(0.0));
    let stride = step.model.deformation.stride;
    let column = |psi: &[f32], k: usize| psi.iter().skip(k).step_by(stride).copied().collect::<Vec<f32>>();
    for k in 0..stride {
        let [found, wanted] = [&trace.gradients, &expected].map(|g| column(&g.psi, k));
        // Needles lose digits in both.
        close_as_a_whole(&format!("ψ {k}"), &found, &wanted, 5e-4);
    }
    close_as_a_whole("opacity", &trace.gradients.opacity_logits, &expected.opacity_logits, 1e-5);
    close_as_a_whole("bands", &trace.gradients.sh_rest, &expected.sh_rest, 1e-5);
    close_as_a_whole("features", &trace.gradients.features, &expected.features, 1e-5);
    let [found, wanted] = [&trace.gradients, &expected].map(|g| g.camera.to_array());
    close_as_a_whole("camera", &found, &wanted, 5e-4);
    if step.model.gaussians.latent_dim > 0 {
        close_as_a_whole("network", &trace.gradients.net, &expected.net, 1e-5);
    }
}

fn check_update(step: &Step, trace: &StepTrace, after: &Model) {
    let mut expected = step.model.clone();
    let (view, context) = (&step.plan.view, step.context());
    expected.statistics.add(&trace.splats, &trace.g_splats, context.pull_scale(view));
    let rates = (TIME, view.progress, context.world_per_px);
    let Model { gaussians, deformation, optimiser, .. } = &mut expected;
    optimiser.step(gaussians, deformation, &mut trace.gradients.clone(), &step.settings, rates);
    let moved = |before: &[f32], after: &[f32]| -> Vec<f32> {
        before.iter().zip(after).map(|(b, a)| a - b).collect()
    };
    let groups = |m: &Model| {
        let (g, d, o) = (&m.gaussians, &m.deformation, &m.optimiser);
        let moments = o.bases.iter().flat_map(|b| [b.first.clone(), b.second.clone()]).collect::<Vec<_>>();
        let own = |k: usize| o.own_bases.iter().flat_map(|own| own[k].first.clone()).collect::<Vec<_>>();
        [
            ("means", g.means.as_flattened().to_vec()),
            ("rotations", g.rotations.as_flattened().to_vec()),
            ("log-scales", g.log_scales.as_flattened().to_vec()),
            ("opacities", g.opacity_logits.clone()),
            ("colours", g.colours.as_flattened().to_vec()),
            ("bands", g.sh_rest.clone()),
            ("features", g.features.clone()),
            ("weights", d.weights.clone()),
            ("centres", d.centres.clone()),
            ("widths", d.widths.clone()),
            ("moments of the centres", own(0)),
            ("moments of the widths", own(1)),
            ("network", [d.feature_weight.clone(), d.feature_bias.clone()].concat()),
            ("moments at rest", [o.rest.first.clone(), o.rest.second.clone()].concat()),
            ("moments of the bases", moments.concat()),
            ("moments of the network", [&*o.net_weight.first, &o.net_bias.second].concat()),
            ("pull", m.statistics.pull.clone()),
        ]
    };
    let parts = groups(&step.model).into_iter().zip(groups(after)).zip(groups(&expected));
    for (((name, before), (_, found)), (_, expected)) in parts {
        // These are differences of numbers near 1, in steps of 1e-2 and less.
        close_as_a_whole(name, &moved(&before, &found), &moved(&before, &expected), 2e-4);
    }
    assert_eq!(after.statistics.seen, expected.statistics.seen);
    let steps = |m: &Model| {
        let own = m.optimiser.own_bases.iter().flatten();
        m.optimiser.bases.iter().chain(own).map(|b| b.steps).collect::<Vec<_>>()
    };
    assert_eq!(steps(after), steps(&expected));
    assert_eq!(after.optimiser.rest.steps, 1);
}

#[test]
fn the_gradients_of_a_whole_step_are_those_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    for mut step in [all_steps().remove(1), all_steps().remove(4)] {
        // The scene has neither needles nor Gaussians beside the camera.
        let gaussians = &mut step.model.gaussians;
        gaussians.log_scales.iter_mut().flatten().for_each(|s| *s = s.clamp(-2.5, -1.5));
        gaussians
            .means
            .iter_mut()
            .for_each(|m| *m = [m[0].clamp(-2.0, 2.0), m[1].clamp(-1.5, 1.5), m[2].max(3.0)]);
        gaussians.opacity_logits.iter_mut().for_each(|o| *o = o.clamp(-2.0, 0.0));
        let (trace, _) = step.run(&mut GpuBackend::new(gpu.clone()).unwrap());
        let expected = cpu_gradients(&step);
        let stride = step.model.deformation.stride;
        let group = |g: &Gradients, channels: std::ops::Range<usize>| -> Vec<f32> {
            g.psi.chunks_exact(stride).flat_map(|row| row[channels.clone()].to_vec()).collect()
        };
        for (name, channels) in
            [("mean", 0..3), ("rotation", 3..7), ("scale", 7..10), ("colour", 10..13), ("gate", 13..stride)]
        {
            let [found, wanted] = [&trace.gradients, &expected].map(|g| group(g, channels.clone()));
            close_as_a_whole(name, &found, &wanted, 1e-4);
        }
        close_as_a_whole("opacity", &trace.gradients.opacity_logits, &expected.opacity_logits, 1e-4);
        close_as_a_whole("features", &trace.gradients.features, &expected.features, 1e-4);
        close_as_a_whole("network", &trace.gradients.net, &expected.net, 1e-4);
        let [found, wanted] = [&trace.gradients, &expected].map(|g| g.camera.to_array());
        close_as_a_whole("camera", &found, &wanted, 1e-4);
    }
}

/// Computes the gradients from the parameters, all of it on the CPU.
fn cpu_gradients(step: &Step) -> Gradients {
    let Model { gaussians, deformation, .. } = &step.model;
    let view = &step.plan.view;
    let psi = deformation.psi(gaussians.len(), TIME);
    let mut deformed = Deformed::default();
    deform_by(gaussians, deformation, &psi, TIME, true, &mut deformed);
    let mut splats = Vec::new();
    project_into(gaussians, &deformed, &view.camera, view.sampling, &mut splats);
    let frame = step.plan.frame.sampled(view.sampling);
    let (width, height) = frame.size();
    let bins = bin(&splats, width, height);
    let packed = Packed::new(&splats, &deformed.features, gaussians.latent_dim);
    let images = raster(&packed, &bins, width, height);
    let weights = step.context().loss_weights(view);
    let (_, g_planes) = loss(&images.planes, &frame.truth(&step.latents, 3.0), &weights);
    let (mut g_splats, g_features) = raster_backward(&splats, &packed, &bins, &images, &g_planes);
    g_splats.iter_mut().for_each(|g| view.sampling.apply_backward(g));
    let (camera, time) = (&view.camera, TIME);
    let state =
        FrameState { gaussians, deformation, psi: &psi, deformed: &deformed, splats: &splats, camera, time };
    let mut gradients = Gradients::default();
    assert!(chain_backward(&state, &g_splats, &g_features, &mut gradients));
    gradients
}

#[test]
fn a_step_that_is_not_finite_changes_nothing_and_is_counted() {
    let Some(gpu) = gpu() else { return };
    let mut backend = GpuBackend::new(gpu).unwrap();
    let mut step = all_steps().remove(1);
    step.latents[0] = f32::NAN;
    let mut model = step.model.clone();
    backend.trace(&mut model, step.plan.clone(), &step.context()).unwrap();
    let outcome = backend.finish(&mut model, &step.context()).unwrap();
    assert_eq!(outcome.dropped, 0, "was told before");
    assert_eq!(model, step.model);
    step.latents[0] = 0.5;
    // The table of features is uploaded with the model.
    let mut backend = GpuBackend::new(crate::fixture::gpu().unwrap()).unwrap();
    backend.trace(&mut model, step.plan.clone(), &step.context()).unwrap();
    backend.finish(&mut model, &step.context()).unwrap();
    assert!(model != step.model);
}

#[test]
#[should_panic(expected = "relative error")]
fn a_gradient_that_is_off_by_a_thousandth_is_noticed() {
    let right: Vec<f32> = (0..100).map(|i| (i as f32).sin()).collect();
    let wrong: Vec<f32> = right.iter().map(|v| v * 1.001).collect();
    close_as_a_whole("gradient", &wrong, &right, 1e-4);
}
