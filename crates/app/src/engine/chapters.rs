//! The chapters of a long scene, of which an engine holds one at a time.

use super::{Engine, Pending, marked::MarksInScene};
use std::{
    ops::{Range, RangeInclusive},
    sync::Arc,
};
use surgtpgs_core::{Result, marks::Graph, scene::Scene};

/// Returns the frames of a shot within `reach` of its frame `i`: scores are smoothed over these.
pub(crate) fn frames_around(i: usize, reach: usize, shot: &Range<usize>) -> RangeInclusive<usize> {
    let last = i.saturating_add(reach).min(shot.end.saturating_sub(1));
    i.saturating_sub(reach).max(shot.start).min(i)..=last.max(i)
}

/// A chapter that was turned from, with its marks.
pub(super) struct TurnedFrom {
    scene: Arc<Scene>,
    carried_marks: Option<MarksInScene>,
    graph: Option<Arc<Graph>>,
}

impl Engine {
    /// Takes the place where another thread tells of requests that wait: carrying marks from one chapter to
    /// another then leaves off with [`surgtpgs_core::Error::Cancelled`], and keeps what it found.
    pub(crate) fn leave_off_for(&mut self, pending: Arc<Pending>) {
        self.pending = pending;
    }

    /// Takes the chapter of a long scene that is shown at `time`.
    pub(crate) fn turn_to(&mut self, time: f32) -> Result<()> {
        if self.scene.is_at(time) {
            return Ok(());
        }
        let next = match self.turned_from.take_if(|other| other.scene.is_at(time)) {
            Some(known) => known,
            None => TurnedFrom { scene: Arc::new(self.scene.at(time)?), carried_marks: None, graph: None },
        };
        // Marks belong to the Gaussians that they were carried to.
        self.turned_from = Some(TurnedFrom {
            scene: std::mem::replace(&mut self.scene, next.scene),
            carried_marks: std::mem::replace(&mut self.carried_marks, next.carried_marks),
            graph: std::mem::replace(&mut self.graph, next.graph),
        });
        Ok(())
    }

    /// Returns `false` if marks have to be carried to another chapter before frame `i` can be asked.
    pub(crate) fn answers_at_once(&self, i: usize) -> bool {
        let time = self.scene.time(i);
        if self.chapter_marks.is_none() || self.scene.chapters.is_empty() {
            return true;
        }
        let near = self.turned_from.as_ref().filter(|other| other.scene.is_at(time));
        let carried_marks = if self.scene.is_at(time) {
            &self.carried_marks
        } else {
            near.map_or(&None, |near| &near.carried_marks)
        };
        carried_marks.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{BackendChoice, EngineOptions, Next};
    use surgtpgs_core::{
        Error,
        marks::{Mark, Marks, Shape},
        scene::Chapter,
        stress,
    };

    /// An ordinary scene of three chapters, of two frames each.
    fn engine() -> Engine {
        let part = |index: usize| {
            let mut part = stress::ordinary(200);
            part.cameras = vec![part.cameras[0]; 6];
            part.times = (0..6).map(|i| i as f32 / 6.0).collect();
            let shown = 2 * index..2 * index + 2;
            let learned = shown.start.saturating_sub(1)..(shown.end + 1).min(6);
            let chapter = Chapter { index, count: 3, shown, learned };
            part.provenance.settings = serde_json::json!({ "chapter": chapter });
            part.as_chapter()
        };
        let scene = (0..3).map(part).fold(None, |earlier, part| Some(Scene::joined(earlier, part)));
        let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
        Engine::new(Arc::new(scene.unwrap()), None, options).unwrap()
    }

    #[test]
    fn frames_around_a_frame_are_of_its_shot() {
        let around = |i, reach| frames_around(i, reach, &(4..9));
        assert_eq!([around(6, 1), around(4, 2), around(8, 9)], [5..=7, 4..=6, 4..=8]);
        assert_eq!((around(5, 0), around(7, usize::MAX)), (5..=5, 4..=8));
        assert_eq!(frames_around(3, 1, &(0..2)), 2..=3, "a frame is always one of those around it");
    }

    #[test]
    fn carrying_marks_leaves_off_for_a_request_elsewhere_and_loses_none() {
        let mut engine = engine();
        let [first, second, last] = [0, 2, 5].map(|i| engine.scene().time(i));
        engine.turn_to(first).unwrap();
        let stroke = |name: &str, points: [[f32; 2]; 2]| {
            Mark::new(0, name, true, Shape::Stroke { points_px: points.to_vec(), radius_px: 2.0 })
        };
        let marks =
            vec![stroke("liver", [[6.0, 6.0], [12.0, 20.0]]), stroke("fat", [[40.0, 30.0], [46.0, 36.0]])];
        let marks = Marks::new(marks, &engine.canvas()).unwrap();
        let pending = Arc::new(Pending::default());
        engine.leave_off_for(pending.clone());
        engine.set_marks(marks.clone()).unwrap();
        engine.carry_marks(first).unwrap();
        pending.set(Next::Frame(0));
        assert!(matches!(engine.carry_marks(last), Err(Error::Cancelled)));
        assert!(engine.scene().is_at(last), "the chapter can be shown");
        assert!(engine.marks() == Some(&marks) && !engine.answers_at_once(5) && engine.answers_at_once(0));
        pending.set(Next::Frame(2));
        engine.carry_marks(second).unwrap();
        assert!(engine.answers_at_once(2) && !engine.answers_at_once(5));
        pending.set(Next::Other);
        let fewer = Marks::new(marks.all()[..1].to_vec(), &engine.canvas()).unwrap();
        engine.set_marks(fewer).unwrap();
        assert!(matches!(engine.carry_marks(second), Err(Error::Cancelled)));
        assert!(matches!(engine.gaussians_found(second), Err(Error::Cancelled)), "old marks answer nothing");
        pending.clear();
        engine.set_marks(marks.clone()).unwrap();
        engine.carry_marks(last).unwrap();
        assert!(engine.answers_at_once(5) && engine.marks() == Some(&marks));
    }
}
