//! Recordings whose files vanish while they are trained on, and disks that cannot keep what is done.

use super::train::{Watched, go_on};
use std::{fs, ops::ControlFlow};
use surgtpgs_core::{
    demo::{self, DemoSettings},
    progress::{Progress, unobserved},
    sequence::Sequence,
    train::{StepReport, TrainSettings, Trainer},
};

/// A small recording whose pictures can be taken away.
struct Vanishing {
    folder: tempfile::TempDir,
}

impl Vanishing {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let small = DemoSettings { width: 48, height: 32, frames: 8, ..DemoSettings::default() };
        demo::write(&small, &folder.path().join("recording"), &mut unobserved).unwrap();
        Self { folder }
    }

    fn trainer(&self, iterations: usize) -> Trainer {
        let sequence = Sequence::open(&self.folder.path().join("recording")).unwrap();
        let settings = TrainSettings { iterations, ..TrainSettings::default() };
        Trainer::new(&sequence, None, settings).unwrap()
    }

    fn take_away(&self) {
        let images = self.folder.path().join("recording/images");
        fs::rename(images, self.folder.path().join("away")).unwrap();
    }

    fn bring_back(&self) {
        let images = self.folder.path().join("recording/images");
        fs::rename(self.folder.path().join("away"), images).unwrap();
    }
}

#[test]
fn training_whose_recording_vanishes_is_kept_and_goes_on_as_if_nothing_had_happened() {
    // The pictures vanish in the first round of the frames, or after the last step.
    for (iterations, last_step) in [(12, 2), (4, 4)] {
        let here = Vanishing::new();
        let whole = go_on(&mut here.trainer(iterations), None, &mut unobserved, &mut |_, _| {}).unwrap();
        let checkpoint = here.folder.path().join("scene.unfinished");
        let mut vanish = |_: &mut Watched<'_>, report: &StepReport| {
            if report.step == last_step {
                here.take_away();
            }
        };
        let broken = go_on(&mut here.trainer(iterations), Some(&checkpoint), &mut unobserved, &mut vanish);
        let message = broken.err().expect("an error").to_string();
        assert!(message.contains("could not open the picture") && message.contains(".png"), "{message}");
        here.bring_back();
        let sequence = Sequence::open(&here.folder.path().join("recording")).unwrap();
        let mut trainer = Trainer::resume(&sequence, None, &checkpoint).unwrap();
        assert_eq!(trainer.steps_done(), last_step);
        let resumed = go_on(&mut trainer, Some(&checkpoint), &mut unobserved, &mut |_, _| {}).unwrap();
        assert!(resumed.scene.gaussians == whole.scene.gaussians, "{iterations} steps");
        assert!(resumed.scene.deformation == whole.scene.deformation, "{iterations} steps");
    }
}

#[test]
fn what_cannot_be_kept_to_go_on_from_is_said_and_ends_no_training() {
    let here = Vanishing::new();
    let nowhere = here.folder.path().join("recording/sequence.toml/scene.unfinished");
    let mut stop = |p: &Progress<'_>| match p.done {
        3 => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let trained = go_on(&mut here.trainer(12), Some(&nowhere), &mut stop, &mut |_, _| {}).unwrap();
    assert!(trained.steps == 3 && !trained.scene.gaussians.is_empty() && !nowhere.exists());
    assert!(trained.notes[0].starts_with("step 3 could not be kept"), "{:?}", trained.notes);
}
