//! Marks of a scene in chapters: names reach a neighbouring chapter as masks of the frame between the two,
//! and are re-detected where there is no such frame.

use super::{
    Carried, CarrySettings, Graph, Mark, Marks,
    carried::Pictures,
    redetect::{ByHand, Examples},
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
const MIN_SCORE: f32 = 0.5;
/// Number of chapters from a source after which names are re-detected instead of taken from the neighbour:
/// errors add up on the way, and no chapter waits for all of a long operation.
const MAX_HOPS: usize = 8;

/// Place of a chapter, and the sources that count there, in their order.
type Key = (usize, Vec<usize>);

/// Marks of each chapter, as far as they were needed.
///
/// Chapters where names are marked by hand are sources, and one that shows more names comes first. The names
/// of a source compete with those of earlier sources alone. So no chapter waits for itself, and one more mark
/// changes few chapters.
#[derive(Clone, Debug)]
pub struct ChapterMarks {
    /// Marks by hand.
    all: Arc<Marks>,
    /// Marks that count in a chapter.
    by_chapter: BTreeMap<Key, Marks>,
    /// Masks of all names of a chapter on a frame at its border.
    at_border: BTreeMap<(Key, usize), Marks>,
    examples: Examples,
}

/// A scene in chapters, and the marks by hand.
#[derive(Clone, Copy)]
struct ChapteredScene<'a> {
    scene: &'a Scene,
    chapters: &'a [Chapter],
    all: &'a Marks,
    /// Names that some mark shows in each chapter, but for those that the scene finds by itself: marks
    /// correct these in their own chapter alone. Marks that deny a name do not count, as they do not say
    /// where it is.
    names: &'a [BTreeSet<String>],
}

/// Returns the names that some mark shows in each chapter, but for those that the scene finds by itself.
fn names_shown(scene: &Scene, chapters: &[Chapter], all: &Marks) -> Vec<BTreeSet<String>> {
    let mut names = vec![BTreeSet::new(); chapters.len()];
    for mark in all.standing().filter(|mark| mark.add && !scene.finds(&mark.name)) {
        for (names, chapter) in names.iter_mut().zip(chapters) {
            if chapter.learned.contains(&mark.frame) && !names.contains(&mark.name) {
                names.insert(mark.name.clone());
            }
        }
    }
    names
}

impl ChapteredScene<'_> {
    /// Returns the marks by hand in a chapter.
    fn within(&self, place: usize) -> Marks {
        self.all.within(&self.chapters[place].learned)
    }

    /// Returns the marks by hand in a chapter, with those of what outlines deny.
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

    /// Returns the names that are not marked in a chapter, by the index in `sources` of the nearest that has
    /// them.
    fn missing_names(&self, place: usize, sources: &[usize]) -> BTreeMap<usize, Vec<String>> {
        let mut missing: BTreeMap<usize, Vec<String>> = BTreeMap::new();
        let all: BTreeSet<&String> = sources.iter().flat_map(|source| &self.names[*source]).collect();
        for name in all.into_iter().filter(|name| !self.names[place].contains(*name)) {
            let with_name = (0..sources.len()).filter(|k| self.names[sources[*k]].contains(name));
            if let Some(nearest) = with_name.min_by_key(|k| sources[*k].abs_diff(place)) {
                missing.entry(nearest).or_default().push(name.clone());
            }
        }
        missing
    }

    /// Returns the neighbours that a chapter takes names from, each with the sources that count there.
    fn dependencies(&self, (place, sources): &Key) -> Vec<Key> {
        let missing = self.missing_names(*place, sources).into_keys();
        let dependency = |nearest: usize| {
            let (neighbour, _) = self.neighbour_towards(*place, sources[nearest])?;
            Some((neighbour, sources[..=nearest].to_vec()))
        };
        missing.filter_map(dependency).collect()
    }

    /// Returns the place of the neighbour in the direction of a source, and the frame that both chapters
    /// have; `None` where a cut parts them, and where names are re-detected because the source is far away.
    fn neighbour_towards(&self, place: usize, source: usize) -> Option<(usize, usize)> {
        let shown = &self.chapters[place].shown;
        let (neighbour, frame) =
            if source < place { (place - 1, shown.start) } else { (place + 1, shown.end - 1) };
        let is_near = !place.abs_diff(source).is_multiple_of(MAX_HOPS);
        (is_near && self.chapters[neighbour].learned.contains(&frame)).then_some((neighbour, frame))
    }
}

impl ChapterMarks {
    /// Takes marks by hand.
    pub fn new(marks: &Marks) -> Self {
        let all = Arc::new(marks.clone());
        let (by_chapter, at_border) = (BTreeMap::new(), BTreeMap::new());
        Self { all, by_chapter, at_border, examples: Examples::default() }
    }

    /// Returns the marks by hand.
    pub fn by_hand(&self) -> &Arc<Marks> {
        &self.all
    }

    /// Returns the marks by hand that correct what the scene finds by its features, in the chapter that it
    /// holds: they do not reach other chapters, and outlines deny nothing of it.
    pub fn correcting(&self, scene: &Scene) -> Marks {
        let learned = scene.chapters.current().map(|chapter| &chapter.learned);
        let is_here = |frame: usize| match learned {
            Some(learned) => learned.contains(&frame),
            None => scene.chapters.is_empty(),
        };
        self.all.filtered(|mark| is_here(mark.frame) && scene.corrects(&mark.name))
    }

    /// Returns the marks that count in the chapter that `scene` holds. These are the marks on its frames and,
    /// for names that are marked in other chapters alone, masks on its first or last frame. Names that are
    /// not seen there, or that a cut parts from the chapter, are re-detected on its frames. A scene without
    /// chapters keeps all marks. Marks come with those of what outlines deny, see [`Marks::with_outsides`].
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
        let chaptered = ChapteredScene { scene, chapters: &chapters, all: &all, names: &names };
        match chapters.iter().position(|chapter| chapter.index == current.index) {
            Some(place) => self.resolve((place, chaptered.sources()), chaptered, pictures),
            None => Ok(Marks::default()),
        }
    }

    /// Returns the marks that count in a chapter, and resolves its dependencies first. A stack takes the
    /// place of recursion: an operation of hours has too many chapters for that.
    fn resolve(
        &mut self,
        key: Key,
        chaptered: ChapteredScene<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Marks> {
        if let Some(known) = self.by_chapter.get(&key) {
            return Ok(known.clone());
        }
        let mut stack = vec![key.clone()];
        while let Some(next) = stack.last().cloned() {
            let mut dependencies = chaptered.dependencies(&next);
            dependencies.retain(|key| !self.by_chapter.contains_key(key));
            if dependencies.is_empty() {
                let marks = self.resolve_chapter(&next, chaptered, pictures)?;
                self.by_chapter.insert(next, marks);
                stack.pop();
            }
            stack.extend(dependencies);
        }
        Ok(self.by_chapter.get(&key).cloned().unwrap_or_default())
    }

    /// Takes other marks by hand, and keeps what still holds.
    pub fn for_marks(mut self, scene: &Scene, marks: &Marks) -> Self {
        let after = Arc::new(marks.clone());
        let before = std::mem::replace(&mut self.all, Arc::clone(&after));
        let [old, new] = [&before, &after].map(|marks| marks.digests());
        let is_changed = |frame: &usize| old.get(frame) != new.get(frame);
        let mut changed: BTreeSet<usize> = old.keys().chain(new.keys()).copied().filter(is_changed).collect();
        // An outline becomes a piece if a larger one is drawn on another frame.
        let [old, new] = [before, after].map(|marks| marks.outlined(scene));
        changed.extend(old.symmetric_difference(&new).map(|(_, frame)| frame));
        let chapters: Vec<&Chapter> = scene.chapters.iter().collect();
        // Marks come through all chapters between the sources and this one.
        let holds = |place: usize, sources: &[usize]| {
            let learned = || sources.iter().chain([&place]).filter_map(|k| Some(&chapters.get(*k)?.learned));
            let from = learned().map(|frames| frames.start).min().unwrap_or(0);
            let to = learned().map(|frames| frames.end).max().unwrap_or(0);
            !changed.iter().any(|frame| (from..to).contains(frame))
        };
        self.by_chapter.retain(|(place, sources), _| holds(*place, sources));
        self.at_border.retain(|((place, sources), _), _| holds(*place, sources));
        self.examples.retain(|frame| !changed.contains(&frame));
        self
    }

    /// Returns the marks that count in a chapter: its own, and those of other names that come from `sources`.
    /// Its dependencies have to be resolved.
    fn resolve_chapter(
        &mut self,
        (place, sources): &Key,
        chaptered: ChapteredScene<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Marks> {
        let mut marks = chaptered.by_hand(*place).marks;
        for (nearest, names) in chaptered.missing_names(*place, sources) {
            let known_sources = &sources[..=nearest];
            let masks = match chaptered.neighbour_towards(*place, sources[nearest]) {
                Some((neighbour, border)) => {
                    self.border_masks((neighbour, known_sources.to_vec()), border, chaptered, pictures)?
                }
                None => Marks::default(),
            };
            let masks = masks.filtered(|mark| names.contains(&mark.name));
            let found = self.redetect_missing(*place, (names, masks), known_sources, chaptered, pictures)?;
            marks.extend(found);
        }
        Ok(Marks::unchecked(marks))
    }

    /// Returns masks of all names of a chapter on a frame at its border.
    fn border_masks(
        &mut self,
        key: Key,
        frame: usize,
        chaptered: ChapteredScene<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Marks> {
        let border = (key, frame);
        if let Some(known) = self.at_border.get(&border) {
            return Ok(known.clone());
        }
        let marks = self.by_chapter.get(&border.0).cloned().unwrap_or_default();
        let chapter = chaptered.scene.of_chapter(chaptered.chapters[border.0.0].index)?;
        let masks = Marks::unchecked(masks_on_frame(&chapter, &marks, frame, pictures)?);
        self.at_border.insert(border, masks.clone());
        Ok(masks)
    }

    /// Takes the names that are not marked in a chapter, and their masks on the frame at its border. Drops
    /// the masks of names that have left the view there, and re-detects names without a mask.
    fn redetect_missing(
        &mut self,
        place: usize,
        (mut names, masks): (Vec<String>, Marks),
        sources: &[usize],
        chaptered: ChapteredScene<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Mark>> {
        let ChapteredScene { scene, chapters, all, .. } = chaptered;
        let source_marks = sources.iter().flat_map(|k| chaptered.within(*k).marks).collect();
        let source_marks = Marks::unchecked(source_marks);
        let (by_hand, frames) = (ByHand { scene, all, source_marks: &source_marks }, &chapters[place].shown);
        let mut marks = self.examples.drop_vanished(masks.marks, by_hand, frames, pictures)?;
        let is_seen = |name: &String| marks.iter().any(|mark| mark.add && mark.name == *name);
        names.retain(|name| !is_seen(name) && !scene.finds(name));
        marks.extend(self.examples.redetect(&names, by_hand, frames, pictures)?);
        Ok(marks)
    }
}

/// Carries marks to a frame. Returns two masks of each name: the pixels that show it, and those that do not.
fn masks_on_frame(
    scene: &Scene,
    marks: &Marks,
    frame: usize,
    pictures: &mut Pictures<'_>,
) -> Result<Vec<Mark>> {
    if marks.is_empty() {
        return Ok(Vec::new());
    }
    let graph = Arc::new(Graph::of(scene));
    let mut carried = Carried::new(scene, graph, marks, CarrySettings::default());
    let found = carried.on_frame(scene, frame, pictures)?;
    let mut masks = Vec::new();
    for (name, scores) in carried.names().iter().zip(&found.scores) {
        for add in [true, false] {
            let mask = mask(scores, &scene.field_of_view, add);
            if mask.data.contains(&true) {
                masks.push(Mark::new(frame, name, add, Shape::from(&mask)));
            }
        }
    }
    Ok(masks)
}

/// Returns the pixels inside the field of view that show a name, or those that do not.
fn mask(scores: &Grid<f32>, field_of_view: &Mask, shows: bool) -> Mask {
    let inside = scores.data.iter().zip(&field_of_view.data);
    let data = inside.map(|(score, seen)| *seen && (*score > MIN_SCORE) == shows).collect();
    Mask::from_vec(scores.width, scores.height, data)
}
