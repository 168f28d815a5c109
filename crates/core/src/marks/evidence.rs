//! Verdicts of the marks on a frame, pixel by pixel.

use super::{Mark, Marks};
use crate::scene::Scene;
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::Range,
};

/// Evidence of the marks on one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// The frame.
    pub frame: usize,
    /// Verdicts of each pixel, [pixels][names]: 1 for names that it shows, −1 for names that it does not,
    /// 0 where the marks say nothing or as much for as against.
    verdicts: Vec<i8>,
    num_names: usize,
}

impl Evidence {
    /// Sums up the marks on a frame. `names` are those that count, in the order of the verdicts.
    pub fn of(marks: &Marks, frame: usize, names: &[String], [width, height]: [usize; 2]) -> Self {
        let num_names = names.len();
        let mut votes = vec![0_i32; width * height * num_names];
        for mark in marks.on(frame) {
            let Some(k) = names.iter().position(|name| *name == mark.name) else { continue };
            let vote = if mark.add { 1 } else { -1 };
            let pixels = mark.shape.pixels(width, height);
            for (i, _) in pixels.data.iter().enumerate().filter(|(_, is_marked)| **is_marked) {
                votes[i * num_names + k] += vote;
            }
        }
        Self { frame, verdicts: votes.iter().map(|v| v.signum() as i8).collect(), num_names }
    }

    /// Sums up all marks, by frame: those frames on which they say something.
    pub(super) fn of_all(marks: &Marks, names: &[String], scene: &Scene) -> BTreeMap<usize, Self> {
        let size = scene.cameras.first().map_or([0; 2], |c| [c.width as usize, c.height as usize]);
        let each = marks.frames().into_iter().map(|frame| (frame, Self::of(marks, frame, names, size)));
        each.filter(|(_, evidence)| !evidence.is_empty()).collect()
    }

    /// Sums up the marks that grow to whole structures, by frame: clicks and strokes. Outlines decide
    /// their own pixels alone, but for names that no click or stroke shows.
    /// `all` is the evidence of all marks. Returns the frames, too, on which clicks or strokes say something.
    pub(super) fn of_growing(
        marks: &Marks,
        all: &BTreeMap<usize, Self>,
        names: &[String],
        scene: &Scene,
    ) -> (BTreeMap<usize, Self>, BTreeSet<usize>) {
        if !marks.all().iter().any(|mark| mark.shape.is_outlined()) {
            return (all.clone(), all.keys().copied().collect());
        }
        let pointed = Self::of_all(&marks.filtered(|mark| !mark.shape.is_outlined()), names, scene);
        let is_pointed_at = |k: usize| pointed.values().any(|evidence| evidence.shows(k));
        let outlined: Vec<&String> =
            names.iter().enumerate().filter(|(k, _)| !is_pointed_at(*k)).map(|(_, name)| name).collect();
        let grows = |mark: &Mark| !mark.shape.is_outlined() || outlined.contains(&&mark.name);
        let mut growing = Self::of_all(&marks.filtered(grows), names, scene);
        growing.iter_mut().for_each(|(frame, evidence)| evidence.agree_with(all.get(frame)));
        growing.retain(|_, evidence| !evidence.is_empty());
        (growing, pointed.into_keys().collect())
    }

    /// Takes back verdicts that others do not share: an outline can erase a stroke.
    fn agree_with(&mut self, other: Option<&Self>) {
        for (i, verdict) in self.verdicts.iter_mut().enumerate() {
            if other.is_none_or(|other| other.verdicts[i] != *verdict) {
                *verdict = 0;
            }
        }
    }

    /// Returns what is said of name `k` alone. Pixels that show other names do not show it.
    pub(super) fn alone(&self, k: usize) -> Self {
        let verdict = |i: usize| match self.at(i, k) {
            (0.0, _) => 0,
            (_, share) => {
                if share > 0.0 {
                    1
                } else {
                    -1
                }
            }
        };
        let num_pixels = self.verdicts.len() / self.num_names.max(1);
        Self { frame: self.frame, verdicts: (0..num_pixels).map(verdict).collect(), num_names: 1 }
    }

    /// Returns `true` if some pixel shows name `k`.
    pub(super) fn shows(&self, k: usize) -> bool {
        self.verdicts.iter().skip(k).step_by(self.num_names).any(|verdict| *verdict > 0)
    }

    /// Returns the name that pixel `i` shows, if it shows one.
    pub(super) fn shown_at(&self, i: usize) -> Option<usize> {
        self.verdicts[i * self.num_names..(i + 1) * self.num_names].iter().position(|verdict| *verdict > 0)
    }

    /// Returns `true` if the marks say nothing of any pixel.
    pub fn is_empty(&self) -> bool {
        self.verdicts.iter().all(|v| *v == 0)
    }

    /// Returns the weight (0 or 1) and the share (0–1) of name `k` at pixel `i`. A pixel that shows some names
    /// is shared by them, and shows no other.
    pub fn at(&self, i: usize, k: usize) -> (f32, f32) {
        let verdicts = &self.verdicts[i * self.num_names..(i + 1) * self.num_names];
        let shown = verdicts.iter().filter(|v| **v > 0).count();
        match (verdicts[k], shown) {
            (1, shown) => (1.0, 1.0 / shown as f32),
            (_, 1..) | (-1, 0) => (1.0, 0.0),
            _ => (0.0, 0.0),
        }
    }

    /// Returns the pixels that marks say something of.
    pub(super) fn pixels(&self) -> impl Iterator<Item = usize> {
        let pixels = self.verdicts.chunks_exact(self.num_names.max(1)).enumerate();
        pixels.filter(|(_, verdicts)| verdicts.iter().any(|v| *v != 0)).map(|(i, _)| i)
    }

    /// Returns the pixels whose label is decided: marks show a name there, or deny every name.
    pub(super) fn decided(&self) -> impl Iterator<Item = usize> {
        let is_decided = |verdicts: &[i8]| verdicts.iter().any(|v| *v > 0) || verdicts.iter().all(|v| *v < 0);
        let pixels = self.verdicts.chunks_exact(self.num_names.max(1)).enumerate();
        pixels.filter(move |(_, verdicts)| is_decided(verdicts)).map(|(i, _)| i)
    }

    /// Returns weight and share planes of some names: [names][pixels] each.
    pub(super) fn planes(&self, names: Range<usize>) -> (Vec<f32>, Vec<f32>) {
        let pixels = self.verdicts.len() / self.num_names.max(1);
        let plane = |k: usize| (0..pixels).map(move |i| self.at(i, k)).unzip::<f32, f32, Vec<_>, Vec<_>>();
        let planes: Vec<(Vec<f32>, Vec<f32>)> = names.into_par_iter().map(plane).collect();
        let (weights, shares): (Vec<_>, Vec<_>) = planes.into_iter().unzip();
        (weights.concat(), shares.concat())
    }
}
