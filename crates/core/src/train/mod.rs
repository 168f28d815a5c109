//! From a recording to a scene: initial Gaussians, losses, gradients, Adam, densify and prune.

mod adam;
mod backend;
mod chain;
mod chapters;
mod checkpoint;
mod cpu;
mod densify;
mod fit_camera;
mod frame_cache;
mod frames;
mod guess;
mod lift;
mod loss;
mod model;
mod optimiser;
mod pass;
mod poses;
mod quality;
mod random;
mod refit;
mod seams;
mod seeds;
mod settings;
mod state;

pub use adam::{Adam, BETA1, BETA2, EPSILON, WIDTH, bias_corrections};
pub use backend::{Context, StepOutcome, StepPlan, StepView, TrainBackend};
pub use chain::{FrameState, Gradients, backward as chain_backward};
pub use chapters::Plan;
pub use checkpoint::{is_checkpoint, supervision_digest};
pub use cpu::CpuBackend;
pub use densify::{CLONE_DISTANCE, Densify, LN_SPLIT, SPLIT_DISTANCE, densify};
pub use fit_camera::fit_camera;
pub use frames::TrainFrame;
pub use loss::{
    LossTerms, LossWeights, MIN_LOSS_ALPHA, MIN_LOSS_DEPTH, NUM_TERMS, Scales, TermScales, Truth, loss,
};
pub use model::{Model, Statistics};
pub use optimiser::{OPACITY_CHANNEL, Optimiser, Rates};
pub use pass::Pass;
pub use quality::Quality;
pub use refit::{REFIT_FRAME_BYTES, REFIT_STEPS, refit};
pub use seams::seam;
pub use settings::{
    DensifySettings, FeatureMode, FrameOrder, LearningRates, LengthUnit, Profile, TrainSettings,
};

use crate::{
    Kept, Result,
    clock::PassClock,
    deform::deform,
    files, metrics, num,
    poses::ScopeVerdict,
    prepare::Prepared,
    progress::{Observer, unobserved},
    raster::{Images, project::Sampling, render_deformed, render_frame},
    scene::{Chapter, Chapters, Provenance, Scene},
    sequence::{Identity, Sequence},
};
use frame_cache::FrameCache;
use rand::Rng;
use seeds::spread;
use state::TrainState;
use std::{path::Path, sync::Arc};

/// Number of frames that [`Trainer::psnr_db`] uses if none is held out.
const PSNR_FRAMES: usize = 8;

/// Identity of the recording. Reads all of it; fails if it differs from the recording that was prepared.
fn identity(sequence: &Sequence, prepared: Option<&Prepared>) -> Result<Arc<Identity>> {
    prepared.map_or(Ok(()), Prepared::require_recording)?;
    sequence.identity()
}

/// Report of one step.
#[derive(Clone, Debug, serde::Serialize)]
pub struct StepReport {
    /// Number of steps done, this one included.
    pub step: usize,
    /// Total loss of this step's frame.
    pub loss: f32,
    /// Terms of the loss.
    pub terms: LossTerms<f32>,
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Number of steps dropped so far because their loss or gradient was not finite.
    pub dropped: usize,
}

/// Training in progress; holds parameters, moments and the decoded frames.
pub struct Trainer {
    settings: TrainSettings,
    /// The same, as far as the recording allows them.
    applied: TrainSettings,
    sequence: Sequence,
    prepared: Option<Prepared>,
    identity: Arc<Identity>,
    /// Hash of what is learned from besides the pictures.
    supervision: String,
    cache: FrameCache,
    state: TrainState,
    started: std::time::Instant,
    backend: Box<dyn TrainBackend>,
    terms: LossTerms<f32>,
    clock: PassClock<Pass>,
}

impl Trainer {
    /// Reads the recording and places the initial Gaussians. Features are trained if `prepared` is given
    /// (then `sequence` is `prepared.sequence`).
    pub fn new(sequence: &Sequence, prepared: Option<&Prepared>, settings: TrainSettings) -> Result<Self> {
        let mut plan = Plan::whole(sequence, prepared, &settings, &mut unobserved)?;
        Self::planned(sequence, prepared, settings, &mut plan, None, &mut unobserved)
    }

    /// Reads one of the plan's chapters, or a recording that has none, as [`Trainer::new`] does. Frames have the
    /// plan's times. The plan keeps the lens of the chapter's shot. The observer hears of the search for that,
    /// and for the path of a moving scope.
    pub fn planned(
        sequence: &Sequence,
        prepared: Option<&Prepared>,
        mut settings: TrainSettings,
        plan: &mut Plan,
        chapter: Option<&Chapter>,
        observer: &mut Observer<'_>,
    ) -> Result<Self> {
        settings.chapter = chapter.cloned();
        settings.eval |= prepared.is_some_and(|p| p.eval);
        let identity = identity(sequence, prepared)?;
        let mut sequence = sequence.clone();
        if let Some(chapter) = chapter
            && let Some(zoom) = plan.zoom(&sequence, &settings, chapter, observer)?
        {
            sequence = sequence.with_zoom(zoom);
        }
        let state = TrainState::new(&sequence, prepared, &settings, plan.times.clone(), observer)?;
        Ok(Self::with_state(&sequence, prepared, settings, state, identity))
    }

    /// Resumes from a file that [`Trainer::save_checkpoint`] wrote, with its settings. The result has the
    /// same bytes as without the interruption.
    pub fn resume(sequence: &Sequence, prepared: Option<&Prepared>, path: &Path) -> Result<Self> {
        Self::resume_if_usable(sequence, prepared, path)?.usable()
    }

    /// Does the same as [`Trainer::resume`]; one that is damaged, or of another version, is no failure.
    pub fn resume_if_usable(
        sequence: &Sequence,
        prepared: Option<&Prepared>,
        path: &Path,
    ) -> Result<Kept<Self>> {
        let identity = identity(sequence, prepared)?;
        let read = checkpoint::read(path, sequence, prepared, &identity)?;
        Ok(read.map(|(settings, state)| Self::with_state(sequence, prepared, settings, state, identity)))
    }

    /// Writes everything that is needed to resume.
    pub fn save_checkpoint(&mut self, path: &Path) -> Result<()> {
        self.finish()?;
        self.state.seconds = self.seconds();
        self.started = std::time::Instant::now();
        let identity = &self.identity;
        checkpoint::write(path, (&self.sequence, &self.supervision), identity, &self.settings, &self.state)
    }

    fn with_state(
        sequence: &Sequence,
        prepared: Option<&Prepared>,
        settings: TrainSettings,
        state: TrainState,
        identity: Arc<Identity>,
    ) -> Self {
        let applied = settings.applied(sequence, prepared, !state.poses.is_empty());
        let guesses = if applied.guesses_held_out {
            let seen = applied.frames(sequence.num_frames());
            let mut held_out = applied.frames_and_held_out(sequence.num_frames());
            held_out.retain(|i| seen.binary_search(i).is_err());
            guess::guesses(&held_out, &seen, |i| state.time(sequence, i))
        } else {
            Vec::new()
        };
        Self {
            identity,
            supervision: supervision_digest(sequence, prepared),
            cache: FrameCache::new(sequence, guesses, applied.frame_cache_bytes),
            sequence: state.posed(sequence),
            prepared: prepared.cloned(),
            settings,
            applied,
            state,
            started: std::time::Instant::now(),
            backend: Box::new(CpuBackend::default()),
            terms: LossTerms::default(),
            clock: PassClock::default(),
        }
    }

    /// Settings as they were asked for. What the recording, or the chapter, made of them does not count.
    pub fn settings(&self) -> &TrainSettings {
        &self.settings
    }

    /// Seconds of training since it began, without interruptions.
    pub fn seconds(&self) -> f64 {
        self.state.seconds + self.started.elapsed().as_secs_f64()
    }

    /// Trains on another backend from the next step on; the first one is the CPU.
    pub fn set_backend(&mut self, backend: Box<dyn TrainBackend>) -> Result<()> {
        self.finish()?;
        self.backend = backend;
        Ok(())
    }

    /// Name of the backend that trains.
    pub fn backend_name(&self) -> String {
        self.backend.name()
    }

    /// Takes one optimiser step.
    pub fn step(&mut self) -> Result<StepReport> {
        if self.state.step == 0 && self.applied.feature_mode == FeatureMode::LiftedFirst {
            self.lift_features()?;
        }
        let plan = self.next_plan()?;
        let context = context(&self.applied, self.prepared.as_ref(), &self.sequence, &self.state);
        let outcome = self.backend.step(&mut self.state.model, plan, &context, &mut self.clock)?;
        self.state.step += 1;
        self.take_in(outcome);
        self.densify_if_due()?;
        if self.state.step == self.applied.iterations {
            self.complete_features()?;
        }
        Ok(StepReport {
            step: self.state.step,
            loss: self.terms.total(),
            terms: self.terms,
            gaussians: self.backend.num_gaussians(&self.state.model),
            dropped: self.state.dropped,
        })
    }

    /// Plans the next step: the frame and its pixels.
    fn next_plan(&mut self) -> Result<StepPlan> {
        let moves_cameras = self.state.queue.is_empty() && self.learns_poses();
        if moves_cameras {
            self.synchronise()?;
        }
        let before = (self.state.queue.clone(), self.state.rng.clone());
        let poses_before = moves_cameras.then(|| (self.state.poses.clone(), self.sequence.clone()));
        if moves_cameras {
            self.update_poses();
        }
        let index = self.next_frame();
        let view = self.next_view(index);
        let frame = self.cache.get(self.prepared.as_ref(), index, view.half).inspect_err(|_| {
            // The step was not begun and can be repeated once the frame can be read.
            (self.state.queue, self.state.rng) = before;
            if let Some(poses) = poses_before {
                (self.state.poses, self.sequence) = poses;
            }
        })?;
        let loses_step = self.applied.densify.loses_step;
        let updates = !(loses_step && self.applied.densifies_at(self.state.step + 1));
        Ok(StepPlan { index, frame, view, step: self.state.step, updates })
    }

    /// Waits for the results of the steps that were taken.
    fn synchronise(&mut self) -> Result<()> {
        let context = context(&self.applied, self.prepared.as_ref(), &self.sequence, &self.state);
        let outcome = self.backend.synchronise(&mut self.state.model, &context)?;
        self.take_in(outcome);
        Ok(())
    }

    /// Waits for the backend and brings the model up to date with its results.
    pub fn finish(&mut self) -> Result<()> {
        let context = context(&self.applied, self.prepared.as_ref(), &self.sequence, &self.state);
        let outcome = self.backend.finish(&mut self.state.model, &context)?;
        self.take_in(outcome);
        Ok(())
    }

    fn take_in(&mut self, outcome: StepOutcome) {
        self.state.dropped += outcome.dropped;
        self.state.poses.gather(&outcome.cameras);
        self.terms = outcome.terms.unwrap_or(self.terms);
    }

    /// Returns `true` if the cameras move after each round.
    fn learns_poses(&self) -> bool {
        !self.state.poses.is_empty() && self.applied.rates.pose > 0.0 && self.state.step > 0
    }

    /// Moves the cameras by what was learned in a whole round, all of whose results are there.
    fn update_poses(&mut self) {
        let progress = self.progress();
        let context = context(&self.applied, self.prepared.as_ref(), &self.sequence, &self.state);
        let rates =
            poses::rates(&self.applied.rates, progress, &self.sequence.camera(0), context.world_per_px);
        let num_frames = self.sequence.num_frames();
        let times: Vec<f32> = (0..num_frames).map(|i| self.time(i)).collect();
        self.state.poses.update(&self.applied.frames(num_frames), &times, rates);
        self.sequence = self.state.posed(&self.sequence);
    }

    /// Share of the steps that are done.
    fn progress(&self) -> f32 {
        self.state.step as f32 / self.applied.iterations.max(1) as f32
    }

    /// Takes `steps` steps on `backend` and undoes them. Returns their duration in seconds, and the loss of the
    /// last. They are steps of the last quarter of the training, where most time is spent, and are taken twice:
    /// the first time everything that they need is decoded, compiled and uploaded.
    pub fn try_out(&mut self, backend: Box<dyn TrainBackend>, steps: usize) -> Result<(f64, LossTerms<f32>)> {
        self.finish()?;
        let (before, terms) = (self.state.clone(), self.terms);
        let own = std::mem::replace(&mut self.backend, backend);
        let most = self.applied.iterations.saturating_sub(steps + 1);
        self.state.step = self.state.step.max((self.applied.iterations / 4 * 3).min(most));
        let tried = (|| {
            let (first, queue, rng) = (self.state.step, self.state.queue.clone(), self.state.rng.clone());
            (0..steps).try_for_each(|_| self.step().map(drop))?;
            self.synchronise()?;
            (self.state.step, self.state.queue, self.state.rng) = (first, queue, rng);
            let started = std::time::Instant::now();
            (0..steps).try_for_each(|_| self.step().map(drop))?;
            self.synchronise()?;
            Ok((started.elapsed().as_secs_f64(), self.terms))
        })();
        self.backend = own;
        (self.state, self.terms) = (before, terms);
        self.sequence = self.state.posed(&self.sequence);
        self.backend.invalidate();
        tried
    }

    /// Next view of frame `i`: at half size first, and of one pixel, at random, in each square of
    /// `pixel_step`².
    fn next_view(&mut self, i: usize) -> StepView {
        let mut camera = self.sequence.camera(i);
        let progress = self.progress();
        let half = progress < self.applied.half_size_share && camera.width > 1 && camera.height > 1;
        let mut sampling = Sampling { step: self.applied.pixel_step.max(1), ..Sampling::ALL };
        if half {
            camera = camera.halved();
            sampling.step = self.applied.half_size_pixel_step.max(1);
        }
        let pixels = (camera.width * camera.height) as usize;
        while sampling.step > 1 && pixels < self.applied.min_pixels * sampling.step.pow(2) {
            sampling.step -= 1;
        }
        if sampling.step > 1 {
            sampling.first = [0; 2].map(|_| self.state.rng.random_range(0..sampling.step));
        }
        StepView { camera, time: self.time(i), half, sampling, progress }
    }

    /// Time of frame `i`.
    fn time(&self, i: usize) -> f32 {
        self.state.time(&self.sequence, i)
    }

    /// Next frame; every frame comes once a round.
    fn next_frame(&mut self) -> usize {
        if self.state.queue.is_empty() {
            self.state.queue = self.applied.frames(self.sequence.num_frames());
            self.state.queue.extend(self.cache.guessed());
            if self.applied.frame_order == FrameOrder::Cyclic {
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

    fn densify_if_due(&mut self) -> Result<()> {
        let is_last = self.state.step == self.applied.iterations;
        if is_last || !self.applied.densifies_at(self.state.step) {
            return Ok(());
        }
        let context = context(&self.applied, self.prepared.as_ref(), &self.sequence, &self.state);
        let how = Densify::new(&self.applied, self.state.budget, context.world_per_px, self.state.step);
        let outcome = self.backend.densify(&mut self.state.model, &how, &context)?;
        self.take_in(outcome);
        Ok(())
    }

    /// Durations of the passes of all steps.
    pub fn clock(&self) -> &PassClock<Pass> {
        &self.clock
    }

    /// Number of steps known to be dropped so far because something was not finite.
    pub fn dropped(&self) -> usize {
        self.state.dropped
    }

    /// Judgement on the recording's camera; still too if its poses are known.
    pub fn scope(&self) -> &ScopeVerdict {
        &self.state.scope
    }

    /// Number of steps done.
    pub fn steps_done(&self) -> usize {
        self.state.step
    }

    /// Scene in its current state, ready to be saved or shown.
    pub fn scene(&mut self) -> Result<Scene> {
        let context = context(&self.applied, self.prepared.as_ref(), &self.sequence, &self.state);
        let (outcome, gaussians, deformation) = self.backend.shown(&mut self.state.model, &context)?;
        self.take_in(outcome);
        let prepared = self.prepared.as_ref();
        Ok(Scene {
            gaussians: gaussians.into(),
            deformation: deformation.into(),
            chapters: Chapters::default(),
            cameras: (0..self.sequence.num_frames()).map(|i| self.sequence.camera(i)).collect(),
            times: self.state.times.clone(),
            field_of_view: self.sequence.field_of_view().clone(),
            codec: prepared.map(|p| p.codec.clone()),
            classes: prepared.map(|p| p.classes.clone()).unwrap_or_default(),
            encoder: prepared.map(|p| p.encoder.clone()),
            words: prepared.map(|p| p.words.clone()).unwrap_or_default(),
            provenance: Provenance {
                made_by: format!("SurgTPGS {}", env!("CARGO_PKG_VERSION")),
                sequence_name: self.sequence.name(),
                sequence_path: files::located_path(self.sequence.path()),
                identity: Some(self.identity.clone()),
                supervision: Some(self.supervision.clone()),
                depth: Some(self.sequence.depth_origin()),
                path_depths: self.state.path_depths.clone(),
                held_out: self.applied.eval && (0..self.sequence.num_frames()).any(Sequence::is_test_frame),
                frames_per_second: self.sequence.frames_per_second(),
                frame_seconds: self.sequence.frame_seconds().to_vec(),
                steps: self.state.step,
                settings: serde_json::to_value(&self.settings).unwrap_or_default(),
            },
        })
    }

    /// Renders frame `i` of the scene in its current state.
    pub fn render(&mut self, i: usize) -> Result<Images> {
        self.finish()?;
        let (time, camera) = (self.time(i), self.sequence.camera(i));
        let Model { gaussians, deformation, .. } = &self.state.model;
        Ok(render_deformed(gaussians, &deform(gaussians, deformation, time, true), &camera))
    }

    /// Mean PSNR in dB inside the supervision mask over the held-out frames, or over a few frames if none
    /// is held out; `None` if their masks hide everything.
    pub fn psnr_db(&mut self) -> Result<Option<f64>> {
        let frames = psnr_frames(self.applied.shown(self.sequence.num_frames()).collect(), self.applied.eval);
        let sequence = self.sequence.clone();
        mean_psnr_db(&sequence, &frames, |i| self.render(i))
    }
}

/// Returns the mean PSNR in dB of a scene in chapters, of frames as in [`Trainer::psnr_db`].
///
/// # Errors
/// A frame or a chapter that cannot be read.
pub fn psnr_db(scene: &Scene, sequence: &Sequence) -> Result<Option<f64>> {
    let shown = scene.chapters.iter().flat_map(|chapter| chapter.shown.clone()).collect();
    let frames = psnr_frames(shown, scene.provenance.held_out);
    let mut now = scene.clone();
    mean_psnr_db(sequence, &frames, |i| {
        let time = scene.time(i);
        if !now.is_at(time) {
            now = scene.at(time)?;
        }
        Ok(render_frame(&now, i))
    })
}

/// Returns the held-out ones of the shown frames, or a few if none is, in their order.
fn psnr_frames(shown: Vec<usize>, is_held_out: bool) -> Vec<usize> {
    let held_out: Vec<usize> =
        shown.iter().copied().filter(|i| is_held_out && Sequence::is_test_frame(*i)).collect();
    let mut frames = if held_out.is_empty() { spread(&shown, PSNR_FRAMES) } else { held_out };
    frames.sort_unstable();
    frames
}

/// Mean PSNR in dB of rendered frames inside the supervision mask; `None` if nothing is inside.
fn mean_psnr_db(
    sequence: &Sequence,
    frames: &[usize],
    mut render: impl FnMut(usize) -> Result<Images>,
) -> Result<Option<f64>> {
    let mut values = Vec::new();
    for &i in frames {
        let mask = sequence.mask(i)?;
        values.extend(metrics::psnr_db(&render(i)?.to_rgb(), &sequence.frame(i)?, Some(&mask)));
    }
    Ok(num::mean(values.into_iter()))
}

fn context<'a>(
    settings: &'a TrainSettings,
    prepared: Option<&'a Prepared>,
    sequence: &Sequence,
    state: &TrainState,
) -> Context<'a> {
    Context {
        settings,
        latents: prepared.map_or(&[], |p| &p.latents),
        typical_depth: state.typical_depth,
        world_per_px: world_per_px(sequence, state),
    }
}

/// Length of a full-size pixel at the typical depth, scene units.
fn world_per_px(sequence: &Sequence, state: &TrainState) -> f32 {
    state.typical_depth / sequence.camera(0).fx
}

#[cfg(test)]
mod behaviour_tests;
#[cfg(test)]
mod pose_tests;
#[cfg(test)]
mod tests;
