//! Chapters of a long scene. Only one is in memory; the others are read when their time comes.

use super::{
    Revised, Scene, Similarity, file,
    part::{HINT, Part},
};
use crate::{Error, Kept, Result, deform::Deformation, gaussian::Gaussians, reading::open_regular};
use std::{
    io::{Seek, Write},
    ops::Range,
    path::Path,
    sync::{Arc, Mutex},
};

/// Key of the chapter in the settings of a scene that was trained on one alone.
const CHAPTER: &str = "chapter";

/// A part of a recording with Gaussians of its own.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Chapter {
    /// Its place among the chapters.
    pub index: usize,
    /// Number of chapters.
    pub count: usize,
    /// Frames that it is shown on.
    pub shown: Range<usize>,
    /// Frames that it is learned from: those, and some around them.
    pub learned: Range<usize>,
}

impl Chapter {
    /// Returns `true` if the chapter is of one shot with the one `before` it: nothing is learned across a cut.
    pub(crate) fn goes_on_from(&self, before: &Self) -> bool {
        before.learned.end > self.learned.start
    }
}

/// Chapters of a scene; none if it is one whole.
#[derive(Clone, Debug, Default)]
pub struct Chapters {
    all: Vec<Place>,
    /// Place in `all` of the chapter whose Gaussians the scene holds; `None` for none.
    current: Option<usize>,
    /// Recorded frame that is the scene's first.
    first_frame: usize,
}

/// A chapter, and where it is.
#[derive(Clone, Debug)]
struct Place {
    chapter: Chapter,
    /// Number of optimiser steps done.
    steps: usize,
    source: Source,
    /// Way from the world of the source to that of the scene.
    placement: Similarity,
}

/// Source of a chapter's Gaussians and motion.
#[derive(Clone, Debug)]
enum Source {
    Memory(Arc<(Revised<Gaussians>, Revised<Deformation>)>),
    File(Part),
}

impl Chapters {
    /// Returns the chapters in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Chapter> {
        self.all.iter().map(|place| &place.chapter)
    }

    /// Returns `true` if the scene is one whole.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Returns the chapter whose Gaussians the scene holds.
    pub fn current(&self) -> Option<&Chapter> {
        self.current.map(|k| &self.all[k].chapter)
    }

    /// Returns how the chapter whose Gaussians the scene holds was moved; see [`Scene::moved`].
    pub fn placement(&self) -> Similarity {
        self.current.map_or(Similarity::IDENTITY, |k| self.all[k].placement)
    }

    /// Returns the recorded frame that is the scene's first: 0, but of [`Scene::chapter_alone`].
    pub fn first_frame(&self) -> usize {
        self.first_frame
    }

    /// Returns the runs of frames that no chapter shows, of `num_frames`; none if the scene is one whole.
    pub fn gaps(&self, num_frames: usize) -> Vec<Range<usize>> {
        let mut next = 0;
        let mut gaps = Vec::new();
        let ends = self.iter().map(|chapter| chapter.shown.clone());
        for shown in ends.chain((!self.is_empty()).then_some(num_frames..num_frames)) {
            if shown.start > next {
                gaps.push(next..shown.start);
            }
            next = shown.end;
        }
        gaps
    }

    /// Returns the number of frames that no chapter shows, of `num_frames`.
    pub fn num_missing(&self, num_frames: usize) -> usize {
        self.gaps(num_frames).into_iter().map(|gap| gap.len()).sum()
    }

    /// Adds a chapter, in place of an earlier one of its number.
    fn put(&mut self, place: Place) {
        let found = self.all.binary_search_by_key(&place.chapter.index, |known| known.chapter.index);
        let (Ok(k) | Err(k)) = found;
        match found {
            Ok(_) => self.all[k] = place,
            Err(_) => self.all.insert(k, place),
        }
        self.current = Some(k);
    }

    pub(super) fn of_parts(parts: Vec<(Chapter, Part)>, steps: usize) -> Self {
        let place = |(chapter, part)| Place {
            chapter,
            steps,
            source: Source::File(part),
            placement: Similarity::IDENTITY,
        };
        let all = parts.into_iter().map(place);
        Self { all: all.collect(), ..Self::default() }
    }
}

impl Scene {
    /// Returns the place of the chapter that is shown at `time`; `None` if there is none.
    fn place_at(&self, time: f32) -> Option<usize> {
        let n = self.num_frames();
        let frame = match self.times.len() {
            // A frame's time is rounded.
            0 => (f64::from(time) * n as f64 + 0.01).max(0.0) as usize,
            _ => self.times.partition_point(|t| *t <= time).saturating_sub(1),
        };
        let frame = frame.min(n.saturating_sub(1));
        self.chapters.iter().position(|chapter| chapter.shown.contains(&frame))
    }

    /// Returns the frames that are shown by the Gaussians that the scene holds.
    pub fn frames_here(&self) -> Range<usize> {
        match self.chapters.current() {
            Some(chapter) => chapter.shown.clone(),
            None if self.chapters.is_empty() => 0..self.num_frames(),
            None => 0..0,
        }
    }

    /// Returns `true` if the scene holds what is shown at `time`.
    pub fn is_at(&self, time: f32) -> bool {
        self.chapters.is_empty() || self.place_at(time) == self.chapters.current
    }

    /// Returns `true` if there is something to show at `time`.
    pub fn shows(&self, time: f32) -> bool {
        self.chapters.is_empty() || self.place_at(time).is_some()
    }

    /// Returns `true` if there is something to show on frame `i`.
    pub fn shows_frame(&self, i: usize) -> bool {
        self.shows(self.time(i))
    }

    /// Returns the frames of the shot of frame `i`; all frames of a scene that is one whole. A frame that no
    /// chapter shows is alone.
    pub fn shot_of(&self, i: usize) -> Range<usize> {
        let chapters: Vec<&Chapter> = self.chapters.iter().collect();
        if chapters.is_empty() {
            return 0..self.num_frames();
        }
        let Some(at) = chapters.iter().position(|chapter| chapter.shown.contains(&i)) else {
            return i..i + 1;
        };
        let begins_shot = |k: &usize| !chapters[*k].goes_on_from(chapters[k - 1]);
        let first = (1..=at).rev().find(begins_shot).unwrap_or(0);
        let end = (at + 1..chapters.len()).find(begins_shot).unwrap_or(chapters.len());
        chapters[first].shown.start..chapters[end - 1].shown.end
    }

    /// Returns the runs of frames that no chapter shows, each by its first and last frame.
    pub fn frames_not_shown(&self) -> Vec<[usize; 2]> {
        self.chapters.gaps(self.num_frames()).into_iter().map(|gap| [gap.start, gap.end - 1]).collect()
    }

    /// Returns the number of Gaussians of all chapters.
    ///
    /// # Errors
    /// A chapter cannot be read.
    pub fn num_gaussians(&self) -> Result<usize> {
        let of = |place: &Place| match &place.source {
            Source::Memory(both) => Ok(both.0.len()),
            Source::File(part) => part.num_gaussians(),
        };
        match self.chapters.is_empty() {
            true => Ok(self.gaussians.len()),
            false => self.chapters.all.iter().map(of).sum(),
        }
    }

    /// Returns the scene with the Gaussians of the chapter that is shown at `time`. Where none is, it has none.
    ///
    /// # Errors
    /// The chapter cannot be read.
    pub fn at(&self, time: f32) -> Result<Self> {
        if self.is_at(time) { Ok(self.clone()) } else { self.with_place(self.place_at(time)) }
    }

    /// Returns the scene with the Gaussians of a chapter.
    ///
    /// # Errors
    /// The chapter cannot be read.
    pub fn of_chapter(&self, index: usize) -> Result<Self> {
        self.with_place(self.chapters.iter().position(|chapter| chapter.index == index))
    }

    /// Returns a chapter as a scene of its own, whose only frames are those of the chapter.
    ///
    /// # Errors
    /// There is no such chapter, or it cannot be read.
    pub fn chapter_alone(&self, index: usize) -> Result<Self> {
        if self.chapters.is_empty() {
            return Err(Error::input("the scene is one whole, without chapters", "Leave the chapter out."));
        }
        let mut scene = self.of_chapter(index)?;
        let Some(shown) = scene.chapters.current().map(|chapter| chapter.shown.clone()) else {
            let there: Vec<String> = self.chapters.iter().map(|c| c.index.to_string()).collect();
            let what = format!("there is no chapter {index}; the scene has {}", there.join(", "));
            return Err(Error::input(what, "Give another --chapter."));
        };
        let times: Vec<f32> = shown.clone().map(|i| self.time(i)).collect();
        let (first, last) = (times[0], times[times.len() - 1]);
        let len = (shown.len() as f32 / self.num_frames() as f32).max(last - first);
        scene.deformation.begin_at(first, len);
        scene.times = times.iter().map(|time| ((time - first) / len).clamp(0.0, 1.0)).collect();
        scene.chapters = Chapters { first_frame: shown.start, ..Chapters::default() };
        scene.cameras = self.cameras[shown].to_vec();
        Ok(scene)
    }

    fn with_place(&self, place: Option<usize>) -> Result<Self> {
        let place_in = place.map(|k| &self.chapters.all[k]);
        let (mut gaussians, mut deformation) = match place_in.map(|place| &place.source) {
            Some(Source::Memory(both)) => (both.0.clone(), both.1.clone()),
            Some(Source::File(part)) => {
                let part = part.scene()?;
                (part.gaussians, part.deformation)
            }
            None => self.nothing(),
        };
        if gaussians.latent_dim != self.gaussians.latent_dim {
            return Err(Error::input("a chapter of the scene has features of another kind", HINT));
        }
        if let Some(by) = place_in.map(|place| place.placement).filter(|by| *by != Similarity::IDENTITY) {
            by.move_gaussians(&mut gaussians);
            by.move_deformation(&mut deformation);
        }
        Ok(Self {
            gaussians,
            deformation,
            chapters: Chapters { current: place, ..self.chapters.clone() },
            cameras: self.cameras.clone(),
            times: self.times.clone(),
            field_of_view: self.field_of_view.clone(),
            codec: self.codec.clone(),
            classes: self.classes.clone(),
            encoder: self.encoder.clone(),
            words: self.words.clone(),
            provenance: self.provenance.clone(),
        })
    }

    /// No Gaussians, with features of the scene's kind.
    fn nothing(&self) -> (Revised<Gaussians>, Revised<Deformation>) {
        let (g, d) = (&self.gaussians, &self.deformation);
        let gaussians = Gaussians { latent_dim: g.latent_dim, ..Gaussians::default() };
        let mut deformation = Deformation::at_rest(0, g.latent_dim, 2, 1.0, d.gate_slope);
        (deformation.shape, deformation.gate_channel) = (d.shape, d.gate_channel);
        (gaussians.into(), deformation.into())
    }

    /// Returns everything but the Gaussians and their motion.
    pub(super) fn without_gaussians(&self) -> Self {
        let (gaussians, deformation) = self.nothing();
        Self { gaussians, deformation, chapters: Chapters::default(), ..self.clone() }
    }

    /// Returns the chapter that the scene was trained on alone.
    pub(super) fn own_chapter(&self) -> Option<Chapter> {
        serde_json::from_value(self.provenance.settings.get(CHAPTER)?.clone()).ok()
    }

    /// Makes a scene of one chapter a scene that shows nothing else.
    #[must_use]
    pub fn as_chapter(mut self) -> Self {
        let n = self.num_frames();
        let fits = |chapter: &Chapter| !chapter.shown.is_empty() && chapter.shown.end <= n;
        if let Some(chapter) = self.own_chapter().filter(fits) {
            let source = Source::Memory(Arc::new((self.gaussians.clone(), self.deformation.clone())));
            let (steps, placement) = (self.provenance.steps, Similarity::IDENTITY);
            let place = Place { chapter, steps, source, placement };
            self.chapters = Chapters { all: vec![place], current: Some(0), first_frame: 0 };
        }
        self
    }

    /// Moves a scene, or a scene of one chapter, and its cameras to other axes of the world. The spherical
    /// harmonics of its Gaussians must be of degree 1 at most, and their channels must share their basis
    /// functions.
    #[must_use]
    pub fn moved(mut self, by: &Similarity) -> Self {
        by.move_gaussians(&mut self.gaussians);
        by.move_deformation(&mut self.deformation);
        self.cameras.iter_mut().for_each(|camera| *camera = by.moved_camera(camera));
        self.provenance.path_depths.iter_mut().for_each(|depth| *depth *= by.scale);
        self.chapters.all.iter_mut().for_each(|place| place.placement = *by);
        self
    }

    /// Joins a scene of one chapter with those of chapters before it, of the same training. The result holds the
    /// Gaussians of that chapter; where a chapter is missing, it has none.
    #[must_use]
    pub fn joined(earlier: Option<Self>, part: Self) -> Self {
        let mut scene = earlier.unwrap_or_else(|| part.clone());
        for place in part.chapters.all {
            let shown = place.chapter.shown.clone();
            if let (Some(to), Some(from)) = (scene.cameras.get_mut(shown.clone()), part.cameras.get(shown)) {
                to.copy_from_slice(from);
            }
            scene.chapters.put(place);
        }
        (scene.gaussians, scene.deformation) = (part.gaussians, part.deformation);
        let (steps, count) = scene
            .chapters
            .all
            .iter()
            .fold((0, 1), |(steps, count), place| (steps + place.steps, count.max(place.chapter.count)));
        scene.provenance.steps = steps / count;
        // They are those of one chapter.
        scene.provenance.path_depths.clear();
        if let Some(settings) = scene.provenance.settings.as_object_mut() {
            settings.insert(CHAPTER.into(), serde_json::Value::Null);
        }
        scene
    }

    /// Reads a scene of one chapter that is to be shown with others; its Gaussians stay in the file.
    ///
    /// # Errors
    /// The file is no scene of a chapter.
    pub fn load_chapter(path: &Path) -> Result<Self> {
        Self::load_chapter_if_usable(path)?.usable()
    }

    /// Does the same as [`Scene::load_chapter`]; one that is damaged, or of another version, is no failure.
    pub fn load_chapter_if_usable(path: &Path) -> Result<Kept<Self>> {
        let fail = |e| Error::io("read the scene file", path, e);
        let file = open_regular(path).map_err(fail)?;
        let len = file.metadata().map_err(fail)?.len();
        let part = Part::new(path, &Arc::new(Mutex::new(file)), [0, len]);
        let mut scene = match part.scene() {
            Ok(scene) => scene.as_chapter(),
            Err(_) if Self::load(path).is_ok_and(|joined| !joined.chapters.is_empty()) => {
                let what = "this scene is joined of chapters already";
                return Err(Error::input_at(path, what, "Give the scenes of single chapters."));
            }
            Err(damaged @ Error::Input { .. }) => return Ok(Kept::Damaged(damaged)),
            Err(error) => return Err(error),
        };
        match scene.chapters.all.first_mut() {
            Some(place) => place.source = Source::File(part),
            None => {
                let what = "this scene is not one of a chapter";
                return Err(Error::input_at(path, what, "Give scenes that were trained with --chapter."));
            }
        }
        Ok(Kept::Usable(scene))
    }

    /// Writes the scene file, in the compact form of [`Scene::to_quantized_bytes`] if asked for. One chapter at a
    /// time is in memory.
    ///
    /// # Errors
    /// A chapter that cannot be read, or a file that cannot be written.
    pub fn write(&self, to: &mut (impl Write + Seek), compact: bool) -> Result<()> {
        if !self.chapters.is_empty() && self.own_chapter().is_none() {
            return file::chapters::write(self, to, compact);
        }
        let bytes = if compact { self.to_quantized_bytes() } else { self.to_bytes() }?;
        to.write_all(&bytes).map_err(|e| Error::io("write the scene", Path::new(""), e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress::ordinary;
    use std::fs::File;

    /// Scenes of two chapters of a recording of nine frames; frames 3 and 4 are in none.
    fn parts() -> [Scene; 2] {
        let shown: [Range<usize>; 2] = [0..3, 5..9];
        [0, 1].map(|index| {
            let mut scene = ordinary(6 + index);
            scene.cameras = vec![scene.cameras[0]; 9];
            let pose = glam::Affine3A::from_translation(glam::Vec3::X * index as f32);
            scene.cameras.iter_mut().for_each(|camera| camera.camera_from_world = pose);
            let shown = shown[index].clone();
            let learned = shown.start.saturating_sub(1)..(shown.end + 1).min(9);
            let chapter = Chapter { index, count: 2, shown, learned };
            scene.provenance.settings = serde_json::json!({ "chapter": chapter });
            scene.provenance.steps = 100;
            scene.as_chapter()
        })
    }

    fn counts(scene: &Scene) -> Vec<usize> {
        (0..9).map(|i| scene.at(scene.time(i)).unwrap().gaussians.len()).collect()
    }

    /// Returns `true` if these are the Gaussians of `scene`: all the same or, in the compact form, at rest
    /// within the steps of that form.
    fn is_stored(found: &Gaussians, scene: &Scene, compact: bool) -> bool {
        let (wanted, steps) = (&scene.gaussians, file::compact::Steps::for_scene(scene));
        let is_near = |name: &str, a: &[f32], b: &[f32]| {
            let step = steps.of(name).unwrap()[0];
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step)
        };
        let are_near = || {
            is_near("means", found.means.as_flattened(), wanted.means.as_flattened())
                && is_near("log_scales", found.log_scales.as_flattened(), wanted.log_scales.as_flattened())
                && is_near("opacity_logits", &found.opacity_logits, &wanted.opacity_logits)
                && is_near("colours", found.colours.as_flattened(), wanted.colours.as_flattened())
        };
        *found == **wanted || compact && are_near()
    }

    const COUNTS: [usize; 9] = [6, 6, 6, 0, 0, 7, 7, 7, 7];

    #[test]
    fn every_frame_is_shown_by_its_chapter_in_memory_and_in_a_file() {
        let [first, second] = parts();
        assert_eq!(counts(&second), [0, 0, 0, 0, 0, 7, 7, 7, 7]);
        let scene = Scene::joined(Some(Scene::joined(None, first.clone())), second.clone());
        assert_eq!((counts(&scene), scene.provenance.steps), (COUNTS.to_vec(), 100));
        let gaps = |scene: &Scene| -> Vec<_> {
            scene.chapters.gaps(9).iter().map(|gap| (gap.start, gap.end)).collect()
        };
        assert_eq!([&scene, &first, &ordinary(3)].map(gaps), [vec![(3, 5)], vec![(3, 9)], vec![]]);
        assert_eq!((0..9).map(|i| scene.shows_frame(i)).collect::<Vec<_>>(), COUNTS.map(|n| n > 0));
        assert_eq!((scene.frames_not_shown(), first.frames_not_shown()), (vec![[3, 4]], vec![[3, 8]]));
        assert!(ordinary(3).shows(0.0));
        assert_eq!([&scene, &ordinary(3)].map(|scene| scene.num_gaussians().unwrap()), [13, 3]);
        assert_eq!([2, 6].map(|i| scene.cameras[i]), [first.cameras[2], second.cameras[6]]);
        let folder = tempfile::tempdir().unwrap();
        for compact in [false, true] {
            let path = folder.path().join(format!("{compact}.safetensors"));
            scene.write(&mut File::create(&path).unwrap(), compact).unwrap();
            let read = Scene::load(&path).unwrap();
            assert_eq!(counts(&read), COUNTS);
            assert_eq!(read.num_gaussians().unwrap(), 13, "of both chapters");
            assert_eq!((&read.cameras, read.provenance.steps), (&scene.cameras, 100));
            let last = read.at(read.time(8)).unwrap();
            assert!(is_stored(&last.gaussians, &second, compact));
            assert!(Scene::is_own_file(&path) && Scene::memory_bytes(&path) > 0);
            let message = |error: Result<Scene>| error.unwrap_err().to_string();
            assert!(message(Scene::load_chapter(&path)).contains("joined of chapters already"));
            assert!(message(read.chapter_alone(2)).contains("there is no chapter 2; the scene has 0, 1"));
            assert!(Scene::read_bytes(&path) < path.metadata().unwrap().len());
            // A file that is replaced meanwhile is still read.
            std::fs::remove_file(&path).unwrap();
            assert_eq!(counts(&read), COUNTS);
        }
    }

    #[test]
    fn chapters_stay_in_their_files_until_they_are_shown() {
        let folder = tempfile::tempdir().unwrap();
        let paths = [0, 1].map(|k| folder.path().join(format!("{k}.safetensors")));
        for (part, path) in parts().iter().zip(&paths) {
            part.save(path).unwrap();
        }
        let [first, second] = paths.each_ref().map(|path| Scene::load_chapter(path).unwrap());
        let joined = Scene::joined(Some(Scene::joined(None, second)), first);
        assert_eq!(counts(&joined), COUNTS, "whatever the order");
        ordinary(3).save(&paths[0]).unwrap();
        assert!(Scene::load_chapter(&paths[0]).unwrap_err().to_string().contains("not one of a chapter"));
        let bytes = std::fs::read(&paths[1]).unwrap();
        std::fs::write(&paths[1], &bytes[..bytes.len() - 1]).unwrap();
        assert!(Scene::load_chapter_if_usable(&paths[1]).unwrap().usable().is_err(), "damaged");
        assert!(Scene::load_chapter_if_usable(&folder.path().join("none")).is_err(), "it cannot be read");
    }

    #[test]
    fn chapters_that_learn_from_each_other_are_one_shot() {
        let part = |(index, learned): (usize, Range<usize>)| {
            let mut scene = ordinary(3);
            scene.cameras = vec![scene.cameras[0]; 12];
            let chapter = Chapter { index, count: 4, shown: 3 * index..3 * index + 3, learned };
            scene.provenance.settings = serde_json::json!({ "chapter": chapter });
            scene.as_chapter()
        };
        let joined = |parts: Vec<(usize, Range<usize>)>| {
            let parts = parts.into_iter().map(part);
            parts.fold(None, |earlier, part| Some(Scene::joined(earlier, part))).unwrap()
        };
        let scene = joined(vec![(0, 0..5), (1, 1..6), (2, 6..11), (3, 7..12)]);
        assert_eq!([0, 5, 6, 11].map(|i| scene.shot_of(i)), [0..6, 0..6, 6..12, 6..12]);
        let some = joined(vec![(0, 0..5), (3, 7..12)]);
        assert_eq!([2, 4, 11].map(|i| some.shot_of(i)), [0..3, 4..5, 9..12]);
        assert_eq!(ordinary(3).shot_of(0), 0..1);
    }

    #[test]
    fn a_chapter_alone_moves_as_it_does_in_the_scene() {
        let [first, second] = parts();
        let scene = Scene::joined(Some(Scene::joined(None, first)), second);
        let alone = scene.chapter_alone(1).unwrap();
        assert_eq!((alone.num_frames(), alone.chapters.is_empty()), (4, true));
        assert_eq!((alone.chapters.first_frame(), scene.chapters.first_frame()), (5, 0));
        let whole = scene.of_chapter(1).unwrap();
        for i in 0..4 {
            let there = crate::deform::deform(&whole.gaussians, &whole.deformation, scene.time(5 + i), true);
            let here = crate::deform::deform(&alone.gaussians, &alone.deformation, alone.time(i), true);
            let pairs = there.means.as_flattened().iter().zip(here.means.as_flattened());
            assert!(
                pairs.chain(there.features.iter().zip(&here.features)).all(|(a, b)| (a - b).abs() < 1e-3)
            );
        }
        assert!(scene.chapter_alone(2).unwrap_err().to_string().contains("there is no chapter 2"));
        let whole = ordinary(3).chapter_alone(0).unwrap_err().to_string();
        assert_eq!(whole, "the scene is one whole, without chapters. Leave the chapter out.");
    }

    #[test]
    fn damaged_files_of_chapters_are_refused() {
        let [first, second] = parts();
        let scene = Scene::joined(Some(Scene::joined(None, first)), second);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        scene.save(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let refused = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Scene::load(&path).and_then(|scene| scene.at(scene.time(8))).unwrap_err().to_string()
        };
        assert!(refused(&bytes[..bytes.len() - 1]).contains("not a complete scene file"));
        // One bit in each of the chapters and in the index.
        for at in [0.3, 0.6, 0.9].map(|share| (share * bytes.len() as f64) as usize) {
            let mut changed = bytes.clone();
            changed[at] ^= 4;
            let what = refused(&changed);
            assert!(["checksum", "damaged", "not a complete"].iter().any(|w| what.contains(w)), "{what}");
        }
        let swapped =
            String::from_utf8_lossy(&bytes[8..2000]).replacen("\\\"start\\\":5", "\\\"start\\\":2", 1);
        let mut changed = bytes.clone();
        changed[8..2000].copy_from_slice(swapped.as_bytes());
        assert!(refused(&changed).contains("the list of chapters is damaged"));
    }
}
