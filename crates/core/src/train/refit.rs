//! Fits a scene that can change in fewer ways to the pictures of another one.

use super::{
    Context, CpuBackend, LossWeights, Model, StepPlan, StepView, TrainBackend, TrainFrame, TrainSettings,
    fit_camera::median_depth, frames::planar,
};
use crate::{
    Result,
    clock::PassClock,
    deform::deform,
    metrics::psnr_db,
    num,
    prepare::NO_REGION,
    progress::{Observer, Progress},
    raster::{ALPHA_PLANE, FEATURE_PLANE, Images, MIN_DEPTH_ALPHA, project::Sampling, render_deformed},
    scene::Scene,
};
use rand::{Rng, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Number of steps after which pictures get nearer only slowly.
pub const REFIT_STEPS: usize = 2000;
/// Memory for rendered frames, bytes; further ones are rendered each time.
pub const REFIT_FRAME_BYTES: usize = 1 << 29;
/// Rates of lengths as shares of those of training, because places are nearly right at the start.
const LENGTHS: f32 = 0.3;
/// Number of frames that two scenes are compared on.
const COMPARED_FRAMES: usize = 8;

/// Improves `scene` until its pictures, depths and features are as near to those of `like` as `steps` steps
/// bring them. Places, shapes, colours, opacities and features change, and the weights of shared bases.
/// Colours stay constant over time. No recording is needed. Equal scenes give equal results. Returns how
/// near they were and are, as PSNR in dB; a scene that does not come nearer stays as it was.
///
/// # Errors
/// [`crate::Error::Cancelled`] if the observer asks to stop.
pub fn refit(
    scene: &mut Scene,
    like: &Scene,
    steps: usize,
    observer: &mut Observer<'_>,
) -> Result<[Option<f64>; 2]> {
    let before = likeness_db(scene, like);
    let fitted = fitted(scene, like, steps, observer)?;
    let after = likeness_db(&fitted, like);
    if after < before {
        return Ok([before; 2]);
    }
    *scene = fitted;
    Ok([before, after])
}

/// Returns the scene after `steps` steps.
fn fitted(scene: &Scene, like: &Scene, steps: usize, observer: &mut Observer<'_>) -> Result<Scene> {
    let settings = settings(steps, scene.deformation.is_shared());
    let mut model = Model::new((*scene.gaussians).clone(), (*scene.deformation).clone());
    let (mut backend, mut clock) = (CpuBackend::default(), PassClock::default());
    let mut examples = Examples::new(like, scene.gaussians.latent_dim);
    let (latents, camera) = (examples.palette.latents(), &like.cameras[0]);
    let typical_depth = median_depth(&like.gaussians.means, camera);
    let world_per_px = typical_depth / camera.fx;
    let context = Context { settings: &settings, latents: &latents, typical_depth, world_per_px };
    for step in 0..steps {
        let plan = examples.next(step, &settings);
        backend.step(&mut model, plan, &context, &mut clock)?;
        Progress::new("fitting", step + 1, steps).tell(observer)?;
    }
    Ok(Scene { gaussians: model.gaussians.into(), deformation: model.deformation.into(), ..scene.clone() })
}

/// Returns how near the pictures of two scenes are, as PSNR in dB inside the field of view, over a few
/// frames.
fn likeness_db(scene: &Scene, like: &Scene) -> Option<f64> {
    let step = like.num_frames().div_ceil(COMPARED_FRAMES).max(1);
    let compare = |i: usize| {
        let [a, b] = [scene, like].map(|s| rendered(s, like, i, false).to_rgb());
        psnr_db(&a, &b, Some(&like.field_of_view))
    };
    num::mean((0..like.num_frames()).step_by(step).filter_map(compare))
}

/// Renders a scene as another one's frame `i` shows it.
fn rendered(scene: &Scene, like: &Scene, i: usize, features: bool) -> Images {
    let now = deform(&scene.gaussians, &scene.deformation, like.time(i), features);
    render_deformed(&scene.gaussians, &now, &like.cameras[i])
}

/// Returns settings of training, of which the rates and the weights of the loss count.
fn settings(steps: usize, has_shared_bases: bool) -> TrainSettings {
    let mut settings = TrainSettings {
        iterations: steps,
        colour_over_time: false,
        depth_over_time: true,
        feature_motion: false,
        loss: LossWeights { total_variation: 0.0, region_smoothness: 0.0, ..LossWeights::default() },
        ..TrainSettings::default()
    };
    settings.rates.final_share = 0.1;
    settings.rates.mean *= LENGTHS;
    settings.rates.motion *= LENGTHS;
    if !has_shared_bases {
        // The rates are those of weights, and too fast for centres and widths.
        (settings.rates.motion, settings.rates.motion_relative) = (0.0, 0.0);
    }
    settings
}

/// Frames to learn from, rendered from a scene.
struct Examples<'a> {
    like: &'a Scene,
    frames: Vec<Option<Arc<TrainFrame>>>,
    /// Frames still to be visited in this round.
    queue: Vec<usize>,
    rng: ChaCha8Rng,
    palette: Palette,
}

impl<'a> Examples<'a> {
    /// Makes examples with `latent_dim` latent numbers per pixel, as many as `like` has or none.
    fn new(like: &'a Scene, latent_dim: usize) -> Self {
        let (frames, rng) = (vec![None; like.num_frames()], ChaCha8Rng::seed_from_u64(0));
        Self { like, frames, queue: Vec::new(), rng, palette: Palette::of(like, latent_dim) }
    }

    /// Returns the next step: a frame, and one pixel of each square unless the picture is small.
    fn next(&mut self, step: usize, settings: &TrainSettings) -> StepPlan {
        if self.queue.is_empty() {
            self.queue = (0..self.frames.len()).collect();
            self.queue.shuffle(&mut self.rng);
        }
        let index = self.queue.pop().unwrap_or(0);
        let camera = self.like.cameras[index];
        let mut sampling = Sampling { step: settings.pixel_step, ..Sampling::ALL };
        if ((camera.width * camera.height) as usize) < settings.min_pixels * sampling.step.pow(2) {
            sampling.step = 1;
        }
        sampling.first = [0; 2].map(|_| self.rng.random_range(0..sampling.step));
        let progress = step as f32 / settings.iterations as f32;
        let view = StepView { camera, time: self.like.time(index), half: false, sampling, progress };
        StepPlan { index, frame: self.frame(index), view, step, updates: true }
    }

    fn frame(&mut self, i: usize) -> Arc<TrainFrame> {
        if let Some(frame) = &self.frames[i] {
            return frame.clone();
        }
        let images = rendered(self.like, self.like, i, self.palette.dim > 0);
        let frame = Arc::new(TrainFrame {
            width: images.width,
            height: images.height,
            colour: planar(images.to_rgb().as_raw()),
            mask: self.like.field_of_view.data.clone(),
            depth: images.normalised_depth().data,
            regions: self.palette.regions(&images),
        });
        let kept = self.frames.iter().flatten().count();
        if (kept + 1) * frame.bytes() <= REFIT_FRAME_BYTES {
            self.frames[i] = Some(frame.clone());
        }
        frame
    }
}

/// Grid of latent features that those of pixels are rounded to, because a frame names a row of a table for
/// each pixel.
struct Palette {
    dim: usize,
    /// Number of grid points along each axis, from −`reach` to `reach`.
    side: usize,
    reach: f32,
}

/// Number of rows that a frame can name.
const MOST_ROWS: f64 = 60_000.0;
/// Largest latent number that matters: those of classes have unit length.
const MOST_REACH: f32 = 1.5;

impl Palette {
    fn of(like: &Scene, dim: usize) -> Self {
        let reach = like.gaussians.features.iter().fold(1e-6_f32, |most, f| most.max(f.abs()));
        let side = if dim > 0 { MOST_ROWS.powf(1.0 / dim as f64) as usize } else { 0 };
        Self { dim, side, reach: reach.min(MOST_REACH) }
    }

    /// Returns the distance between two grid points.
    fn step(&self) -> f32 {
        2.0 * self.reach / (self.side.max(2) - 1) as f32
    }

    /// Returns the table of all grid points, [rows][dim]; the last axis counts fastest.
    fn latents(&self) -> Vec<f32> {
        let rows = if self.dim > 0 { self.side.pow(self.dim as u32) } else { 0 };
        let place = |row: usize, d: usize| row / self.side.pow((self.dim - 1 - d) as u32) % self.side;
        let point = |row: usize| (0..self.dim).map(move |d| place(row, d) as f32 * self.step() - self.reach);
        (0..rows).flat_map(point).collect()
    }

    /// Returns the row of each pixel's latent; none where the picture is mostly empty.
    fn regions(&self, images: &Images) -> Vec<u16> {
        if self.dim == 0 || images.latent_dim() != self.dim {
            return Vec::new();
        }
        let place = |v: f32| (((v + self.reach) / self.step()).round() as usize).min(self.side - 1);
        let row = |i: usize| {
            let values = (0..self.dim).map(|d| images.plane(FEATURE_PLANE + d)[i]);
            values.fold(0, |row, v| row * self.side + place(v)) as u16
        };
        let alpha = images.plane(ALPHA_PLANE);
        (0..alpha.len()).map(|i| if alpha[i] >= MIN_DEPTH_ALPHA { row(i) } else { NO_REGION }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        deform::{COLOUR_CHANNEL, GATE_CHANNEL},
        progress::unobserved,
        stress,
    };

    /// Returns a scene of a few frames whose colours change by `factor` times as much as usual.
    fn colourful(factor: f32) -> Scene {
        let mut scene = stress::ordinary(60);
        scene.cameras = vec![scene.cameras[0]; 12];
        let stride = scene.deformation.stride;
        let rows = scene.deformation.weights.chunks_exact_mut(stride);
        rows.for_each(|row| row[COLOUR_CHANNEL..GATE_CHANNEL].iter_mut().for_each(|w| *w *= factor));
        scene
    }

    #[test]
    fn a_scene_of_the_released_form_comes_nearer_to_the_pictures() {
        let scene = colourful(30.0);
        let mut released = scene.released().scene;
        let [before, after] = refit(&mut released, &scene, 200, &mut unobserved).unwrap().map(Option::unwrap);
        assert!(after > before + 0.5, "{before} dB became {after} dB");
        assert_eq!(likeness_db(&released, &scene), Some(after));
        assert!(released.released().lost.is_empty(), "the form is kept");
        let mut again = scene.released().scene;
        refit(&mut again, &scene, 200, &mut unobserved).unwrap();
        assert_eq!(again.gaussians, released.gaussians);
    }

    #[test]
    fn a_scene_that_is_as_near_as_can_be_stays() {
        let scene = colourful(0.0);
        let mut released = scene.released().scene;
        let kept = released.gaussians.clone();
        let [before, after] = refit(&mut released, &scene, 3, &mut unobserved).unwrap();
        assert_eq!(likeness_db(&released, &scene), after, "it is that of the scene that is kept");
        assert!(after > before || released.gaussians == kept);
    }

    #[test]
    fn latents_are_rounded_to_the_nearest_row() {
        let scene = stress::ordinary(40);
        let images = rendered(&scene, &scene, 0, true);
        let palette = Palette::of(&scene, 3);
        let (table, rows) = (palette.latents(), palette.regions(&images));
        assert!(table.len() / 3 <= usize::from(NO_REGION) && rows.iter().any(|row| *row != NO_REGION));
        for (i, row) in rows.iter().enumerate().filter(|(_, row)| **row != NO_REGION) {
            for d in 0..3 {
                let value = images.plane(FEATURE_PLANE + d)[i].clamp(-palette.reach, palette.reach);
                assert!((table[3 * usize::from(*row) + d] - value).abs() <= 0.51 * palette.step());
            }
        }
        assert!(Palette::of(&scene, 0).latents().is_empty());
    }
}
