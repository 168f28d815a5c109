//! Marks of a scene in chapters: from one chapter to the next, what was marked is handed on as masks of the
//! frame between them.

use super::{
    Carried, CarrySettings, Graph, Mark, Marks,
    again::{ByHand, Examples},
    carried::Pictures,
};
use crate::{
    Result,
    annotations::Shape,
    grid::{Grid, Mask},
    scene::{Chapter, Scene},
};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

/// Score above which a pixel of the frame between chapters shows a name.
const SHOWN: f32 = 0.5;
/// Number of chapters from a source after which names are looked for anew instead of handed on: errors add up
/// on the way, and no chapter waits for all of a long operation.
const LONGEST: usize = 8;

/// Place of a chapter, and the sources that were heard, in their order.
type Key = (usize, Vec<usize>);

/// Marks of each chapter, as far as they were needed.
///
/// Chapters where names are marked by hand are sources, and one that shows more names comes first. What a
/// source hands on competes with the names of earlier sources alone: so no chapter waits for itself, and one
/// more mark changes little of what is known.
#[derive(Clone, Debug)]
pub struct Handed {
    /// Marks by hand.
    all: Arc<Marks>,
    /// Marks that count in a chapter.
    of: BTreeMap<Key, Marks>,
    /// Masks that a chapter hands on, by their frame.
    on: BTreeMap<(Key, usize), Marks>,
    examples: Examples,
}

/// A scene in chapters, and the marks by hand.
#[derive(Clone, Copy)]
struct Marked<'a> {
    scene: &'a Scene,
    chapters: &'a [Chapter],
    all: &'a Marks,
    /// Names that some mark shows in each chapter, but for the scene's own, which are corrected where they are
    /// marked alone. What a name is not says nothing of where it is.
    names: &'a [BTreeSet<String>],
}

/// Returns the names that some mark shows in each chapter, but for those that the scene finds by itself.
fn names_shown(scene: &Scene, chapters: &[Chapter], all: &Marks) -> Vec<BTreeSet<String>> {
    let mut names = vec![BTreeSet::new(); chapters.len()];
    for mark in all.all().iter().filter(|mark| mark.add && !scene.finds(&mark.name)) {
        for (names, chapter) in names.iter_mut().zip(chapters) {
            if chapter.learned.contains(&mark.frame) && !names.contains(&mark.name) {
                names.insert(mark.name.clone());
            }
        }
    }
    names
}

impl Marked<'_> {
    /// Returns the marks by hand in a chapter.
    fn within(&self, place: usize) -> Marks {
        self.all.within(&self.chapters[place].learned)
    }

    /// Returns the same, with what they deny.
    fn by_hand(&self, place: usize) -> Marks {
        let frames = &self.chapters[place].learned;
        self.all.with_outsides(self.scene, frames).within(frames)
    }

    /// Returns the places of all sources, in their order.
    fn sources(&self) -> Vec<usize> {
        let mut sources: Vec<usize> =
            (0..self.chapters.len()).filter(|k| !self.names[*k].is_empty()).collect();
        sources.sort_by_key(|place| (Reverse(self.names[*place].len()), *place));
        sources
    }

    /// Returns the names that a chapter lacks, by the nearest of the sources that has them, as its number.
    fn lacking(&self, place: usize, sources: &[usize]) -> BTreeMap<usize, Vec<String>> {
        let mut lacking: BTreeMap<usize, Vec<String>> = BTreeMap::new();
        let all: BTreeSet<&String> = sources.iter().flat_map(|source| &self.names[*source]).collect();
        for name in all.into_iter().filter(|name| !self.names[place].contains(*name)) {
            let with_name = (0..sources.len()).filter(|k| self.names[sources[*k]].contains(name));
            if let Some(nearest) = with_name.min_by_key(|k| sources[*k].abs_diff(place)) {
                lacking.entry(nearest).or_default().push(name.clone());
            }
        }
        lacking
    }

    /// Returns the chapters beside one that hand something on to it, each with the sources that it hears.
    fn givers(&self, (place, sources): &Key) -> Vec<Key> {
        let lacking = self.lacking(*place, sources).into_keys();
        let giver = |nearest: usize| {
            let (beside, _) = self.handing(*place, sources[nearest])?;
            Some((beside, sources[..=nearest].to_vec()))
        };
        lacking.filter_map(giver).collect()
    }

    /// Returns the place of the chapter that hands names of a source on to another one, and the frame that both
    /// have; `None` where a cut parts them, and where names are looked for anew.
    fn handing(&self, place: usize, source: usize) -> Option<(usize, usize)> {
        let shown = &self.chapters[place].shown;
        let (beside, frame) =
            if source < place { (place - 1, shown.start) } else { (place + 1, shown.end - 1) };
        let is_handed = !place.abs_diff(source).is_multiple_of(LONGEST);
        (is_handed && self.chapters[beside].learned.contains(&frame)).then_some((beside, frame))
    }
}

impl Handed {
    /// Takes marks by hand.
    pub fn new(marks: &Marks) -> Self {
        let all = Arc::new(marks.clone());
        Self { all, of: BTreeMap::new(), on: BTreeMap::new(), examples: Examples::default() }
    }

    /// Returns the marks by hand.
    pub fn by_hand(&self) -> &Arc<Marks> {
        &self.all
    }

    /// Returns the marks that count in the chapter that `scene` holds: those on its frames and, of names that are
    /// marked in other chapters alone, masks of the first or the last frame, wherever the two chapters of a frame
    /// are not parted by a cut; of those that are not seen there, masks of what looks like them later. A scene
    /// that is one whole keeps all marks. Marks come with what they deny, see [`Marks::with_outsides`].
    ///
    /// # Errors
    /// A chapter or a picture that cannot be read.
    pub fn marks(&mut self, scene: &Scene, pictures: &mut Pictures<'_>) -> Result<Marks> {
        let all = Arc::clone(&self.all);
        let Some(current) = scene.chapters.current() else {
            let whole = || all.with_outsides(scene, &(0..scene.num_frames()));
            return Ok(if scene.chapters.is_empty() { whole() } else { Marks::default() });
        };
        let chapters: Vec<Chapter> = scene.chapters.iter().cloned().collect();
        let names = names_shown(scene, &chapters, &all);
        let marked = Marked { scene, chapters: &chapters, all: &all, names: &names };
        match chapters.iter().position(|chapter| chapter.index == current.index) {
            Some(place) => self.found((place, marked.sources()), marked, pictures),
            None => Ok(Marks::default()),
        }
    }

    /// Finds the marks that count in a chapter, those of chapters that it needs first. An operation of hours has
    /// too many chapters for one to call the next.
    fn found(&mut self, key: Key, marked: Marked<'_>, pictures: &mut Pictures<'_>) -> Result<Marks> {
        if let Some(known) = self.of.get(&key) {
            return Ok(known.clone());
        }
        let mut open = vec![key.clone()];
        while let Some(next) = open.last().cloned() {
            let mut needed = marked.givers(&next);
            needed.retain(|key| !self.of.contains_key(key));
            if needed.is_empty() {
                let marks = self.of(&next, marked, pictures)?;
                self.of.insert(next, marks);
                open.pop();
            }
            open.extend(needed);
        }
        Ok(self.of.get(&key).cloned().unwrap_or_default())
    }

    /// Takes other marks by hand, and keeps what still holds.
    pub fn for_marks(mut self, scene: &Scene, marks: &Marks) -> Self {
        let after = Arc::new(marks.clone());
        let before = std::mem::replace(&mut self.all, Arc::clone(&after));
        let [old, new] = [&before, &after].map(|marks| marks.digests());
        let is_changed = |frame: &usize| old.get(frame) != new.get(frame);
        let mut changed: BTreeSet<usize> = old.keys().chain(new.keys()).copied().filter(is_changed).collect();
        // A larger outline on another frame makes one a piece.
        let [then, now] = [before, after].map(|marks| marks.outlined(scene));
        changed.extend(then.symmetric_difference(&now).map(|(_, frame)| frame));
        let chapters: Vec<&Chapter> = scene.chapters.iter().collect();
        // All chapters on the way from the sources count.
        let holds = |place: usize, sources: &[usize]| {
            let learned = || sources.iter().chain([&place]).filter_map(|k| Some(&chapters.get(*k)?.learned));
            let from = learned().map(|frames| frames.start).min().unwrap_or(0);
            let to = learned().map(|frames| frames.end).max().unwrap_or(0);
            !changed.iter().any(|frame| (from..to).contains(frame))
        };
        self.of.retain(|(place, sources), _| holds(*place, sources));
        self.on.retain(|((place, sources), _), _| holds(*place, sources));
        self.examples.retain(|frame| !changed.contains(&frame));
        self
    }

    /// Returns the marks that count in a chapter: its own, and those of other names that come from `sources`.
    /// Those of its givers have to be known.
    fn of(
        &mut self,
        (place, sources): &Key,
        marked: Marked<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Marks> {
        let mut marks = marked.by_hand(*place);
        for (nearest, names) in marked.lacking(*place, sources) {
            let heard = &sources[..=nearest];
            let given = match marked.handing(*place, sources[nearest]) {
                Some((beside, between)) => self.on((beside, heard.to_vec()), between, marked, pictures)?,
                None => Marks::default(),
            };
            let given = given.filtered(|mark| names.contains(&mark.name));
            marks.marks.extend(self.in_view(*place, (names, given), heard, marked, pictures)?.marks);
        }
        Ok(marks)
    }

    /// Returns masks of all names on a frame that a chapter hands on.
    fn on(
        &mut self,
        key: Key,
        frame: usize,
        marked: Marked<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Marks> {
        let place = (key, frame);
        if let Some(known) = self.on.get(&place) {
            return Ok(known.clone());
        }
        let given = self.of.get(&place.0).cloned().unwrap_or_default();
        let chapter = marked.chapters[place.0.0].index;
        let marks = Marks { marks: on_frame(&marked.scene.of_chapter(chapter)?, &given, frame, pictures)? };
        self.on.insert(place, marks.clone());
        Ok(marks)
    }

    /// Takes the names that a chapter lacks and the marks of them that were handed to it. Replaces those of
    /// names that are not in view by marks of where they come back.
    fn in_view(
        &mut self,
        place: usize,
        (mut names, given): (Vec<String>, Marks),
        sources: &[usize],
        marked: Marked<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Marks> {
        let Marked { scene, chapters, all, .. } = marked;
        let heard = Marks { marks: sources.iter().flat_map(|k| marked.within(*k).marks).collect() };
        let (by_hand, frames) = (ByHand { scene, all, heard: &heard }, &chapters[place].shown);
        let marks = self.examples.without_rests(given.marks, by_hand, frames, pictures)?;
        let mut marks = Marks { marks };
        let is_seen = |name: &String| marks.all().iter().any(|mark| mark.add && mark.name == *name);
        names.retain(|name| !is_seen(name) && !scene.finds(name));
        marks.marks.extend(self.examples.found_again(&names, by_hand, frames, pictures)?);
        Ok(marks)
    }
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
