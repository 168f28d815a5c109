//! Output of the verbs: results on standard output, progress and messages on standard error.

use indicatif::{ProgressBar, ProgressStyle};
use std::{
    io::Write,
    ops::ControlFlow,
    sync::{
        Once, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};
use surgtpgs_core::{Error, Result, sequence::remove_unpacked_videos};

pub use crate::text::say;
use crate::{
    cli::Exit,
    jobs::Progress,
    text::{in_json, visible},
};

/// Writes text to standard output, with invisible characters escaped.
pub fn print(text: &str) -> Result<()> {
    print_data(&visible(text))
}

/// Writes text that other programs read to standard output, as it is. A reader that went away (`| head`) is
/// not an error, a full disk is.
pub fn print_data(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            let what = format!("the result could not be written to standard output: {e}");
            Err(Error::input(what, "Free some space, or send it elsewhere."))
        }
        _ => Ok(()),
    }
}

/// Writes a value to standard output as indented JSON.
pub fn print_json(value: &impl serde::Serialize) -> Result<()> {
    // Reports are plain structs of text and numbers: they always serialize.
    print_data(&(in_json(&serde_json::to_string_pretty(value).unwrap_or_default()) + "\n"))
}

/// Writes a report to standard output: as JSON, or as text for people.
pub fn print_report(report: &impl serde::Serialize, text: &str, is_json: bool) -> Result<()> {
    if is_json { print_json(report) } else { print(text) }
}

/// Says once which libraries that could run models were passed over, if a model was opened.
pub fn say_backend_notes() {
    static ARE_SAID: AtomicBool = AtomicBool::new(false);
    let notes = surgtpgs_clip::backend_notes();
    if !notes.is_empty() && !ARE_SAID.swap(true, Ordering::Relaxed) {
        notes.iter().for_each(|note| say(&format!("note: {note}")));
    }
}

/// Time between two lines about one stage, where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(60);

/// Shows the progress of a job on standard error: a bar on a terminal, a line per stage and minute elsewhere.
pub struct ProgressView {
    bar: ProgressBar,
    stage: String,
    /// Start of this stage, and the number of its steps that were done by then.
    started: (Instant, usize),
    /// Time of the last line about this stage, where there is no terminal.
    said: Instant,
}

impl Default for ProgressView {
    fn default() -> Self {
        let now = Instant::now();
        Self { bar: ProgressBar::hidden(), stage: String::new(), started: (now, 0), said: now }
    }
}

impl ProgressView {
    /// Shows how far the job is. Returns a break if the job shall stop (see [`watch_interrupts`]).
    pub fn show(&mut self, progress: &Progress<'_>) -> ControlFlow<()> {
        if self.stage != progress.stage {
            self.start_stage(progress);
        }
        self.bar.set_position(progress.done as u64);
        let left = self.left(progress).unwrap_or_default();
        self.bar.set_message(format!("{left} {}", visible(progress.detail)));
        if self.bar.is_hidden() && self.said.elapsed() > LINE_EVERY {
            self.said = Instant::now();
            let left = self.left(progress).map_or(String::new(), |left| format!(", {left} left"));
            let detail = if progress.detail.is_empty() { "" } else { ", " };
            let Progress { stage, done, total, .. } = progress;
            say(&format!("{stage}: {done} of {total}{detail}{}{left}", progress.detail));
        }
        if interrupted() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Returns the time for the rest at the pace so far, in words; `None` before the first step is done.
    fn left(&self, progress: &Progress<'_>) -> Option<String> {
        let (since, first) = self.started;
        let done = progress.done.checked_sub(first).filter(|done| *done > 0)?;
        let seconds =
            since.elapsed().as_secs_f64() / done as f64 * progress.total.saturating_sub(progress.done) as f64;
        Some(if seconds < 90.0 { format!("{seconds:.0} s") } else { format!("{:.0} min", seconds / 60.0) })
    }

    /// Shows the progress of a loop. Returns [`Error::Cancelled`] if it shall stop.
    pub fn count(&mut self, stage: &str, done: usize, total: usize) -> Result<()> {
        Progress::new(stage, done, total).tell(&mut |p| self.show(p))
    }

    fn start_stage(&mut self, progress: &Progress<'_>) {
        self.bar.finish_and_clear();
        self.stage = progress.stage.to_owned();
        self.bar = ProgressBar::new(progress.total as u64);
        if self.bar.is_hidden() {
            say(&format!("{} …", self.stage));
        }
        // The template is constant; if it were wrong, the default style would stand in.
        if let Ok(style) = ProgressStyle::with_template("{prefix} {bar:30} {pos}/{len} {msg}") {
            self.bar.set_style(style);
        }
        self.bar.set_prefix(self.stage.clone());
        // Work that was done earlier says nothing about how long the rest takes.
        self.started = (Instant::now(), progress.done);
        self.said = Instant::now();
    }
}

impl Drop for ProgressView {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Time of the first wish to stop.
static INTERRUPTED: OnceLock<Instant> = OnceLock::new();
/// `true` once the terminal is gone.
static HUNG_UP: AtomicBool = AtomicBool::new(false);

/// Time after the first signal in which further ones are copies of it: `timeout` and managers of jobs send
/// one to the program and another to its group.
const SAME_WISH: Duration = Duration::from_secs(1);

/// `true` once the job can stop and keep its work.
static IS_WATCHED: AtomicBool = AtomicBool::new(false);

/// Makes Ctrl-C, and the signals of schedulers and of systems that shut down, end the program without
/// leaving temporary files behind.
pub fn end_cleanly() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        // If this fails, a signal ends the program as it would any other.
        let _ = ctrlc::set_handler(interrupt);
        #[cfg(unix)]
        watch_signals();
    });
}

/// Makes the same signals ask the job to stop and keep its work from now on. A second one ends the program
/// at once.
pub fn watch_interrupts() {
    IS_WATCHED.store(true, Ordering::SeqCst);
    end_cleanly();
}

#[cfg(unix)]
fn watch_signals() {
    use signal_hook::consts::{SIGHUP, SIGTERM};
    // A program started with `nohup` is to go on when the terminal closes.
    let watched: &[_] = if is_ignored(SIGHUP) { &[SIGTERM] } else { &[SIGTERM, SIGHUP] };
    let Ok(mut signals) = signal_hook::iterator::Signals::new(watched) else { return };
    let watch = move || {
        signals.forever().for_each(|signal| match signal {
            // Only a flag is set here: a terminal that closes may send SIGHUP twice, and systems that shut
            // down send SIGTERM as well. Together they must not count as a second Ctrl-C.
            SIGHUP if IS_WATCHED.load(Ordering::SeqCst) => HUNG_UP.store(true, Ordering::SeqCst),
            _ => interrupt(),
        });
    };
    // Without this thread signals have no effect; the work itself is none the worse.
    let _ = std::thread::Builder::new().name("signals".into()).spawn(watch);
}

/// Returns `true` if the process was told to ignore a signal, or if that is not known.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_none_or(|m| m >> (signal - 1) & 1 == 1)
}

/// Makes a write beyond `ulimit -f` fail with a message, instead of ending the program.
pub fn keep_writing() {
    #[cfg(unix)]
    {
        // It is enough to catch the signal: the flag tells no more than the failed write.
        let caught = std::sync::Arc::new(AtomicBool::new(false));
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, caught);
    }
}

fn interrupt() {
    let now = Instant::now();
    let first = *INTERRUPTED.get_or_init(|| now);
    if !IS_WATCHED.load(Ordering::SeqCst) || now.duration_since(first) > SAME_WISH {
        remove_unpacked_videos();
        std::process::exit(Exit::Ended as i32);
    }
    if first == now {
        say("stopping, the work so far is kept (press Ctrl-C again to end at once)");
    }
}

/// Returns `true` if the user, or the system, wants the program to stop.
pub fn interrupted() -> bool {
    INTERRUPTED.get().is_some() || HUNG_UP.load(Ordering::SeqCst)
}
