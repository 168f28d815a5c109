//! Files of the window, read as it does: to be tried on arbitrary bytes.

use super::{keymap, preferences::Preferences, session::Session};
use std::path::Path;
use surgtpgs_core::Result;

/// Reads a session and writes it beside itself.
///
/// # Panics
/// Where what was written is not what was read.
pub fn session(file: &Path) -> Result<()> {
    let read = Session::load(file)?;
    let copy = file.with_extension("copy");
    read.save(&copy)?;
    // An older version is written as the newest.
    let again = Session::load(&copy).map(|again| Session { version: read.version, ..again });
    assert!(again.as_ref().is_ok_and(|again| *again == read), "{read:?} became {again:?}");
    Ok(())
}

/// Reads preferences, which damage makes those of a first start, and uses their keys.
///
/// # Panics
/// Where they are beyond their ranges.
pub fn preferences(file: &Path) {
    let read = Preferences::load(Some(file.to_owned()));
    assert!((75..=200).contains(&read.scale_percent), "text of {} percent", read.scale_percent);
    assert_eq!(read.overlay, read.overlay.mended(), "an overlay beyond its ranges");
    keymap::apply(&read.keys);
}
