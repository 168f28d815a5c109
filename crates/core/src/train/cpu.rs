//! A training step on the CPU.

use super::{
    Context, LossTerms, Model, StepOutcome, StepPlan, StepView, TrainBackend,
    chain::{self, FrameState, Gradients},
    densify::{Densify, densify},
    frames::TrainFrame,
    loss::loss_into,
    pass::Pass,
    settings::TrainSettings,
};
use crate::{
    Result,
    clock::PassClock,
    deform::{Deformed, deform_by},
    raster::{
        Images, Packed,
        backward::raster_backward_with,
        bin::{Bins, bin},
        forward::raster_into,
        project::{Sampling, Splat, SplatGradient, project_into},
    },
};

/// The passes of a step on the CPU. Their outputs are kept from step to step: fresh memory costs more
/// than the arithmetic on it.
#[derive(Debug, Default)]
pub struct CpuBackend {
    psi: Vec<f32>,
    deformed: Deformed,
    splats: Vec<Splat<f32>>,
    packed: Packed,
    images: Images,
    g_planes: Vec<f32>,
    slots: Vec<f32>,
    g_splats: Vec<SplatGradient<f32>>,
    g_features: Vec<f32>,
    gradients: Gradients,
}

impl TrainBackend for CpuBackend {
    fn name(&self) -> String {
        format!("CPU, {} threads", rayon::current_num_threads())
    }

    fn step(
        &mut self,
        model: &mut Model,
        plan: StepPlan,
        context: &Context<'_>,
        clock: &mut PassClock<Pass>,
    ) -> Result<StepOutcome> {
        let StepPlan { index, view, step, updates, .. } = &plan;
        let sampled;
        let frame = if view.sampling == Sampling::ALL {
            &*plan.frame
        } else {
            sampled = plan.frame.sampled(view.sampling);
            &sampled
        };
        clock.start();
        let bins = self.render(model, frame, view, context, clock);
        let terms = self.compare(frame, view, context, clock);
        let finite = terms.total().is_finite() && self.differentiate(model, &bins, view, context, clock);
        if finite {
            model.statistics.add(&self.splats, &self.g_splats, context.pull_scale(view));
            if *updates {
                self.update(model, view, *step, context);
            }
            clock.lap(Pass::Adam);
        }
        let cameras = if finite { vec![(*index, self.gradients.camera)] } else { Vec::new() };
        Ok(StepOutcome { terms: Some(terms), dropped: usize::from(!finite), cameras })
    }

    fn densify(&mut self, model: &mut Model, how: &Densify, _: &Context<'_>) -> Result<StepOutcome> {
        densify(model, how);
        Ok(StepOutcome::default())
    }
}

impl CpuBackend {
    /// Runs deform, project, bin and raster.
    fn render(
        &mut self,
        model: &Model,
        frame: &TrainFrame,
        view: &StepView,
        context: &Context<'_>,
        clock: &mut PassClock<Pass>,
    ) -> Bins {
        let Self { psi, deformed, splats, packed, images, .. } = self;
        let Model { gaussians, deformation, .. } = model;
        deformation.psi_into(gaussians.len(), view.time, psi);
        let latent_dim = context.learned_latents(gaussians);
        deform_by(gaussians, deformation, psi, view.time, latent_dim > 0, deformed);
        clock.lap(Pass::Deform);
        project_into(gaussians, deformed, &view.camera, view.sampling, splats);
        packed.fill(splats, &deformed.features, latent_dim);
        clock.lap(Pass::Project);
        (images.width, images.height) = frame.size();
        let bins = bin(splats, images.width, images.height);
        clock.lap(Pass::Bin);
        raster_into(packed, &bins, images);
        clock.lap(Pass::Raster);
        bins
    }

    /// Computes the loss and its gradient with respect to the images.
    fn compare(
        &mut self,
        frame: &TrainFrame,
        view: &StepView,
        context: &Context<'_>,
        clock: &mut PassClock<Pass>,
    ) -> LossTerms<f32> {
        let truth = frame.truth(context.latents, context.typical_depth);
        let weights = context.loss_weights(view);
        let terms = loss_into(&self.images.planes, &truth, &weights, &mut self.g_planes);
        clock.lap(Pass::Loss);
        terms
    }

    /// Computes the gradient of all parameters from that of the images; returns `false` if it is not finite.
    fn differentiate(
        &mut self,
        model: &Model,
        bins: &Bins,
        view: &StepView,
        context: &Context<'_>,
        clock: &mut PassClock<Pass>,
    ) -> bool {
        let Self { psi, deformed, splats, packed, images, g_planes, slots, g_splats, g_features, gradients } =
            self;
        (*g_splats, *g_features) = raster_backward_with(splats, packed, bins, images, g_planes, slots);
        for g in g_splats.iter_mut() {
            view.sampling.apply_backward(g);
            if !context.settings.depth_moves_centres {
                g.depth = 0.0;
            }
        }
        clock.lap(Pass::Backward);
        let state = FrameState {
            gaussians: &model.gaussians,
            deformation: &model.deformation,
            psi,
            deformed,
            splats,
            camera: &view.camera,
            time: view.time,
        };
        let finite = chain::backward(&state, g_splats, g_features, gradients);
        clock.lap(Pass::Chain);
        finite
    }

    fn update(&mut self, model: &mut Model, view: &StepView, step: usize, context: &Context<'_>) {
        let Model { gaussians, deformation, optimiser, .. } = model;
        hold_bands(&mut self.gradients, context.settings, gaussians.sh_bands(), step);
        let rates = (view.time, view.progress, context.world_per_px);
        optimiser.step(gaussians, deformation, &mut self.gradients, context.settings, rates);
    }
}

/// Clears the gradients of colour bands that are not learned yet at `step`.
fn hold_bands(gradients: &mut Gradients, settings: &TrainSettings, bands: usize, step: usize) {
    let learned = settings.learned_bands(bands, step);
    if learned < bands {
        for row in gradients.sh_rest.chunks_exact_mut(bands * 3) {
            row[learned * 3..].fill(0.0);
        }
    }
}
