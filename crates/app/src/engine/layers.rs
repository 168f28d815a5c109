//! Layers of a view besides colours: the motion of things, their opacity, and the parts that the
//! endoscope did not see.

use super::{Engine, SceneView};
use std::sync::Arc;
use surgtpgs_core::{
    Result,
    deform::{deform, travel_px},
    gaussian::Gaussians,
    grid::{Grid, Mask},
    raster::{ALPHA_PLANE, FEATURE_PLANE, MIN_DEPTH_ALPHA, render_deformed},
    unseen::unseen,
};

/// Largest number of times at which the path of a Gaussian is sampled.
const MAX_TIMES: usize = 32;
/// Distance from which on a Gaussian counts as moving, px.
const MOVES_PX: f32 = 1.0;

/// Gaussians whose only feature is the distance that they travel, in pixels of the first recorded frame.
pub(super) struct Travelling {
    /// Revision of the scene that the Gaussians belong to.
    revision: [u64; 2],
    gaussians: Arc<Gaussians>,
}

/// Motion of a view over the recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Distance that the thing at each pixel travels over the recording, in pixels of the first recorded
    /// frame; not a number where nothing is.
    pub travel_px: Grid<f32>,
    /// Number of Gaussians that travel a pixel or further.
    pub num_moving: usize,
    /// Number of all Gaussians.
    pub num_gaussians: usize,
}

impl Engine {
    /// Returns how far the things that a view shows move over the recording.
    pub fn motion(&mut self, view: &SceneView) -> Result<Motion> {
        self.turn_to(view.time)?;
        let gaussians = self.travelling();
        let mut deformed = deform(&gaussians, &self.scene.deformation, view.time, false);
        deformed.features.clone_from(&gaussians.features);
        let images = render_deformed(&gaussians, &deformed, &view.camera);
        let pixels = images.plane(FEATURE_PLANE).iter().zip(images.plane(ALPHA_PLANE));
        let travel =
            pixels.map(|(sum, alpha)| if *alpha >= MIN_DEPTH_ALPHA { sum / alpha } else { f32::NAN });
        Ok(Motion {
            travel_px: Grid::from_vec(images.width, images.height, travel.collect()),
            num_moving: gaussians.features.iter().filter(|px| **px >= MOVES_PX).count(),
            num_gaussians: gaussians.len(),
        })
    }

    fn travelling(&mut self) -> Arc<Gaussians> {
        let revision = self.scene.revision();
        if let Some(known) = self.travelling.as_ref().filter(|t| t.revision == revision) {
            return known.gaussians.clone();
        }
        let scene = &self.scene;
        let frames = scene.frames_here();
        let some = frames.len().min(MAX_TIMES);
        let place = |k: usize| frames.start + k * frames.len().saturating_sub(1) / (some - 1).max(1);
        let times: Vec<f32> = (0..some).map(|k| scene.time(place(k))).collect();
        let features = scene
            .cameras
            .first()
            .map_or_else(Vec::new, |camera| travel_px(&scene.gaussians, &scene.deformation, camera, &times));
        let gaussians = Arc::new(Gaussians { features, latent_dim: 1, ..(*scene.gaussians).clone() });
        self.travelling = Some(Travelling { revision, gaussians: gaussians.clone() });
        gaussians
    }

    /// Returns the opacity of a view, 0–1: where it is 0, nothing was reconstructed.
    pub fn opacity(&mut self, view: &SceneView) -> Result<Grid<f32>> {
        let images = self.render(view, false)?;
        Ok(Grid::from_vec(images.width, images.height, images.plane(ALPHA_PLANE).to_vec()))
    }

    /// Returns the pixels of a view with this depth that the endoscope did not see on frame `i`,
    /// whose depth is `recorded_depth`.
    pub fn unseen(
        &self,
        view: &SceneView,
        depth: &Grid<f32>,
        i: usize,
        recorded_depth: &Grid<f32>,
    ) -> Result<Mask> {
        let recorded = self.view(i)?.camera;
        Ok(unseen((&view.camera, depth), (&recorded, recorded_depth), &self.scene.field_of_view))
    }
}
