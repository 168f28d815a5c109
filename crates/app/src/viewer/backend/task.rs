//! Long work on named threads, with progress and cancellation. The window polls and does not wait.

use crate::jobs;
use std::{
    ops::ControlFlow,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU32, Ordering},
        mpsc::{Receiver, Sender, channel},
    },
    time::Duration,
};
use surgtpgs_core::{Error, Result};

/// Default number of seconds between two previews.
const USUAL_PREVIEW_SECONDS: u32 = 4;

/// Stage of a task whose work is done but cannot be saved yet. It waits until it is saved or given up.
pub(crate) const NOT_SAVED: &str = "not saved yet";

/// Levels of the wish to end a task; each includes those before.
const STOP: u32 = 1;
const GIVE_UP: u32 = 2;

/// Progress of a task.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TaskProgress {
    /// Name of the stage, e.g. "training".
    pub(crate) stage: String,
    pub(crate) done: usize,
    pub(crate) total: usize,
    /// Further figures in words, e.g. "12 000 Gaussians"; may be empty.
    pub(crate) detail: String,
    /// Seconds since this stage began, without pauses.
    pub(crate) seconds: f64,
}

impl TaskProgress {
    /// Returns the finished share, 0–1.
    pub(crate) fn fraction(&self) -> f32 {
        if self.total == 0 { 0.0 } else { self.done as f32 / self.total as f32 }
    }

    /// Returns `true` if the work is done but cannot be saved yet.
    pub(crate) fn is_unsaved(&self) -> bool {
        self.stage == NOT_SAVED
    }

    /// Returns the seconds that this stage will still take at the pace so far; `None` before there is a pace.
    pub(crate) fn seconds_left(&self) -> Option<f64> {
        let has_pace = self.done > 0 && self.seconds >= 2.0;
        has_pace.then(|| self.seconds / self.done as f64 * self.total.saturating_sub(self.done) as f64)
    }
}

/// Message from a task: `T` is what it returns, `U` what it tells meanwhile.
pub(crate) enum TaskEvent<T, U = ()> {
    Progress(TaskProgress),
    /// An intermediate state, or other news.
    Update(U),
    /// The end of the task; nothing follows.
    Done(Result<T>),
}

/// Message from a running task, independent of its return type.
enum News<U> {
    Progress(TaskProgress),
    Update(U),
    Note(U),
}

/// Time within which progress is shown. A step of a training takes less than drawing the window may take on a
/// computer without a GPU, which would leave no processor to the training.
const PROGRESS_WITHIN: Duration = Duration::from_secs(1);

/// The task's own side of a [`Task`].
pub(crate) struct TaskContext<U = ()> {
    report: Box<dyn Fn(News<U>) + Send + Sync>,
    /// The wish to end the task: 0, or one of its levels.
    end: Arc<AtomicU32>,
    pause: Arc<Pause>,
    wishes: Arc<Wishes>,
    stage_began: Mutex<(String, std::time::Instant)>,
}

impl<U> TaskContext<U> {
    /// Reports the progress of the task.
    pub(crate) fn progress(&self, stage: &str, done: usize, total: usize, detail: String) {
        let seconds = {
            let mut began = lock(&self.stage_began);
            if began.0 != stage {
                *began = (stage.to_owned(), std::time::Instant::now());
            }
            began.1.elapsed().as_secs_f64()
        };
        (self.report)(News::Progress(TaskProgress { stage: stage.to_owned(), done, total, detail, seconds }));
    }

    /// Tells the window an intermediate state, or other news.
    pub(crate) fn update(&self, update: U) {
        (self.report)(News::Update(update));
    }

    /// Tells the window news that can wait until it draws the next progress.
    pub(crate) fn note(&self, note: U) {
        (self.report)(News::Note(note));
    }

    /// Returns the time between two previews; `None` if nobody wants to see them.
    pub(crate) fn preview_every(&self) -> Option<Duration> {
        let seconds = self.wishes.preview_every.load(Ordering::Relaxed);
        (seconds > 0).then(|| Duration::from_secs(seconds.into()))
    }

    /// Returns the frame that the user looks at.
    pub(crate) fn play_head(&self) -> usize {
        self.wishes.play_head.load(Ordering::Relaxed) as usize
    }

    /// Returns `true` if the user asked to stop.
    pub(crate) fn is_cancelled(&self) -> bool {
        self.end.load(Ordering::Relaxed) >= STOP
    }

    /// Returns `true` if the user gave up finished work that waits to be saved.
    pub(crate) fn is_given_up(&self) -> bool {
        self.end.load(Ordering::Relaxed) >= GIVE_UP
    }

    /// Waits while the task is paused; returns at once if it is to stop.
    pub(crate) fn rest_while_paused(&self) {
        let is_resting = |is_paused: &mut bool| *is_paused && !self.is_cancelled();
        let began = std::time::Instant::now();
        drop(self.pause.changed.wait_while(lock(&self.pause.is_paused), is_resting));
        // Pauses do not count as work and must not change the pace of the stage.
        lock(&self.stage_began).1 += began.elapsed();
    }

    /// Reports the progress of a job, and breaks if it is to stop.
    pub(crate) fn follow(&self, job: &jobs::Progress<'_>) -> ControlFlow<()> {
        self.progress(job.stage, job.done, job.total, job.detail.to_owned());
        self.rest_while_paused();
        if self.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Returns [`Error::Cancelled`] if the user asked to stop.
    pub(crate) fn check(&self) -> Result<()> {
        if self.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
    }
}

#[cfg(test)]
impl<U> TaskContext<U> {
    /// Makes the context of work without a window, which is asked to stop at the first progress that `stops`
    /// is true for.
    pub(crate) fn stopping_at(stops: impl Fn(&TaskProgress) -> bool + Send + Sync + 'static) -> Self {
        let end = Arc::new(AtomicU32::new(0));
        let wish = end.clone();
        let report = move |news: News<U>| {
            if let News::Progress(progress) = news
                && stops(&progress)
            {
                wish.store(STOP, Ordering::Relaxed);
            }
        };
        Self {
            report: Box::new(report),
            end,
            pause: Arc::default(),
            wishes: Arc::new(Wishes::usual()),
            stage_began: Mutex::new((String::new(), std::time::Instant::now())),
        }
    }
}

/// Wishes of the user while a task runs.
struct Wishes {
    /// Seconds between two previews; 0 means never.
    preview_every: AtomicU32,
    /// Frame that the user looks at.
    play_head: AtomicU32,
}

impl Wishes {
    /// Returns those of a user who has not said any.
    fn usual() -> Self {
        Self { preview_every: AtomicU32::new(USUAL_PREVIEW_SECONDS), play_head: AtomicU32::new(0) }
    }
}

/// Pause switch of a task.
#[derive(Default)]
struct Pause {
    is_paused: Mutex<bool>,
    changed: Condvar,
}

impl Pause {
    /// Makes a paused task check again if it is to continue.
    fn wake(&self) {
        // Taking the lock ensures that no task misses the notice between its check and its wait.
        drop(lock(&self.is_paused));
        self.changed.notify_all();
    }
}

/// Locks a mutex, also one whose thread has panicked.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The window's side of a task. Dropping it ends the task and gives up what is not saved.
pub(crate) struct Task<T, U = ()> {
    events: Receiver<TaskEvent<T, U>>,
    end: Arc<AtomicU32>,
    pause: Arc<Pause>,
    wishes: Arc<Wishes>,
    /// The latest progress.
    pub(crate) progress: TaskProgress,
}

impl<T: Send + 'static, U: Send + 'static> Task<T, U> {
    /// Starts `work` on a thread of its own; `ctx` is repainted when the task reports something, and soon when
    /// that is progress.
    pub(crate) fn start(
        name: &str,
        ctx: &egui::Context,
        work: impl FnOnce(&TaskContext<U>) -> Result<T> + Send + 'static,
    ) -> Self {
        let (sender, events) = channel();
        let end = Arc::new(AtomicU32::new(0));
        let pause = Arc::new(Pause::default());
        let wishes = Arc::new(Wishes::usual());
        let context = context(sender.clone(), ctx.clone(), end.clone(), pause.clone(), wishes.clone());
        let (at_end, repaint) = (sender.clone(), ctx.clone());
        let body = move || {
            let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(&context)));
            // The receiver is gone if the window has dropped the task.
            let _ = at_end.send(TaskEvent::Done(result.unwrap_or_else(|_| Err(broken()))));
            repaint.request_repaint();
        };
        if let Err(e) = std::thread::Builder::new().name(name.to_owned()).spawn(body) {
            let _ = sender.send(TaskEvent::Done(Err(Error::Missing {
                what: format!("no thread could be started: {e}"),
                hint: "Close other programs and try again.".into(),
            })));
        }
        Self { events, end, pause, wishes, progress: TaskProgress::default() }
    }

    /// Asks the task to stop at the next opportunity. Finished work still waits to be saved.
    pub(crate) fn cancel(&self) {
        self.end_at(STOP);
    }

    /// Asks the task to stop, and to give up finished work that waits to be saved.
    pub(crate) fn give_up(&self) {
        self.end_at(GIVE_UP);
    }

    /// Pauses or resumes the task.
    pub(crate) fn set_paused(&self, is_paused: bool) {
        *lock(&self.pause.is_paused) = is_paused;
        self.pause.wake();
    }

    pub(crate) fn is_paused(&self) -> bool {
        *lock(&self.pause.is_paused)
    }

    /// Sets the number of seconds between two previews; 0 means never.
    pub(crate) fn set_preview_seconds(&self, seconds: u32) {
        self.wishes.preview_every.store(seconds, Ordering::Relaxed);
    }

    pub(crate) fn preview_seconds(&self) -> u32 {
        self.wishes.preview_every.load(Ordering::Relaxed)
    }

    /// Tells the task which frame the user looks at.
    pub(crate) fn set_play_head(&self, frame: usize) {
        self.wishes.play_head.store(frame as u32, Ordering::Relaxed);
    }

    #[cfg(test)]
    pub(crate) fn play_head(&self) -> usize {
        self.wishes.play_head.load(Ordering::Relaxed) as usize
    }

    pub(crate) fn is_cancelling(&self) -> bool {
        self.end.load(Ordering::Relaxed) >= STOP
    }

    /// Returns the next event other than progress, if there is one; progress is kept in [`Task::progress`].
    pub(crate) fn poll(&mut self) -> Option<TaskEvent<T, U>> {
        while let Ok(event) = self.events.try_recv() {
            match event {
                TaskEvent::Progress(progress) => self.progress = progress,
                other => return Some(other),
            }
        }
        None
    }
}

impl<T, U> Task<T, U> {
    fn end_at(&self, level: u32) {
        self.end.fetch_max(level, Ordering::Relaxed);
        self.pause.wake();
    }
}

impl<T, U> Drop for Task<T, U> {
    fn drop(&mut self) {
        self.end_at(GIVE_UP);
    }
}

fn context<T: Send + 'static, U: Send + 'static>(
    sender: Sender<TaskEvent<T, U>>,
    repaint: egui::Context,
    end: Arc<AtomicU32>,
    pause: Arc<Pause>,
    wishes: Arc<Wishes>,
) -> TaskContext<U> {
    let report = move |news: News<U>| {
        let (event, shown_within) = match news {
            News::Progress(progress) => (TaskEvent::Progress(progress), Some(PROGRESS_WITHIN)),
            News::Update(update) => (TaskEvent::Update(update), Some(Duration::ZERO)),
            News::Note(note) => (TaskEvent::Update(note), None),
        };
        if let (Ok(()), Some(within)) = (sender.send(event), shown_within) {
            repaint.request_repaint_after(within);
        }
    };
    let stage_began = Mutex::new((String::new(), std::time::Instant::now()));
    TaskContext { report: Box::new(report), end, pause, wishes, stage_began }
}

fn broken() -> Error {
    Error::input(
        "the program made a mistake and stopped this work",
        "What was finished is kept; please report what you did.",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wait<T: Send + 'static>(task: &mut Task<T>) -> TaskEvent<T> {
        loop {
            match task.poll() {
                Some(event) => return event,
                None => std::thread::yield_now(),
            }
        }
    }

    #[test]
    fn a_task_reports_and_ends() {
        let mut task = Task::start("test", &egui::Context::default(), |task| {
            task.progress("counting", 3, 4, "three".into());
            Ok(7)
        });
        assert!(matches!(wait(&mut task), TaskEvent::Done(Ok(7))));
        assert_eq!((task.progress.done, task.progress.fraction()), (3, 0.75));
    }

    #[test]
    fn progress_is_drawn_soon_and_news_at_once() {
        let ctx = egui::Context::default();
        let delays = Arc::new(Mutex::new(Vec::new()));
        let asked = delays.clone();
        ctx.set_request_repaint_callback(move |info| lock(&asked).push(info.delay));
        let mut task = Task::start("test", &ctx, |task: &TaskContext<i32>| {
            (0..100).for_each(|step| {
                task.note(step);
                task.progress("counting", step as usize, 100, String::new());
            });
            task.update(7);
            Ok(())
        });
        let mut news = Vec::new();
        loop {
            match task.poll() {
                Some(TaskEvent::Update(update)) => news.push(update),
                Some(_) => break,
                None => std::thread::yield_now(),
            }
        }
        assert_eq!(news, (0..100).chain([7]).collect::<Vec<_>>());
        let delays = lock(&delays);
        assert_eq!((delays[0], delays.last()), (PROGRESS_WITHIN, Some(&Duration::ZERO)));
        assert!(delays.len() < 5, "{delays:?}");
    }

    #[test]
    fn a_cancelled_task_stops() {
        let mut task: Task<()> = Task::start("test", &egui::Context::default(), |task| {
            loop {
                task.check()?;
                std::thread::yield_now();
            }
        });
        task.cancel();
        assert!(matches!(wait(&mut task), TaskEvent::Done(Err(Error::Cancelled))));
    }

    #[test]
    fn a_paused_task_rests_until_it_goes_on_or_is_cancelled() {
        let (passed, counter) = channel();
        let mut task: Task<()> = Task::start("test", &egui::Context::default(), move |task| {
            loop {
                task.rest_while_paused();
                task.check()?;
                let _ = passed.send(());
                std::thread::yield_now();
            }
        });
        counter.recv().unwrap();
        task.set_paused(true);
        // The step in progress may still be finished once.
        while counter.recv_timeout(std::time::Duration::from_millis(50)).is_ok() {}
        assert!(task.is_paused() && task.poll().is_none());
        task.set_paused(false);
        counter.recv().unwrap();
        task.set_paused(true);
        task.cancel();
        assert!(matches!(wait(&mut task), TaskEvent::Done(Err(Error::Cancelled))));
    }

    #[test]
    fn a_task_that_breaks_says_so_instead_of_hanging() {
        let mut task: Task<()> = Task::start("test", &egui::Context::default(), |_| panic!("on purpose"));
        assert!(matches!(wait(&mut task), TaskEvent::Done(Err(Error::Input { .. }))));
    }

    #[test]
    fn time_left_follows_the_pace() {
        let progress = TaskProgress { done: 100, total: 400, seconds: 10.0, ..Default::default() };
        assert_eq!(progress.seconds_left(), Some(30.0));
        assert_eq!(TaskProgress { done: 0, ..progress.clone() }.seconds_left(), None);
        assert_eq!(TaskProgress::default().fraction(), 0.0);
    }
}
