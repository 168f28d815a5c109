//! The recording that a scene was made from, and what is known of it.

use super::Engine;
use std::sync::Arc;
use surgtpgs_core::{
    Result,
    grid::Mask,
    sequence::{DepthOrigin, HiddenRectangle, Identity, Sequence},
};

/// The recording that a scene was made from, or the reason why it is not there.
pub(super) enum Recorded {
    Found(Sequence),
    Missing(String),
}

impl Recorded {
    /// Returns the picture of frame `i`; `None` if the recording is not there.
    pub(super) fn frame(&self, i: usize) -> Result<Option<image::RgbImage>> {
        match self {
            Self::Found(sequence) => sequence.frame(i).map(Some),
            Self::Missing(_) => Ok(None),
        }
    }
}

impl Engine {
    /// Returns the recording, if it was found.
    pub fn sequence(&self) -> Option<&Sequence> {
        match &self.recording {
            Recorded::Found(sequence) => Some(sequence),
            Recorded::Missing(_) => None,
        }
    }

    /// Returns the origin of the scene's depth. What is not known counts as absent.
    pub fn depth_origin(&self) -> DepthOrigin {
        let recorded = || self.sequence().map(Sequence::depth_origin);
        self.scene.provenance.depth.or_else(recorded).unwrap_or(DepthOrigin::Absent)
    }

    /// Fails if the content of a recorded frame is not what the scene was trained on. To be called before
    /// something is made of recorded frames; it reads all of them.
    pub fn require_recording(&self) -> Result<()> {
        match (self.sequence(), &self.scene.provenance.identity) {
            (Some(sequence), Some(then)) => {
                sequence.identity()?.require(then, sequence.path(), "the scene was trained on")
            }
            _ => Ok(()),
        }
    }

    /// Returns the file names of the recorded frames (of a video, their numbers); none if they are not known.
    pub fn frame_sources(&self) -> Vec<String> {
        self.known_identity().into_iter().flat_map(|known| known.names().map(str::to_owned)).collect()
    }

    /// Returns the rectangles that are black in every recorded frame; none if they are not known.
    pub fn hidden(&self) -> &[HiddenRectangle] {
        self.known_identity().map_or(&[], |known| known.hidden())
    }

    /// Returns the identity of the recording that the scene holds, or else that of the recording at hand.
    fn known_identity(&self) -> Option<&Arc<Identity>> {
        let of_scene = self.scene.provenance.identity.as_ref();
        of_scene.or_else(|| self.sequence().map(Sequence::outline))
    }

    /// Returns the reason why there is no recording, in a sentence; `None` if there is one.
    pub fn recording_missing(&self) -> Option<&str> {
        match &self.recording {
            Recorded::Found(_) => None,
            Recorded::Missing(why) => Some(why),
        }
    }

    /// Returns the recorded picture of frame `i`; `None` if the recording is not there.
    pub fn original(&self, i: usize) -> Result<Option<image::RgbImage>> {
        self.recording.frame(i)
    }

    /// Returns the mask of instruments on recorded frame `i`; `None` if the recording does not have one.
    pub fn instruments(&self, i: usize) -> Result<Option<Mask>> {
        self.sequence().map_or(Ok(None), |s| s.instruments(i))
    }
}
