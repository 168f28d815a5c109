//! Marks of a scene in chapters: from one chapter to the next, what was marked is handed on as masks of the
//! frame between them.

use super::{Carried, CarrySettings, Graph, Mark, Marks, again::Examples, carried::Pictures};
use crate::{
    Result,
    annotations::Shape,
    grid::{Grid, Mask},
    scene::{Chapter, Scene},
};
use std::{collections::BTreeMap, sync::Arc};

/// Score above which a pixel of the frame between chapters shows a name.
const SHOWN: f32 = 0.5;

/// Marks of each chapter, as far as they were needed.
#[derive(Clone, Debug, Default)]
pub struct Handed {
    by_chapter: BTreeMap<usize, Marks>,
    examples: Examples,
}

impl Handed {
    /// Returns the marks that count in the chapter that `scene` holds: those on its frames and, of names that are
    /// marked in other chapters alone, masks of the first or the last frame, wherever the two chapters of a frame
    /// are not parted by a cut; of those that are not seen there, masks of what looks like them later. A scene
    /// that is one whole keeps all marks.
    ///
    /// # Errors
    /// A chapter or a picture that cannot be read.
    pub fn marks(&mut self, scene: &Scene, all: &Marks, pictures: &mut Pictures<'_>) -> Result<Marks> {
        match scene.chapters.current() {
            Some(chapter) => self.of_chapter(scene, chapter.index, all, pictures),
            None if scene.chapters.is_empty() => Ok(all.clone()),
            None => Ok(Marks::default()),
        }
    }

    fn of_chapter(
        &mut self,
        scene: &Scene,
        index: usize,
        all: &Marks,
        pictures: &mut Pictures<'_>,
    ) -> Result<Marks> {
        if let Some(known) = self.by_chapter.get(&index) {
            return Ok(known.clone());
        }
        let chapters: Vec<Chapter> = scene.chapters.iter().cloned().collect();
        let Some(place) = chapters.iter().position(|chapter| chapter.index == index) else {
            return Ok(Marks::default());
        };
        let mut marks = all.within(&chapters[place].learned);
        let mut missing = all.names();
        missing.retain(|name| !marks.names().contains(name));
        let mut handed = Vec::new();
        for (beside, names) in givers(all, &chapters, place, missing) {
            let (here, there) = (&chapters[place], &chapters[beside]);
            let between = if beside < place { here.shown.start } else { here.shown.end - 1 };
            if !there.learned.contains(&between) {
                continue;
            }
            let given = self.of_chapter(scene, there.index, all, pictures)?;
            let given = given.filtered(|mark| names.contains(&mark.name));
            handed.extend(on_frame(&scene.of_chapter(there.index)?, &given, between, pictures)?);
        }
        let (frames, by_hand) = (&chapters[place].shown, (scene, all));
        let handed = self.examples.without_rests(handed, by_hand, frames, pictures)?;
        // Names that came this far, and are not seen where they came from.
        let handed = Marks { marks: handed };
        let is_seen = |name: &String| handed.all().iter().any(|mark| mark.add && mark.name == *name);
        let mut unseen = handed.names();
        unseen.retain(|name| !is_seen(name) && !is_known(scene, name));
        marks.marks.extend(handed.marks);
        marks.marks.extend(self.examples.found_again(&unseen, by_hand, frames, pictures)?);
        self.by_chapter.insert(index, marks.clone());
        Ok(marks)
    }
}

/// Returns `true` if a scene finds a name by its features.
fn is_known(scene: &Scene, name: &str) -> bool {
    scene.codec.is_some() && scene.classes.iter().any(|(class, _)| class.name == name)
}

/// Returns the neighbours, by their place among the chapters, that names come from: those on the way to the
/// nearest chapter where the name is marked.
fn givers(
    all: &Marks,
    chapters: &[Chapter],
    place: usize,
    names: Vec<String>,
) -> BTreeMap<usize, Vec<String>> {
    let mut givers: BTreeMap<usize, Vec<String>> = BTreeMap::new();
    for name in names {
        let is_marked =
            |k: &usize| all.within(&chapters[*k].learned).all().iter().any(|mark| mark.name == name);
        let nearest = (0..chapters.len()).filter(is_marked).min_by_key(|k| k.abs_diff(place));
        if let Some(nearest) = nearest.filter(|k| *k != place) {
            let beside = if nearest < place { place - 1 } else { place + 1 };
            givers.entry(beside).or_default().push(name);
        }
    }
    givers
}

/// Carries marks to a frame and returns masks of what is found there, and of what is not.
fn on_frame(scene: &Scene, marks: &Marks, frame: usize, pictures: &mut Pictures<'_>) -> Result<Vec<Mark>> {
    if marks.is_empty() {
        return Ok(Vec::new());
    }
    let graph = Arc::new(Graph::of(scene));
    let mut carried = Carried::new(scene, graph, marks, CarrySettings::default());
    let found = carried.on_frame(scene, frame, pictures)?;
    let mut handed = Vec::new();
    for (name, scores) in carried.names().iter().zip(&found.scores) {
        for add in [true, false] {
            let mask = mask(scores, &scene.field_of_view, add);
            if mask.data.contains(&true) {
                handed.push(Mark::new(frame, name, add, Shape::from(&mask)));
            }
        }
    }
    Ok(handed)
}

/// Pixels inside the field of view that show a name, or that do not.
fn mask(scores: &Grid<f32>, field_of_view: &Mask, shows: bool) -> Mask {
    let inside = scores.data.iter().zip(&field_of_view.data);
    let data = inside.map(|(score, seen)| *seen && (*score > SHOWN) == shows).collect();
    Mask::from_vec(scores.width, scores.height, data)
}
