//! Times of the window's pictures, for `bench frame` and `bench gpu`.

use crate::{
    engine::{Answer, Engine, Negatives, Question},
    settings::PROMPT_COLOURS,
    viewer::{
        backend::{FrameSource, FrameView, Info, Parts, Rendering, engine::source_of},
        picture::{
            pipeline::Pipeline,
            request::{AskedPrompt, Request},
        },
        state::marks::MarkList,
    },
};
use image::RgbImage;
use std::{
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};
use surgtpgs_core::{
    Error, Result,
    grid::{Grid, Mask},
    mask::CleanUp,
    overlay::OverlayLook,
};
use surgtpgs_render::Gpu;

/// Milliseconds of pictures, one of each frame.
#[derive(Debug, Default)]
pub(crate) struct PictureTimes {
    /// From a request for a frame that is not known to its picture.
    pub(crate) whole: Vec<f64>,
    /// Of that, rendering, scoring and what comes back from a device.
    pub(crate) source: Vec<f64>,
    /// From another threshold to the picture of the same frame.
    pub(crate) again: Vec<f64>,
    /// Bytes that crossed between this program and a device for each picture of another frame.
    pub(crate) uploaded: f64,
    pub(crate) read_back: f64,
}

/// Makes the window's pictures of `frames`, with nothing prepared ahead. The first one warms up and is not
/// timed.
pub(crate) fn time_pictures(mut engine: Engine, words: &[String], frames: &[usize]) -> Result<PictureTimes> {
    let negatives = Negatives::of(engine.settings());
    let threshold = engine.settings().threshold;
    let size = engine.scene().cameras.first().map_or((0, 0), |c| (c.width as usize, c.height as usize));
    let prompts = words.iter().zip(PROMPT_COLOURS.iter().cycle()).zip(1..);
    let prompts: Vec<AskedPrompt> = prompts
        .map(|((text, colour), id)| AskedPrompt {
            id,
            question: Question::words(text, negatives.clone()),
            threshold,
            colour: *colour,
            is_instrument: false,
        })
        .collect();
    let request = |frame: usize, change: f32| Request {
        view: FrameView { frame, ..FrameView::default() },
        jump: 0,
        needs_original: false,
        needs_reconstruction: true,
        layer: None,
        needs_difference: false,
        needs_depth: false,
        prompts: prompts
            .iter()
            .map(|p| AskedPrompt { threshold: p.threshold + change, ..p.clone() })
            .collect(),
        candidates: Vec::new(),
        look: OverlayLook::default(),
        clean_up: CleanUp::usual(size.0, size.1),
        point: None,
        marks: MarkList::default(),
        is_typing: false,
    };
    let device = engine.gpu().map(|renderer| renderer.gpu().clone());
    let traffic = || device.as_ref().map(Gpu::traffic).unwrap_or_default();
    let spent = Arc::new(AtomicU64::new(0));
    let mut pipeline = Pipeline::new(Box::new(Timed { source: source_of(engine), spent: spent.clone() }));
    let mut make = |request| {
        let (began, before) = (Instant::now(), spent.load(Ordering::Relaxed));
        let picture = pipeline.produce(request);
        let in_source = (spent.load(Ordering::Relaxed) - before) as f64 * 1e-6;
        let whole = began.elapsed().as_secs_f64() * 1e3;
        picture.problem.map_or(Ok((whole, in_source)), |problem| Err(Error::input(problem, "")))
    };
    let mut times = PictureTimes::default();
    let mut before = traffic();
    for (k, frame) in frames.iter().take(1).chain(frames).enumerate() {
        let (whole, source) = make(request(*frame, 0.0))?;
        let (again, _) = make(request(*frame, 0.01))?;
        // The first two are of the same frame.
        if k > 1 {
            times.whole.push(whole);
            times.source.push(source);
            times.again.push(again);
        } else {
            before = traffic();
        }
    }
    let crossed = traffic().since(&before);
    let count = times.whole.len().max(1) as f64;
    (times.uploaded, times.read_back) = (crossed.uploaded as f64 / count, crossed.read_back as f64 / count);
    Ok(times)
}

/// A source that adds up the time spent in it, nanoseconds.
struct Timed {
    source: Box<dyn FrameSource>,
    spent: Arc<AtomicU64>,
}

impl Timed {
    fn time<T>(&mut self, work: impl FnOnce(&mut dyn FrameSource) -> T) -> T {
        let began = Instant::now();
        let made = work(&mut *self.source);
        self.spent.fetch_add(began.elapsed().as_nanos() as u64, Ordering::Relaxed);
        made
    }
}

impl FrameSource for Timed {
    fn info(&self) -> &Info {
        self.source.info()
    }
    fn shot_of(&self, frame: usize) -> Range<usize> {
        self.source.shot_of(frame)
    }
    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        self.time(|source| source.original(frame))
    }
    fn instruments(&mut self, frame: usize) -> Result<Option<Mask>> {
        self.time(|source| source.instruments(frame))
    }
    fn render(&mut self, view: &FrameView, parts: Parts) -> Result<Rendering> {
        self.time(|source| source.render(view, parts))
    }
    fn scores(&mut self, view: &FrameView, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
        self.time(|source| source.scores(view, questions))
    }
    fn answers(&mut self, questions: &[Question]) -> Vec<Option<Answer>> {
        self.time(|source| source.answers(questions))
    }
    fn motion(&mut self, view: &FrameView) -> Result<(Grid<f32>, String)> {
        self.time(|source| source.motion(view))
    }
    fn opacity(&mut self, view: &FrameView) -> Result<Grid<f32>> {
        self.time(|source| source.opacity(view))
    }
}
