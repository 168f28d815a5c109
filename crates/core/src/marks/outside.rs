//! Outlines end where their structure ends: what lies outside of them is denied.

use super::{Mark, Marks};
use crate::{annotations::Shape, grid::Mask, mask::Bits, scene::Scene};
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::Range,
};

/// Least area of a structure's outlines on a frame, as a part of its largest one on any. Smaller ones add a
/// piece, and say nothing of the rest of the structure.
const LEAST_PART: f32 = 0.5;
/// Number of columns of a picture for each pixel of the band around outlines that is left open: they are
/// drawn by hand.
const COLUMNS_PER_BAND_PX: usize = 80;

impl Marks {
    /// Adds what outlines on `frames` deny. Where polygons, boxes and masks alone show a name that the scene does
    /// not find by its features, they show all of it on their frame: the rest of the frame, but for a band around
    /// them, does not show it.
    pub fn with_outsides(&self, scene: &Scene, frames: &Range<usize>) -> Self {
        let Some(camera) = scene.cameras.first() else { return self.clone() };
        let size = [camera.width, camera.height].map(|side| side as usize);
        let mut outlined = self.outlined(scene);
        outlined.retain(|(_, frame)| frames.contains(frame));
        let denied = outlined.into_par_iter().filter_map(|(name, frame)| {
            let shown = shown(&self.filtered(|mark| mark.frame == frame && mark.name == name), size);
            let outside = outside(&shown);
            let is_some = shown.data.contains(&true) && outside.data.contains(&true);
            is_some.then(|| Mark::new(frame, &name, false, Shape::from(&outside)))
        });
        let denied: Vec<Mark> = denied.collect();
        Self::unchecked(self.standing().cloned().chain(denied).collect())
    }

    /// Returns the names that outlines show all of, with the frame.
    pub(super) fn outlined(&self, scene: &Scene) -> BTreeSet<(String, usize)> {
        let mut outlined = BTreeSet::new();
        for name in self.names().into_iter().filter(|name| !scene.finds(name)) {
            let shown = || self.standing().filter(|mark| mark.add && mark.name == name);
            if shown().any(|mark| !mark.shape.is_outlined()) {
                continue;
            }
            let mut areas: BTreeMap<usize, f32> = BTreeMap::new();
            shown().for_each(|mark| *areas.entry(mark.frame).or_default() += mark.shape.area_px());
            let largest = areas.values().copied().fold(0.0, f32::max);
            let complete = areas.into_iter().filter(|(_, area)| *area >= LEAST_PART * largest);
            outlined.extend(complete.map(|(frame, _)| (name.clone(), frame)));
        }
        outlined
    }
}

/// Returns the pixels that all marks of one name on one frame show.
fn shown(own: &Marks, [width, height]: [usize; 2]) -> Mask {
    let mut shown = Mask::filled(width, height, false);
    for add in [true, false] {
        for mark in own.all().iter().filter(|mark| mark.add == add) {
            let pixels = mark.shape.pixels(width, height).data.into_iter().enumerate();
            pixels.filter(|(_, is_marked)| *is_marked).for_each(|(i, _)| shown.data[i] = add);
        }
    }
    shown
}

/// Returns the pixels outside of a mask and the band around it.
fn outside(mask: &Mask) -> Mask {
    let mut covered = Bits::of_mask(mask);
    for _ in 0..mask.width / COLUMNS_PER_BAND_PX {
        covered = covered.dilated();
    }
    covered.to_mask().map(|covered| !covered)
}
