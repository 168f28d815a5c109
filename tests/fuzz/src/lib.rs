//! Fuzz targets: everything that reads what somebody else wrote, as functions of arbitrary bytes.
//! None of them may panic, hang or use memory out of proportion, whatever the bytes are. Everything
//! that they accept must be consistent.
//!
//! `tests/short_run.rs` runs them in CI, on all regressions and on seeded mutations of the seeds; `libfuzzer`
//! runs them guided by coverage (see README.md).

mod dicom;
mod mutate;
#[cfg(feature = "program")]
mod program;
mod recordings;
mod scenes;
mod structured;

pub use mutate::Mutator;

/// A reader to be tried.
pub struct Target {
    /// Name of the target and of its folder of regressions.
    pub name: &'static str,
    /// Reads the bytes and checks the result.
    pub run: fn(&[u8]),
    /// Good input to start from.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

impl std::fmt::Debug for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

/// All targets.
pub fn targets() -> Vec<Target> {
    let mut targets = Vec::from(scenes::TARGETS);
    targets.extend(recordings::TARGETS);
    targets.extend(structured::TARGETS);
    targets.extend(dicom::TARGETS);
    #[cfg(feature = "program")]
    targets.extend(program::TARGETS);
    targets
}

/// Runs the target of a name.
///
/// # Panics
/// If there is no such target.
pub fn run(name: &str, bytes: &[u8]) {
    match targets().into_iter().find(|t| t.name == name) {
        Some(target) => (target.run)(bytes),
        None => panic!("there is no target {name}"),
    }
}

/// Checks that a refusal says something, in printable words.
fn expect_words<T>(result: surgtpgs_core::Result<T>) -> Option<T> {
    match result {
        Ok(value) => Some(value),
        Err(error) => {
            let text = error.to_string();
            assert!(!text.trim().is_empty(), "an error without words: {error:?}");
            None
        }
    }
}
