//! Training of long recordings, chapter by chapter.

use super::{
    backend,
    material::Material,
    train::{Trained, Watched, checkpoint_path, go_on, remove_file},
};
use crate::{
    engine::BackendChoice,
    memory::{Work, require_for},
    outputs,
};
use std::{
    ops::ControlFlow,
    path::{Path, PathBuf},
};
use surgtpgs_core::{
    Error, Kept, Result,
    progress::{Observer, Progress},
    scene::{Chapter, Provenance, Scene, Similarity},
    train::{Plan, StepReport, TrainSettings, Trainer, is_checkpoint, psnr_db, seam},
};

/// A training in chapters.
pub struct Course<'a> {
    /// The recording.
    pub material: &'a Material,
    /// Settings of each chapter.
    pub settings: TrainSettings,
    /// Device to train on.
    pub backend: BackendChoice,
    /// Scene file to be written at the end. What is done of it is kept beside it.
    pub scene: &'a Path,
    /// `true` to keep what is unfinished, too, the recording beside the scene file, or a chapter beside its own.
    pub keeps_unfinished: bool,
    /// `true` to replace chapters beside the scene file that are not of this training; else they are an error.
    pub replaces: bool,
    /// Returns the frame whose chapter is to be trained next; `None` to go from the first to the last.
    pub look_at: Option<&'a dyn Fn() -> usize>,
}

/// Part of the name of a file that keeps a chapter, before its number.
const CHAPTER: &str = "chapter-";

/// Note on a chapter of which there is something that cannot be gone on with.
pub const DAMAGED: &str = "what was kept of it is damaged, or of another version: it is begun anew";

/// Returns the path of the file that keeps a chapter until the scene is whole.
pub fn chapter_path(scene: &Path, index: usize) -> PathBuf {
    scene.with_extension(format!("{CHAPTER}{index:04}.safetensors"))
}

/// Returns the chapters that lie beside a scene file, whichever they are: the window trains in any order.
fn chapters_beside(scene: &Path) -> Vec<PathBuf> {
    let is_scene = |path: &PathBuf| *path == path.with_extension("safetensors") && Scene::is_own_file(path);
    files_of_chapters(scene).into_iter().filter(is_scene).collect()
}

/// Returns the files beside a scene file that have the name of one of its chapters, with any ending.
fn files_of_chapters(scene: &Path) -> Vec<PathBuf> {
    let start = scene.with_extension(CHAPTER);
    let Some(start) = start.file_name().map(|name| name.to_string_lossy().into_owned()) else {
        return Vec::new();
    };
    let folder = scene.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let is_of_chapter = |path: &PathBuf| {
        let stem = path.file_stem().map(|stem| stem.to_string_lossy()).unwrap_or_default();
        stem.strip_prefix(&start).is_some_and(|number| number.parse::<usize>().is_ok())
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut paths: Vec<PathBuf> = entries.filter(is_of_chapter).collect();
    paths.sort_unstable();
    paths
}

/// Returns the files that keep the unfinished training of chapters of a scene file.
fn unfinished_chapters_beside(scene: &Path) -> Vec<PathBuf> {
    let is_unfinished = |path: &PathBuf| *path == checkpoint_path(path) && is_checkpoint(path);
    files_of_chapters(scene).into_iter().filter(is_unfinished).collect()
}

/// Returns the files of a training in chapters that was begun, and lies beside a scene file.
pub fn begun_chapters(scene: &Path) -> Vec<PathBuf> {
    [chapters_beside(scene), unfinished_chapters_beside(scene)].concat()
}

/// Returns the settings of a training of which chapters were begun, and lie beside a scene file; `None` if
/// there are none. Chapters that are damaged are passed over.
///
/// # Errors
/// Files that cannot be read, or none that can be used.
pub fn settings_of_chapters(scene: &Path, material: &Material) -> Result<Option<TrainSettings>> {
    let mut damaged = None;
    let finished = chapters_beside(scene).into_iter().map(|path| settings_of_finished(&path));
    let unfinished =
        unfinished_chapters_beside(scene).into_iter().map(|path| settings_of_unfinished(&path, material));
    for settings in finished.chain(unfinished) {
        match settings? {
            Kept::Usable(settings) => return Ok(Some(TrainSettings { chapter: None, ..settings })),
            Kept::Damaged(error) => damaged = damaged.or(Some(error)),
        }
    }
    damaged.map_or(Ok(None), Err)
}

/// Returns the settings of a chapter that is done.
fn settings_of_finished(path: &Path) -> Result<Kept<TrainSettings>> {
    let part = match read_chapter(path)? {
        Kept::Usable(part) => part,
        Kept::Damaged(error) => return Ok(Kept::Damaged(error)),
    };
    let unknown =
        || Error::input_at(path, "the settings of this chapter cannot be read", "Begin the training anew.");
    Ok(settings(&part).map_or_else(|| Kept::Damaged(unknown()), Kept::Usable))
}

/// Returns the settings of a chapter that is unfinished.
fn settings_of_unfinished(path: &Path, material: &Material) -> Result<Kept<TrainSettings>> {
    let trainer = Trainer::resume_if_usable(material.sequence(), material.prepared(), path)?;
    Ok(trainer.map(|trainer| trainer.settings().clone()))
}

/// Reads a chapter that is done. Fails on a file of somebody else.
fn read_chapter(path: &Path) -> Result<Kept<Scene>> {
    match Scene::load_chapter_if_usable(path)? {
        Kept::Damaged(error) if !Scene::is_own_file(path) => Err(error),
        read => Ok(read),
    }
}

/// Returns `true` if a scene file holds a chapter that was trained to the end on this material with these
/// settings.
///
/// # Errors
/// A file that is no such scene, or a recording that cannot be read.
pub fn is_finished_chapter(path: &Path, material: &Material, wanted: &TrainSettings) -> Result<Kept<bool>> {
    let part = match read_chapter(path)? {
        Kept::Usable(part) => part,
        Kept::Damaged(error) => return Ok(Kept::Damaged(error)),
    };
    let is_done = part.provenance.steps >= wanted.iterations;
    Ok(Kept::Usable(is_done && is_trained_on(&part, material, wanted, None)?))
}

/// Returns `true` if a chapter was trained on this material, as it is now, with these settings; any chapter
/// will do if none is named. How many steps were taken does not count.
///
/// # Errors
/// A recording that cannot be read.
fn is_trained_on(
    part: &Scene,
    material: &Material,
    wanted: &TrainSettings,
    chapter: Option<&Chapter>,
) -> Result<bool> {
    let wanted = settings_for(material, wanted);
    Ok(settings(part).is_some_and(|settings| settings.agrees_with(&wanted))
        && chapter.is_none_or(|chapter| part.chapters.current() == Some(chapter))
        && part.codec.as_ref() == material.prepared().map(|prepared| &prepared.codec)
        && is_supervised_by(part, material)
        && part.provenance.identity.as_ref() == Some(&material.sequence().identity()?))
}

/// Steps of a training that was stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped {
    /// Number of steps done; of chapters, their mean.
    pub steps: usize,
    /// Number of steps that were to be done.
    pub of: usize,
}

/// Returns where the training of the scene in a file was stopped; `None` if it was not, or nothing tells.
pub fn stopped_at(scene: &Path) -> Option<Stopped> {
    let made = Scene::provenance_of(scene)?;
    let (steps, of) = (made.steps, settings_in(&made)?.iterations);
    (steps < of).then_some(Stopped { steps, of })
}

/// Returns `true` if there is a scene whose training was not stopped: an unfinished one must not replace it.
pub fn is_whole_scene(path: &Path) -> bool {
    path.exists() && stopped_at(path).is_none()
}

/// Settings that a training with these on `material` records.
fn settings_for(material: &Material, settings: &TrainSettings) -> TrainSettings {
    let is_held_out = material.prepared().is_some_and(|prepared| prepared.eval);
    TrainSettings { eval: settings.eval || is_held_out, ..settings.clone() }
}

/// Removes the chapters that lie beside a scene file, and what keeps the unfinished training of one.
pub fn remove_chapters(scene: &Path) -> Result<()> {
    begun_chapters(scene).iter().try_for_each(|path| remove_file(path))
}

/// Reads scenes that were trained on a chapter each, of the same training, as one scene. Gaussians stay in
/// the files. Chapters whose paths were estimated come to lie in one world, that of the first of each shot.
///
/// # Errors
/// A file that is no such scene, one of another training, or a second one of the same chapter.
pub fn join(paths: &[PathBuf]) -> Result<Scene> {
    // One at a time is in memory, so that they are read once more in their order.
    let mut ordered = Vec::new();
    for path in paths {
        ordered.push((Scene::load_chapter(path)?.chapters.current().map(|chapter| chapter.index), path));
    }
    ordered.sort_unstable();
    if let Some(same) = ordered.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        let what = format!("this is the same chapter as {}", same[0].1.display());
        return Err(Error::input_at(same[1].1, what, "Give one file of each chapter."));
    }
    let (mut scene, mut before): (Option<Scene>, Option<Scene>) = (None, None);
    for (_, path) in ordered {
        let part = Scene::load_chapter(path)?;
        if scene.as_ref().is_some_and(|scene| !are_of_one_training(scene, &part)) {
            let what = "this chapter is of another training than the first one";
            return Err(Error::input_at(path, what, "Join chapters of one recording and equal settings."));
        }
        let seam = before.as_ref().and_then(|before| seam(before, &part));
        let part = match seam.filter(|seam| *seam != Similarity::IDENTITY) {
            Some(seam) => part.moved(&seam),
            None => part,
        };
        before = Some(part.clone());
        scene = Some(Scene::joined(scene, part));
    }
    scene.ok_or_else(|| Error::input("there is no chapter to join", "Give scenes of chapters."))
}

/// Returns `true` if two scenes of chapters come from one plan, one recording with its features, and equal
/// settings.
fn are_of_one_training(a: &Scene, b: &Scene) -> bool {
    let count = |scene: &Scene| scene.chapters.iter().next().map(|chapter| chapter.count);
    let settings_agree = settings(a).zip(settings(b)).is_some_and(|(a, b)| a.agrees_with(&b));
    let (of_a, of_b) = (&a.provenance, &b.provenance);
    let supervisions = of_a.supervision.as_ref().zip(of_b.supervision.as_ref());
    let is_one = of_a.identity == of_b.identity && supervisions.is_none_or(|(a, b)| a == b);
    settings_agree && count(a) == count(b) && is_one && a.codec == b.codec
}

/// Returns `true` if a scene was trained with the cameras, depth, masks and features of this material, as far
/// as it tells.
fn is_supervised_by(part: &Scene, material: &Material) -> bool {
    part.provenance.supervision.as_ref().is_none_or(|digest| *digest == material.supervision())
}

/// Settings that a scene was trained with.
fn settings(scene: &Scene) -> Option<TrainSettings> {
    settings_in(&scene.provenance)
}

/// Settings in the record of how a scene was made.
fn settings_in(made: &Provenance) -> Option<TrainSettings> {
    serde_json::from_value(made.settings.clone()).ok()
}

impl Course<'_> {
    /// Trains the recording, in chapters if it is long or has several shots, or until the observer asks to stop.
    /// Chapters that lie beside the scene file and were trained in the same way are not trained again: the result
    /// is the same.
    pub fn train(
        &self,
        observer: &mut Observer<'_>,
        watch: &mut dyn FnMut(&mut Watched<'_>, &StepReport),
    ) -> Result<Trained> {
        let (sequence, prepared) = (self.material.sequence(), self.material.prepared());
        let plan = Plan::of(sequence, prepared, &self.settings, observer)?;
        self.train_planned(plan, observer, watch)
    }

    /// Does the same as [`Course::train`] with a plan that was made before.
    pub fn train_planned(
        &self,
        mut plan: Plan,
        observer: &mut Observer<'_>,
        watch: &mut dyn FnMut(&mut Watched<'_>, &StepReport),
    ) -> Result<Trained> {
        require_for(&Work::Training(self.material.sequence(), &self.settings))?;
        if !plan.chapters.is_empty() {
            return self.train_chapters(plan, observer, watch);
        }
        let (sequence, prepared) = (self.material.sequence(), self.material.prepared());
        let mut trainer =
            Trainer::planned(sequence, prepared, self.settings.clone(), &mut plan, None, observer)?;
        backend::choose(&mut trainer, self.backend)?;
        let checkpoint = self.keeps_unfinished.then(|| checkpoint_path(self.scene));
        go_on(&mut trainer, checkpoint.as_deref(), observer, watch)
    }

    /// Returns `true` if all chapters are done.
    pub fn is_whole(&self, trained: &Trained) -> bool {
        trained.scene.provenance.steps >= self.settings.iterations
    }

    /// Removes the chapters that lie beside the scene file, once it is whole.
    pub fn clear(&self, trained: &Trained) -> Result<()> {
        if self.is_whole(trained) { remove_chapters(self.scene) } else { Ok(()) }
    }

    fn train_chapters(
        &self,
        mut plan: Plan,
        observer: &mut Observer<'_>,
        watch: &mut dyn FnMut(&mut Watched<'_>, &StepReport),
    ) -> Result<Trained> {
        let chapters = plan.chapters.clone();
        let mut whole: Option<Trained> = None;
        let mut left: Vec<&Chapter> = chapters.iter().collect();
        let mut tally = Tally { chapters: chapters.len(), kept: 0, trained: 0 };
        while !left.is_empty() {
            let chapter = left.remove(self.next(&left));
            let damaged = match self.kept(chapter)? {
                Some(Kept::Usable(part)) => {
                    tally.kept += 1;
                    whole = Some(Trained::with_chapter(whole, Trained::kept(part)));
                    continue;
                }
                Some(Kept::Damaged(_)) => Some(DAMAGED),
                None => None,
            };
            let checkpoint = self.checkpoint(chapter);
            let inputs = self.material.inputs(self.material.sequence().path());
            let claim = |path: &PathBuf| outputs::checkpoint_file(path, &inputs);
            // Held until the chapter is done: a file of somebody else is not written over.
            let _claim = checkpoint.as_ref().map(claim).transpose()?;
            let (mut trainer, unusable) = match self.trainer(&mut plan, chapter, observer) {
                // Nothing of this chapter is learned yet.
                Err(Error::Cancelled) if whole.is_some() => break,
                begun => begun?,
            };
            backend::choose(&mut trainer, self.backend)?;
            let notes = trainer.scope().note().into_iter().chain(damaged.or(unusable).map(str::to_owned));
            let notes = notes.map(|note| format!("Chapter {}: {note}", tally.place(chapter)));
            let notes: Vec<String> = notes.collect();
            let steps = trainer.settings().iterations;
            let mut tell = |p: &Progress<'_>| tally.tell(chapter, steps, p, observer);
            let done = whole.as_ref().map(|whole| &whole.scene);
            let mut show = |watched: &mut Watched<'_>, report: &StepReport| {
                watch(&mut Watched { trainer: watched.trainer, done }, report)
            };
            let mut trained = self.train_one(trainer, chapter, &mut tell, &mut show)?;
            let is_stopped = trained.steps < steps;
            trained.notes.extend(notes);
            tally.trained += 1;
            whole = Some(Trained::with_chapter(whole, trained));
            if is_stopped {
                break;
            }
        }
        let mut whole = whole.ok_or_else(|| Error::input("there is no chapter to train", ""))?;
        if self.is_whole(&whole) {
            // The order in which chapters were trained leaves no trace.
            let paths: Vec<PathBuf> =
                chapters.iter().map(|chapter| chapter_path(self.scene, chapter.index)).collect();
            whole.scene = join(&paths)?;
        }
        Ok(Trained { psnr_db: psnr_db(&whole.scene, self.material.sequence())?, ..whole })
    }

    /// Trains a chapter until all its steps are done or the observer asks to stop. One that is done is
    /// written beside the scene file.
    fn train_one(
        &self,
        mut trainer: Trainer,
        chapter: &Chapter,
        observer: &mut Observer<'_>,
        watch: &mut dyn FnMut(&mut Watched<'_>, &StepReport),
    ) -> Result<Trained> {
        let checkpoint = self.checkpoint(chapter);
        let mut trained = go_on(&mut trainer, checkpoint.as_deref(), observer, watch)?;
        trained.scene = if trained.steps < trainer.settings().iterations {
            trained.scene.as_chapter()
        } else {
            let path = self.keep(trained.scene, chapter)?;
            checkpoint.as_deref().map_or(Ok(()), remove_file)?;
            // Before the chapter is read again there is room for it.
            drop(trainer);
            Scene::load_chapter(&path)?
        };
        Ok(trained)
    }

    /// Returns the place of the chapter to train next.
    fn next(&self, left: &[&Chapter]) -> usize {
        let frame = self.look_at.map_or(0, |look_at| look_at());
        // The one under the play head, else the one after it, else the first.
        left.iter().position(|chapter| frame < chapter.shown.end).unwrap_or(0)
    }

    /// Returns the file that keeps a chapter while it is unfinished.
    fn checkpoint(&self, chapter: &Chapter) -> Option<PathBuf> {
        self.keeps_unfinished.then(|| checkpoint_path(&chapter_path(self.scene, chapter.index)))
    }

    /// Returns a trainer for a chapter, and a note if what was kept of it is of no use; else that goes on.
    fn trainer(
        &self,
        plan: &mut Plan,
        chapter: &Chapter,
        observer: &mut Observer<'_>,
    ) -> Result<(Trainer, Option<&'static str>)> {
        let (sequence, prepared) = (self.material.sequence(), self.material.prepared());
        let mut note = None;
        if let Some(path) = self.checkpoint(chapter).filter(|path| path.exists()) {
            match Trainer::resume_if_usable(sequence, prepared, &path)? {
                Kept::Usable(trainer)
                    if trainer.settings().chapter.as_ref() == Some(chapter)
                        && trainer.settings().agrees_with(&settings_for(self.material, &self.settings)) =>
                {
                    return Ok((trainer, None));
                }
                Kept::Usable(_) => {}
                Kept::Damaged(_) => note = Some(DAMAGED),
            }
        }
        let settings = self.settings.clone();
        let trainer = Trainer::planned(sequence, prepared, settings, plan, Some(chapter), observer)?;
        Ok((trainer, note))
    }

    /// Reads a chapter that is done; `None` if it is to be trained.
    fn kept(&self, chapter: &Chapter) -> Result<Option<Kept<Scene>>> {
        let path = chapter_path(self.scene, chapter.index);
        if !path.exists() {
            return Ok(None);
        }
        let part = match read_chapter(&path) {
            Ok(Kept::Usable(part)) => part,
            Ok(damaged) => return Ok(Some(damaged)),
            Err(_) if self.replaces => return Ok(None),
            Err(error) => return Err(error),
        };
        if part.provenance.steps < self.settings.iterations {
            return Ok(None);
        }
        if is_trained_on(&part, self.material, &self.settings, Some(chapter))? {
            return Ok(Some(Kept::Usable(part)));
        }
        if self.replaces {
            return Ok(None);
        }
        let what = "this chapter was trained on another recording, or in another way";
        Err(Error::input_at(&path, what, "Remove it, or give the scene another name."))
    }

    /// Writes a chapter beside the scene file, and returns where.
    fn keep(&self, part: Scene, chapter: &Chapter) -> Result<PathBuf> {
        let path = chapter_path(self.scene, chapter.index);
        let inputs = self.material.inputs(self.material.sequence().path());
        // An unfinished one may lie there.
        outputs::scene_file(&path, &inputs, true)?.write_with(|file| part.write(file, false))?;
        Ok(path)
    }
}

/// Number of chapters of a training, and of those that are done.
struct Tally {
    /// Number of chapters.
    chapters: usize,
    /// Number of those that were there already. They take no time, and are no progress.
    kept: usize,
    /// Number of those that were trained.
    trained: usize,
}

impl Tally {
    /// Says which of the chapters one is.
    fn place(&self, chapter: &Chapter) -> String {
        format!("{} of {}", chapter.index + 1, self.chapters)
    }

    /// Tells `observer` of the progress of a chapter of so many steps, as a part of the whole.
    fn tell(
        &self,
        chapter: &Chapter,
        steps: usize,
        progress: &Progress<'_>,
        observer: &mut Observer<'_>,
    ) -> ControlFlow<()> {
        let detail = format!("chapter {}, {}", self.place(chapter), progress.detail);
        observer(&Progress {
            stage: progress.stage,
            done: self.trained * steps + progress.done,
            total: (self.chapters - self.kept) * steps,
            detail: &detail,
        })
    }
}

impl Trained {
    /// A chapter that was trained earlier.
    fn kept(part: Scene) -> Self {
        let (steps, gaussians) = (part.provenance.steps, part.gaussians.len());
        let (seconds, psnr_db, dropped, notes) = (0.0, None, 0, Vec::new());
        Self { steps, steps_kept: steps, gaussians, scene: part, seconds, psnr_db, dropped, notes }
    }

    /// Adds a chapter to those before it.
    fn with_chapter(earlier: Option<Self>, chapter: Self) -> Self {
        let Some(earlier) = earlier else {
            return Self { scene: Scene::joined(None, chapter.scene), ..chapter };
        };
        Self {
            scene: Scene::joined(Some(earlier.scene), chapter.scene),
            steps: earlier.steps + chapter.steps,
            steps_kept: earlier.steps_kept + chapter.steps_kept,
            seconds: earlier.seconds + chapter.seconds,
            psnr_db: chapter.psnr_db,
            dropped: earlier.dropped + chapter.dropped,
            gaussians: earlier.gaussians + chapter.gaussians,
            notes: earlier.notes.into_iter().chain(chapter.notes).collect(),
        }
    }
}

#[cfg(test)]
mod tests;
