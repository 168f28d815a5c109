//! The way from a request to a picture: decode or render, score, draw. The pipeline keeps what the next
//! requests may need again, so that a moved threshold costs only a redraw of the overlay. It prepares the
//! frames ahead while there is no request. It runs on the worker thread.

use crate::engine::{Absence, Answer, Pending, Question, frames_around};
use crate::viewer::{
    backend::{FrameSource, FrameView, Parts},
    picture::{
        areas::{Counted, Measure, Measured},
        difference::Difference,
        findings::{FoundLast, PromptScores, Scores},
        layer_colours::colour_layer,
        marks::{color_image, mark, outline},
        rendered::{Colour, Rendered},
        request::{AskedPrompt, LayerPane, Pane, Picture, Request},
        thumbnails::small,
    },
    remedy::message,
    state::{content::PREVIEW, marks::MarkList, view_mode::Layer},
};
use egui::ColorImage;
use image::RgbImage;
use std::{collections::VecDeque, sync::Arc, time::Instant};
use surgtpgs_core::{
    Error, Result,
    grid::{Grid, Mask},
    mask::mean_scores,
    num::finite_percentile,
};

/// Number of frames that are prepared ahead of the shown one.
const FRAMES_AHEAD: usize = 12;
/// Number of instrument masks that are kept.
const KEPT_TOOLS: usize = 32;
/// Number of values that scales of colours are taken from.
const SAMPLES: usize = 16_384;
/// Memory for pictures that may be needed again, bytes.
const KEPT_BYTES: usize = 128 << 20;

/// Makes pictures from a source. Remembers the last ones and prepares those to come.
pub(crate) struct Pipeline {
    source: Box<dyn FrameSource>,
    /// Recorded frames, the most recently used at the end.
    originals: VecDeque<(usize, Arc<RgbImage>, Arc<ColorImage>)>,
    /// Rendered views, the most recently used at the end.
    rendered: VecDeque<Rendered>,
    /// Results of the last picture.
    found: FoundLast,
    /// Masks of instruments on recorded frames, `None` where they are not known; the newest at the end.
    tools: VecDeque<(usize, Option<Arc<Mask>>)>,
    depth_range: Option<(f32, f32)>,
    /// Upper end of the scale of motion, px; kept like the depth scale.
    motion_top: Option<f32>,
    /// The last request.
    last: Option<Request>,
    /// `None` for a passing state of a scene, such as one that is being trained.
    counted: Option<Counted>,
    /// Marks that the source has.
    marks: MarkList,
    /// Marks that it could not take last, and why; it has none then.
    refused: Option<(MarkList, String)>,
    /// The request that waits.
    pending: Arc<Pending>,
}

impl Pipeline {
    pub(crate) fn new(source: Box<dyn FrameSource>) -> Self {
        Self {
            counted: Some(nothing_counted(&*source)),
            source,
            originals: VecDeque::new(),
            rendered: VecDeque::new(),
            found: FoundLast::default(),
            tools: VecDeque::new(),
            depth_range: None,
            motion_top: None,
            last: None,
            marks: MarkList::default(),
            refused: None,
            pending: Arc::default(),
        }
    }

    /// Lets long work leave off for a request that waits.
    pub(crate) fn leaving_off_for(mut self, pending: Arc<Pending>) -> Self {
        self.source.leave_off_for(&pending);
        self.pending = pending;
        self
    }

    /// Continues with another state of the same recording; decoded frames are kept.
    pub(crate) fn replace(&mut self, source: Box<dyn FrameSource>) {
        self.source = source;
        self.source.leave_off_for(&self.pending);
        self.rendered.clear();
        self.motion_top = None;
        self.counted = None;
        (self.marks, self.refused) = (MarkList::default(), None);
    }

    /// Makes the picture. A failure becomes [`Picture::problem`], and work that was left off
    /// [`Picture::is_left_off`].
    pub(crate) fn produce(&mut self, request: Request) -> Picture {
        self.last = Some(request.clone());
        let began = Instant::now();
        let passes_before = self.source.clock();
        let mut picture = Picture {
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
            problem: None,
            is_left_off: false,
            took_ms: 0.0,
            passes_run: 0,
            renderer: String::new(),
            request,
        };
        let refused = self.take_marks(&picture.request.marks);
        match self.fill(&mut picture) {
            Ok(()) => picture.problem = refused,
            Err(Error::Cancelled) => picture.is_left_off = true,
            Err(e) => picture.problem = Some(message(&e)),
        }
        let is_drawn = !picture.findings.is_empty();
        picture.passes_run = self.source.clock().ran_since(&passes_before) + usize::from(is_drawn);
        picture.renderer = self.source.renderer();
        picture.took_ms = began.elapsed().as_secs_f64() * 1000.0;
        picture
    }

    /// Makes the picture without what holds it up: prompts that have to wait for marks from another chapter, or
    /// depth that is not drawn. `None` if nothing does.
    pub(crate) fn first_look(&mut self, request: &Request) -> Option<Picture> {
        if self.take_marks(&request.marks).is_some() {
            return None;
        }
        let is_asked = !request.prompts.is_empty() && self.can_ask();
        let waits = is_asked && !self.source.answers_at_once(&request.view);
        let depth = self.needs(request).parts.filter(|_| request.wants_depth_alone());
        let is_held_up = waits || depth.is_some_and(|depth| self.known(&request.view, depth).is_none());
        let alone = || Request {
            needs_depth: false,
            prompts: Vec::new(),
            candidates: Vec::new(),
            point: None,
            ..request.clone()
        };
        is_held_up.then(|| self.produce(alone())).filter(|picture| !picture.is_left_off)
    }

    fn fill(&mut self, picture: &mut Picture) -> Result<()> {
        let request = picture.request.clone();
        let Needs { decodes, parts, asks } = self.needs(&request);
        // The recorded frame comes first, so that it can be shown even if rendering fails.
        let original = if decodes { Some(self.original(request.view.frame)?) } else { None };
        if let Some((_, bare)) = &original {
            picture.original = Some(Pane { bare: bare.clone(), marked: None });
        }
        let Some(parts) = parts else { return Ok(()) };
        let questions = if asks { request.questions() } else { Vec::new() };
        let answers = self.answers(&request.view, parts, &questions, request.clean_up.smooth_frames)?;
        let tools = self.tools_below(&request, asks);
        let layer = request.layer.map(|layer| self.layer(layer, &request.view)).transpose()?;
        let Some(rendered) = self.rendered.back() else { return Ok(()) };
        let said =
            self.source.answers(&request.prompts.iter().map(|p| p.question.clone()).collect::<Vec<_>>());
        picture.findings = self.found.findings(&answers, &request, &said, tools.as_deref());
        picture.outlines = outline(&picture.findings, tools.as_deref(), &request);
        picture.candidates = candidates(&answers, &request.candidates);
        if let Some(point) = request.point.filter(|_| self.source.info().has_features) {
            // The scores at the point can be shown even without a sample.
            picture.sample = self.source.sample(&request.view, point).ok().flatten();
        }
        picture.depth_values = rendered.depth.clone();
        picture.layer = layer;
        picture.unseen_share = rendered.unseen_share;
        let colour = rendered.colour.as_ref();
        if let Some(Colour { image, bare }) = colour.filter(|_| request.needs_reconstruction) {
            let marked = mark(image, &picture.findings, tools.as_deref(), &request);
            picture.reconstruction = Some(Pane { bare: bare.clone(), marked });
        }
        if let (Some((frame, _)), Some(pane)) = (&original, &mut picture.original) {
            pane.marked = mark(frame, &picture.findings, tools.as_deref(), &request);
            let compared = colour.filter(|_| request.needs_difference);
            picture.difference = compared.map(|colour| Difference::of(frame, &colour.image));
        }
        Ok(())
    }

    /// Gives the source other marks. All scores so far are those of earlier marks then. Returns why the source
    /// cannot take these, and has none; they are not tried again before there are others.
    fn take_marks(&mut self, marks: &MarkList) -> Option<String> {
        if let Some((_, why)) = self.refused.as_ref().filter(|(refused, _)| refused == marks) {
            return Some(why.clone());
        }
        self.refused = None;
        if self.marks == *marks {
            return None;
        }
        self.rendered.iter_mut().for_each(|rendered| rendered.scores.clear());
        self.count_anew();
        if let Err(error) = self.source.set_marks(marks.all()) {
            // It may have kept the earlier ones.
            let _ = self.source.set_marks(&[]);
            self.marks = MarkList::default();
            let why = message(&error);
            self.refused = Some((marks.clone(), why.clone()));
            return Some(why);
        }
        self.marks = marks.clone();
        None
    }

    /// Forgets what was counted.
    pub(crate) fn count_anew(&mut self) {
        if self.counted.is_some() {
            self.counted = Some(nothing_counted(&*self.source));
        }
    }

    /// Returns `true` if the source can answer prompts.
    fn can_ask(&self) -> bool {
        let info = self.source.info();
        info.has_features || (info.has_reconstruction && !self.marks.is_empty())
    }

    fn needs(&self, request: &Request) -> Needs {
        let info = self.source.info();
        let asks = self.can_ask() && !(request.prompts.is_empty() && request.candidates.is_empty());
        let measures = request.needs_depth && info.has_measured_depth;
        let renders = request.needs_reconstruction || request.layer.is_some() || asks || measures;
        // What the endoscope did not see is faded, for which its depth is needed.
        let is_turned = !request.view.orbit.is_home();
        // A reconstruction can be turned around a point of it.
        let is_solid = request.needs_reconstruction || request.layer == Some(Layer::Depth) || is_turned;
        let parts = Parts {
            features: asks,
            colour: request.needs_reconstruction || request.needs_difference || is_turned,
            depth: is_solid || info.has_measured_depth,
        };
        Needs {
            decodes: info.has_original && request.needs_original,
            parts: (info.has_reconstruction && renders).then_some(parts),
            asks,
        }
    }

    /// Prepares the next frame that is likely to be requested; returns `false` if there is none. A failure is
    /// not reported here: it will happen again, and be reported, when the frame is requested.
    pub(crate) fn prepare_ahead(&mut self) -> bool {
        let Some(last) = self.last.clone().filter(|l| !l.view.is_preview && self.source.prepares_ahead())
        else {
            return false;
        };
        let end = self.source.info().num_frames.min(last.view.frame + 1 + FRAMES_AHEAD);
        for frame in last.view.frame + 1..end {
            let view = FrameView { frame, ..last.view };
            let request = Request { view, candidates: Vec::new(), needs_depth: false, ..last.clone() };
            let Needs { decodes, parts, asks } = self.needs(&request);
            // While a word is typed, the next letter comes sooner than the next frame.
            let parts = parts.filter(|_| !last.is_typing);
            let decodes = decodes && !self.originals.iter().any(|(i, ..)| *i == frame);
            let is_new = |r: &Rendered| asks && !r.new_questions(&request.questions()).is_empty();
            let parts = parts.filter(|parts| self.known(&view, *parts).is_none_or(is_new));
            if !decodes && parts.is_none() {
                continue;
            }
            // Pictures that will be needed sooner must not be dropped for this one.
            if !self.has_room_for(frame - last.view.frame) {
                return false;
            }
            let is_decoded = !decodes || self.original(frame).is_ok();
            let questions = if asks { request.questions() } else { Vec::new() };
            let is_rendered = parts.is_none_or(|parts| self.render_asked(&view, parts, &questions).is_ok());
            return is_decoded && is_rendered;
        }
        false
    }

    /// Renders the shown view once more if others were rendered since, so that the next word is looked for in
    /// what is there. A failure will be reported when the view is requested.
    pub(crate) fn come_back(&mut self) {
        let shown = self.last.as_ref().map(|last| last.view).filter(|view| !view.is_preview);
        if let Some(view) = shown.filter(|_| self.source.info().has_features && self.source.prepares_ahead())
        {
            let _ = self.source.render(&view, Parts { features: true, ..Parts::default() });
        }
    }

    /// Makes a small picture of a recorded frame, which is not kept; `None` where it cannot be decoded.
    pub(crate) fn thumbnail(&mut self, frame: usize) -> Option<ColorImage> {
        if let Some((_, image, _)) = self.originals.iter().find(|(i, ..)| *i == frame) {
            return Some(small(image));
        }
        let has_original = self.source.info().has_original;
        has_original.then(|| self.source.original(frame).ok()).flatten().map(|image| small(&image))
    }

    /// Counts the areas of the last request's prompts on the next uncounted frame; `None` if there is none,
    /// or if it was left off.
    pub(crate) fn count_next(&mut self) -> Option<Measured> {
        let last = self.last.as_ref().filter(|l| !l.view.is_preview)?;
        if !self.can_ask() || !self.source.prepares_ahead() {
            return None;
        }
        let measure = |p: &AskedPrompt| Measure::new(p.question.clone(), last.clean_up, p.threshold);
        let prompts: Vec<Measure> = last.prompts.iter().filter(|p| p.id != PREVIEW).map(measure).collect();
        let (frame, new) = self.counted.as_ref()?.next(&prompts)?;
        let questions: Vec<Question> = new.iter().map(|m| m.question.clone()).collect();
        let answers = self.answers_unkept(frame, &questions, new.iter().map(Measure::reach).max()?)?;
        let unmarked = self.cannot_be_looked_for(&questions);
        let levels = |(k, measure): (usize, &Measure)| {
            let scores = answers.get(k)?.as_ref().ok()?;
            (!unmarked.contains(&k)).then(|| measure.levels(scores))
        };
        let levels: Vec<_> = new.iter().enumerate().map(levels).collect();
        let marks = self.marks.clone();
        let looked = if marks.is_empty() { Ok(None) } else { self.source.look_here(frame) };
        if matches!(looked, Err(Error::Cancelled)) {
            return None;
        }
        let look_here = looked.ok().flatten();
        let prompts_counted = new.into_iter().zip(levels).collect();
        let mut measured =
            Measured { frame, prompts: prompts_counted, forgotten: Vec::new(), marks, look_here };
        let counted = self.counted.as_mut()?;
        counted.note(&measured);
        measured.forgotten = counted.forget(&prompts);
        Some(measured)
    }

    /// Returns the places of the questions that cannot be looked for: only what is marked can be, and they mean
    /// none of it.
    fn cannot_be_looked_for(&mut self, questions: &[Question]) -> Vec<usize> {
        if self.source.info().has_features {
            return Vec::new();
        }
        let said = self.source.answers(questions);
        let needs_mark = |answer: &Option<Answer>| {
            answer.as_ref().is_some_and(|answer| answer.absence == Absence::NeedsMark)
        };
        said.iter().enumerate().filter(|(_, answer)| needs_mark(answer)).map(|(k, _)| k).collect()
    }

    /// Returns the scores on a recorded frame; empty if they cannot be had, and `None` if that was left off. The
    /// rendered view is not kept, because nobody asked to see it, unless neighbouring frames will need it.
    fn answers_unkept(&mut self, frame: usize, questions: &[Question], reach: usize) -> Option<Vec<Scores>> {
        let view = FrameView { frame, ..FrameView::default() };
        let parts = Parts { features: true, ..Parts::default() };
        if reach > 0 {
            return match self.answers(&view, parts, questions, reach) {
                Ok(answers) => Some(answers.into_iter().map(|(_, scores)| scores).collect()),
                Err(Error::Cancelled) => None,
                Err(_) => Some(Vec::new()),
            };
        }
        let kept = self.rendered.iter().find(|r| r.view == view).and_then(|r| r.known(questions));
        if kept.is_some() {
            return kept;
        }
        match self.source.render(&view, parts).and_then(|_| scores(&mut *self.source, &view, questions)) {
            Ok(answers) => Some(answers),
            Err(Error::Cancelled) => None,
            Err(_) => Some(Vec::new()),
        }
    }

    /// Returns the scores of a view, averaged over `reach` frames of its shot before and after. Afterwards the
    /// view is the last of the rendered ones.
    fn answers(
        &mut self,
        view: &FrameView,
        parts: Parts,
        questions: &[Question],
        reach: usize,
    ) -> Result<Vec<PromptScores>> {
        let asks = !questions.is_empty();
        let reach = if asks { reach } else { 0 };
        let around = frames_around(view.frame, reach, &self.source.shot_of(view.frame));
        let mut neighbours: Vec<Vec<Scores>> = Vec::new();
        for frame in around.filter(|frame| *frame != view.frame) {
            let beside = FrameView { frame, ..*view };
            self.render_asked(&beside, Parts { features: true, ..Parts::default() }, questions)?;
            neighbours.extend(self.rendered.back().and_then(|r| r.known(questions)));
        }
        self.render_asked(view, parts, questions)?;
        let own = self.rendered.back().and_then(|r| r.known(questions)).unwrap_or_default();
        let smoothed = |(k, scores): (usize, Scores)| match scores {
            Ok(scores) if reach > 0 => {
                let beside: Vec<&Grid<f32>> =
                    neighbours.iter().filter_map(|n| n.get(k)?.as_deref().ok()).collect();
                Ok(Arc::new(mean_scores(&scores, &beside)))
            }
            other => other,
        };
        Ok(questions.iter().cloned().zip(own.into_iter().enumerate().map(smoothed)).collect())
    }

    /// Returns the mask of instruments that lie over everything found in a view, if the recording has one.
    fn tools_below(&mut self, request: &Request, asks: bool) -> Option<Arc<Mask>> {
        let is_wanted = asks && request.look.below_instruments && !request.prompts.is_empty();
        if !is_wanted || !request.view.orbit.is_home() {
            return None;
        }
        let frame = request.view.frame;
        if let Some((_, tools)) = self.tools.iter().find(|(f, _)| *f == frame) {
            return tools.clone();
        }
        // Without a mask the picture is still right: the overlay then covers the instruments, too.
        let tools = self.source.instruments(frame).ok().flatten().map(Arc::new);
        if self.tools.len() >= KEPT_TOOLS {
            self.tools.pop_front();
        }
        self.tools.push_back((frame, tools.clone()));
        tools
    }

    fn original(&mut self, frame: usize) -> Result<(Arc<RgbImage>, Arc<ColorImage>)> {
        if let Some(k) = self.originals.iter().position(|(i, ..)| *i == frame) {
            let known = self.originals.remove(k);
            self.originals.extend(known);
        } else {
            let image = Arc::new(self.source.original(frame)?);
            let bare = Arc::new(color_image(&image));
            self.make_room();
            self.originals.push_back((frame, image, bare));
        }
        let newest = self.originals.back().map(|(_, image, bare)| (image.clone(), bare.clone()));
        newest.ok_or_else(|| Error::input("the recorded frame is not at hand", ""))
    }

    /// Makes sure that the view is the last of the rendered ones, with these parts.
    fn render(&mut self, view: &FrameView, parts: Parts) -> Result<()> {
        let known = self.rendered.iter().position(|r| r.view == *view);
        let mut rendered = known.and_then(|k| self.rendered.remove(k)).unwrap_or_else(|| Rendered::of(view));
        if !rendered.has(parts) {
            let missing = parts.without(rendered.parts());
            match self.source.render(view, missing) {
                Ok(rendering) => rendered.add(rendering, missing),
                Err(e) => {
                    self.rendered.extend(known.is_some().then_some(rendered));
                    return Err(e);
                }
            }
            self.make_room();
        }
        self.rendered.push_back(rendered);
        Ok(())
    }

    /// Does the same, and scores those questions that have not been asked for this view yet.
    fn render_asked(&mut self, view: &FrameView, parts: Parts, questions: &[Question]) -> Result<()> {
        self.render(view, parts)?;
        let Some(rendered) = self.rendered.back_mut() else { return Ok(()) };
        let new = rendered.new_questions(questions);
        if new.is_empty() {
            return Ok(());
        }
        let answers = scores(&mut *self.source, view, &new)?;
        rendered.scores.extend(new.into_iter().zip(answers));
        Ok(())
    }

    /// Returns a view, if it was rendered with these parts and is kept.
    fn known(&self, view: &FrameView, parts: Parts) -> Option<&Rendered> {
        self.rendered.iter().find(|r| r.view == *view && r.has(parts))
    }

    fn kept_bytes(&self) -> usize {
        let originals: usize = self.originals.iter().map(|(_, image, _)| 7 * image.as_raw().len() / 3).sum();
        originals + self.rendered.iter().map(Rendered::bytes).sum::<usize>()
    }

    /// Returns the number of frames by which a kept picture is ahead of the shown one. Returns the largest
    /// number for pictures behind the shown one or from another viewpoint.
    fn distance(&self, frame: usize, view: Option<&FrameView>) -> usize {
        let Some(shown) = self.last.as_ref().map(|last| last.view) else { return 0 };
        let is_alike = view.is_none_or(|view| FrameView { frame: shown.frame, ..*view } == shown);
        if is_alike { frame.checked_sub(shown.frame).unwrap_or(usize::MAX) } else { usize::MAX }
    }

    /// Returns index and distance of the rendered view, and of the recorded frame, that will be needed last.
    fn farthest(&self) -> [Option<(usize, usize)>; 2] {
        let rendered = self.rendered.iter().map(|r| self.distance(r.view.frame, Some(&r.view)));
        let originals = self.originals.iter().map(|(frame, ..)| self.distance(*frame, None));
        [rendered.enumerate().max_by_key(|(_, d)| *d), originals.enumerate().max_by_key(|(_, d)| *d)]
    }

    fn has_room_for(&self, distance: usize) -> bool {
        let is_farther = |farthest: &(usize, usize)| farthest.1 > distance;
        self.kept_bytes() < KEPT_BYTES || self.farthest().iter().flatten().any(is_farther)
    }

    /// Drops the pictures that will be needed last until there is room for another one.
    fn make_room(&mut self) {
        while self.kept_bytes() >= KEPT_BYTES {
            match self.farthest() {
                [Some((k, d)), original] if d > 0 && original.is_none_or(|(_, other)| d >= other) => {
                    self.rendered.remove(k);
                }
                [_, Some((k, d))] if d > 0 => {
                    self.originals.remove(k);
                }
                _ => return,
            }
        }
    }

    /// Draws a layer of the view rendered last in colours.
    fn layer(&mut self, layer: Layer, view: &FrameView) -> Result<LayerPane> {
        let (values, range, note) = match layer {
            Layer::Depth => {
                let range = self.depth_range();
                let depth = self.rendered.back().and_then(|r| r.depth.clone()).unwrap_or_default();
                (depth, range, String::new())
            }
            Layer::Motion => {
                let (values, note) = self.source.motion(view)?;
                let top = *self.motion_top.get_or_insert_with(|| percentile(&values, 98.0).max(1.0));
                (Arc::new(values), (0.0, top), note)
            }
            Layer::Opacity => (Arc::new(self.source.opacity(view)?), (0.0, 1.0), String::new()),
        };
        let image = Arc::new(colour_layer(layer, &values, range));
        Ok(LayerPane { layer, image, range, note })
    }

    /// Returns the depth scale. It is taken from the first depth picture and then kept, so that colours mean
    /// the same on all frames, until most of a picture lies beyond it: then the scope has moved, or another
    /// shot is shown.
    fn depth_range(&mut self) -> (f32, f32) {
        let depth = self.rendered.back().and_then(|r| r.depth.as_ref());
        let at = |q: f64| depth.map_or(0.0, |depth| percentile(depth, q));
        let middle = at(50.0);
        let fits = self.depth_range.is_some_and(|(near, far)| (near..=far).contains(&middle));
        if middle > 0.0 && !fits {
            self.depth_range = Some((at(2.0), at(98.0)));
        }
        self.depth_range.unwrap_or((0.0, 1.0))
    }
}

/// Makes the record of what is counted of a source: nothing yet.
fn nothing_counted(source: &dyn FrameSource) -> Counted {
    let info = source.info();
    Counted::new(info.num_frames, &info.unlearned)
}

/// Returns the percentile of the values above 0, of up to [`SAMPLES`] that are evenly spread; 0 without any.
fn percentile(values: &Grid<f32>, q: f64) -> f32 {
    let sampled = values.data.iter().step_by(values.data.len().div_ceil(SAMPLES).max(1));
    finite_percentile(sampled.copied().filter(|v| *v > 0.0), q).unwrap_or(0.0)
}

/// Stages that a request needs.
struct Needs {
    decodes: bool,
    /// Parts to render; `None` if nothing is rendered.
    parts: Option<Parts>,
    asks: bool,
}

/// Carries the marks to a view that was just rendered, and asks it questions. The only error is that this was
/// left off: any other is that of a question, and the picture can be shown.
fn scores(source: &mut dyn FrameSource, view: &FrameView, questions: &[Question]) -> Result<Vec<Scores>> {
    let is_left_off = |error: &Error| matches!(error, Error::Cancelled);
    if source.carry_marks(view).is_err_and(|error| is_left_off(&error)) {
        return Err(Error::Cancelled);
    }
    let answers = source.scores(view, questions);
    if answers.iter().any(|answer| answer.as_ref().is_err_and(is_left_off)) {
        return Err(Error::Cancelled);
    }
    Ok(answers.into_iter().map(shared).collect())
}

fn shared(scores: Result<Grid<f32>>) -> Scores {
    scores.map(Arc::new).map_err(|e| message(&e))
}

/// Returns the scores of those `wanted` questions that have any.
fn candidates(answers: &[PromptScores], wanted: &[Question]) -> Vec<(String, Arc<Grid<f32>>)> {
    let known = answers.iter().filter(|(question, _)| wanted.contains(question));
    known.filter_map(|(q, scores)| Some((q.text.clone(), scores.as_ref().ok()?.clone()))).collect()
}
