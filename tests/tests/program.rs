//! The program as its users meet it.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

/// Small models of every contract.
#[path = "../../crates/clip/tests/models/mod.rs"]
mod models;

/// A model of LPIPS' contract.
#[path = "../../crates/clip/tests/models/distance.rs"]
mod distance;

/// A recording without labels.
mod any_recording;
/// Bad input ends in one plain line and a code, never in a panic.
mod bad_input;
/// Many recordings, one report.
mod batch;
/// Long recordings, chapter by chapter.
mod chapters;
/// From a recording to masked frames, and what each verb reports.
mod data_flow;
/// The headless job of a bare `surgtpgs`.
mod default_job;
/// Recordings in DICOM, and what is kept of them.
mod dicom;
/// Full disks, kills and readers that go away.
#[cfg(target_os = "linux")]
mod faults;
/// Scenes to and from what other programs read.
mod formats;
/// One command judges the GPU of a machine.
mod gpu;
/// A recording is known again by its frames.
mod identity;
/// Marks by hand: asked, corrected, exported, prepared, refused.
mod marks;
/// Inputs, other people's files and earlier results are safe.
mod outputs;
/// Nothing that speaks to a network is built in.
mod privacy;
/// Comments and pages: first words, lengths, citations, links.
mod words;
/// A folder with everything that verbs read.
mod workplace;
