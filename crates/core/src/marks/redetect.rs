//! Re-detection of structures: a name that is not seen on the frame between two chapters may be seen later in
//! the second one. It is found there by its appearance, and marked by a mask.

use super::{
    Evidence, Mark, Marks,
    carried::Pictures,
    cells::{CellFeatures, Example, Match},
};
use crate::{
    Result,
    annotations::Shape,
    camera::Camera,
    grid::Mask,
    mask::{Bits, remove_small},
    scene::Scene,
};
use std::{collections::BTreeMap, ops::Range, sync::Arc};

/// Largest distance between the frames that are searched, and their smallest number.
const MAX_FRAME_STEP: usize = 12;
const MIN_FRAMES: usize = 4;
/// Smallest area of a match without its border, cells; and as a part of that on the marked frame.
const MIN_CELLS: usize = 8;
const MIN_PART: f32 = 0.15;
/// Part of the area on the marked frame below which a name counts as vanished.
const VANISHED_PART: f32 = 0.05;

/// Marked frames as examples of appearance, as far as they were needed.
#[derive(Clone, Debug, Default)]
pub(super) struct Examples {
    by_frame: BTreeMap<usize, Arc<Example>>,
    /// Marks of re-detected names, by the first frame searched, the name, and the frame of the example.
    found: BTreeMap<(usize, String, usize), Vec<Mark>>,
}

/// Marks by hand on a scene.
#[derive(Clone, Copy)]
pub(super) struct ByHand<'a> {
    pub(super) scene: &'a Scene,
    /// All of them, which decide the pixels that outlines deny.
    pub(super) all: &'a Marks,
    /// Those of the source chapters, on frames that may be examples.
    pub(super) source_marks: &'a Marks,
}

impl Examples {
    /// Drops examples of frames whose marks have changed, and what was found by them.
    pub(super) fn retain(&mut self, is_same: impl Fn(usize) -> bool) {
        self.by_frame.retain(|frame, _| is_same(*frame));
        self.found.retain(|(_, _, frame), _| is_same(*frame));
    }

    /// Returns the marked frame that is nearest to some frames and shows a name. It must also show another
    /// name, or deny this one somewhere: else there is nothing to tell the name apart from.
    fn nearest(
        ByHand { scene, all, source_marks }: ByHand<'_>,
        name: &str,
        frames: &Range<usize>,
    ) -> Option<usize> {
        let outlined = all.outlined(scene);
        let is_example = |frame: &usize| {
            names_on(source_marks, *frame).len() > 1
                || source_marks.on(*frame).any(|mark| !mark.add)
                || outlined.contains(&(name.to_owned(), *frame))
        };
        let shown =
            source_marks.standing().filter(|mark| mark.add && mark.name == name).map(|mark| mark.frame);
        let shown = shown.filter(is_example);
        shown.min_by_key(|frame| frame.abs_diff(frames.start).min(frame.abs_diff(frames.end)))
    }

    /// Returns a marked frame as an example of the names on it.
    fn example(
        &mut self,
        frame: usize,
        ByHand { scene, all, .. }: ByHand<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Arc<Example>> {
        if let Some(known) = self.by_frame.get(&frame) {
            return Ok(known.clone());
        }
        let picture = pictures(frame)?;
        let size = [picture.width(), picture.height()].map(|side| side as usize);
        let names = names_on(all, frame);
        let all = all.with_outsides(scene, &(frame..frame + 1));
        let evidence = Evidence::of(&all, frame, &names, size);
        let example = Arc::new(Example::of(&picture, &scene.field_of_view, &evidence, names.len()));
        self.by_frame.insert(frame, example.clone());
        Ok(example)
    }

    /// Removes masks of names that have all but left the view from the marks of a chapter.
    ///
    /// # Errors
    /// A picture that cannot be read.
    pub(super) fn drop_vanished(
        &mut self,
        marks: Vec<Mark>,
        by_hand: ByHand<'_>,
        frames: &Range<usize>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Mark>> {
        let mut kept = Vec::new();
        for mark in marks {
            let nearest = mark.add.then(|| Self::nearest(by_hand, &mark.name, frames)).flatten();
            let is_vanished = match nearest {
                Some(frame) => {
                    let example = self.example(frame, by_hand, pictures)?;
                    let camera = by_hand.scene.cameras[mark.frame];
                    let area = mark.shape.pixels(camera.width as usize, camera.height as usize).count();
                    let shown =
                        place_of(&mark.name, by_hand.source_marks, frame).map(|place| example.area_px(place));
                    (area as f32) < VANISHED_PART * shown.unwrap_or(0) as f32
                }
                None => false,
            };
            kept.extend((!is_vanished).then_some(mark));
        }
        Ok(kept)
    }

    /// Searches some of the `frames` of the chapter that `scene` holds for names. Returns two masks of each
    /// name that is found, on the frame that shows most of it: its pixels, and those of something else.
    ///
    /// # Errors
    /// A picture that cannot be read.
    pub(super) fn redetect(
        &mut self,
        names: &[String],
        by_hand: ByHand<'_>,
        frames: &Range<usize>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Mark>> {
        let (scene, mut targets, mut marks) = (by_hand.scene, Vec::new(), Vec::new());
        for name in names {
            let Some(frame) = Self::nearest(by_hand, name, frames) else { continue };
            if let Some(known) = self.found.get(&(frames.start, name.clone(), frame)) {
                marks.extend(known.iter().cloned());
                continue;
            }
            let Some(place) = place_of(name, by_hand.source_marks, frame) else { continue };
            let example = self.example(frame, by_hand, pictures)?;
            let Some(own) = example.match_itself(&scene.field_of_view) else { continue };
            let own_area = without_border(&own[place].positive, 1).count();
            let min_area = MIN_CELLS.max((MIN_PART * own_area as f32) as usize);
            targets.push(Target { name, place, frame, example, min_area, best: None });
        }
        if targets.is_empty() {
            return Ok(marks);
        }
        let step = (frames.len() / MIN_FRAMES).clamp(1, MAX_FRAME_STEP);
        for frame in frames.clone().step_by(step) {
            let cells = CellFeatures::of(&pictures(frame)?, None);
            let mut matches: BTreeMap<usize, Option<Vec<Match>>> = BTreeMap::new();
            for target in &mut targets {
                let compare = || target.example.match_picture(&cells, &scene.field_of_view);
                let Some(matches) = matches.entry(target.frame).or_insert_with(compare) else { continue };
                let found = without_border(&matches[target.place].positive, target.min_area);
                let area = found.count();
                if area > target.best.as_ref().map_or(0, |(most, ..)| *most) {
                    let denied = without_border(&matches[target.place].negative, MIN_CELLS);
                    target.best = Some((area, frame, [found, denied]));
                }
            }
        }
        for target in targets {
            let found = target.marks(scene);
            marks.extend(found.iter().cloned());
            self.found.insert((frames.start, target.name.to_owned(), target.frame), found);
        }
        Ok(marks)
    }
}

/// Returns the names on a marked frame, sorted.
fn names_on(all: &Marks, frame: usize) -> Vec<String> {
    all.within(&(frame..frame + 1)).names()
}

/// Returns the place of a name among those on a marked frame.
fn place_of(name: &str, all: &Marks, frame: usize) -> Option<usize> {
    names_on(all, frame).iter().position(|other| other == name)
}

/// A name that is searched for.
struct Target<'a> {
    name: &'a str,
    /// Place among the names of its example.
    place: usize,
    /// The marked frame that is its example.
    frame: usize,
    example: Arc<Example>,
    /// Smallest area of a match, cells.
    min_area: usize,
    /// Area, frame, cells where the name was found, and cells of something else.
    best: Option<(usize, usize, [Mask; 2])>,
}

impl Target<'_> {
    /// Returns a mask of the name, and one of something else; no mask if the name was not found.
    fn marks(&self, scene: &Scene) -> Vec<Mark> {
        let Some((_, frame, masks)) = &self.best else { return Vec::new() };
        let masks = [true, false].into_iter().zip(masks);
        let mark = |(add, cells)| {
            let shape = Shape::from(&pixels(cells, &scene.cameras[*frame]));
            Mark::new(*frame, self.name, add, shape)
        };
        masks.filter(|(_, cells)| cells.data.contains(&true)).map(mark).collect()
    }
}

/// Returns a mask without its border and without parts of less than `min_area`.
fn without_border(mask: &Mask, min_area: usize) -> Mask {
    let bits = Bits::of_mask(mask);
    remove_small(&bits.eroded().to_mask(), min_area)
}

/// Returns the pixels of cells.
fn pixels(cells: &Mask, camera: &Camera) -> Mask {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let side = CellFeatures::side_of(camera);
    let data = (0..width * height).map(|i| cells.at(i % width / side, i / width / side)).collect();
    Mask::from_vec(width, height, data)
}
