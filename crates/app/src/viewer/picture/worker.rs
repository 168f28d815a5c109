//! The thread that makes pictures. The newest request wins; an older one that has not begun is dropped.

use crate::engine::{Next, Pending};
use crate::viewer::{
    backend::{FrameSource, task::lock},
    picture::{
        areas::Measured,
        pipeline::Pipeline,
        request::{Picture, Request},
    },
    state::marks::MarkList,
};
use std::{
    panic::AssertUnwindSafe,
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};
use surgtpgs_core::{Error, Result};

/// The window's side of the thread. Dropping it ends the thread after the picture in progress.
pub(crate) struct Worker {
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

/// Time between two looks at a thread that is to end.
const LOOKS: Duration = Duration::from_millis(5);

#[derive(Default)]
struct Shared {
    inbox: Mutex<Inbox>,
    wake: Condvar,
    outbox: Mutex<Option<Picture>>,
    made: Condvar,
    measured: Mutex<Vec<Measured>>,
    thumbnails: Mutex<Vec<(usize, egui::ColorImage)>>,
    /// The request in the inbox, for work that may leave off for it.
    pending: Arc<Pending>,
}

#[derive(Default)]
struct Inbox {
    request: Option<Request>,
    source: Option<Box<dyn FrameSource>>,
    /// Marks of the request that was taken last, and of the one that was submitted last.
    marks: MarkList,
    submitted: MarkList,
    /// `true` if marks have changed since a request was taken, though they may be the same again: whoever
    /// submitted them has dropped what was counted.
    counts_anew: bool,
    /// Frames whose small pictures are wanted, the first one at the end.
    wanted: Vec<usize>,
    is_closed: bool,
}

impl Worker {
    /// Starts the thread; `ctx` is repainted whenever a picture is ready.
    pub(crate) fn start(source: Box<dyn FrameSource>, ctx: &egui::Context) -> Result<Self> {
        let shared = Arc::new(Shared::default());
        let (theirs, repaint) = (shared.clone(), ctx.clone());
        let thread = std::thread::Builder::new()
            .name("pictures".into())
            .spawn(move || {
                let pipeline = Pipeline::new(source).leaving_off_for(theirs.pending.clone());
                work(&theirs, pipeline, &repaint);
            })
            .map_err(|e| Error::Missing {
                what: format!("no thread could be started: {e}"),
                hint: "Close other programs and try again.".into(),
            })?;
        Ok(Self { shared, thread })
    }

    /// Requests a picture; replaces a request that has not begun. Long work on other frames, and for other marks,
    /// leaves off for it.
    pub(crate) fn submit(&self, request: Request) {
        let mut inbox = lock(&self.shared.inbox);
        let has_marks = inbox.marks == request.marks;
        inbox.counts_anew |= inbox.submitted != request.marks;
        inbox.submitted = request.marks.clone();
        self.shared.pending.set(if has_marks { Next::Frame(request.view.frame) } else { Next::Other });
        inbox.request = Some(request);
        drop(inbox);
        self.shared.wake.notify_one();
    }

    /// Continues with another state of the same recording.
    pub(crate) fn replace(&self, source: Box<dyn FrameSource>) {
        let mut inbox = lock(&self.shared.inbox);
        self.shared.pending.set(Next::Other);
        inbox.source = Some(source);
        drop(inbox);
        self.shared.wake.notify_one();
    }

    /// Takes the areas that were counted in idle time since the last call.
    pub(crate) fn take_measured(&self) -> Vec<Measured> {
        std::mem::take(&mut *lock(&self.shared.measured))
    }

    /// Asks for small pictures of frames, which are made in idle time; earlier wishes are dropped.
    pub(crate) fn want_thumbnails(&self, frames: &[usize]) {
        lock(&self.shared.inbox).wanted = frames.iter().rev().copied().collect();
        self.shared.wake.notify_one();
    }

    /// Takes the small pictures that were made since the last call.
    pub(crate) fn take_thumbnails(&self) -> Vec<(usize, egui::ColorImage)> {
        std::mem::take(&mut *lock(&self.shared.thumbnails))
    }

    /// Waits until there is a picture to take, for a limited time.
    pub(crate) fn wait(&self, limit: Duration) {
        let is_missing = |outbox: &mut Option<Picture>| outbox.is_none();
        drop(self.shared.made.wait_timeout_while(lock(&self.shared.outbox), limit, is_missing));
    }

    /// Ends the thread and waits until it has ended, for a limited time: drivers of graphics cards crash where
    /// the program ends while a thread draws.
    pub(crate) fn end(&self, limit: Duration) {
        self.close();
        let began = Instant::now();
        while !self.thread.is_finished() && began.elapsed() < limit {
            std::thread::sleep(LOOKS);
        }
    }

    fn close(&self) {
        let mut inbox = lock(&self.shared.inbox);
        self.shared.pending.set(Next::Other);
        inbox.is_closed = true;
        drop(inbox);
        self.shared.wake.notify_one();
    }

    /// Takes the newest picture, if it has not been taken yet.
    pub(crate) fn take(&self) -> Option<Picture> {
        lock(&self.shared.outbox).take()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.close();
    }
}

fn work(shared: &Shared, mut pipeline: Pipeline, ctx: &egui::Context) {
    // While there may be something to prepare, the thread checks for requests without waiting for them.
    let mut is_preparing = false;
    loop {
        let (source, request, counts_anew) = {
            let is_idle = |inbox: &mut Inbox| {
                let has_work = inbox.request.is_some() || inbox.source.is_some() || !inbox.wanted.is_empty();
                !has_work && !inbox.is_closed && !is_preparing
            };
            let waited = shared.wake.wait_while(lock(&shared.inbox), is_idle);
            let mut inbox = waited.unwrap_or_else(PoisonError::into_inner);
            if inbox.is_closed {
                return;
            }
            shared.pending.clear();
            if let Some(request) = &inbox.request {
                inbox.marks = request.marks.clone();
            }
            (inbox.source.take(), inbox.request.take(), std::mem::take(&mut inbox.counts_anew))
        };
        if let Some(source) = source {
            pipeline.replace(source);
        }
        if counts_anew {
            pipeline.count_anew();
        }
        if let Some(request) = request {
            let asked = request.clone();
            let first = std::panic::catch_unwind(AssertUnwindSafe(|| pipeline.first_look(&request)));
            if let Some(first) = first.ok().flatten() {
                *lock(&shared.outbox) = Some(first);
                shared.made.notify_one();
                ctx.request_repaint();
            }
            let made = std::panic::catch_unwind(AssertUnwindSafe(|| pipeline.produce(request)));
            let made = made.unwrap_or_else(|_| broken(asked));
            if !made.is_left_off {
                *lock(&shared.outbox) = Some(made);
                shared.made.notify_one();
                ctx.request_repaint();
            }
            is_preparing = true;
        } else {
            let idle_work = || {
                let has_worked = pipeline.prepare_ahead()
                    || next_thumbnail(shared, &mut pipeline, ctx)
                    || count_next(shared, &mut pipeline, ctx);
                if !has_worked {
                    pipeline.come_back();
                }
                has_worked
            };
            is_preparing = std::panic::catch_unwind(AssertUnwindSafe(idle_work)).unwrap_or(false);
        }
    }
}

/// Makes the next small picture; returns `false` if none is wanted.
fn next_thumbnail(shared: &Shared, pipeline: &mut Pipeline, ctx: &egui::Context) -> bool {
    let Some(frame) = lock(&shared.inbox).wanted.pop() else { return false };
    if let Some(image) = pipeline.thumbnail(frame) {
        lock(&shared.thumbnails).push((frame, image));
        ctx.request_repaint();
    }
    true
}

/// Counts the areas on another frame; returns `false` if there is none left.
fn count_next(shared: &Shared, pipeline: &mut Pipeline, ctx: &egui::Context) -> bool {
    let Some(measured) = pipeline.count_next() else { return false };
    lock(&shared.measured).push(measured);
    ctx.request_repaint();
    true
}

/// Makes the picture to show after a fault of the program itself; the next request is tried as usual.
fn broken(request: Request) -> Picture {
    Picture {
        request,
        original: None,
        reconstruction: None,
        layer: None,
        difference: None,
        outlines: Arc::default(),
        depth_values: None,
        findings: Vec::new(),
        candidates: Vec::new(),
        sample: None,
        unseen_share: 0.0,
        problem: Some("The program made a mistake with this picture; please report what you did.".into()),
        is_left_off: false,
        took_ms: 0.0,
        passes_run: 0,
        renderer: String::new(),
    }
}
