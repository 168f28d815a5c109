//! What of a view can be shown besides colours: how far things move, how opaque they are, and what the endoscope did not see.

use super::{Engine, View};
use std::sync::Arc;
use surgtpgs_core::{
    Result,
    deform::{deform, travel_px},
    gaussian::Gaussians,
    grid::{Grid, Mask},
    raster::{ALPHA_PLANE, FEATURE_PLANE, MIN_DEPTH_ALPHA, render_deformed},
    unseen::unseen,
};

/// Times at which the way of a Gaussian is looked at, at most.
const MAX_TIMES: usize = 32;
/// What gets this far moves, px.
const MOVES_PX: f32 = 1.0;

/// The Gaussians with how far they get, in pixels of the first recorded frame, as their only feature.
pub(super) struct Travelling {
    /// Of the scene that they are of.
    fingerprint: u64,
    gaussians: Arc<Gaussians>,
}

/// How far things move.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// How far what a pixel shows gets over the recording, in pixels of the first recorded frame; not a number where nothing is.
    pub travel_px: Grid<f32>,
    /// Gaussians that get a pixel or further.
    pub num_moving: usize,
    /// All of them.
    pub num_gaussians: usize,
}

impl Engine {
    /// How far what a view shows moves over the recording.
    pub fn motion(&mut self, view: &View) -> Motion {
        let gaussians = self.travelling();
        let mut deformed = deform(&gaussians, &self.scene.deformation, view.time, false);
        deformed.features.clone_from(&gaussians.features);
        let images = render_deformed(&gaussians, &deformed, &view.camera);
        let pixels = images.plane(FEATURE_PLANE).iter().zip(images.plane(ALPHA_PLANE));
        let travel =
            pixels.map(|(sum, alpha)| if *alpha >= MIN_DEPTH_ALPHA { sum / alpha } else { f32::NAN });
        Motion {
            travel_px: Grid::from_vec(images.width, images.height, travel.collect()),
            num_moving: gaussians.features.iter().filter(|px| **px >= MOVES_PX).count(),
            num_gaussians: gaussians.len(),
        }
    }

    fn travelling(&mut self) -> Arc<Gaussians> {
        let fingerprint = self.scene.fingerprint();
        if let Some(known) = self.travelling.as_ref().filter(|t| t.fingerprint == fingerprint) {
            return known.gaussians.clone();
        }
        let scene = &self.scene;
        let frames = scene.num_frames();
        let some = frames.min(MAX_TIMES);
        let times: Vec<f32> =
            (0..some).map(|k| scene.time(k * frames.saturating_sub(1) / (some - 1).max(1))).collect();
        let features = scene
            .cameras
            .first()
            .map_or_else(Vec::new, |camera| travel_px(&scene.gaussians, &scene.deformation, camera, &times));
        let gaussians = Arc::new(Gaussians { features, latent_dim: 1, ..scene.gaussians.clone() });
        self.travelling = Some(Travelling { fingerprint, gaussians: gaussians.clone() });
        gaussians
    }

    /// How opaque a view is, 0–1: where it is not, nothing was reconstructed.
    pub fn opacity(&mut self, view: &View) -> Result<Grid<f32>> {
        let images = self.render(view, false)?;
        Ok(Grid::from_vec(images.width, images.height, images.plane(ALPHA_PLANE).to_vec()))
    }

    /// Where a view with this depth shows what the endoscope did not see on frame `i`, whose depth is `recorded_depth`.
    pub fn unseen(
        &self,
        view: &View,
        depth: &Grid<f32>,
        i: usize,
        recorded_depth: &Grid<f32>,
    ) -> Result<Mask> {
        let recorded = self.view(i)?.camera;
        Ok(unseen((&view.camera, depth), (&recorded, recorded_depth), &self.scene.field_of_view))
    }
}
