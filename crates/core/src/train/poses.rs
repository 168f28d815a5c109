//! Camera poses that are learned together with the Gaussians.

use super::{
    adam::{Adam, WIDTH},
    settings::LearningRates,
};
use crate::camera::{Camera, Twist};
use glam::Affine3A;

/// Poses of all frames and their corrections. Gradients are gathered while frames are visited, and all poses
/// change together when every frame had its turn: it does not matter how late a backend tells gradients.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub(super) struct LearnedPoses {
    /// `camera_from_world` of every frame at the start.
    start: Vec<Affine3A>,
    /// Motion of every frame's camera since then.
    corrections: Vec<[f32; 6]>,
    moments: Adam,
    /// Gradients of the frames visited in this round; those that were not visited have zeros.
    gradients: Vec<[f32; 6]>,
}

impl LearnedPoses {
    pub(super) fn new(start: Vec<Affine3A>) -> Self {
        let n = start.len();
        Self {
            corrections: vec![[0.0; 6]; n],
            moments: Adam::new(6 * n),
            gradients: vec![[0.0; 6]; n],
            start,
        }
    }

    /// Returns `true` if there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.start.is_empty()
    }

    /// Returns `true` if there is as much of everything as there are frames.
    pub(super) fn is_consistent(&self) -> bool {
        let n = self.start.len();
        [self.corrections.len(), self.gradients.len()] == [n; 2]
            && [self.moments.first.len(), self.moments.second.len()] == [6 * n; 2]
    }

    /// Adds the gradients of visited frames. Those that are not finite are left out.
    pub(super) fn gather(&mut self, visited: &[(usize, Twist<f32>)]) {
        for (frame, gradient) in visited {
            let gradient = gradient.to_array();
            let is_finite = gradient.iter().all(|v| v.is_finite());
            if let Some(sum) = self.gradients.get_mut(*frame).filter(|_| is_finite) {
                sum.iter_mut().zip(gradient).for_each(|(total, part)| *total += part);
            }
        }
    }

    /// Moves the cameras of `frames` by what was gathered, and those of the others as their neighbours in
    /// time. `frames` are in ascending order, `times` those of all frames, `rates` from [`rates`].
    pub(super) fn update(&mut self, frames: &[usize], times: &[f32], rates: [f32; 6]) {
        let mut gradients = std::mem::take(&mut self.gradients);
        self.gradients = vec![[0.0; 6]; gradients.len()];
        let is_learned = |i: &usize| frames.binary_search(i).is_ok();
        (0..gradients.len()).filter(|i| !is_learned(i)).for_each(|i| gradients[i] = [0.0; 6]);
        // Adam takes rates in multiples of its own width.
        let rates = [rates; WIDTH / 2];
        let parameters = self.corrections.as_flattened_mut();
        self.moments.step_rows(parameters, gradients.as_flattened(), 1.0, 1.0, rates.as_flattened());
        for i in (0..self.corrections.len()).filter(|i| !is_learned(i)) {
            self.corrections[i] = self.between(frames, times, i);
        }
    }

    /// Correction of frame `i` between those of the frames before and after it.
    fn between(&self, frames: &[usize], times: &[f32], i: usize) -> [f32; 6] {
        let after = frames.partition_point(|frame| *frame < i);
        let [before, after] = [frames.get(after.wrapping_sub(1)), frames.get(after)];
        let (Some(&a), Some(&b)) = (before.or(after), after.or(before)) else { return [0.0; 6] };
        let gap = times[b] - times[a];
        let share = if gap > 0.0 { (times[i] - times[a]) / gap } else { 0.0 };
        let [from, to] = [self.corrections[a], self.corrections[b]];
        std::array::from_fn(|k| from[k] + share * (to[k] - from[k]))
    }

    /// `camera_from_world` of every frame.
    pub(super) fn now(&self) -> Vec<Affine3A> {
        let moved = |(start, by): (&Affine3A, &[f32; 6])| Twist::of(*by).moved(*start);
        self.start.iter().zip(&self.corrections).map(moved).collect()
    }
}

/// Rates of a camera's motion at the share `progress` of training: turns in rad, then shifts in scene units.
pub(super) fn rates(rates: &LearningRates, progress: f32, camera: &Camera, world_per_px: f32) -> [f32; 6] {
    let px = rates.pose * rates.cooldown_at(progress) * rates.final_share.powf(progress);
    let (turn, shift) = (px / camera.fx, px * world_per_px);
    [turn, turn, turn, shift, shift, shift]
}
