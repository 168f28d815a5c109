//! Errors in the terms of the window.

use crate::viewer::text::sentence;
use surgtpgs_core::{Error, Remedy};

/// Returns the message of an error where it stands alone, beginning with a capital letter.
pub(crate) fn statement(error: &Error) -> String {
    sentence(&message(error))
}

/// Returns the message of an error, with what the window offers about it.
pub(crate) fn message(error: &Error) -> String {
    error.told(|remedy| match remedy {
        Remedy::Replace => "The window replaces nothing: remove it first.",
        Remedy::UseCpu => "The command line can do it on the CPU.",
        Remedy::CheckRecording => "Open the recording: its check says what it holds.",
        Remedy::Prepare => "Reconstruct the recording with its labels, or with networks.",
        Remedy::OtherFeatures => "Choose networks that find regions and tell what they show.",
        Remedy::OtherEncoder => "Put it back where it was, or give its folder on the command line.",
        Remedy::FindRecording => "Open the recording first, or export pictures from the reconstruction.",
    })
}
