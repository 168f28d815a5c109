//! Paths that the user is asked for.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};
use surgtpgs_core::{Error, Result, marks::Marks};

/// A path that is asked for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PathAsk {
    pub(crate) title: String,
    pub(crate) kind: PathKind,
    /// Folder to begin in; `None` begins where the system likes.
    pub(crate) folder: Option<PathBuf>,
}

/// Kind of the path that is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PathKind {
    /// A file that exists, with one of these extensions.
    File(&'static [&'static str]),
    /// A folder that exists.
    Folder,
    /// A folder that exists, with a Segment Anything that finds the borders of marks.
    MasksModel,
    /// A file of marks that exists.
    Marks,
    /// A file of marks to write, of this name to begin with.
    SaveMarks(String),
    /// A file to write, of this name to begin with. The text names the kind of file.
    Save(String, &'static str),
}

impl PathAsk {
    /// Asks for a file to write; `path` is offered.
    pub(crate) fn save(title: &str, path: &Path, kind: impl FnOnce(String) -> PathKind) -> Self {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self { title: title.to_owned(), kind: kind(name), folder: path.parent().map(Path::to_owned) }
    }
}

impl PathKind {
    /// Returns the extension of the file to write; `None` if something that exists is asked for.
    pub(crate) fn written_extension(&self) -> Option<&str> {
        match self {
            Self::SaveMarks(name) | Self::Save(name, _) => name.rsplit('.').next(),
            Self::File(_) | Self::Folder | Self::MasksModel | Self::Marks => None,
        }
    }

    /// Returns a chosen path, with the extension of the file to write.
    pub(crate) fn completed(&self, path: &Path) -> PathBuf {
        self.written_extension().map_or_else(|| path.to_owned(), |extension| with_extension(path, extension))
    }
}

/// Appends an extension to a path that has another one or none: a dot may be part of its name.
pub(crate) fn with_extension(path: &Path, extension: &str) -> PathBuf {
    let is_there = path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
    if is_there { path.to_owned() } else { path.with_added_extension(extension) }
}

/// Says that a file is there already, which is not written over; `None` if it is not there.
pub(crate) fn taken(file: &Path) -> Option<String> {
    file.exists().then(|| format!("{} is there already: choose another name.", file.display()))
}

/// Returns the first path for a file of a name that does not exist yet and is not `planned`, so that nothing
/// is overwritten.
pub(crate) fn free_path(folder: &Path, name: &str, extension: &str, planned: &[PathBuf]) -> PathBuf {
    first_free(planned, |number| folder.join(format!("{name}{number}.{extension}")))
}

/// Returns the first path for a folder that does not exist yet: of a name and what the folder holds.
pub(crate) fn free_folder(parent: &Path, name: &str, what: &str) -> PathBuf {
    first_free(&[], |number| parent.join(format!("{name}-{what}{number}")))
}

/// Returns the first of the paths without a number, and with `-2` and so on, that does not exist yet and is
/// not `planned`.
fn first_free(planned: &[PathBuf], path: impl Fn(&str) -> PathBuf) -> PathBuf {
    let numbered = |number: usize| if number == 1 { path("") } else { path(&format!("-{number}")) };
    let is_free = |path: &PathBuf| !path.exists() && !planned.contains(path);
    (1..1000).map(&numbered).find(is_free).unwrap_or_else(|| numbered(1000))
}

/// Answer to a question for a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Picked {
    Path(PathBuf),
    /// The dialog was closed without a choice.
    Nothing,
    /// The system has no file dialog.
    Unavailable,
}

/// Milliseconds within which no person closes a dialog: whatever ends sooner was never shown.
const NEVER_SHOWN_MS: u128 = 400;

/// Program that opens folders with the system's file manager.
const FILE_MANAGER: &str = if cfg!(target_os = "windows") {
    "explorer"
} else if cfg!(target_os = "macos") {
    "open"
} else {
    "xdg-open"
};

/// Shows a folder with the system's file manager, and does not wait for it.
pub(super) fn show_folder(folder: &Path) -> Result<()> {
    let mut command = Command::new(FILE_MANAGER);
    command.arg(folder).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().map_err(|e| Error::Missing {
        what: format!("the folder {} could not be shown: {e}", folder.display()),
        hint: "Open it with your file manager.".into(),
    })?;
    // Nobody waits for it otherwise.
    let waiting = std::thread::Builder::new().name("file manager".into());
    drop(waiting.spawn(move || child.wait()));
    Ok(())
}

/// Asks by a dialog of the system, and returns once it is closed. A native dialog may block as long as it is
/// open.
pub(super) fn pick(ask: &PathAsk) -> Picked {
    let began = std::time::Instant::now();
    let dialog = rfd::FileDialog::new().set_title(&ask.title);
    let dialog = match &ask.folder {
        Some(folder) => dialog.set_directory(folder),
        None => dialog,
    };
    let extension = ask.kind.written_extension().unwrap_or_default();
    let save = |dialog: rfd::FileDialog, name: &str, what: &str| {
        dialog.set_file_name(name).add_filter(what, &[extension]).save_file()
    };
    let path = match &ask.kind {
        PathKind::File(extensions) => dialog
            .add_filter("Reconstructions, sessions and videos", extensions)
            .add_filter("All files", &["*"])
            .pick_file(),
        PathKind::Folder | PathKind::MasksModel => dialog.pick_folder(),
        PathKind::Marks => dialog
            .add_filter("Marks and annotations", &Marks::EXTENSIONS)
            .add_filter("All files", &["*"])
            .pick_file(),
        PathKind::SaveMarks(name) => save(dialog, name, "Marks"),
        PathKind::Save(name, what) => save(dialog, name, what),
    };
    match path {
        Some(path) => Picked::Path(path),
        None if began.elapsed().as_millis() < NEVER_SHOWN_MS => Picked::Unavailable,
        None => Picked::Nothing,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extension_is_appended_unless_it_is_there() {
        let kind = PathKind::Save("clip.surgtpgs".into(), "Sessions");
        for (chosen, written) in [
            ("/data/op.2024", "/data/op.2024.surgtpgs"),
            ("case", "case.surgtpgs"),
            ("case.surgtpgs", "case.surgtpgs"),
            ("CASE.SURGTPGS", "CASE.SURGTPGS"),
        ] {
            assert_eq!(kind.completed(Path::new(chosen)), Path::new(written));
        }
        assert_eq!(PathKind::SaveMarks("a.json".into()).completed(Path::new("b.c")), Path::new("b.c.json"));
        assert_eq!(PathKind::Folder.completed(Path::new("b.c")), Path::new("b.c"));
    }

    #[test]
    fn no_file_is_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second, third] =
            ["clip", "clip-2", "clip-3"].map(|n| folder.path().join(format!("{n}.csv")));
        assert_eq!(free_path(folder.path(), "clip", "csv", &[]), first);
        assert_eq!(taken(&first), None);
        std::fs::write(&first, "").unwrap();
        assert!(taken(&first).unwrap().ends_with("clip.csv is there already: choose another name."));
        assert_eq!(free_path(folder.path(), "clip", "csv", &[]), second);
        assert_eq!(free_path(folder.path(), "clip", "csv", &[second]), third);
        for name in ["op.1-export", "op.1-export-2"] {
            let free = free_folder(folder.path(), "op.1", "export");
            assert_eq!(free, folder.path().join(name));
            std::fs::create_dir(free).unwrap();
        }
    }
}
