//! Outlines end where their structure ends: what lies outside of them is denied.

use super::{Mark, Marks};
use crate::{annotations::Shape, grid::Mask, mask::Bits, scene::Scene};
use rayon::prelude::*;

/// Least area of a structure's outlines on a frame, as a part of its largest one on any. Smaller ones add a
/// piece, and say nothing of the rest of the structure.
const LEAST_PART: f32 = 0.5;
/// Number of columns of a picture for each pixel of the band around outlines that is left open: they are
/// drawn by hand.
const COLUMNS_PER_BAND_PX: usize = 80;

impl Marks {
    /// Adds what outlines deny. Where polygons, boxes and masks alone show a name that the scene does not find by
    /// its features, they show all of it on their frame: the rest of the frame, but for a band around them, does
    /// not show it.
    pub fn with_outsides(&self, scene: &Scene) -> Self {
        let Some(camera) = scene.cameras.first() else { return self.clone() };
        let size = [camera.width, camera.height].map(|side| side as usize);
        let mut marks = self.marks.clone();
        for name in self.names().into_iter().filter(|name| !scene.finds(name)) {
            let own = self.filtered(|mark| mark.name == name);
            if !own.all().iter().all(|mark| mark.shape.is_outlined() || !mark.add) {
                continue;
            }
            let denied = complete(&own, size).into_iter().filter_map(|frame| {
                let outside = outside(&shown(&own, frame, size));
                let is_some = outside.data.contains(&true);
                is_some.then(|| Mark::new(frame, &name, false, Shape::from(&outside)))
            });
            marks.extend(denied);
        }
        Self { marks }
    }
}

/// Returns the frames on which outlines show all of a name.
fn complete(own: &Marks, size: [usize; 2]) -> Vec<usize> {
    let area = |frame: usize| (frame, shown(own, frame, size).count());
    let areas: Vec<(usize, usize)> = own.frames().into_par_iter().map(area).collect();
    let largest = areas.iter().map(|(_, area)| *area).max().unwrap_or(0);
    let is_complete = |area: usize| area > 0 && area as f32 >= LEAST_PART * largest as f32;
    areas.into_iter().filter(|(_, area)| is_complete(*area)).map(|(frame, _)| frame).collect()
}

/// Returns the pixels that marks of one name show on a frame.
fn shown(own: &Marks, frame: usize, [width, height]: [usize; 2]) -> Mask {
    let mut shown = Mask::filled(width, height, false);
    for add in [true, false] {
        for mark in own.on(frame).filter(|mark| mark.add == add) {
            let pixels = mark.shape.pixels(width, height).data.into_iter().enumerate();
            pixels.filter(|(_, is_marked)| *is_marked).for_each(|(i, _)| shown.data[i] = add);
        }
    }
    shown
}

/// Returns the pixels outside of a mask and the band around it.
fn outside(mask: &Mask) -> Mask {
    let mut covered = Bits::of(mask.width, mask.height, |i| mask.data[i]);
    for _ in 0..mask.width / COLUMNS_PER_BAND_PX {
        covered = covered.dilated();
    }
    covered.to_mask().map(|covered| !covered)
}
