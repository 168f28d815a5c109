//! The reconstruction of a recording: its check before, its training, and what was finished meanwhile.

use crate::{
    jobs::TRAINING,
    viewer::{
        backend::{
            Backend, Checked, Info, TrainNews, TrainRequest, Words,
            task::{Task, TaskEvent, TaskProgress},
        },
        remedy::message,
        state::loss_curve::LossCurve,
    },
};
use egui::Context;
use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::train::Quality;

/// Check, training and result of reconstructions.
#[derive(Default)]
pub(crate) struct Reconstruction {
    pub(crate) check: Option<ImportCheck>,
    pub(crate) training: Option<Training>,
    /// Trainings that begin when the present one has ended, the next one first.
    pub(crate) queue: VecDeque<TrainRequest>,
    /// Finished reconstructions that are not open, because something else was shown or the window was busy.
    pub(crate) finished: Vec<PathBuf>,
}

impl Reconstruction {
    /// Returns `true` if a recording is being reconstructed or waits for it.
    pub(crate) fn is_planned(&self, recording: &Path) -> bool {
        self.will_find_words(recording).is_some()
    }

    /// Returns `true` if words will be found in a recording once it is reconstructed; `None` if that is not
    /// planned.
    pub(crate) fn will_find_words(&self, recording: &Path) -> Option<bool> {
        let running = self.training.iter().map(|t| (&t.recording, t.finds_words));
        let waiting = self.queue.iter().map(|request| (&request.recording, request.words != Words::Nothing));
        running.chain(waiting).find(|(planned, _)| *planned == recording).map(|(_, finds_words)| finds_words)
    }

    /// Returns the scene files that are being made or will be.
    pub(crate) fn planned_scenes(&self) -> Vec<PathBuf> {
        let running = self.training.iter().map(|t| t.scene.clone());
        running.chain(self.queue.iter().map(|request| request.scene.clone())).collect()
    }

    /// Offers a finished reconstruction that is not opened now.
    pub(crate) fn offer(&mut self, scene: PathBuf) {
        self.forget(&scene);
        self.finished.push(scene);
    }

    /// Stops offering a finished reconstruction.
    pub(crate) fn forget(&mut self, scene: &Path) {
        self.finished.retain(|other| other != scene);
    }

    /// Returns `true` while the masks of the open recording are being inverted.
    pub(crate) fn is_flipping(&self) -> bool {
        self.check.as_ref().is_some_and(|check| check.flipping.is_some())
    }

    /// Returns `true` if the check of the open recording found that a reconstruction would be wrong.
    pub(crate) fn would_be_wrong(&self) -> bool {
        let outcome = self.check.as_ref().and_then(|check| check.outcome.as_ref());
        matches!(outcome, Some(Ok(checked)) if !checked.report.ok)
    }
}

/// Check of the open recording: its content, and faults that would make a reconstruction of it wrong.
pub(crate) struct ImportCheck {
    pub(crate) path: PathBuf,
    pub(crate) task: Task<Checked>,
    /// Result of the check, or the reason for its failure.
    pub(crate) outcome: Option<Result<Checked, String>>,
    /// Task that inverts which side of the masks is kept.
    pub(crate) flipping: Option<Task<PathBuf>>,
}

impl ImportCheck {
    /// Starts to read the whole recording in the background.
    pub(crate) fn start(backend: Arc<dyn Backend>, path: PathBuf, ctx: &Context) -> Self {
        let at = path.clone();
        let task = Task::start("check", ctx, move |task| backend.check(&at, task));
        Self { path, task, outcome: None, flipping: None }
    }

    pub(crate) fn poll(&mut self) {
        if let Some(TaskEvent::Done(result)) = self.task.poll() {
            self.outcome = Some(result.map_err(|e| message(&e)));
        }
    }
}

/// Training in the background, with all that comes before it.
pub(crate) struct Training {
    pub(crate) task: Task<PathBuf, TrainNews>,
    pub(crate) recording: PathBuf,
    /// The scene file that is being made.
    pub(crate) scene: PathBuf,
    /// Folder of what networks found so far, which stays; `None` without networks.
    pub(crate) features: Option<PathBuf>,
    /// `true` if words will be found in the scene.
    finds_words: bool,
    pub(crate) curve: LossCurve,
    backend: Arc<dyn Backend>,
    /// Available memory, bytes, and the time of that reading, seconds.
    pub(crate) memory: Option<(u64, f64)>,
    quality: Quality,
    /// Expected duration of the training itself, seconds; `None` if the recording's size is not known.
    expected_seconds: Option<f64>,
    whole: WholeWork,
    /// Duration of a step of [`Quality::Standard`], seconds, once there is a pace.
    pub(crate) seconds_per_step: Option<f64>,
    /// Time at which the window was asked to close, seconds. Closing waits until the scene is saved.
    pub(crate) closing_since: Option<f64>,
}

impl Training {
    pub(crate) fn start(
        backend: Arc<dyn Backend>,
        request: TrainRequest,
        expected_seconds: Option<f64>,
        ctx: &Context,
    ) -> Self {
        let (theirs, recording, scene) = (backend.clone(), request.recording.clone(), request.scene.clone());
        let features = matches!(request.words, Words::Models(_)).then(|| request.features_folder());
        let whole = WholeWork::of(&request.words);
        let finds_words = request.words != Words::Nothing;
        let quality = request.quality;
        let task = Task::start("training", ctx, move |task| theirs.reconstruct(&request, task));
        let curve = LossCurve::default();
        let (memory, seconds_per_step, closing_since) = (None, None, None);
        Self {
            task,
            recording,
            scene,
            features,
            finds_words,
            curve,
            backend,
            memory,
            quality,
            expected_seconds,
            whole,
            seconds_per_step,
            closing_since,
        }
    }

    /// Returns `true` if this is the training on the recording of `info`.
    pub(crate) fn is_about(&self, info: &Info) -> bool {
        info.recording.as_ref() == Some(&self.recording)
    }

    /// Returns `true` during the work before the training itself.
    pub(crate) fn is_preparing(&self) -> bool {
        !self.whole.has_begun
    }

    /// Returns the next event other than progress, if there is one. Progress is followed up to each of them,
    /// so that no stage between two parts of a long recording is missed.
    pub(crate) fn poll(&mut self) -> Option<TaskEvent<PathBuf, TrainNews>> {
        let event = self.task.poll();
        self.follow();
        event
    }

    /// Takes the latest progress: how far the whole work is, and the pace that later trainings are estimated
    /// from.
    fn follow(&mut self) {
        let progress = &self.task.progress;
        self.whole.follow(progress);
        if progress.stage == TRAINING {
            let pace = pace(&self.whole.training(progress), self.quality);
            self.seconds_per_step = pace.or(self.seconds_per_step);
        }
    }

    /// Returns the finished share of the whole work, 0–1.
    pub(crate) fn fraction(&self) -> f32 {
        self.whole.fraction
    }

    /// Returns the seconds that the whole work has taken, without pauses.
    pub(crate) fn seconds(&self) -> f64 {
        self.whole.seconds_before + self.task.progress.seconds
    }

    /// Returns the seconds that the whole work will still take; `None` before there is a pace.
    pub(crate) fn seconds_left(&self) -> Option<f64> {
        let progress = &self.task.progress;
        if progress.stage == TRAINING {
            return self.whole.training(progress).seconds_left();
        }
        let left = progress.seconds_left()? + self.expected_seconds?;
        // Between two parts of a long recording, the time of those that follow is not known.
        self.is_preparing().then_some(left)
    }

    /// Reads the available memory, at most once a second.
    pub(crate) fn watch_memory(&mut self, now: f64) {
        if self.memory.is_none_or(|(_, at)| now >= at + 1.0) {
            self.memory = self.backend.available_bytes().map(|bytes| (bytes, now));
        }
    }
}

/// Returns the duration of a step of [`Quality::Standard`], seconds, once there is a pace. A long recording
/// takes the steps of the quality for each of its parts.
fn pace(progress: &TaskProgress, quality: Quality) -> Option<f64> {
    let steps = quality.steps();
    let is_training = progress.total > 0 && progress.total.is_multiple_of(steps);
    let has_pace = is_training && progress.done * 10 > steps;
    has_pace.then(|| progress.seconds / progress.done as f64 / quality.step_cost())
}

/// Progress of work in several stages as one.
#[derive(Default)]
struct WholeWork {
    /// Share of the work before the training, and the number of its stages.
    before: (f32, usize),
    /// Stages so far, in their order.
    stages: Vec<String>,
    /// Duration of the stages that are over, and of the present one, seconds.
    seconds_before: f64,
    seconds: f64,
    /// Duration of the training of the parts of a long recording that are over, seconds.
    trained_before: f64,
    fraction: f32,
    /// `true` once the training itself has begun.
    has_begun: bool,
}

impl WholeWork {
    /// Plans the work by what makes words known: labels are read in a moment, networks take most of the time.
    fn of(words: &Words) -> Self {
        let before = match words {
            Words::Nothing => (0.1, 4),
            Words::Labels => (0.1, 8),
            Words::Models(_) => (0.6, 10),
        };
        Self { before, ..Self::default() }
    }

    /// Takes the progress of a stage. The whole never goes back. Each part of a long recording has stages before
    /// its training; they count for the first part alone.
    fn follow(&mut self, progress: &TaskProgress) {
        if self.stages.last() != Some(&progress.stage) {
            if self.stages.last().is_some_and(|stage| stage == TRAINING) {
                self.trained_before += self.seconds;
            }
            self.seconds_before += self.seconds;
            self.stages.push(progress.stage.clone());
        }
        self.seconds = progress.seconds;
        let (share, num_stages) = self.before;
        let fraction = if progress.stage == TRAINING {
            self.has_begun = true;
            share + (1.0 - share) * progress.fraction()
        } else if self.has_begun {
            self.fraction
        } else {
            let stages = (self.stages.len() - 1) as f32 + progress.fraction();
            share * (stages / num_stages as f32).min(1.0)
        };
        self.fraction = self.fraction.max(fraction);
    }

    /// Returns the progress of the training with the seconds of all its parts, as its steps are those of all.
    fn training(&self, progress: &TaskProgress) -> TaskProgress {
        TaskProgress { seconds: self.trained_before + progress.seconds, ..progress.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_is_known_after_a_tenth_of_the_steps_of_one_part_or_of_several() {
        let steps = Quality::Standard.steps();
        let pace = |done, total| {
            pace(&TaskProgress { done, total, seconds: 8.0, ..TaskProgress::default() }, Quality::Standard)
        };
        assert_eq!([pace(steps / 10, steps), pace(800, 800), pace(0, 0)], [None; 3]);
        assert_eq!([pace(800, steps), pace(800, 9 * steps)], [Some(0.01); 2]);
    }

    #[test]
    fn the_pace_and_the_time_left_are_those_of_all_parts_so_far() {
        let (steps, mut whole) = (Quality::Standard.steps(), WholeWork::of(&Words::Nothing));
        let mut follow = |stage: &str, done, seconds| {
            let stage = stage.to_owned();
            let progress = TaskProgress { stage, done, total: 3 * steps, seconds, ..TaskProgress::default() };
            whole.follow(&progress);
            whole.training(&progress)
        };
        for part in 0..3 {
            follow("following points", 5, 3.0);
            let half = follow(TRAINING, part * steps + steps / 2, 20.0);
            assert_eq!(pace(&half, Quality::Standard), Some(0.01), "part {part}");
            let left = half.seconds_left().map(f64::round);
            assert_eq!(left, Some(100.0 - 40.0 * part as f64), "part {part}");
            follow(TRAINING, (part + 1) * steps, 40.0);
        }
    }

    #[test]
    fn stages_make_one_progress_that_never_goes_back() {
        let stages = ["looking", "path", "points", TRAINING, "points", TRAINING];
        for words in [Words::Nothing, Words::Labels] {
            let mut whole = WholeWork::of(&words);
            let mut last = 0.0;
            for (k, stage) in stages.into_iter().enumerate() {
                for done in 0..=10 {
                    let (done, total) = match (stage, k) {
                        (TRAINING, 3) => (done, 20),
                        (TRAINING, _) => (done + 10, 20),
                        _ => (done, 10),
                    };
                    let seconds = if stage == TRAINING && k > 3 { done - 10 } else { done } as f64;
                    let (stage, detail) = (stage.into(), String::new());
                    whole.follow(&TaskProgress { stage, done, total, detail, seconds });
                    assert!((last..=1.0).contains(&whole.fraction), "stage {k}, {done}");
                    last = whole.fraction;
                }
                let most = [0.1, 0.1, 0.1, 0.55, 0.55, 1.0][k];
                assert!(whole.fraction <= most + 1e-6, "{} after {k} stages", whole.fraction);
                assert_eq!(whole.has_begun, k >= 3);
            }
            assert_eq!((whole.fraction, whole.seconds_before), (1.0, 50.0));
        }
    }
}
