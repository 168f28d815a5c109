//! From a recording to a scene: initial Gaussians, losses, gradients, Adam, densify and prune.

mod adam;
mod chain;
mod densify;
mod frames;
mod loss;
mod optimiser;
mod settings;

pub use loss::{LossTerms, LossWeights, Truth, loss};
pub use settings::{DensifySettings, LearningRates, TrainSettings};

use crate::{
    Error, Result,
    deform::{Deformation, deform_by},
    gaussian::{Gaussians, init},
    metrics,
    num::percentile,
    prepare::Prepared,
    raster::{
        Images, backward::raster_backward, bin::bin, forward::raster, project::project_all, render_deformed,
    },
    scene::{Provenance, Scene},
    sequence::Sequence,
};
use chain::FrameState;
use densify::Statistics;
use frames::{Frame, FrameCache};
use optimiser::Optimiser;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Depth of the start surface where a recording has none, in its own arbitrary units.
const DEFAULT_DEPTH: f32 = 100.0;
/// Frames that the first Gaussians are taken from.
const SEED_FRAMES: usize = 8;
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

/// Training in progress; holds parameters, moments and the decoded frames.
pub struct Trainer {
    settings: TrainSettings,
    sequence: Sequence,
    prepared: Option<Prepared>,
    cache: FrameCache,
    gaussians: Gaussians,
    deformation: Deformation,
    optimiser: Optimiser,
    statistics: Statistics,
    rng: ChaCha8Rng,
    /// Frames still to be visited in this round, in random order.
    queue: Vec<usize>,
    typical_depth: f32,
    step: usize,
    dropped: usize,
    started: std::time::Instant,
}

impl Trainer {
    /// Reads the recording and places the initial Gaussians. Features are trained if `prepared` is given
    /// (then `sequence` is `prepared.sequence`).
    pub fn new(sequence: &Sequence, prepared: Option<&Prepared>, settings: TrainSettings) -> Result<Self> {
        let mut settings = settings;
        settings.eval |= prepared.is_some_and(|p| p.eval);
        settings.sh_degree = if sequence.camera_moves() { settings.sh_degree.min(3) } else { 0 };
        let train_frames = train_frames(sequence.num_frames(), settings.eval);
        let latent_dim = prepared.map_or(0, |p| p.codec.latent_dim());
        let (gaussians, typical_depth) = initial_gaussians(sequence, &train_frames, latent_dim, &settings)?;
        let num_bases = settings.num_bases.max(2);
        let width = settings.basis_width / (num_bases - 1) as f32;
        let mut deformation =
            Deformation::at_rest(gaussians.len(), latent_dim, num_bases, width, settings.gate_slope);
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        // PyTorch's initial range for a layer of D + 1 inputs.
        let bound = 1.0 / ((latent_dim + 1) as f32).sqrt();
        let net = deformation.feature_weight.iter_mut().chain(&mut deformation.feature_bias);
        net.for_each(|v| *v = rng.random_range(-bound..bound));
        Ok(Self {
            cache: FrameCache::new(sequence, settings.frame_cache_bytes),
            optimiser: Optimiser::new(&gaussians, &deformation),
            statistics: Statistics::new(gaussians.len()),
            sequence: sequence.clone(),
            prepared: prepared.cloned(),
            settings,
            gaussians,
            deformation,
            rng,
            queue: Vec::new(),
            typical_depth,
            step: 0,
            dropped: 0,
            started: std::time::Instant::now(),
        })
    }

    /// One optimiser step.
    pub fn step(&mut self) -> Result<StepReport> {
        let i = self.next_frame();
        let progress = self.step as f32 / self.settings.iterations.max(1) as f32;
        let half = progress < self.settings.half_size_share;
        let frame = self.cache.get(self.prepared.as_ref(), i, half)?;
        let (terms, report) = self.learn(&frame, i, half, progress);
        self.step += 1;
        if !report {
            self.dropped += 1;
        }
        self.densify_if_due();
        Ok(StepReport {
            step: self.step,
            loss: terms.total(),
            terms,
            gaussians: self.gaussians.len(),
            dropped: self.dropped,
        })
    }

    /// Forward, backward and update on one frame; `false` if it was dropped because something was not finite.
    fn learn(&mut self, frame: &Frame, i: usize, half: bool, progress: f32) -> (LossTerms<f32>, bool) {
        let latents = self.prepared.as_ref().map_or(&[][..], |p| &p.latents);
        let truth = frame.truth(latents, self.typical_depth);
        let camera = self.sequence.camera(i).resized(truth.width as u32, truth.height as u32);
        let time = self.sequence.time(i);
        let psi = self.deformation.psi(self.gaussians.len(), time);
        let deformed = deform_by(&self.gaussians, &self.deformation, &psi, time, true);
        let splats = project_all(&self.gaussians, &deformed, &camera);
        let bins = bin(&splats, truth.width, truth.height);
        let dim = self.gaussians.latent_dim;
        let images = raster(&splats, &deformed.features, dim, &bins, truth.width, truth.height);
        let (terms, g_planes) = loss(&images.planes, &truth, &self.settings.loss);
        if !terms.total().is_finite() {
            return (terms, false);
        }
        let (g_splats, g_features) = raster_backward(&splats, &deformed.features, &bins, &images, &g_planes);
        let state = FrameState {
            gaussians: &self.gaussians,
            deformation: &self.deformation,
            psi: &psi,
            deformed: &deformed,
            splats: &splats,
            camera: &camera,
            time,
        };
        let gradients = chain::backward(&state, &g_splats, &g_features);
        if !gradients.are_finite() {
            return (terms, false);
        }
        self.statistics.add(&splats, &g_splats, if half { 0.5 } else { 1.0 });
        let rates = (time, progress, self.world_per_px());
        self.optimiser.step(&mut self.gaussians, &mut self.deformation, &gradients, &self.settings, rates);
        (terms, true)
    }

    /// Random order, every frame once a round.
    fn next_frame(&mut self) -> usize {
        if self.queue.is_empty() {
            self.queue = train_frames(self.sequence.num_frames(), self.settings.eval);
            for k in (1..self.queue.len()).rev() {
                let j = self.rng.random_range(0..=k);
                self.queue.swap(k, j);
            }
        }
        self.queue.pop().unwrap_or(0)
    }

    fn densify_if_due(&mut self) {
        let d = &self.settings.densify;
        let at = |share: f32| (share * self.settings.iterations as f32) as usize;
        if self.step < at(d.from) || self.step > at(d.until) || !self.step.is_multiple_of(d.every.max(1)) {
            return;
        }
        let world_per_px = self.world_per_px();
        let change = densify::densify(
            &mut self.gaussians,
            &mut self.deformation,
            &self.statistics,
            &self.settings.densify,
            world_per_px,
            &mut self.rng,
        );
        let (bands, dim) = (self.gaussians.sh_bands() * 3, self.gaussians.latent_dim);
        self.optimiser.rearrange(&change.moment_rows(), bands, dim, self.deformation.stride);
        self.statistics = Statistics::new(self.gaussians.len());
    }

    /// Length of a full-size pixel at the typical depth, scene units.
    fn world_per_px(&self) -> f32 {
        self.typical_depth / self.sequence.camera(0).fx
    }

    /// Steps done.
    pub fn steps_done(&self) -> usize {
        self.step
    }

    /// The scene as it stands, ready to be saved or shown.
    pub fn scene(&self) -> Scene {
        let prepared = self.prepared.as_ref();
        Scene {
            gaussians: self.gaussians.clone(),
            deformation: self.deformation.clone(),
            cameras: (0..self.sequence.num_frames()).map(|i| self.sequence.camera(i)).collect(),
            field_of_view: self.sequence.field_of_view().clone(),
            codec: prepared.map(|p| p.codec.clone()),
            classes: prepared.map(|p| p.classes.clone()).unwrap_or_default(),
            encoder: prepared.map(|p| p.encoder.clone()),
            provenance: Provenance {
                made_by: format!("SurgTPGS {}", env!("CARGO_PKG_VERSION")),
                sequence_name: self.sequence.name(),
                sequence_path: self.sequence.path().to_owned(),
                held_out: self.settings.eval,
                frames_per_second: self.sequence.frames_per_second(),
                steps: self.step,
                seconds: self.started.elapsed().as_secs_f64(),
                settings: serde_json::to_value(&self.settings).unwrap_or_default(),
            },
        }
    }

    /// Renders frame `i` as the scene stands.
    pub fn render(&self, i: usize) -> Images {
        let time = self.sequence.time(i);
        let psi = self.deformation.psi(self.gaussians.len(), time);
        let deformed = deform_by(&self.gaussians, &self.deformation, &psi, time, true);
        render_deformed(&self.gaussians, &deformed, &self.sequence.camera(i))
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

/// Frames that training may see.
fn train_frames(num_frames: usize, eval: bool) -> Vec<usize> {
    (0..num_frames).filter(|&i| !(eval && Sequence::is_test_frame(i))).collect()
}

/// At most `count` of `frames`, evenly spread, the middle one first.
fn spread(frames: &[usize], count: usize) -> Vec<usize> {
    let n = frames.len();
    let count = count.min(n);
    let mut picked: Vec<usize> = (0..count).map(|k| frames[(2 * k + 1) * n / (2 * count)]).collect();
    let middle = picked.len() / 2;
    if !picked.is_empty() {
        picked.swap(0, middle);
    }
    picked
}

/// Seeds Gaussians from a few training frames, the middle one first; also the typical depth.
fn initial_gaussians(
    sequence: &Sequence,
    frames: &[usize],
    latent_dim: usize,
    settings: &TrainSettings,
) -> Result<(Gaussians, f32)> {
    let mut seeds = Vec::new();
    for i in spread(frames, SEED_FRAMES) {
        seeds.push(init::SeedFrame {
            camera: sequence.camera(i),
            colour: sequence.frame(i)?,
            mask: sequence.mask(i)?,
            depth: sequence.depth(i)?,
        });
    }
    let mut known: Vec<f32> = seeds
        .iter()
        .filter_map(|s| s.depth.as_ref())
        .flat_map(|d| d.data.iter().copied().filter(|z| *z > 0.0 && z.is_finite()))
        .collect();
    let typical_depth = percentile(&mut known, 50.0).unwrap_or(DEFAULT_DEPTH);
    let spacing = settings.px_per_gaussian.max(1.0).sqrt();
    let gaussians = init::seed(&seeds, spacing, typical_depth, latent_dim, settings.sh_degree, settings.seed);
    if gaussians.is_empty() {
        return Err(Error::input_at(
            sequence.path(),
            "no pixel of the recording is to be supervised",
            "Its masks are probably inverted: run `surgtpgs check`, and set `[masks] keep` in sequence.toml.",
        ));
    }
    Ok((gaussians, typical_depth))
}

#[cfg(test)]
mod tests;
