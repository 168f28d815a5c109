//! Structures that come back: a name that is not seen between two chapters may be seen later in the second.
//! It is found by its looks, and marked there by a mask.

use super::{
    Evidence, Mark, Marks,
    carried::Pictures,
    cells::{Alike, Example, Squares},
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

/// Largest distance of the frames that are looked at, and their least number.
const EVERY: usize = 12;
const FEWEST: usize = 4;
/// Least area of what is found, without its border, squares; and as a part of that on the marked frame.
const LEAST_SQUARES: usize = 8;
const LEAST_PART: f32 = 0.15;
/// Part of the area on the marked frame below which a name has left the view.
const REST: f32 = 0.05;

/// Marked frames as examples of looks, as far as they were needed.
#[derive(Clone, Debug, Default)]
pub(super) struct Examples {
    by_frame: BTreeMap<usize, Arc<Example>>,
    /// Marks of names that were looked for, by the first frame where, the name, and the frame of the example.
    found: BTreeMap<(usize, String, usize), Vec<Mark>>,
}

/// Marks by hand on a scene.
#[derive(Clone, Copy)]
pub(super) struct ByHand<'a> {
    pub(super) scene: &'a Scene,
    /// All of them, which tell what outlines deny.
    pub(super) all: &'a Marks,
    /// Those on frames that may be examples.
    pub(super) heard: &'a Marks,
}

impl Examples {
    /// Drops examples of frames whose marks have changed, and what was found by them.
    pub(super) fn retain(&mut self, is_same: impl Fn(usize) -> bool) {
        self.by_frame.retain(|frame, _| is_same(*frame));
        self.found.retain(|(_, _, frame), _| is_same(*frame));
    }

    /// Returns the marked frame that is nearest to some frames, of those that show a name, and something else or
    /// what it is not: by itself, nothing tells what it looks unlike.
    fn nearest(ByHand { scene, all, heard }: ByHand<'_>, name: &str, frames: &Range<usize>) -> Option<usize> {
        let outlined = all.outlined(scene);
        let tells = |frame: &usize| {
            names_on(heard, *frame).len() > 1
                || heard.on(*frame).any(|mark| !mark.add)
                || outlined.contains(&(name.to_owned(), *frame))
        };
        let shown = heard.all().iter().filter(|mark| mark.add && mark.name == name).map(|mark| mark.frame);
        let shown = shown.filter(tells);
        shown.min_by_key(|frame| frame.abs_diff(frames.start).min(frame.abs_diff(frames.end)))
    }

    /// Returns a marked frame as an example of the names on it.
    fn on(
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

    /// Removes from the marks of a chapter what is left of names that have all but left the view.
    ///
    /// # Errors
    /// A picture that cannot be read.
    pub(super) fn without_rests(
        &mut self,
        marks: Vec<Mark>,
        by_hand: ByHand<'_>,
        frames: &Range<usize>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Mark>> {
        let mut kept = Vec::new();
        for mark in marks {
            let nearest = mark.add.then(|| Self::nearest(by_hand, &mark.name, frames)).flatten();
            let is_rest = match nearest {
                Some(frame) => {
                    let example = self.on(frame, by_hand, pictures)?;
                    let camera = by_hand.scene.cameras[mark.frame];
                    let area = mark.shape.pixels(camera.width as usize, camera.height as usize).count();
                    let shown =
                        place_of(&mark.name, by_hand.heard, frame).map(|place| example.area_px(place));
                    (area as f32) < REST * shown.unwrap_or(0) as f32
                }
                None => false,
            };
            kept.extend((!is_rest).then_some(mark));
        }
        Ok(kept)
    }

    /// Looks for names on some of the `frames` of the chapter that `scene` holds. Returns masks of each name that
    /// is found, and of what is not it, on that frame which shows most of it.
    ///
    /// # Errors
    /// A picture that cannot be read.
    pub(super) fn found_again(
        &mut self,
        names: &[String],
        by_hand: ByHand<'_>,
        frames: &Range<usize>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Mark>> {
        let (scene, mut sought, mut marks) = (by_hand.scene, Vec::new(), Vec::new());
        for name in names {
            let Some(frame) = Self::nearest(by_hand, name, frames) else { continue };
            if let Some(known) = self.found.get(&(frames.start, name.clone(), frame)) {
                marks.extend(known.iter().cloned());
                continue;
            }
            let Some(place) = place_of(name, by_hand.heard, frame) else { continue };
            let example = self.on(frame, by_hand, pictures)?;
            let Some(own) = example.own(&scene.field_of_view) else { continue };
            let own = without_border(&own[place].shows, 1).count();
            let least = LEAST_SQUARES.max((LEAST_PART * own as f32) as usize);
            sought.push(Sought { name, place, frame, example, least, best: None });
        }
        if sought.is_empty() {
            return Ok(marks);
        }
        let step = (frames.len() / FEWEST).clamp(1, EVERY);
        for frame in frames.clone().step_by(step) {
            let squares = Squares::of(&pictures(frame)?);
            let mut likes: BTreeMap<usize, Option<Vec<Alike>>> = BTreeMap::new();
            for sought in &mut sought {
                let example = || sought.example.likes(&squares, &scene.field_of_view);
                let Some(likes) = likes.entry(sought.frame).or_insert_with(example) else { continue };
                let found = without_border(&likes[sought.place].shows, sought.least);
                let area = found.count();
                if area > sought.best.as_ref().map_or(0, |(most, ..)| *most) {
                    let denied = without_border(&likes[sought.place].denies, LEAST_SQUARES);
                    sought.best = Some((area, frame, [found, denied]));
                }
            }
        }
        for sought in sought {
            let found = sought.marks(scene);
            marks.extend(found.iter().cloned());
            self.found.insert((frames.start, sought.name.to_owned(), sought.frame), found);
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

/// A name that is looked for.
struct Sought<'a> {
    name: &'a str,
    /// Place among the names of its example.
    place: usize,
    /// The marked frame that is its example.
    frame: usize,
    example: Arc<Example>,
    /// Least area that counts, squares.
    least: usize,
    /// Area, frame, squares that it was found on and those that are something else.
    best: Option<(usize, usize, [Mask; 2])>,
}

impl Sought<'_> {
    /// Returns a mask of what was found, and one of what is something else; none if nothing was found.
    fn marks(&self, scene: &Scene) -> Vec<Mark> {
        let Some((_, frame, squares)) = &self.best else { return Vec::new() };
        let squares = [true, false].into_iter().zip(squares);
        let mark = |(add, squares)| {
            let shape = Shape::from(&pixels(squares, &scene.cameras[*frame]));
            Mark::new(*frame, self.name, add, shape)
        };
        squares.filter(|(_, squares)| squares.data.contains(&true)).map(mark).collect()
    }
}

/// Returns what is left of a mask without its border, in parts of a least area.
fn without_border(mask: &Mask, least: usize) -> Mask {
    let bits = Bits::of(mask.width, mask.height, |i| mask.data[i]);
    remove_small(&bits.eroded().to_mask(), least)
}

/// Returns the pixels of squares.
fn pixels(squares: &Mask, camera: &Camera) -> Mask {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let side = Squares::side_of(camera);
    let data = (0..width * height).map(|i| squares.at(i % width / side, i / width / side)).collect();
    Mask::from_vec(width, height, data)
}
