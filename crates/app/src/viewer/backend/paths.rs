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
    /// A file of marks that exists.
    Marks,
    /// A file of marks to write, of this name to begin with.
    SaveMarks(String),
    /// A file to write, of this name to begin with. The text names the kind of file.
    Save(String, &'static str),
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
    let path = match &ask.kind {
        PathKind::File(extensions) => dialog
            .add_filter("Reconstructions, sessions and videos", extensions)
            .add_filter("All files", &["*"])
            .pick_file(),
        PathKind::Folder => dialog.pick_folder(),
        PathKind::Marks => dialog
            .add_filter("Marks and annotations", &Marks::EXTENSIONS)
            .add_filter("All files", &["*"])
            .pick_file(),
        PathKind::SaveMarks(name) => dialog.set_file_name(name).add_filter("Marks", &["json"]).save_file(),
        PathKind::Save(name, what) => {
            let extension = name.rsplit('.').next().unwrap_or_default();
            dialog.set_file_name(name).add_filter(*what, &[extension]).save_file()
        }
    };
    match path {
        Some(path) => Picked::Path(path),
        None if began.elapsed().as_millis() < NEVER_SHOWN_MS => Picked::Unavailable,
        None => Picked::Nothing,
    }
}
