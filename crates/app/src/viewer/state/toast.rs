//! A short message about what has just happened, with a way back.

/// Seconds that a message is shown.
pub(crate) const SHOWN_SECS: f64 = 7.0;

/// A message about what has just happened.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Toast {
    pub(crate) text: String,
    /// Offer to take it back.
    pub(crate) back: Option<Back>,
    /// Time at which it vanishes, by the window's clock, seconds.
    pub(crate) until: f64,
    /// Revision of the document that the message is about.
    pub(crate) revision: u64,
}

/// A way back from what a message is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Back {
    /// Undoes the last edit.
    Undo,
    /// Shows everything that is drawn over the picture again.
    ShowOverlays,
}
