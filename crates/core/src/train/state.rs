//! Everything that training changes, and its initial values.

use super::{
    chapters::{no_frames_left, time_of, times_of},
    model::Model,
    poses::LearnedPoses,
    seeds,
    settings::{FeatureMode, TrainSettings},
};
use crate::{
    Error, Remedy, Result,
    deform::{Deformation, SCALE_CHANNEL, stride_for},
    gaussian::{
        Gaussians,
        init::{self, SeedSettings},
    },
    num::percentile,
    poses::{self, ScopePath, ScopeVerdict, Timeline},
    prepare::Prepared,
    progress::Observer,
    raster::NEAR,
    sequence::{Sequence, settings_name},
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Depth of the start surface if a recording has no depth, in arbitrary units.
const DEFAULT_DEPTH: f32 = 100.0;

/// State of training. Together with the settings and the recording it determines all later steps.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct TrainState {
    pub model: Model,
    pub rng: ChaCha8Rng,
    /// Time of every frame.
    pub times: Vec<f32>,
    /// Judgement on a camera whose path is not known.
    pub scope: ScopeVerdict,
    /// Median depth of what is seen on each frame that may be learned from, where a path was estimated.
    pub path_depths: Vec<f32>,
    /// Poses that were estimated, or that are learned; none if the recording's own are used.
    pub poses: LearnedPoses,
    /// Factor from the recording's focal length to the estimated one; 1 if the lens is known.
    pub zoom: f32,
    /// Frames still to be visited in this round, in random order.
    pub queue: Vec<usize>,
    pub typical_depth: f32,
    /// Largest number of Gaussians.
    pub budget: usize,
    pub step: usize,
    pub dropped: usize,
    /// Seconds of training before this run.
    pub seconds: f64,
}

impl TrainState {
    pub(super) fn new(
        sequence: &Sequence,
        prepared: Option<&Prepared>,
        settings: &TrainSettings,
        times: Vec<f32>,
        observer: &mut Observer<'_>,
    ) -> Result<Self> {
        let seen = match settings.seed_test_frames {
            true => settings.frames_and_held_out(sequence.num_frames()),
            false => settings.frames(sequence.num_frames()),
        };
        if seen.is_empty() {
            return Err(no_frames_left());
        }
        let latent_dim = prepared.map_or(0, |p| p.codec.latent_dim());
        let path = path(sequence, &times, settings, observer)?;
        let zoom = path.zoom.unwrap_or(1.0);
        let zoomed = &sequence.clone().with_zoom(zoom);
        let applied = &settings.applied(zoomed, prepared, !path.poses.is_empty());
        let poses = first_poses(zoomed, &path, applied);
        let (gaussians, typical_depth) = initial_gaussians(zoomed, &path, &seen, latent_dim, applied)?;
        let mut deformation = first_motion(zoomed, &path, &times, &gaussians, applied);
        let mut rng = ChaCha8Rng::seed_from_u64(applied.seed);
        start_network(&mut deformation, latent_dim, zoomed, prepared, applied, &mut rng)?;
        Ok(Self {
            budget: budget(gaussians.len(), applied),
            model: Model::new(gaussians, deformation),
            rng,
            times,
            path_depths: path.typical_depths(zoomed, applied.window(zoomed.num_frames())),
            scope: path.verdict,
            poses,
            zoom,
            queue: Vec::new(),
            typical_depth,
            step: 0,
            dropped: 0,
            seconds: 0.0,
        })
    }

    /// Time of frame `i`.
    pub(super) fn time(&self, sequence: &Sequence, i: usize) -> f32 {
        time_of(sequence, &self.times, i)
    }

    /// Returns the recording with the lens and the poses as they are now.
    pub(super) fn posed(&self, sequence: &Sequence) -> Sequence {
        let sequence = sequence.clone().with_zoom(self.zoom);
        if self.poses.is_empty() { sequence } else { sequence.with_poses(&self.poses.now()) }
    }

    /// Returns `true` if all arrays have the sizes that the number of Gaussians requires.
    pub(super) fn is_consistent(&self) -> bool {
        let Model { gaussians: g, deformation: d, optimiser, statistics } = &self.model;
        let n = g.len();
        let rows = [g.rotations.len(), g.log_scales.len(), g.opacity_logits.len(), g.colours.len()];
        let block = d.num_bases * n * d.stride;
        let basis = if d.is_shared() { d.num_bases } else { block };
        (self.zoom.is_finite() && self.zoom > 0.0)
            && self.poses.is_consistent()
            && rows.iter().all(|len| *len == n)
            && g.sh_degree <= 3
            && g.sh_rest.len() == n * g.sh_bands() * 3
            && g.features.len() == n * g.latent_dim
            && d.stride == stride_for(g.latent_dim)
            && d.gate_channel + g.latent_dim <= d.stride
            && d.weights.len() == block
            && [d.centres.len(), d.widths.len()] == [basis; 2]
            && d.feature_weight.len() == g.latent_dim * (g.latent_dim + 1)
            && d.feature_bias.len() == g.latent_dim
            && optimiser.fits(g, d)
            && [statistics.pull.len(), statistics.seen.len()] == [n; 2]
    }
}

/// Returns the poses that training begins with: those of the path, or if it has none and poses are learned,
/// those of the recording.
fn first_poses(sequence: &Sequence, path: &ScopePath, settings: &TrainSettings) -> LearnedPoses {
    if path.poses.is_empty() && settings.refines_poses {
        let recorded = (0..sequence.num_frames()).map(|i| sequence.camera(i).camera_from_world);
        LearnedPoses::new(recorded.collect())
    } else {
        LearnedPoses::new(path.poses.clone())
    }
}

/// Returns the motion that training begins with: what of the path was the motion of tissue.
fn first_motion(
    sequence: &Sequence,
    path: &ScopePath,
    times: &[f32],
    gaussians: &Gaussians,
    settings: &TrainSettings,
) -> Deformation {
    let latent_dim = gaussians.latent_dim;
    let window = settings.window(sequence.num_frames());
    let num_bases = settings.num_bases(window.len());
    let width = settings.basis_width / (num_bases - 1) as f32;
    let mut deformation =
        Deformation::at_rest(gaussians.len(), latent_dim, num_bases, width, settings.gate_slope);
    deformation.shape = settings.basis_shape;
    let time = |i: usize| time_of(sequence, times, i);
    if settings.chapter.is_some() {
        deformation.squeeze(time(window.start), time(window.end - 1));
    }
    let sways = window.filter_map(|i| {
        let recorded = sequence.camera(i).camera_from_world;
        Some((time(i), path.sway(i, recorded)?))
    });
    let sways: Vec<_> = sways.collect();
    deformation.follow(&gaussians.means, &sways);
    if settings.own_bases {
        deformation = deformation.with_own_bases();
    }
    if settings.gate_on_scale && latent_dim <= 3 {
        deformation.gate_channel = SCALE_CHANNEL;
    }
    deformation
}

/// Gives the feature network random weights. With lifted features it starts at zero, because it would disturb
/// them. So it does where no feature is learned: what it adds would be taken for one.
fn start_network(
    deformation: &mut Deformation,
    latent_dim: usize,
    sequence: &Sequence,
    prepared: Option<&Prepared>,
    settings: &TrainSettings,
    rng: &mut ChaCha8Rng,
) -> Result<()> {
    let learns_features = match prepared {
        Some(prepared) if settings.feature_mode == FeatureMode::Learned && settings.feature_motion => {
            prepared.has_features(&settings.frames(sequence.num_frames()))?
        }
        _ => false,
    };
    if learns_features {
        // PyTorch's initial range for a layer of D + 1 inputs.
        let bound = 1.0 / ((latent_dim + 1) as f32).sqrt();
        let net = deformation.feature_weight.iter_mut().chain(&mut deformation.feature_bias);
        net.for_each(|v| *v = rng.random_range(-bound..bound));
    }
    Ok(())
}

/// Largest number of Gaussians, given the number of first ones: one for `px_per_gaussian` supervised pixels.
fn budget(first: usize, settings: &TrainSettings) -> usize {
    let d = &settings.densify;
    // The conversion turns infinity into the largest integer.
    let by_pixels = first as f32 * settings.px_per_gaussian.max(1.0) / d.min_px_per_gaussian.max(0.0);
    d.max_gaussians.min((by_pixels as usize).max(first))
}

/// Estimates the path of a camera that is not known, or points that a known one sees; it has no poses if the
/// camera is known or stands still.
fn path(
    sequence: &Sequence,
    times: &[f32],
    settings: &TrainSettings,
    observer: &mut Observer<'_>,
) -> Result<ScopePath> {
    if !settings.finds_path {
        return Ok(ScopePath::default());
    }
    let frames = settings.frames(sequence.num_frames());
    if let Some(verdict) = poses::too_long(sequence, frames.len()) {
        return Ok(ScopePath::judged(verdict));
    }
    let times = times_of(sequence, times);
    let timeline = Timeline { frames: &frames, times: &times };
    if poses::are_wanted(sequence) {
        poses::estimate(sequence, timeline, DEFAULT_DEPTH, observer)
    } else if poses::can_triangulate(sequence) {
        poses::triangulate_with_known_poses(sequence, timeline, observer)
    } else {
        Ok(ScopePath::default())
    }
}

/// Seeds Gaussians from a few training frames, the middle one first; also returns the typical depth.
fn initial_gaussians(
    sequence: &Sequence,
    path: &ScopePath,
    frames: &[usize],
    latent_dim: usize,
    settings: &TrainSettings,
) -> Result<(Gaussians, f32)> {
    let seeds = seeds::read(sequence, path, frames)?;
    let mut known: Vec<f32> = seeds
        .iter()
        .filter_map(|s| s.depth.as_ref())
        .flat_map(|d| d.data.iter().copied().filter(|z| *z > 0.0 && z.is_finite()))
        .collect();
    let typical_depth = percentile(&mut known, 50.0).or(path.typical_depth).unwrap_or(DEFAULT_DEPTH);
    if typical_depth < 2.0 * NEAR {
        return Err(Error::input_at(
            sequence.path(),
            format!(
                "the recording's typical depth is {typical_depth}, and what is nearer than the near plane at {NEAR} is \
                 not seen"
            ),
            if sequence.has_depth() {
                let place = settings_name(sequence.path());
                format!("Give its depth in millimetres: set a larger `[depth] scale` in {place}.")
            } else {
                "Give the places of its cameras in millimetres.".to_owned()
            },
        ));
    }
    let seeded = |spacing_px: f32| {
        let (default_depth, opacity, neighbour_sizes) =
            (typical_depth, settings.initial_opacity, settings.neighbour_sizes);
        let (sh_degree, seed) = (settings.sh_degree, settings.seed);
        let seed =
            SeedSettings { spacing_px, default_depth, opacity, neighbour_sizes, latent_dim, sh_degree, seed };
        init::seed(&seeds, &seed)
    };
    let mut spacing_px = settings.px_per_gaussian.max(1.0).sqrt();
    let mut gaussians = seeded(spacing_px);
    let (most, longest) = (settings.densify.max_gaussians.max(1), sequence.width().max(sequence.height()));
    while gaussians.len() > most && spacing_px < longest as f32 {
        spacing_px *= 1.05 * (gaussians.len() as f32 / most as f32).sqrt();
        gaussians = seeded(spacing_px);
    }
    if gaussians.is_empty() {
        let why = match sequence.hidden() {
            [] => format!(
                "Its masks are probably inverted: set `[masks] keep` in {}.",
                settings_name(sequence.path())
            ),
            _ => "What is hidden leaves nothing of it: hide less.".to_owned(),
        };
        let what = "no pixel of the recording is to be supervised";
        return Err(Error::input_at(sequence.path(), what, Remedy::CheckRecording.after(why)));
    }
    Ok((gaussians, typical_depth))
}
