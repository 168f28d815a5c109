//! Errors in the terms of the command line.

use surgtpgs_core::{Error, Remedy};

/// Returns the message of an error, with the option or the verb that helps.
pub(super) fn message(error: &Error) -> String {
    error.told(|remedy| match remedy {
        Remedy::Replace => "`--force` replaces what is there.",
        Remedy::UseCpu => "`--backend cpu` does without the GPU.",
        Remedy::CheckRecording => "`surgtpgs check` says what the recording holds.",
        Remedy::Prepare => "Run `surgtpgs prepare` on the recording, and train on the prepared folder.",
        Remedy::OtherFeatures => "Use automatic masks (`--masks-model`), or train on it without features.",
        Remedy::OtherEncoder => "`--text-encoder` names its folder.",
        Remedy::FindRecording => {
            "Say where the recording is with `--sequence`, or export with `--source reconstruction`."
        }
    })
}
