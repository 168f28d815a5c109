//! Training steps on the GPU; twin of [`surgtpgs_core::train::CpuBackend`]. From the Gaussians at rest to
//! their update everything stays on the device, with one submission per step:
//!
//! ```text
//! deform ─▶ project ─▶ bin, a slot for each pair ─▶ raster ─▶ loss, regions
//!                                                                 │
//! update ◀─ finish_step ◀─ chain, features, network ◀─ gather ◀─ backward into the slots
//! ```
//!
//! The host reads the results of the steps now and then. It then notices if pairs did not fit. In that
//! case the device has changed nothing since: the buffers grow and the steps are repeated. There are no
//! float atomics and all sums have a fixed order, so that two runs give the same bytes, whatever the room
//! for pairs was.

mod current;
mod densify;
mod frame;
mod resident;
mod status;
mod step;

use crate::{
    buffers::uniform,
    device::Gpu,
    planes::{BinPass, DeformPass, ProjectPass, RasterInput, RasterPass},
    rows::ViewParams,
    shader::Shader,
    timer::Timer,
};
use current::CurrentStep;
use densify::DensifyPass;
use frame::FrameStore;
use resident::{READ_EVERY, Resident};
use std::time::Duration;
use step::StepPasses;
use surgtpgs_core::{
    Error, Remedy, Result,
    clock::{PassClock, PassName},
    deform::{Deformation, GATE_CHANNEL},
    gaussian::Gaussians,
    raster::{
        Images,
        project::{Splat, SplatGradient},
    },
    train::{Context, Densify, Gradients, LossTerms, Model, Pass, StepOutcome, StepPlan, TrainBackend},
};

/// Shaders of training, besides those of the picture.
pub(crate) fn shaders() -> impl Iterator<Item = &'static Shader> {
    step::SHADERS.iter().chain([&densify::Wgsl::SHADER])
}

/// Carries out training steps on a GPU.
#[derive(Debug)]
pub struct GpuBackend {
    gpu: Gpu,
    deform: DeformPass,
    project: ProjectPass,
    bin: BinPass,
    raster: RasterPass,
    step: Option<StepPasses>,
    densify: Option<DensifyPass>,
    frames: FrameStore,
    resident: Option<Resident>,
    /// Steps submitted since the history was last read.
    pending: Vec<StepPlan>,
    timer: Timer,
}

/// Output of each pass of one step, in the form of its twin.
#[derive(Debug)]
pub struct StepTrace {
    /// Splats on the grid of the rendered pixels.
    pub splats: Vec<Splat<f32>>,
    /// Features at the time of the step, [N][D].
    pub features: Vec<f32>,
    /// Rendered images.
    pub images: Images,
    /// Terms of their loss.
    pub terms: LossTerms<f32>,
    /// ∂L/∂planes.
    pub g_planes: Vec<f32>,
    /// ∂L/∂splats, in pixels of the full grid.
    pub g_splats: Vec<SplatGradient<f32>>,
    /// ∂L/∂features at the time of the step.
    pub g_features: Vec<f32>,
    /// ∂L/∂parameters.
    pub gradients: Gradients,
}

impl GpuBackend {
    /// Compiles the passes that do not depend on the scene.
    pub fn new(gpu: Gpu) -> Result<Self> {
        gpu.guarded(|| {
            Ok(Self {
                deform: DeformPass::new(&gpu),
                project: ProjectPass::new(&gpu)?,
                bin: BinPass::new(&gpu)?,
                raster: RasterPass::new(&gpu),
                step: None,
                densify: None,
                frames: FrameStore::default(),
                resident: None,
                pending: Vec::new(),
                timer: Timer::default(),
                gpu: gpu.clone(),
            })
        })
    }

    /// Sets the initial room to `capacity` splat-tile pairs. It grows as needed, at the cost of repeated
    /// steps.
    pub fn set_pair_capacity(&mut self, capacity: usize) -> Result<()> {
        self.bin.set_capacity(&self.gpu, capacity)
    }

    /// Switches on the timing of every pass by the device's own clock, which waits for each step. Returns
    /// `false` if the adapter cannot time.
    pub fn time_passes(&mut self) -> bool {
        self.timer.switch_on(&self.gpu)
    }

    fn add_pass_costs(&self, clock: &mut PassClock<Pass>) -> Result<()> {
        for (pass, cost) in Pass::ALL.iter().zip(self.timer.read(&self.gpu)?) {
            clock.add(*pass, Duration::from_secs_f64(cost.ms * 1e-3), cost.bytes);
        }
        Ok(())
    }

    /// Takes one step and reads back the output of each pass.
    pub fn trace(&mut self, model: &mut Model, plan: StepPlan, context: &Context<'_>) -> Result<StepTrace> {
        let size = plan.view.sampling.size(plan.frame.size().0, plan.frame.size().1);
        let now = self.step(model, plan, context, &mut PassClock::default())?;
        let gpu = self.gpu.clone();
        let later = gpu.guarded(|| self.read_history(model, context))?;
        let Some(step) = &self.step else {
            return Err(Error::input("no step was done", "Do one first."));
        };
        gpu.guarded(|| {
            let n = self.num_gaussians(model);
            let (dim, stride) = (step.latent_dim, model.deformation.stride);
            let rest = step.chain.g_rest.read(&gpu, n)?;
            let gate = step.chain.g_gate.read(&gpu, n * dim)?;
            let mut psi = vec![0.0; n * stride];
            for (i, (row, psi)) in rest.iter().zip(psi.chunks_exact_mut(stride)).enumerate() {
                let at_rest = [&row.mean[..], &row.rotation, &row.log_scale, &row.colour].concat();
                psi[..GATE_CHANNEL].copy_from_slice(&at_rest);
                psi[GATE_CHANNEL..GATE_CHANNEL + dim].copy_from_slice(&gate[i * dim..(i + 1) * dim]);
            }
            let rows = step.backward.g_splats.read(&gpu, n)?;
            Ok(StepTrace {
                splats: self.project.splats.read(&gpu, n)?.into_iter().map(Splat::from).collect(),
                features: self.deform.features.read(&gpu, n * dim)?,
                images: Images {
                    width: size.0,
                    height: size.1,
                    planes: self.raster.planes.read(&gpu, usize::MAX)?,
                },
                terms: later.terms.or(now.terms).unwrap_or_default(),
                g_planes: step.loss.g_planes.read(&gpu, usize::MAX)?,
                g_splats: rows.iter().map(SplatGradient::from).collect(),
                g_features: step.backward.g_features.read(&gpu, n * dim)?,
                gradients: Gradients {
                    psi,
                    opacity_logits: rest.iter().map(|r| r.opacity_logit).collect(),
                    sh_rest: step.chain.g_sh_rest.read(&gpu, model.gaussians.sh_rest.len())?,
                    features: step.chain.g_features.read(&gpu, n * dim)?,
                    net: step.chain.g_network.read(&gpu, dim * (dim + 1) + dim)?,
                    camera: later.cameras.last().or(now.cameras.last()).map(|c| c.1).unwrap_or_default(),
                },
            })
        })
    }

    /// Uploads the model if the device does not have it.
    fn load(&mut self, model: &Model, context: &Context<'_>) -> Result<()> {
        let Self { gpu, deform, project, step, resident, .. } = self;
        let latent_dim = context.learned_latents(&model.gaussians);
        if step.as_ref().is_none_or(|s| s.latent_dim != latent_dim) {
            *step = Some(StepPasses::new(gpu, latent_dim, context.latents)?);
        }
        if resident.is_none() {
            let n = model.gaussians.len();
            deform.prepare(gpu, &model.deformation, n, 0.0, latent_dim)?;
            project.prepare(gpu, n)?;
            *resident = Some(Resident::new(gpu, model, context.settings.iterations)?);
        }
        Ok(())
    }

    /// Submits one step.
    fn submit(&mut self, model: &Model, plan: &StepPlan, context: &Context<'_>) -> Result<()> {
        self.load(model, context)?;
        let Self { gpu, deform, project, bin, raster, step, frames, resident, timer, .. } = self;
        let (Some(step), Some(resident)) = (step, resident) else { return Ok(()) };
        let Model { gaussians, deformation, .. } = model;
        let (n, dim, time) = (resident.num_gaussians, step.latent_dim, plan.view.time);
        let view = ViewParams::new(&plan.view.camera, gaussians, bin.capacity()).sampled(plan.view.sampling);
        let view = ViewParams { num_gaussians: n as u32, ..view };
        let view_buffer = &uniform(gpu, &view);
        let frame = frames.get(gpu, plan, context, dim)?;
        deform.set_time(gpu, deformation, time);
        bin.prepare(gpu, &view)?;
        raster.prepare(gpu, &view, dim)?;
        resident.is_known = false;

        let mut commands = gpu.device().create_command_encoder(&Default::default());
        let encoder = &mut commands;
        timer.start();
        deform.encode(gpu, &mut timer.begin(encoder, "deform"), &resident.scene, deformation, time, dim);
        let sh_rest = &resident.scene.sh_rest;
        project.encode(gpu, &mut timer.begin(encoder, "project"), view_buffer, &deform.rows, sh_rest, n);
        bin.encode_with_slots(gpu, &mut timer.begin(encoder, "bin"), view_buffer, &view, &project.splats)?;
        let input = RasterInput {
            splats: &project.splats,
            features: &deform.features,
            pairs: &bin.pair_gaussians,
            ranges: &bin.ranges,
        };
        raster.encode(gpu, &mut timer.begin(encoder, "raster"), view_buffer, &view, &input, dim);
        let now = CurrentStep {
            gpu,
            view: &view,
            view_buffer,
            plan,
            context,
            deformation,
            deform,
            splats: &project.splats,
            bin,
            raster,
            frame,
            resident,
        };
        step.encode(&now, encoder, timer)?;
        timer.finish(encoder);
        gpu.submit(commands);
        Ok(())
    }

    /// Reads the results of the submitted steps and repeats those whose pairs did not fit.
    fn read_history(&mut self, model: &Model, context: &Context<'_>) -> Result<StepOutcome> {
        let mut outcome = StepOutcome::default();
        while let Some(resident) = self.resident.as_ref().filter(|_| !self.pending.is_empty()) {
            let mut state = resident.status.read(&self.gpu, status::COUNT_REST as usize)?;
            let done = state[status::DONE as usize] as usize;
            if done < self.pending.len() && state[status::OVERFLOWN as usize] == 0 {
                // An error that the driver reported meanwhile says more.
                return Err(Error::input("the GPU left out steps of the training", Remedy::UseCpu));
            }
            let history = resident.history.read(&self.gpu, done)?;
            outcome.dropped += history.iter().filter(|s| s.is_dropped != 0).count();
            outcome.terms = history.last().map(LossTerms::from).or(outcome.terms);
            let wanted = std::mem::take(&mut state[status::WANTED as usize]);
            state[status::DONE as usize] = 0;
            state[status::OVERFLOWN as usize] = 0;
            resident.status.write_at(&self.gpu, 0, &state);
            // Makes room before it is needed: a scene grows slowly.
            self.bin.grow_if_full(&self.gpu, wanted.saturating_add(wanted / 8))?;
            let left = self.pending.split_off(done);
            let visited = self.pending.iter().zip(&history);
            outcome.cameras.extend(visited.filter_map(|(plan, result)| Some((plan.index, result.camera()?))));
            self.pending = left.clone();
            for plan in &left {
                self.submit(model, plan, context)?;
            }
        }
        Ok(outcome)
    }
}

impl TrainBackend for GpuBackend {
    fn name(&self) -> String {
        self.gpu.name()
    }

    /// Takes one step; passes are timed only if [`GpuBackend::time_passes`] was called.
    fn step(
        &mut self,
        model: &mut Model,
        plan: StepPlan,
        context: &Context<'_>,
        clock: &mut PassClock<Pass>,
    ) -> Result<StepOutcome> {
        let gpu = self.gpu.clone();
        let is_first = self.resident.is_none();
        gpu.guarded(|| {
            self.submit(model, &plan, context)?;
            self.pending.push(plan);
            if self.timer.is_on() {
                self.add_pass_costs(clock)?;
            }
            // The first step shows how much room is needed.
            let looks = is_first || self.pending.len() >= READ_EVERY;
            if looks { self.read_history(model, context) } else { Ok(StepOutcome::default()) }
        })
    }

    fn densify(&mut self, model: &mut Model, how: &Densify, context: &Context<'_>) -> Result<StepOutcome> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| {
            let outcome = self.read_history(model, context)?;
            self.load(model, context)?;
            if self.densify.is_none() {
                self.densify = Some(DensifyPass::new(&gpu)?);
            }
            let Self { densify: Some(pass), resident: Some(resident), deform, project, .. } = self else {
                return Ok(outcome);
            };
            pass.run(&gpu, resident, model, how)?;
            deform.make_room(&gpu, resident.num_gaussians, context.learned_latents(&model.gaussians))?;
            project.prepare(&gpu, resident.num_gaussians)?;
            Ok(outcome)
        })
    }

    fn num_gaussians(&self, model: &Model) -> usize {
        self.resident.as_ref().map_or(model.gaussians.len(), |resident| resident.num_gaussians)
    }

    fn synchronise(&mut self, model: &mut Model, context: &Context<'_>) -> Result<StepOutcome> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| self.read_history(model, context))
    }

    fn finish(&mut self, model: &mut Model, context: &Context<'_>) -> Result<StepOutcome> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| {
            let outcome = self.read_history(model, context)?;
            if let Some(resident) = self.resident.as_mut().filter(|r| !r.is_known) {
                let network = self.deform.read_network(&gpu, &model.deformation)?;
                resident.read_into(&gpu, model, &network)?;
                resident.is_known = true;
            }
            Ok(outcome)
        })
    }

    fn shown(
        &mut self,
        model: &mut Model,
        context: &Context<'_>,
    ) -> Result<(StepOutcome, Gaussians, Deformation)> {
        let gpu = self.gpu.clone();
        gpu.guarded(|| {
            let outcome = self.read_history(model, context)?;
            let (mut gaussians, mut deformation) = (model.gaussians.clone(), model.deformation.clone());
            if let Some(resident) = self.resident.as_ref().filter(|r| !r.is_known) {
                let network = self.deform.read_network(&gpu, &deformation)?;
                resident.read_shown(&gpu, &mut gaussians, &mut deformation, &network)?;
            }
            Ok((outcome, gaussians, deformation))
        })
    }

    fn invalidate(&mut self) {
        self.resident = None;
        self.pending.clear();
    }
}
