//! From a recording to a scene: initial Gaussians, losses, gradients, Adam, densify and prune.

mod adam;
mod chain;
mod checkpoint;
mod densify;
mod frames;
mod lift;
mod loss;
mod optimiser;
mod pass;
mod settings;
mod state;

pub use loss::{LossTerms, LossWeights, Truth, loss};
pub use pass::Pass;
pub use settings::{
    DensifySettings, FeatureMode, FrameOrder, LearningRates, LengthUnit, Profile, TrainSettings,
};

use crate::{
    Error, Result,
    camera::Camera,
    clock::PassClock,
    deform::{Deformed, deform, deform_by},
    files, metrics,
    prepare::Prepared,
    raster::{
        Images, Packed,
        backward::raster_backward_with,
        bin::{Bins, bin},
        forward::raster_into,
        project::{Sampling, Splat, SplatGradient, project_into},
        render_deformed,
    },
    scene::{Provenance, Scene},
    sequence::Sequence,
};
use chain::{FrameState, Gradients};
use densify::Statistics;
use frames::{Frame, FrameCache};
use loss::loss_into;
use rand::Rng;
use state::{State, spread, train_frames};
use std::{path::Path, sync::Arc};

/// Frames that [`Trainer::psnr_db`] looks at where none is held out.
const PSNR_FRAMES: usize = 8;

/// What one step did.
#[derive(Clone, Debug, serde::Serialize)]
pub struct StepReport {
    /// Steps done, this one included.
    pub step: usize,
    /// Total loss of the frame of this step.
    pub loss: f32,
    /// Its terms.
    pub terms: LossTerms<f32>,
    /// Gaussians now.
    pub gaussians: usize,
    /// Steps dropped so far because their loss or gradient was not finite.
    pub dropped: usize,
}

/// What the passes of a step write, kept from step to step: fresh memory costs more than the arithmetic on it.
#[derive(Debug, Default)]
struct Passes {
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

/// How a step looks at the scene.
struct Look {
    camera: Camera,
    time: f32,
    /// Whether the camera is one of half the size.
    half: bool,
    sampling: Sampling,
    /// Share of all steps done.
    progress: f32,
}

/// Training in progress; holds parameters, moments and the decoded frames.
pub struct Trainer {
    settings: TrainSettings,
    sequence: Sequence,
    prepared: Option<Prepared>,
    cache: FrameCache,
    state: State,
    started: std::time::Instant,
    passes: Passes,
    clock: PassClock<Pass>,
}

impl Trainer {
    /// Reads the recording and places the initial Gaussians. Features are trained if `prepared` is given
    /// (then `sequence` is `prepared.sequence`).
    pub fn new(sequence: &Sequence, prepared: Option<&Prepared>, settings: TrainSettings) -> Result<Self> {
        let mut settings = settings;
        settings.eval |= prepared.is_some_and(|p| p.eval);
        let sees_around = sequence.camera_moves() || settings.sh_when_still;
        settings.sh_degree = if sees_around { settings.sh_degree.min(3) } else { 0 };
        let state = State::new(sequence, prepared, &settings)?;
        Ok(Self::with_state(sequence, prepared, settings, state))
    }

    /// Goes on from a file that [`Trainer::save_checkpoint`] wrote, with its settings, to the same bytes as if there had
    /// been no stop.
    pub fn resume(sequence: &Sequence, prepared: Option<&Prepared>, path: &Path) -> Result<Self> {
        let (settings, state) = checkpoint::read(path, sequence, prepared)?;
        Ok(Self::with_state(sequence, prepared, settings, state))
    }

    /// Writes all that is needed to go on.
    pub fn save_checkpoint(&self, path: &Path) -> Result<()> {
        let mut state = self.state.clone();
        state.seconds = self.seconds();
        checkpoint::write(path, &self.sequence, self.prepared.as_ref(), &self.settings, state)
    }

    fn with_state(
        sequence: &Sequence,
        prepared: Option<&Prepared>,
        settings: TrainSettings,
        state: State,
    ) -> Self {
        Self {
            cache: FrameCache::new(sequence, settings.frame_cache_bytes),
            sequence: sequence.clone(),
            prepared: prepared.cloned(),
            settings,
            state,
            started: std::time::Instant::now(),
            passes: Passes::default(),
            clock: PassClock::default(),
        }
    }

    /// The settings, as far as the recording allows them.
    pub fn settings(&self) -> &TrainSettings {
        &self.settings
    }

    /// Seconds since training began, stops left out.
    pub fn seconds(&self) -> f64 {
        self.state.seconds + self.started.elapsed().as_secs_f64()
    }

    /// One optimiser step.
    pub fn step(&mut self) -> Result<StepReport> {
        if self.state.step == 0 && self.settings.feature_mode == FeatureMode::LiftedFirst {
            self.lift_features()?;
        }
        let i = self.next_frame();
        let look = self.next_look(i);
        let mut frame = self.cache.get(self.prepared.as_ref(), i, look.half)?;
        if look.sampling != Sampling::ALL {
            frame = Arc::new(frame.sampled(look.sampling));
        }
        let (terms, report) = self.learn(&frame, &look);
        self.state.step += 1;
        if !report {
            self.state.dropped += 1;
        }
        self.densify_if_due();
        if self.state.step == self.settings.iterations {
            self.complete_features()?;
        }
        Ok(StepReport {
            step: self.state.step,
            loss: terms.total(),
            terms,
            gaussians: self.state.gaussians.len(),
            dropped: self.state.dropped,
        })
    }

    /// The next look at frame `i`: of half size first, and at one pixel of each square of `pixel_step`², at random.
    fn next_look(&mut self, i: usize) -> Look {
        let mut camera = self.sequence.camera(i);
        let progress = self.state.step as f32 / self.settings.iterations.max(1) as f32;
        let half = progress < self.settings.half_size_share && camera.width > 1 && camera.height > 1;
        let mut sampling = Sampling { step: self.settings.pixel_step.max(1), ..Sampling::ALL };
        if half {
            camera = camera.resized(camera.width / 2, camera.height / 2);
            sampling.step = self.settings.half_size_pixel_step.max(1);
        }
        let pixels = (camera.width * camera.height) as usize;
        while sampling.step > 1 && pixels < self.settings.min_pixels * sampling.step.pow(2) {
            sampling.step -= 1;
        }
        if sampling.step > 1 {
            sampling.first = [0; 2].map(|_| self.state.rng.random_range(0..sampling.step));
        }
        Look { camera, time: self.sequence.time(i), half, sampling, progress }
    }

    /// Forward, backward and update on one frame; `false` if it was dropped because something was not finite.
    fn learn(&mut self, frame: &Frame, look: &Look) -> (LossTerms<f32>, bool) {
        self.clock.start();
        let bins = self.render_step(frame, look);
        let terms = self.compare(frame, look);
        let finite = terms.total().is_finite() && self.differentiate(&bins, look);
        if finite {
            self.update(look);
        }
        (terms, finite)
    }

    /// Deform, project, bin, raster.
    fn render_step(&mut self, frame: &Frame, look: &Look) -> Bins {
        let Passes { psi, deformed, splats, packed, images, .. } = &mut self.passes;
        let State { gaussians, deformation, .. } = &self.state;
        deformation.psi_into(gaussians.len(), look.time, psi);
        let learns_features = self.settings.feature_mode != FeatureMode::Lifted;
        deform_by(gaussians, deformation, psi, look.time, learns_features, deformed);
        self.clock.lap(Pass::Deform);
        project_into(gaussians, deformed, &look.camera, look.sampling, splats);
        let latent_dim = if learns_features { gaussians.latent_dim } else { 0 };
        packed.fill(splats, &deformed.features, latent_dim);
        self.clock.lap(Pass::Project);
        (images.width, images.height) = frame.size();
        let bins = bin(splats, images.width, images.height);
        self.clock.lap(Pass::Bin);
        raster_into(packed, &bins, images);
        self.clock.lap(Pass::Raster);
        bins
    }

    /// The loss, and its gradient with respect to the images.
    fn compare(&mut self, frame: &Frame, look: &Look) -> LossTerms<f32> {
        let latents = self.prepared.as_ref().map_or(&[][..], |p| &p.latents);
        let truth = frame.truth(latents, self.state.typical_depth);
        let weights = self.settings.loss.sampled(look.sampling.step);
        let Passes { images, g_planes, .. } = &mut self.passes;
        let terms = loss_into(&images.planes, &truth, &weights, g_planes);
        self.clock.lap(Pass::Loss);
        terms
    }

    /// From the images' gradient to that of all parameters; `false` if it is not finite.
    fn differentiate(&mut self, bins: &Bins, look: &Look) -> bool {
        let Passes {
            psi,
            deformed,
            splats,
            packed,
            images,
            g_planes,
            slots,
            g_splats,
            g_features,
            gradients,
        } = &mut self.passes;
        (*g_splats, *g_features) = raster_backward_with(splats, packed, bins, images, g_planes, slots);
        for g in g_splats.iter_mut() {
            look.sampling.apply_backward(g);
            if !self.settings.depth_moves_centres {
                g.depth = 0.0;
            }
        }
        self.clock.lap(Pass::Backward);
        let state = FrameState {
            gaussians: &self.state.gaussians,
            deformation: &self.state.deformation,
            psi,
            deformed,
            splats,
            camera: &look.camera,
            time: look.time,
        };
        let finite = chain::backward(&state, g_splats, g_features, gradients);
        self.clock.lap(Pass::Chain);
        finite
    }

    fn update(&mut self, look: &Look) {
        let world_per_px = self.world_per_px();
        let Passes { splats, g_splats, gradients, .. } = &mut self.passes;
        let pull_scale = if self.settings.densify.threshold > 0.0 {
            [0.5 * look.camera.width as f32, 0.5 * look.camera.height as f32]
        } else if look.half {
            [0.5; 2]
        } else {
            [1.0; 2]
        };
        self.state.statistics.add(splats, g_splats, pull_scale);
        if !(self.settings.densify.loses_step && self.settings.densifies_at(self.state.step + 1)) {
            let State { gaussians, deformation, optimiser, step, .. } = &mut self.state;
            hold_bands(gradients, &self.settings, gaussians.sh_bands(), *step);
            let rates = (look.time, look.progress, world_per_px);
            optimiser.step(gaussians, deformation, gradients, &self.settings, rates);
        }
        self.clock.lap(Pass::Adam);
    }

    /// Every frame once a round.
    fn next_frame(&mut self) -> usize {
        if self.state.queue.is_empty() {
            self.state.queue =
                train_frames(self.sequence.num_frames(), self.settings.eval, &self.settings.excluded);
            if self.settings.frame_order == FrameOrder::Cyclic {
                self.state.queue.reverse();
                return self.state.queue.pop().unwrap_or(0);
            }
            for k in (1..self.state.queue.len()).rev() {
                let j = self.state.rng.random_range(0..=k);
                self.state.queue.swap(k, j);
            }
        }
        self.state.queue.pop().unwrap_or(0)
    }

    fn densify_if_due(&mut self) {
        if !self.settings.densifies_at(self.state.step) {
            return;
        }
        let world_per_px = self.world_per_px();
        let change = densify::densify(
            &mut self.state.gaussians,
            &mut self.state.deformation,
            &self.state.statistics,
            &self.settings.densify,
            self.state.budget,
            world_per_px,
            &mut self.state.rng,
        );
        let (bands, dim) = (self.state.gaussians.sh_bands() * 3, self.state.gaussians.latent_dim);
        self.state.optimiser.rearrange(&change.moment_rows(), bands, dim, self.state.deformation.stride);
        self.state.statistics = Statistics::new(self.state.gaussians.len());
    }

    /// Length of a full-size pixel at the typical depth, scene units.
    fn world_per_px(&self) -> f32 {
        self.state.typical_depth / self.sequence.camera(0).fx
    }

    /// Where the time of the steps went.
    pub fn clock(&self) -> &PassClock<Pass> {
        &self.clock
    }

    /// Steps done.
    pub fn steps_done(&self) -> usize {
        self.state.step
    }

    /// The scene as it stands, ready to be saved or shown.
    pub fn scene(&self) -> Scene {
        let prepared = self.prepared.as_ref();
        Scene {
            gaussians: self.state.gaussians.clone(),
            deformation: self.state.deformation.clone(),
            cameras: (0..self.sequence.num_frames()).map(|i| self.sequence.camera(i)).collect(),
            field_of_view: self.sequence.field_of_view().clone(),
            codec: prepared.map(|p| p.codec.clone()),
            classes: prepared.map(|p| p.classes.clone()).unwrap_or_default(),
            encoder: prepared.map(|p| p.encoder.clone()),
            provenance: Provenance {
                made_by: format!("SurgTPGS {}", env!("CARGO_PKG_VERSION")),
                sequence_name: self.sequence.name(),
                sequence_path: files::full_path(self.sequence.path()),
                held_out: self.settings.eval,
                frames_per_second: self.sequence.frames_per_second(),
                steps: self.state.step,
                seconds: self.seconds(),
                settings: serde_json::to_value(&self.settings).unwrap_or_default(),
            },
        }
    }

    /// Renders frame `i` as the scene stands.
    pub fn render(&self, i: usize) -> Images {
        let time = self.sequence.time(i);
        let deformed = deform(&self.state.gaussians, &self.state.deformation, time, true);
        render_deformed(&self.state.gaussians, &deformed, &self.sequence.camera(i))
    }

    /// Mean PSNR in dB inside the supervision mask over the held-out frames, or over a few frames if none is held out.
    pub fn psnr_db(&mut self) -> Result<f64> {
        let n = self.sequence.num_frames();
        let held_out: Vec<usize> =
            (0..n).filter(|&i| self.settings.eval && Sequence::is_test_frame(i)).collect();
        let frames =
            if held_out.is_empty() { spread(&(0..n).collect::<Vec<_>>(), PSNR_FRAMES) } else { held_out };
        let mut values = Vec::new();
        for i in frames {
            let mask = self.sequence.mask(i)?;
            values.extend(metrics::psnr_db(&self.render(i).to_rgb(), &self.sequence.frame(i)?, Some(&mask)));
        }
        if values.is_empty() {
            return Err(Error::input(
                "no frame has supervised pixels",
                "Run `surgtpgs check` on the recording.",
            ));
        }
        Ok(values.iter().sum::<f64>() / values.len() as f64)
    }
}

/// Clears the gradients of colour bands that are not learned yet at `step`.
fn hold_bands(gradients: &mut Gradients, settings: &TrainSettings, bands: usize, step: usize) {
    if settings.sh_every == 0 || bands == 0 {
        return;
    }
    let degree = step / settings.sh_every;
    let learned = ((degree + 1) * (degree + 1) - 1).min(bands) * 3;
    for row in gradients.sh_rest.chunks_exact_mut(bands * 3) {
        row[learned..].fill(0.0);
    }
}

#[cfg(test)]
mod behaviour_tests;
#[cfg(test)]
mod tests;
