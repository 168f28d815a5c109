//! Corrections of what the scene finds by its features: its classes or, without a list of classes, the words
//! that name a mark.

use super::{
    Evidence, Graph, Mark, Marks,
    carried::keep_marked,
    frame_splats::FrameSplats,
    seeds::Seeds,
    spread::{Before, spread},
};
use crate::{Result, camera::Camera, grid::Grid, scene::Scene};
use std::{collections::BTreeMap, sync::Arc};

/// Pull of no change: much larger than without features, so that a correction stays around its mark.
const PULL: f32 = 0.05;

/// Gives the scores of a name on a frame, as they are before they are corrected.
pub type ScoresBefore<'a> = dyn FnMut(&str, usize) -> Result<Arc<Grid<f32>>> + 'a;

/// Change of the scores of one name.
#[derive(Clone, Debug)]
pub struct Correction {
    /// Change of the score of each Gaussian, −1 to 1.
    change: Vec<f32>,
    evidence: BTreeMap<usize, Evidence>,
}

impl Correction {
    /// Carries marks of what the scene finds to the Gaussians, and returns the correction of each name. Pixels
    /// whose score is above `threshold` show it before. Where marks say the same, nothing is to change.
    ///
    /// # Errors
    /// Scores that cannot be had.
    pub fn of_names(
        scene: &Scene,
        graph: &Graph,
        marks: &Marks,
        threshold: f32,
        before: &mut ScoresBefore<'_>,
    ) -> Result<BTreeMap<String, Self>> {
        let names = marks.names();
        let all = Evidence::of_all(marks, &names, scene);
        let mut asked: Vec<(Seeds, BTreeMap<usize, Evidence>)> =
            names.iter().map(|_| (Seeds::none(scene, 1), BTreeMap::new())).collect();
        // Frame by frame, so that the scores of all names come from one picture.
        for (frame, evidence) in all {
            for (k, (name, (seeds, of_name))) in names.iter().zip(&mut asked).enumerate() {
                let own = evidence.alone(k);
                if own.is_empty() {
                    continue;
                }
                let scores = before(name, frame)?;
                let planes = changes(&own, &scores, threshold, is_outlined(marks, frame, name));
                seeds.add_pixels(scene, scene.cameras[frame], scene.time(frame), |_| planes.clone());
                of_name.insert(frame, own);
            }
        }
        let correction = |(name, (seeds, evidence)): (String, (Seeds, BTreeMap<usize, Evidence>))| {
            let change = spread(&graph.links, &seeds, Before::Nothing, PULL, None).pop().unwrap_or_default();
            (name, Self { change, evidence })
        };
        Ok(names.into_iter().zip(asked).map(correction).collect())
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
        let blended = FrameSplats::of(scene, camera, time).blend(&self.change, 1);
        let changed = scores.data.iter().zip(blended.value(0)).map(|(s, c)| (s + c).clamp(0.0, 1.0));
        let mut planes = [changed.collect::<Vec<f32>>()];
        if let Some(evidence) = frame.and_then(|frame| self.evidence.get(&frame)) {
            keep_marked(evidence, &mut planes);
        }
        let [plane] = planes;
        scores.data = plane;
    }

    /// Changes the score of each Gaussian.
    pub fn apply_to_gaussians(&self, scores: &mut [f32]) {
        if !self.evidence.is_empty() {
            scores.iter_mut().zip(&self.change).for_each(|(s, c)| *s = (*s + c).clamp(0.0, 1.0));
        }
    }
}

/// Returns `true` if outlines alone mark a name on a frame, or, where nothing marks it, all others.
fn is_outlined(marks: &Marks, frame: usize, name: &str) -> bool {
    let (of_name, others): (Vec<&Mark>, Vec<&Mark>) = marks.on(frame).partition(|mark| mark.name == name);
    let deciding = if of_name.is_empty() { others } else { of_name };
    deciding.iter().all(|mark| mark.shape.is_outlined())
}

/// Returns the weight of each pixel, and the change of its score that the marks ask for. Outlines say on
/// their frame how far the change goes; strokes grow.
fn changes(
    evidence: &Evidence,
    scores: &Grid<f32>,
    threshold: f32,
    is_outlined: bool,
) -> (Vec<f32>, Vec<f32>) {
    let change = |(weight, (share, score)): (f32, (f32, &f32))| match weight {
        0.0 => (f32::from(u8::from(is_outlined)), 0.0),
        _ if (share > 0.0) == (*score > threshold) => (weight, 0.0),
        _ => (weight, share - score),
    };
    let (weights, shares) = evidence.planes(0..1);
    weights.into_iter().zip(shares.into_iter().zip(&scores.data)).map(change).unzip()
}
