//! A session: the user's decisions about a recording, as a small JSON file. It never holds pixels.

use crate::viewer::{
    backend::{Info, frames::Frames},
    state::{
        content::{Content, Look},
        view_mode::ViewMode,
    },
};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    files::{full_path, write_whole},
    overlay::OverlayLook,
    reading::read_text,
    scene::Scene,
};

/// The extension of session files.
pub(crate) const EXTENSION: &str = "surgtpgs";
/// Number of session files of a folder that are looked at.
const MOST_LOOKED_AT: usize = 100;
/// Version that is written, and the newest that can be read. New fields do not need a new version, because
/// unknown fields are kept.
const VERSION: u32 = 1;

/// Content of a session file.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Session {
    /// Version of the format.
    pub(crate) version: u32,
    /// Path of the scene or recording; in a file, relative to the file's folder if it lies inside that
    /// folder.
    pub(crate) opened: PathBuf,
    /// Hash of the names and sizes of the recording's frames; absent where they were not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) recording: Option<String>,
    /// Hash of the content of a few frames; absent where it was not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) spots: Option<String>,
    /// Path of the recorded frames, with links resolved; in a file, as `opened`. Absent where it was unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) sequence: Option<PathBuf>,
    /// Session file that unsaved work belongs to; absent if there is none, and in session files themselves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) saved_as: Option<PathBuf>,
    #[serde(default)]
    pub(crate) content: Content,
    #[serde(default)]
    pub(crate) display: Display,
    #[serde(default)]
    pub(crate) time: Time,
    /// Words of earlier prompts, newest first.
    #[serde(default)]
    pub(crate) earlier_prompts: Vec<String>,
    /// Fields that a newer program wrote.
    #[serde(flatten)]
    pub(crate) unknown: Map<String, Value>,
}

/// Display of the picture.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Display {
    pub(crate) mode: ViewMode,
    #[serde(flatten)]
    pub(crate) overlay: OverlayLook,
    pub(crate) is_hidden: bool,
    pub(crate) wipe: f32,
    pub(crate) look: Look,
}

/// State of the playback.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Time {
    pub(crate) frame: usize,
    pub(crate) speed: f64,
    pub(crate) repeats: bool,
}

impl Default for Display {
    fn default() -> Self {
        Self {
            mode: ViewMode::default(),
            overlay: OverlayLook::default(),
            is_hidden: false,
            wipe: 0.5,
            look: Look::default(),
        }
    }
}

impl Default for Time {
    fn default() -> Self {
        Self { frame: 0, speed: 1.0, repeats: true }
    }
}

impl Session {
    pub(crate) fn new(opened: PathBuf) -> Self {
        Self {
            version: VERSION,
            opened,
            recording: None,
            spots: None,
            sequence: None,
            saved_as: None,
            content: Content::default(),
            display: Display::default(),
            time: Time::default(),
            earlier_prompts: Vec::new(),
            unknown: Map::new(),
        }
    }

    /// Returns `true` if a path is that of a session file.
    pub(crate) fn is_file(path: &Path) -> bool {
        path.extension().is_some_and(|e| e.eq_ignore_ascii_case(EXTENSION))
    }

    /// Returns the frames of the recording; `None` where they are not known. An older session knows no more
    /// of their place than what was opened.
    fn frames(&self) -> Option<Frames<'_>> {
        let opened = Some(&self.opened).filter(|path| !Scene::is_named_like_one(path));
        let place = self.sequence.as_ref().or(opened).map(PathBuf::as_path);
        let spots = self.spots.as_deref();
        self.recording.as_deref().map(|outline| Frames { outline, spots, place })
    }

    /// Returns `true` if the session is about a scene or recording: about its frames, wherever they lie, or
    /// about its path.
    pub(crate) fn is_about(&self, info: &Info) -> bool {
        let frames = self.frames().zip(info.frames());
        self.opened == info.path || frames.is_some_and(|(then, now)| then.are_of_one(now))
    }

    /// Returns `true` if the session was made on other frames; `false` where either are not known.
    pub(crate) fn is_of_other_frames(&self, info: &Info) -> bool {
        self.frames().zip(info.frames()).is_some_and(|(then, now)| !then.are_like(now))
    }

    /// Returns `true` if the session is about a scene or recording, and known to be made on its frames.
    fn fits(&self, info: &Info) -> bool {
        let frames = self.frames().zip(info.frames());
        self.is_about(info) && frames.is_some_and(|(then, now)| then.are_like(now))
    }

    /// Reads a session file; the paths in it become absolute.
    pub(crate) fn load(file: &Path) -> Result<Self> {
        let text = read_text(file).map_err(|e| Error::io("read the session", file, e))?;
        let not_a_session = |why: String| {
            let what = format!("this is not a session file: {why}");
            Error::input_at(file, what, "Open the recording or reconstruction itself.")
        };
        let json: Value = serde_json::from_str(&text).map_err(|e| not_a_session(e.to_string()))?;
        if !is_bounded(&json) {
            return Err(not_a_session("a number in it is too large".into()));
        }
        let mut session: Self = serde_json::from_value(json).map_err(|e| not_a_session(e.to_string()))?;
        if session.version > VERSION {
            let what = format!(
                "this session has the format {}, this program reads formats up to {VERSION}",
                session.version
            );
            return Err(Error::input_at(file, what, "Use the program that saved it, or a newer one."));
        }
        let beside = |path: &Path| file.parent().unwrap_or(Path::new("")).join(path);
        session.opened = beside(&session.opened);
        session.sequence = session.sequence.map(|path| full_path(&beside(&path)));
        // Opening sessions that name each other would not end.
        if Self::is_file(&session.opened) {
            return Err(not_a_session("it names a session in place of a recording".into()));
        }
        Ok(session)
    }

    /// Returns the newest session file in the folder for files made of a scene or recording that is about it and
    /// its frames, and the session. Many files may be read for it.
    pub(crate) fn newest_beside(info: &Info) -> Option<(PathBuf, Self)> {
        info.frames()?;
        let entries = std::fs::read_dir(&info.output_folder).into_iter().flatten().flatten();
        let files = entries.map(|entry| entry.path());
        let mut files: Vec<PathBuf> = files.filter(|path| Self::is_file(path)).collect();
        let saved = |file: &PathBuf| std::fs::metadata(file).and_then(|about| about.modified()).ok();
        files.sort_by_cached_key(|file| std::cmp::Reverse(saved(file)));
        files.into_iter().take(MOST_LOOKED_AT).find_map(|file| {
            let session = Self::load(&file).ok()?;
            session.fits(info).then_some((file, session))
        })
    }

    /// Writes a session file.
    pub(crate) fn save(&self, file: &Path) -> Result<()> {
        let folder = file.parent().unwrap_or(Path::new(""));
        let told = |path: &PathBuf| {
            let inside = path.strip_prefix(folder).ok().filter(|p| !p.as_os_str().is_empty());
            inside.unwrap_or(path).to_owned()
        };
        let (opened, sequence) = (told(&self.opened), self.sequence.as_ref().map(told));
        let told = Self { opened, sequence, version: VERSION, ..self.clone() };
        let text = serde_json::to_string_pretty(&told)
            .map_err(|e| Error::input_at(file, format!("the session cannot be written: {e}"), ""))?;
        write_whole(file, text.as_bytes())
    }

    /// Returns the name of the opened scene or recording, for lists.
    pub(crate) fn name(&self) -> String {
        let name = self.opened.file_stem().map(|n| n.to_string_lossy().into_owned());
        name.unwrap_or_else(|| self.opened.display().to_string())
    }
}

/// Returns `true` if all numbers are finite in single precision. Others could be read, but not written again.
fn is_bounded(json: &Value) -> bool {
    match json {
        Value::Number(number) => number.as_f64().is_some_and(|v| (v as f32).is_finite()),
        Value::Array(values) => values.iter().all(is_bounded),
        Value::Object(fields) => fields.values().all(is_bounded),
        Value::Null | Value::Bool(_) | Value::String(_) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn session(opened: PathBuf) -> Session {
        let content = r#"{"prompts": [{"text": "liver", "colour": [1, 2, 3], "is_visible": false, "threshold": 0.45,
            "synonyms": ["hepar"]}], "bookmarks": [{"frame": 7, "note": "clip", "author": "x"}], "range": [2, 9],
            "landmarks": [1]}"#;
        let unknown = Map::from_iter([("reviewed_by".to_owned(), Value::from("two people"))]);
        let time = Time { frame: 7, speed: -2.0, repeats: false };
        Session { content: serde_json::from_str(content).unwrap(), time, unknown, ..Session::new(opened) }
    }

    #[test]
    fn a_session_comes_back_with_what_a_newer_program_wrote() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("review.surgtpgs");
        let saved = session(folder.path().join("scenes/clip.safetensors"));
        saved.save(&file).unwrap();
        assert_eq!(Session::load(&file).unwrap(), saved);
        let text = std::fs::read_to_string(&file).unwrap();
        for kept in ["reviewed_by", "synonyms", "author", "landmarks"] {
            assert!(text.contains(kept), "{kept}");
        }
    }

    #[test]
    fn paths_are_relative_inside_the_folder_and_absolute_elsewhere() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("review.surgtpgs");
        session(folder.path().join("clip.safetensors")).save(&file).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.contains("\"opened\": \"clip.safetensors\""));
        assert!(!text.contains(&*folder.path().to_string_lossy()));

        let moved = tempfile::tempdir().unwrap();
        std::fs::rename(&file, moved.path().join("review.surgtpgs")).unwrap();
        let opened = Session::load(&moved.path().join("review.surgtpgs")).unwrap().opened;
        assert_eq!(opened, moved.path().join("clip.safetensors"), "the folder may move");

        let recording = std::fs::canonicalize(folder.path()).unwrap().join("clip.mp4");
        let sequence = Some(recording.clone());
        Session { sequence: sequence.clone(), ..session(recording) }.save(&file).unwrap();
        assert_eq!(Session::load(&file).unwrap().sequence, sequence);

        let elsewhere = moved.path().join("clip.safetensors");
        session(elsewhere.clone()).save(&file).unwrap();
        assert_eq!(Session::load(&file).unwrap().opened, elsewhere);
    }

    #[test]
    fn what_is_no_session_or_a_newer_one_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("bad.surgtpgs");
        for (text, expected) in [
            ("not json", "this is not a session file"),
            ("{\"version\": 1}", "missing field `opened`"),
            (
                "{\"version\": 1, \"opened\": \"a\", \"display\": {\"wipe\": 1e39}}",
                "a number in it is too large",
            ),
            ("{\"version\": 9, \"opened\": \"a\"}", "format 9, this program reads formats up to 1"),
            ("{\"version\": 1, \"opened\": \"bad.surgtpgs\"}", "names a session in place of a recording"),
        ] {
            std::fs::write(&file, text).unwrap();
            let error = Session::load(&file).unwrap_err().to_string();
            assert!(error.contains(expected) && error.ends_with("bad.surgtpgs)"), "{error}");
        }
        std::fs::write(&file, "{\"version\": 1, \"opened\": \"a\"}").unwrap();
        assert_eq!(Session::load(&file).unwrap().time, Time::default());
    }
}
