//! The judgement on a recording's camera, and what users are told of it.

/// Most frames of a recording, or of a chapter, that points are followed through; a frame takes some 50 ms.
pub(super) const MOST_FRAMES: usize = 3000;

/// The judgement on a recording's camera.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScopeVerdict {
    /// It stands still, or nothing says otherwise.
    #[default]
    Still,
    /// It moves along a path that explains what is seen.
    Moves {
        /// Horizontal field of view, degrees, if that was estimated, too.
        fov_x_degrees: Option<f32>,
        /// Number of frames after which the tissue comes back, if it was seen to come back again and again:
        /// what of the path does, too, is not in it.
        period_frames: Option<f32>,
        /// First and last frame that the path is known for, if it breaks off: before and after them the
        /// camera is taken to stand still.
        known: Option<[usize; 2]>,
    },
    /// Something moves that neither a still camera nor a path explains.
    Unclear,
    /// Its poses are known, and explain little of what is seen.
    Unexplained,
    /// The path breaks off at this frame: nothing that was seen before is seen there, and no other part is
    /// longer than half of the recording.
    Lost(usize),
    /// Too many frames are learned together: nothing was looked for.
    TooLong {
        /// Number of these frames.
        frames: usize,
        /// `true` if the poses are known, and depth would follow from them.
        has_poses: bool,
    },
}

impl ScopeVerdict {
    /// Says, at the end of a sentence, that what sways with a period is taken for tissue.
    pub fn sway_note(period_frames: f32) -> String {
        format!(
            "; what comes again every {period_frames:.0} frames is taken for tissue that breathes or beats"
        )
    }

    /// Says, after "from the pictures", of which frames the path is known.
    pub fn known_note([first, last]: [usize; 2]) -> String {
        format!(" of frames {first} to {last}, before and after which it is not known")
    }

    /// Returns a sentence for users; `None` if the camera stands still, as they expect.
    pub fn note(&self) -> Option<String> {
        let still = "the scope is taken to stand still";
        match self {
            Self::Still => None,
            Self::Moves { fov_x_degrees, period_frames, known } => {
                let part = known.map(Self::known_note).unwrap_or_default();
                let lens = fov_x_degrees.map(|fov| format!(", and its field of view as {fov:.0}°"));
                let lens = lens.unwrap_or_default();
                let sway = period_frames.map(Self::sway_note).unwrap_or_default();
                Some(format!("The scope moves: its path was estimated from the pictures{part}{lens}{sway}"))
            }
            Self::Unclear => {
                Some(format!("Something moves that neither a still scope nor a moving one explains: {still}"))
            }
            Self::Unexplained => Some(
                "The camera's poses explain little of what is seen: much moves by itself, or they are not of this \
                 recording"
                    .into(),
            ),
            Self::Lost(frame) => Some(format!(
                "The scope's path breaks off at frame {frame}, where nothing is seen that was seen before: {still}"
            )),
            Self::TooLong { frames, has_poses } => {
                let (what, so) = match has_poses {
                    true => ("points are followed through", "depth is not known"),
                    false => ("the scope's path is looked for in", still),
                };
                Some(format!("{frames} frames are learned together, and {what} {MOST_FRAMES} at most: {so}"))
            }
        }
    }
}
