//! The library's error type. A message says what happened, what was expected and found, and what to do;
//! the path comes last.

use std::path::{Path, PathBuf};

/// The reason why something could not be done.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The input is wrong; `what` says what was expected and found, `hint` what to do.
    #[error("{what}. {hint}{}", at(.path))]
    Input {
        /// Description of what happened, expected and found, without a full stop.
        what: String,
        /// Advice on what the user can do about it; a full sentence or empty.
        hint: String,
        /// The file or folder concerned.
        path: Option<PathBuf>,
    },
    /// The machine lacks something (a program, a library, an adapter).
    #[error("{what}. {hint}")]
    Missing {
        /// Description of what is missing and what it is needed for, without a full stop.
        what: String,
        /// Advice on how to get it.
        hint: String,
    },
    /// Reading or writing failed.
    #[error("could not {doing}: {source}{}", at(&Some(.path.clone())))]
    Io {
        /// Description of what was being done, e.g. "read the image".
        doing: String,
        /// The cause.
        source: std::io::Error,
        /// The file or folder concerned.
        path: PathBuf,
    },
    /// The user asked to stop; what was finished is kept.
    #[error("stopped on request")]
    Cancelled,
}

fn at(path: &Option<PathBuf>) -> String {
    path.as_ref().map(|p| format!(" ({})", p.display())).unwrap_or_default()
}

/// The result of this library's fallible functions.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Creates an error about wrong input without a file: `what` (no full stop) and `hint` (a
    /// sentence, or empty).
    pub fn input(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Input { what: what.into(), hint: hint.into(), path: None }
    }

    /// Creates an error about wrong input in the file or folder `path`.
    pub fn input_at(path: impl AsRef<Path>, what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Input { what: what.into(), hint: hint.into(), path: Some(path.as_ref().to_owned()) }
    }

    /// Creates an error about a failed read or write, or about missing memory if that is why; use as
    /// `.map_err(|e| Error::io("read the image", path, e))`.
    pub fn io(doing: impl Into<String>, path: impl AsRef<Path>, source: std::io::Error) -> Self {
        let (doing, path) = (doing.into(), path.as_ref().to_owned());
        if source.kind() == std::io::ErrorKind::OutOfMemory {
            let what = format!("there is not enough memory to {doing} ({})", path.display());
            return Self::Missing { what, hint: "Close other programs, or raise the limit.".to_owned() };
        }
        Self::Io { doing, source, path }
    }
}
