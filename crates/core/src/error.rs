//! The library's error type. A message says what happened, what was expected and found, and what to do;
//! the path comes last. Each program adds a [`Remedy`] in its own terms.

use std::path::{Path, PathBuf};

/// Something that can be done about an error, other than mending the input. Each program phrases it in the
/// terms of what it offers: an option of the command line, a button of the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Remedy {
    /// Replacing the earlier result that is in the way.
    Replace,
    /// Computing on the CPU instead of the GPU.
    UseCpu,
    /// Reading what a check of the recording says.
    CheckRecording,
    /// Preparing the recording, so that it has features.
    Prepare,
    /// Taking features from automatic masks, or doing without.
    OtherFeatures,
    /// Giving another text encoder.
    OtherEncoder,
    /// Giving the recording, or doing with the reconstruction.
    FindRecording,
}

/// Advice on an error: a full sentence or nothing, and a remedy if there is one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hint {
    /// The sentence, which names nothing that only one program has.
    pub text: String,
    /// The remedy.
    pub remedy: Option<Remedy>,
}

impl<T: Into<String>> From<T> for Hint {
    fn from(text: T) -> Self {
        Self { text: text.into(), remedy: None }
    }
}

impl From<Remedy> for Hint {
    fn from(remedy: Remedy) -> Self {
        remedy.after("")
    }
}

impl Remedy {
    /// Creates a hint of this remedy and a sentence before it.
    pub fn after(self, text: impl Into<String>) -> Hint {
        Hint { text: text.into(), remedy: Some(self) }
    }
}

/// The reason why something could not be done.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The input is wrong; `what` says what was expected and found, `hint` what to do.
    #[error("{}", message(.what, .hint, "", .path.as_deref()))]
    Input {
        /// Description of what happened, expected and found, without a full stop.
        what: String,
        /// Advice on what the user can do about it.
        hint: Hint,
        /// The file or folder concerned.
        path: Option<PathBuf>,
    },
    /// The machine lacks something (a program, a library, an adapter).
    #[error("{}", message(.what, .hint, "", None))]
    Missing {
        /// Description of what is missing and what it is needed for, without a full stop.
        what: String,
        /// Advice on how to get it.
        hint: Hint,
    },
    /// Reading or writing failed.
    #[error("could not {doing}: {source} ({})", .path.display())]
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

/// Joins the parts of a message that are there; the path comes last.
fn message(what: &str, hint: &Hint, remedy: &str, path: Option<&Path>) -> String {
    let path = path.map_or(String::new(), |path| format!("({})", path.display()));
    let parts = [&format!("{what}."), &*hint.text, remedy, &path];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ")
}

/// The result of this library's fallible functions.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Creates an error about wrong input without a file: `what` (no full stop) and `hint` (a
    /// sentence, or empty; or a [`Remedy`] after one).
    pub fn input(what: impl Into<String>, hint: impl Into<Hint>) -> Self {
        Self::Input { what: what.into(), hint: hint.into(), path: None }
    }

    /// Creates an error about wrong input in the file or folder `path`.
    pub fn input_at(path: impl AsRef<Path>, what: impl Into<String>, hint: impl Into<Hint>) -> Self {
        Self::Input { what: what.into(), hint: hint.into(), path: Some(path.as_ref().to_owned()) }
    }

    /// Creates an error about a failed read or write, or about missing memory if that is why; use as
    /// `.map_err(|e| Error::io("read the image", path, e))`.
    pub fn io(doing: impl Into<String>, path: impl AsRef<Path>, source: std::io::Error) -> Self {
        let (doing, path) = (doing.into(), path.as_ref().to_owned());
        if source.kind() == std::io::ErrorKind::OutOfMemory {
            let what = format!("there is not enough memory to {doing} ({})", path.display());
            return Self::Missing { what, hint: "Close other programs, or raise the limit.".into() };
        }
        Self::Io { doing, source, path }
    }

    /// Returns what can be done about it, if the program can offer something.
    pub fn remedy(&self) -> Option<Remedy> {
        match self {
            Self::Input { hint, .. } | Self::Missing { hint, .. } => hint.remedy,
            Self::Io { .. } | Self::Cancelled => None,
        }
    }

    /// Returns the message with its remedy, as `phrase` puts it in a sentence.
    pub fn told(&self, phrase: impl Fn(Remedy) -> &'static str) -> String {
        let remedy = self.remedy().map_or("", phrase);
        match self {
            Self::Input { what, hint, path } => message(what, hint, remedy, path.as_deref()),
            Self::Missing { what, hint } => message(what, hint, remedy, None),
            Self::Io { .. } | Self::Cancelled => self.to_string(),
        }
    }
}

/// Earlier work in a file of this program, as far as it can still be used.
#[derive(Debug)]
pub enum Kept<T> {
    /// It can be used.
    Usable(T),
    /// It is damaged, or of another version.
    Damaged(Error),
}

impl<T> Kept<T> {
    /// Returns what can be used; the error is of what is damaged.
    pub fn usable(self) -> Result<T> {
        match self {
            Self::Usable(kept) => Ok(kept),
            Self::Damaged(error) => Err(error),
        }
    }

    /// Changes what can be used.
    pub fn map<U>(self, change: impl FnOnce(T) -> U) -> Kept<U> {
        match self {
            Self::Usable(kept) => Kept::Usable(change(kept)),
            Self::Damaged(error) => Kept::Damaged(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_remedy_stands_before_the_path() {
        let error = || Error::input_at("a/b", "it is there", Remedy::Replace.after("Move it away."));
        assert_eq!(error().to_string(), "it is there. Move it away. (a/b)");
        assert_eq!(error().remedy(), Some(Remedy::Replace));
        assert_eq!(error().told(|_| "Or press R."), "it is there. Move it away. Or press R. (a/b)");
        assert_eq!(Error::input("no", "").told(|_| "Or press R."), "no.");
    }
}
