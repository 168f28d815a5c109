//! The check of a recording before anything is made of it.

use surgtpgs_core::{
    Error, Result,
    poses::{self, ANY_DEPTH, ScopeVerdict, Timeline},
    progress::Observer,
    sequence::{self, CheckReport, Sequence},
};

/// Number of frames that a scope's motion is judged by at most; a frame takes some 50 ms.
const LOOKED_AT: usize = 96;

/// Checks a recording, and judges if its scope moves where nothing is known of that.
///
/// # Errors
/// The observer's wish to stop; wrong files become entries of the report.
pub fn check(sequence: &Sequence, observer: &mut Observer<'_>) -> Result<CheckReport> {
    let mut report = sequence::check(sequence, observer)?;
    if report.ok && poses::are_wanted(sequence) {
        report.warnings.extend(scope(sequence, &report, observer)?);
    }
    Ok(report)
}

/// Says if the scope moves in the first shot, or that it cannot be told, but not that it stands still. Also
/// says which frames are blurred.
fn scope(sequence: &Sequence, report: &CheckReport, observer: &mut Observer<'_>) -> Result<Vec<String>> {
    let end = report.cuts.first().copied().unwrap_or(report.frames).min(LOOKED_AT);
    let frames: Vec<usize> = (0..end).collect();
    let times = sequence.times();
    let timeline = Timeline { frames: &frames, times: &times };
    let path = match poses::estimate(sequence, timeline, ANY_DEPTH, observer) {
        Ok(path) => path,
        Err(Error::Cancelled) => return Err(Error::Cancelled),
        // A frame that cannot be read is told by the check itself.
        Err(_) => return Ok(Vec::new()),
    };
    let last = end.saturating_sub(1);
    let verdict = match path.verdict {
        ScopeVerdict::Moves { fov_x_degrees, period_frames, known } => {
            let part = known.map(ScopeVerdict::known_note);
            let lens = fov_x_degrees.map(|fov| format!(", and its field of view, which is about {fov:.0}°"));
            let sway = period_frames.map(ScopeVerdict::sway_note);
            Some(format!(
                "The scope moves, as far as frames 0 to {last} tell. Its path will be estimated from the pictures{}{}{}",
                part.unwrap_or_default(),
                lens.unwrap_or_default(),
                sway.unwrap_or_default()
            ))
        }
        other => other.note().map(|note| format!("{note} (judged by frames 0 to {last})")),
    };
    let blurred = (!path.blurred.is_empty()).then(|| {
        format!("Blurred, and of no use for the scope's path: {}", sequence::name_frames(&path.blurred))
    });
    Ok(verdict.into_iter().chain(blurred).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use surgtpgs_core::{
        demo::{self, DemoSettings},
        progress::unobserved,
    };

    /// Checks the pictures of a rigid demo, without its poses and depth.
    fn warnings(moving_camera: bool, blurred: bool) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let settings =
            DemoSettings { frames: 24, moving_camera, rigid: true, blurred, ..DemoSettings::default() };
        demo::write(&settings, &folder.path().join("all"), &mut unobserved).unwrap();
        let images = folder.path().join("recording");
        std::fs::rename(folder.path().join("all/images"), &images).unwrap();
        let report = check(&Sequence::open(&images).unwrap(), &mut unobserved).unwrap();
        assert!(report.ok, "{:?}", report.errors);
        report.warnings
    }

    #[test]
    fn a_scope_that_moves_is_told_and_one_that_stands_still_is_not() {
        let moving = warnings(true, false);
        assert!(
            moving.iter().any(|w| w.starts_with("The scope moves, as far as frames 0 to 23")),
            "{moving:?}"
        );
        let still = warnings(false, false);
        assert!(!still.iter().any(|w| w.contains("scope")), "{still:?}");
    }

    #[test]
    fn blurred_frames_are_named() {
        let told = warnings(true, true);
        let expected = "Blurred, and of no use for the scope's path: frames 3, 8, 13, 18, 23";
        assert!(told.iter().any(|w| w == expected), "{told:?}");
    }
}
