//! Earlier work on a recording, which a new reconstruction goes on with.

use crate::{
    jobs,
    viewer::backend::{Info, SCENE, Words, frames::Frames, paths::free_folder},
};
use std::{
    cmp::Reverse,
    path::{Path, PathBuf},
    time::SystemTime,
};
use surgtpgs_core::{
    prepare::Prepared,
    scene::Scene,
    train::{Quality, TrainSettings},
};

/// Earlier work on a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Earlier {
    /// The latest reconstruction whose training was stopped and can be gone on with; `None` if a whole one is
    /// newer.
    pub(crate) stopped: Option<StoppedScene>,
    /// Folders of what networks found, perhaps in this recording.
    pub(crate) features: Vec<PathBuf>,
}

/// A scene whose training was stopped. Parts of a long recording are done, and lie beside it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StoppedScene {
    pub(crate) path: PathBuf,
    /// Settings that it was trained with.
    settings: TrainSettings,
    /// `true` if words are found in it.
    has_features: bool,
}

impl Earlier {
    /// Looks for earlier work on what is open, in the folder for files made of it.
    pub(crate) fn on(info: &Info) -> Self {
        let is_here = |scene: &&PathBuf| scene.parent() == Some(info.output_folder.as_path());
        let shown = Some(&info.path).filter(|path| info.has_reconstruction && path.is_file()).filter(is_here);
        let mut scenes = scenes_of(info);
        scenes.extend(shown.into_iter().chain(info.made_before.iter().filter(is_here)).cloned());
        scenes.sort_by_cached_key(|scene| Reverse(written(scene)));
        let unfinished = scenes.iter().take_while(|scene| jobs::stopped_at(scene).is_some());
        let stopped = shown.into_iter().chain(unfinished).find_map(|scene| StoppedScene::at(scene));
        Self { stopped, features: features_of(info) }
    }
}

impl StoppedScene {
    /// Reads a scene; `None` if its training was not stopped, or nothing of it can be gone on with.
    fn at(path: &Path) -> Option<Self> {
        jobs::stopped_at(path)?;
        if jobs::begun_chapters(path).is_empty() {
            return None;
        }
        let settings = Scene::provenance_of(path)?.settings;
        let settings: TrainSettings = serde_json::from_value(settings).ok()?;
        Some(Self { path: path.to_owned(), settings, has_features: Scene::has_codec_in(path) })
    }

    /// Returns the quality that the training goes on with if these frames are left out; `None` if it would
    /// begin anew at any.
    pub(crate) fn quality(&self, excluded: &[(usize, usize)]) -> Option<Quality> {
        // A prepared folder may hold frames out.
        let eval = self.settings.eval;
        let wanted = TrainSettings { excluded: excluded.to_vec(), eval, ..TrainSettings::default() };
        let agrees = |quality: &Quality| self.settings.agrees_with(&wanted.clone().with_quality(*quality));
        Quality::ALL.into_iter().find(agrees)
    }

    /// Returns `true` if words are found in it as they are to be found now, as far as that is known.
    pub(crate) fn finds(&self, words: &Words) -> bool {
        self.has_features == (*words != Words::Nothing)
    }
}

/// Ending of the names of folders of what networks find.
const FEATURES: &str = "features";
/// Part of the name of a scene whose training was stopped and that is saved beside another one.
pub(crate) const STOPPED: &str = "stopped";

/// Returns the folder of what networks find for a scene.
pub(crate) fn features_beside(scene: &Path) -> PathBuf {
    let name = scene.file_stem().unwrap_or_default().to_string_lossy();
    scene.with_file_name(format!("{name}-{FEATURES}"))
}

/// Returns a folder for what networks find for a scene, which is not there yet.
pub(crate) fn new_features_beside(scene: &Path) -> PathBuf {
    let (folder, name) = (scene.parent().unwrap_or(Path::new("")), scene.file_stem().unwrap_or_default());
    free_folder(folder, &name.to_string_lossy(), FEATURES)
}

/// Returns the reconstruction of a recording that is offered before a new one is made: the newest whole one,
/// or that which learned most.
pub(crate) fn made_before(info: &Info) -> Option<PathBuf> {
    let steps = |scene: &PathBuf| jobs::stopped_at(scene).map_or(usize::MAX, |stopped| stopped.steps);
    scenes_of(info).into_iter().max_by_key(|scene| (steps(scene), written(scene)))
}

/// Returns the reconstructions of a recording under the names that are offered for it.
fn scenes_of(info: &Info) -> Vec<PathBuf> {
    let is_scene = |path: &PathBuf| path.extension().is_some_and(|extension| extension == SCENE);
    let scenes = named_after(info).into_iter().filter(is_scene);
    scenes.filter(|scene| is_made_of(scene, info)).collect()
}

/// Returns `true` if a scene was made of a recording.
fn is_made_of(scene: &Path, info: &Info) -> bool {
    let identity = Scene::provenance_of(scene).and_then(|provenance| provenance.identity);
    let Some((identity, frames)) = identity.zip(info.frames()) else { return false };
    let (outline, spots) = (identity.outline_digest(), identity.spots_digest());
    frames.are_like(Frames { outline: &outline, spots: spots.as_deref(), place: None })
}

/// Returns the folders of what networks found under the names that are offered for them.
fn features_of(info: &Info) -> Vec<PathBuf> {
    let is_named = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.split('-').any(|part| part == FEATURES)
    };
    let is_there = |path: &PathBuf| Prepared::is_prepared(path) || Prepared::is_unfinished(path);
    named_after(info).into_iter().filter(is_named).filter(is_there).collect()
}

/// Returns everything with a name that is offered for what is made of a recording, in the order of the names.
fn named_after(info: &Info) -> Vec<PathBuf> {
    let is_named = |path: &PathBuf| {
        let is_folder = path.extension().is_none_or(|extension| extension != SCENE);
        let name = if is_folder { path.file_name() } else { path.file_stem() };
        name.and_then(|name| name.to_str()).is_some_and(|name| is_offered(name, &info.name))
    };
    let entries = std::fs::read_dir(&info.output_folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_named).collect();
    paths.sort_unstable();
    paths
}

/// Returns `true` for names that are offered for what is made of a recording: its own, with numbers and the
/// words for what was stopped and for features.
fn is_offered(name: &str, recording: &str) -> bool {
    let is_part = |part: &str| [STOPPED, FEATURES].contains(&part) || part.parse::<usize>().is_ok();
    let rest = name.strip_prefix(recording);
    rest.is_some_and(|rest| {
        rest.is_empty() || rest.strip_prefix('-').is_some_and(|parts| parts.split('-').all(is_part))
    })
}

/// Returns the time at which a file was written.
fn written(file: &Path) -> Option<SystemTime> {
    file.metadata().and_then(|about| about.modified()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_that_are_offered() {
        let is_offered = |name| is_offered(name, "op");
        assert!(["op", "op-2", "op-stopped", "op-2-stopped-3", "op-2-features"].into_iter().all(is_offered));
        assert!(
            !["other", "op2", "op-", "op-marks", "op.chapter-0001", "op-a-2"].into_iter().any(is_offered)
        );
    }

    #[test]
    fn a_folder_that_is_there_gets_no_other_features() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("op.1.safetensors");
        for name in ["op.1-features", "op.1-features-2"] {
            let features = new_features_beside(&scene);
            assert_eq!(features, folder.path().join(name));
            std::fs::create_dir(features).unwrap();
        }
    }
}
