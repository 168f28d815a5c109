//! Readers of the window's files, to be tried on arbitrary bytes.

use super::{
    command::{COMMANDS, keys},
    state::{phases, preferences::Preferences, session::Session},
};
use std::path::Path;
use surgtpgs_core::Result;

/// Reads a session and writes it to a file beside it.
///
/// # Panics
/// If the written session differs from the one that was read.
pub fn session(file: &Path) -> Result<()> {
    let read = Session::load(file)?;
    let copy = file.with_extension("copy");
    read.save(&copy)?;
    // A session of an older version is written with the newest version.
    let again = Session::load(&copy).map(|again| Session { version: read.version, ..again });
    assert!(again.as_ref().is_ok_and(|again| *again == read), "{read:?} became {again:?}");
    Ok(())
}

/// Reads phases of an operation, and writes and reads them again.
///
/// # Panics
/// If they overlap, or differ after that.
pub fn phases(text: &str) {
    const FRAMES: usize = 1000;
    let Ok(read) = phases::read(text, FRAMES) else { return };
    assert!(read.windows(2).all(|pair| pair[0].last < pair[1].first), "phases that overlap: {read:?}");
    let again = phases::read(&phases::csv(&read, |frame| frame as f64), FRAMES);
    assert_eq!(again.as_ref(), Ok(&read));
}

/// Reads preferences and applies their keys. Damaged preferences become those of a first start.
///
/// # Panics
/// If values are beyond their ranges.
pub fn preferences(file: &Path) {
    let read = Preferences::load(Some(file.to_owned()));
    assert!((75..=200).contains(&read.scale_percent), "text of {} percent", read.scale_percent);
    assert_eq!(read.overlay, read.overlay.mended(), "an overlay beyond its ranges");
    for entry in COMMANDS {
        keys::keys(entry, &read.keys);
    }
}
