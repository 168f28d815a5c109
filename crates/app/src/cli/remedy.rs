//! Errors and notes in the terms of the command line.

use surgtpgs_core::{Error, Remedy, poses::ScopeVerdict};

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

/// Returns the note on a recording's camera, with the option that helps; `None` if there is nothing to say.
pub(super) fn scope_note(scope: &ScopeVerdict) -> Option<String> {
    let note = scope.note()?;
    Some(match scope {
        ScopeVerdict::TooLong { .. } => {
            format!("{note}. A smaller number of `--chapter-frames` above 0 helps")
        }
        _ => note,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_too_much_is_learned_together_the_option_is_named() {
        let note = |has_poses| scope_note(&ScopeVerdict::TooLong { frames: 5000, has_poses }).unwrap();
        assert!([true, false].map(note).iter().all(|note| note.contains("`--chapter-frames`")));
        assert!(!scope_note(&ScopeVerdict::Unclear).unwrap().contains("--"));
        assert_eq!(scope_note(&ScopeVerdict::Still), None);
    }
}
