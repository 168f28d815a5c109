//! The graph of Gaussians that look alike, lie near and move together.

use super::{
    appearance::{Appearance, AppearanceFeatures, opponents},
    links::Links,
};
use crate::{deform::deform, gaussian::SH_C0, scene::Scene};
use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZeroUsize;

/// Numbers by which Gaussians are compared: three projected positions along the path, and a colour.
const DIM: usize = 9;
/// Neighbours of each Gaussian, itself included.
const NEIGHBOURS: usize = 12;
/// Distance at which places weigh e^(−½), px of the first frame.
const PLACE_PX: f32 = 8.0;
/// Difference of the square roots of colours, of 0 to 1, that does so. Roots tell dark tissue apart.
const COLOUR: f32 = 0.05;

/// Neighbours of each Gaussian, with weights of 0 to 1. Symmetric.
#[derive(Clone, Debug, PartialEq)]
pub struct Graph {
    /// Revision of the scene that the graph is of.
    revision: [u64; 2],
    pub(super) links: Links,
    pub(super) appearance: AppearanceFeatures,
}

impl Graph {
    /// Connects each Gaussian with those that are most like it. Two Gaussians that start beside each other
    /// and part are far from each other.
    pub fn of(scene: &Scene) -> Self {
        let points = points(scene);
        let linked = |(i, near): (usize, Vec<(u32, f32)>)| {
            near.into_iter().map(move |(j, distance_2)| (i as u32, j, (-0.5 * distance_2).exp()))
        };
        let links = Links::new(points.len(), nearest(&points).into_iter().enumerate().flat_map(linked));
        Self { revision: scene.revision(), links, appearance: appearance(scene, &points) }
    }

    /// Returns `true` if this is the graph of `scene` as it is now.
    pub fn is_of(&self, scene: &Scene) -> bool {
        self.revision == scene.revision()
    }

    /// Returns the number of Gaussians.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Returns `true` if there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.links.len() == 0
    }
}

/// Returns the numbers by which Gaussians are compared; differences of 1 are those of the constants.
fn points(scene: &Scene) -> Vec<[f32; DIM]> {
    let n = scene.gaussians.len();
    let mut points = vec![[0.0; DIM]; n];
    let shown = scene.frames_here();
    let last = shown.end.saturating_sub(1);
    for (k, frame) in [shown.start, shown.start.midpoint(last), last].into_iter().enumerate() {
        let Some(camera) = scene.cameras.get(frame) else { continue };
        let deformed = deform(&scene.gaussians, &scene.deformation, scene.time(frame), false);
        for (i, point) in points.iter_mut().enumerate() {
            let place = camera.project(Vec3::from(deformed.means[i]));
            let scale = 1.0 / (PLACE_PX * 3.0_f32.sqrt());
            let (u, v) = place.map_or((0.0, 0.0), |(u, v, _)| (u, v));
            (point[2 * k], point[2 * k + 1]) = (finite(u * scale), finite(v * scale));
            for c in 0..3 {
                let root = (0.5 + SH_C0 * deformed.colours[i][c]).max(0.0).sqrt();
                point[6 + c] += finite(root / (3.0 * COLOUR));
            }
        }
    }
    points
}

/// Returns the appearance of the Gaussians; positions are those of the middle frame. Roughness and depth
/// do not count.
fn appearance(scene: &Scene, points: &[[f32; DIM]]) -> AppearanceFeatures {
    let width = scene.cameras.first().map_or(1.0, |camera| camera.width as f32);
    let scale = PLACE_PX * 3.0_f32.sqrt() / width;
    let of_point = |p: &[f32; DIM]| {
        let colour = opponents([6, 7, 8].map(|c| p[c] * COLOUR));
        let position = [2, 3].map(|c| p[c] * scale);
        Appearance { colour, around: colour, roughness: 0.0, position, log_depth: 0.0 }
    };
    AppearanceFeatures::new(points.iter().map(of_point))
}

fn finite(value: f32) -> f32 {
    if value.is_finite() { value.clamp(-1e6, 1e6) } else { 0.0 }
}

/// Returns for each point those nearest to it, without itself, with squared distances.
fn nearest(points: &[[f32; DIM]]) -> Vec<Vec<(u32, f32)>> {
    let Ok(tree) = ImmutableKdTree::<f32, DIM>::new_from_slice(points) else { return Vec::new() };
    let count = NonZeroUsize::new(NEIGHBOURS).unwrap_or(NonZeroUsize::MIN);
    let of = |(i, point): (usize, &[f32; DIM])| {
        let found = tree.query(point).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        let others = found.iter().map(|n| (n.item, n.distance));
        others.filter(|(j, _)| *j as usize != i).collect()
    };
    points.par_iter().enumerate().map(of).collect()
}
