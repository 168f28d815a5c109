//! Corrections of a class that the scene knows by its features.

use super::{
    Evidence, Graph, Marks,
    carried::keep_marked,
    seeds::Seeds,
    seen::Seen,
    spread::{Before, spread},
};
use crate::{camera::Camera, grid::Grid, scene::Scene};
use std::collections::BTreeMap;

/// Pull of the scores before: much larger than without features, so that a correction stays around its mark.
const PULL: f32 = 0.05;

/// Change of the scores of one class.
#[derive(Clone, Debug)]
pub struct Correction {
    /// Change of the score of each Gaussian, −1 to 1.
    change: Vec<f32>,
    evidence: BTreeMap<usize, Evidence>,
}

impl Correction {
    /// Carries marks of one name to the Gaussians, whose scores were `before`.
    pub fn new(scene: &Scene, graph: &Graph, marks: &Marks, before: &[f32]) -> Self {
        let names = marks.names();
        let evidence = Evidence::of_all(marks, &names, scene);
        let seeds = Seeds::of(scene, names.len(), evidence.values());
        let before = [before.to_vec()];
        let change =
            spread(&graph.links, &seeds, Before::Shares(&before), PULL, None).pop().unwrap_or_default();
        Self { change, evidence }
    }

    /// Changes the scores of a view, which shows a recorded `frame` or none.
    pub fn apply(
        &self,
        scene: &Scene,
        (camera, time): (Camera, f32),
        frame: Option<usize>,
        scores: &mut Grid<f32>,
    ) {
        if self.evidence.is_empty() {
            return;
        }
        let blended = Seen::of(scene, camera, time).blend(&self.change, 1);
        let changed = scores.data.iter().zip(blended.value(0)).map(|(s, c)| (s + c).clamp(0.0, 1.0));
        let mut planes = [changed.collect::<Vec<f32>>()];
        if let Some(evidence) = frame.and_then(|frame| self.evidence.get(&frame)) {
            keep_marked(evidence, &mut planes);
        }
        let [plane] = planes;
        scores.data = plane;
    }
}
