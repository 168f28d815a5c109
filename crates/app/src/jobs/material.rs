//! Material of a training: a recording, with or without features.

use std::path::Path;
use surgtpgs_core::{
    Error, Result,
    files::Inputs,
    prepare::Prepared,
    sequence::{HiddenRectangle, Sequence},
    train::supervision_digest,
};

/// Recording to train on, with or without features.
pub enum Material {
    /// A recording with features.
    Prepared(Box<Prepared>),
    /// A recording without features.
    Bare(Sequence),
}

impl Material {
    /// Opens a prepared folder or a recording.
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_hiding(path, &[])
    }

    /// Opens a recording whose rectangles `hidden` are black. A prepared folder knows itself what is hidden: that
    /// any is given is an error.
    pub fn open_hiding(path: &Path, hidden: &[HiddenRectangle]) -> Result<Self> {
        if !Prepared::is_prepared(path) {
            return Sequence::open_with(path, None, hidden).map(Self::Bare);
        }
        if !hidden.is_empty() {
            let what = "what is hidden was decided when this folder was prepared";
            return Err(Error::input_at(path, what, "Prepare the recording again with other rectangles."));
        }
        Prepared::open(path).map(|p| Self::Prepared(Box::new(p)))
    }

    /// Returns the recording.
    pub fn sequence(&self) -> &Sequence {
        match self {
            Self::Prepared(prepared) => &prepared.sequence,
            Self::Bare(sequence) => sequence,
        }
    }

    /// Returns the features, if there are some.
    pub fn prepared(&self) -> Option<&Prepared> {
        match self {
            Self::Prepared(prepared) => Some(prepared),
            Self::Bare(_) => None,
        }
    }

    /// Returns the hash of everything that is learned from besides the pictures.
    pub(crate) fn supervision(&self) -> String {
        supervision_digest(self.sequence(), self.prepared())
    }

    /// Returns the inputs of a run on this material, which was opened at `path`.
    pub(crate) fn inputs(&self, path: &Path) -> Inputs {
        let inputs = Inputs::none().with_recording(self.sequence());
        match self.prepared() {
            Some(prepared) => inputs
                .with("the prepared folder", path)
                .with_some("the text encoder", prepared.encoder.folder.as_deref()),
            None => inputs,
        }
    }
}
