//! Fits the camera of a picture that nothing was learned from.

use super::{
    adam::{Adam, WIDTH},
    chain,
    frames::TrainFrame,
    loss::{LossWeights, loss_into},
};
use crate::{
    Result,
    camera::{Camera, Twist},
    deform::deform,
    metrics::psnr_db,
    raster::{
        Images, Packed,
        backward::raster_backward_with,
        bin::bin,
        forward::raster_into,
        project::{Sampling, project_into},
        render_deformed,
    },
    scene::Scene,
    sequence::Sequence,
};

/// Number of steps of a fit.
const STEPS: usize = 80;
/// Rate at the start, px of the picture; it falls to zero in a line.
const RATE_PX: f32 = 0.3;
/// Edge of the squares of pixels of which a step renders one pixel, another one each time.
const PIXEL_STEP: usize = 2;

/// Returns the camera of frame `i` from where the scene, which stays as it is, looks most like the recorded
/// frame inside its mask; the scene's own camera if no other is better. Equal input gives equal cameras.
///
/// # Errors
/// A frame that cannot be read.
pub fn fit_camera(scene: &Scene, sequence: &Sequence, i: usize) -> Result<Camera> {
    let start = scene.cameras[i];
    let frame = TrainFrame::load(sequence, None, i)?;
    let now = deform(&scene.gaussians, &scene.deformation, scene.time(i), false);
    let typical_depth = median_depth(&now.means, &start);
    let weights = LossWeights { absolute: 0.0, total_variation: 0.0, ..LossWeights::default() };
    let mut motion = [0.0; 6];
    let mut moments = Adam::new(motion.len());
    let (mut splats, mut packed, mut images) = (Vec::new(), Packed::default(), Images::default());
    let (mut g_planes, mut slots) = (Vec::new(), Vec::new());
    let moved = |motion: [f32; 6]| Camera {
        camera_from_world: Twist::of(motion).moved(start.camera_from_world),
        ..start
    };
    for step in 0..STEPS {
        let camera = moved(motion);
        let first = [step % PIXEL_STEP, step / PIXEL_STEP % PIXEL_STEP];
        let sampling = Sampling { step: PIXEL_STEP, first };
        let sampled = frame.sampled(sampling);
        project_into(&scene.gaussians, &now, &camera, sampling, &mut splats);
        packed.fill(&splats, &[], 0);
        (images.width, images.height) = sampled.size();
        let bins = bin(&splats, images.width, images.height);
        raster_into(&packed, &bins, &mut images);
        loss_into(&images.planes, &sampled.truth(&[], typical_depth), &weights, &mut g_planes);
        let (mut g_splats, _) = raster_backward_with(&splats, &packed, &bins, &images, &g_planes, &mut slots);
        g_splats.iter_mut().for_each(|g| sampling.apply_backward(g));
        let gradient = chain::camera_backward(&scene.gaussians, &now, &splats, &camera, &g_splats).to_array();
        if gradient.iter().any(|v| !v.is_finite()) {
            break;
        }
        let px = RATE_PX * (1.0 - step as f32 / STEPS as f32);
        let (turn, shift) = (px / camera.fx, px * typical_depth / camera.fx);
        let mut rates = [0.0; WIDTH];
        rates[..6].copy_from_slice(&[turn, turn, turn, shift, shift, shift]);
        moments.step_rows(&mut motion, &gradient, 1.0, 1.0, &rates);
    }
    let (fitted, picture, mask) = (moved(motion), sequence.frame(i)?, sequence.mask(i)?);
    let [before, after] = [&start, &fitted].map(|camera| {
        psnr_db(&render_deformed(&scene.gaussians, &now, camera).to_rgb(), &picture, Some(&mask))
    });
    Ok(if after > before { fitted } else { start })
}

/// Returns the median depth of the points in front of a camera, scene units; 1 if there are none.
pub(super) fn median_depth(means: &[[f32; 3]], camera: &Camera) -> f32 {
    camera.depth_percentile(means, 50.0).unwrap_or(1.0)
}
