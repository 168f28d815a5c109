//! Renders a scene at a time from a camera and repeats only those passes whose input has changed.

use super::{
    Images, Packed,
    bin::{Bins, bin},
    forward::raster_into,
    project::{Sampling, Splat, project_into},
};
use crate::{
    Result,
    camera::Camera,
    clock::{PassClock, PassName},
    deform::{Deformed, deform_by},
    scene::Scene,
};

/// The passes of a frame, from Gaussians to the picture on the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FramePass {
    /// Computes ψ(t) and the Gaussians at time t.
    Deform,
    /// Projects them onto the image plane.
    Project,
    /// Sorts them by depth and distributes them over tiles.
    Bin,
    /// Blends them.
    Raster,
    /// Computes the scores of prompts.
    Relevancy,
    /// Measures the found regions and draws them over the frame.
    Overlay,
}

impl PassName for FramePass {
    const ALL: &'static [Self] =
        &[Self::Deform, Self::Project, Self::Bin, Self::Raster, Self::Relevancy, Self::Overlay];
    fn number(self) -> usize {
        self as usize
    }
}

/// Counts and durations of the passes of frames.
pub type FrameClock = PassClock<FramePass>;

/// Renders a scene at a time from a camera; implemented for the GPU and the CPU.
pub trait Renderer: Send {
    /// Name of the device that renders, for reports and provenance, e.g. "CPU (AVX-512)".
    fn name(&self) -> String;

    /// Renders into `images`, whose memory is reused; features only if asked for. Results of the last
    /// frame that are still valid are not computed again; `clock` counts the passes that ran.
    fn render_into(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        time: f32,
        features: bool,
        images: &mut Images,
        clock: &mut FrameClock,
    ) -> Result<()>;

    /// Renders as [`Renderer::render_into`] does, into new images.
    fn render(&mut self, scene: &Scene, camera: &Camera, time: f32, features: bool) -> Result<Images> {
        let mut images = Images::default();
        self.render_into(scene, camera, time, features, &mut images, &mut FrameClock::default())?;
        Ok(images)
    }
}

/// The passes on the CPU, threaded and vectorised; also the specification of the shaders.
#[derive(Debug, Default)]
pub struct CpuRenderer {
    psi: Vec<f32>,
    deformed: Deformed,
    splats: Vec<Splat<f32>>,
    bins: Bins,
    packed: Packed,
    /// Input that `deformed` was computed from: the revision of the scene, the time, and `true` if with features.
    deformed_at: Option<([u64; 2], f32, bool)>,
    /// Camera that `splats` and `bins` were computed for, from `deformed`.
    seen_by: Option<Camera>,
}

impl CpuRenderer {
    /// Deforms, unless the last call was the same.
    fn deform(&mut self, scene: &Scene, time: f32, features: bool, clock: &mut FrameClock) {
        let revision = scene.revision();
        let same_time = self.deformed_at.filter(|(scene, t, _)| *scene == revision && *t == time);
        if same_time.is_some_and(|(.., with_features)| with_features || !features) {
            return;
        }
        scene.deformation.psi_into(scene.gaussians.len(), time, &mut self.psi);
        deform_by(&scene.gaussians, &scene.deformation, &self.psi, time, features, &mut self.deformed);
        self.deformed_at = Some((revision, time, features));
        if same_time.is_none() {
            self.seen_by = None;
        }
        clock.lap(FramePass::Deform);
    }

    /// Projects and bins, unless the last call was the same.
    fn project(&mut self, scene: &Scene, camera: &Camera, clock: &mut FrameClock) {
        if self.seen_by.as_ref() == Some(camera) {
            return;
        }
        project_into(&scene.gaussians, &self.deformed, camera, Sampling::ALL, &mut self.splats);
        clock.lap(FramePass::Project);
        self.bins = bin(&self.splats, camera.width as usize, camera.height as usize);
        self.seen_by = Some(*camera);
        clock.lap(FramePass::Bin);
    }
}

impl Renderer for CpuRenderer {
    fn name(&self) -> String {
        format!("CPU, {} threads, {}", rayon::current_num_threads(), instruction_set())
    }

    fn render_into(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        time: f32,
        features: bool,
        images: &mut Images,
        clock: &mut FrameClock,
    ) -> Result<()> {
        clock.start();
        self.deform(scene, time, features, clock);
        self.project(scene, camera, clock);
        let latent_dim = if features { scene.gaussians.latent_dim } else { 0 };
        self.packed.fill(&self.splats, &self.deformed.features, latent_dim);
        (images.width, images.height) = (camera.width as usize, camera.height as usize);
        raster_into(&self.packed, &self.bins, images);
        clock.lap(FramePass::Raster);
        Ok(())
    }
}

/// Name of the instruction set that the kernels use on this machine.
fn instruction_set() -> String {
    let level = format!("{:?}", fearless_simd::Level::new());
    level.split(['(', ' ']).next().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress;

    /// Number of runs of each pass for a frame.
    fn passes(clock: &FrameClock, before: &FrameClock) -> Vec<usize> {
        FramePass::ALL.iter().map(|p| clock.runs(*p) - before.runs(*p)).collect()
    }

    #[test]
    fn only_what_has_changed_is_computed_and_the_pictures_are_the_same() {
        let scene = stress::ordinary(12);
        let camera = scene.cameras[0];
        let mut kept = CpuRenderer::default();
        let mut clock = FrameClock::default();
        let mut images = Images::default();
        let mut frame = |camera: &Camera, time, features| {
            let before = clock.clone();
            kept.render_into(&scene, camera, time, features, &mut images, &mut clock).unwrap();
            let fresh = CpuRenderer::default().render(&scene, camera, time, features).unwrap();
            assert_eq!(images, fresh);
            passes(&clock, &before)[..4].to_vec()
        };
        let nearer = camera.resized(24, 20);
        assert_eq!(frame(&camera, 0.2, false), [1, 1, 1, 1]);
        assert_eq!(frame(&camera, 0.2, false), [0, 0, 0, 1]);
        assert_eq!(frame(&nearer, 0.2, false), [0, 1, 1, 1]);
        // Features are computed in addition; nothing moves.
        assert_eq!(frame(&nearer, 0.2, true), [1, 0, 0, 1]);
        assert_eq!(frame(&nearer, 0.2, false), [0, 0, 0, 1]);
        assert_eq!(frame(&nearer, 0.7, true), [1, 1, 1, 1]);
    }

    #[test]
    fn another_scene_is_noticed() {
        let scene = stress::ordinary(12);
        let camera = scene.cameras[0];
        let mut other = scene.clone();
        other.gaussians.colours.iter_mut().for_each(|c| c[0] += 0.3);
        let mut renderer = CpuRenderer::default();
        let first = renderer.render(&scene, &camera, 0.2, true).unwrap();
        assert_ne!(first, renderer.render(&other, &camera, 0.2, true).unwrap());
        assert_eq!(first, renderer.render(&scene, &camera, 0.2, true).unwrap());
    }
}
