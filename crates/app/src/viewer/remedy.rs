//! Errors in the terms of the window.

use surgtpgs_core::{Error, Remedy};

/// Returns the message of an error, with what the window offers about it.
pub(crate) fn message(error: &Error) -> String {
    error.told(|remedy| match remedy {
        Remedy::Replace => "The window replaces nothing: remove it first.",
        Remedy::UseCpu => "The command line can do it on the CPU.",
        Remedy::CheckRecording => "Open the recording: its check says what it holds.",
        Remedy::Prepare => "Reconstruct a recording with labels, or one that the command line has prepared.",
        Remedy::OtherFeatures => "The command line can take features from automatic masks.",
        Remedy::OtherEncoder => "Put it back where it was, or give its folder on the command line.",
        Remedy::FindRecording => "Open the recording first, or export pictures from the reconstruction.",
    })
}
