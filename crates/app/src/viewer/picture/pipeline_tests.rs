//! Tests that the pipeline keeps and prepares the right pictures, and that frames never mix.

use crate::engine::{
    BackendChoice, Engine, EngineOptions, Negatives, Next, Pending, Question,
    asking_tests::{adapter, engine_on},
};
use crate::viewer::{
    backend::{FrameSource, FrameView, Info, Parts, Rendering, engine::source_of},
    picture::{
        pipeline::Pipeline,
        request::{AskedPrompt, Picture, Request},
        worker::Worker,
    },
    state::{marks::MarkList, view_mode::Layer},
};
use image::{Rgb, RgbImage};
use std::{
    ops::Range,
    sync::{Arc, Mutex},
    time::Duration,
};
use surgtpgs_core::{
    Error, Result,
    grid::Grid,
    marks::{LookHere, Mark, Shape},
    mask::CleanUp,
    overlay::OverlayLook,
    relevancy::RelevancySettings,
    scene::Scene,
};
use surgtpgs_render::{Gpu, Traffic};

const FRAMES: usize = 40;

/// Source whose pictures and scores tell their frame. It records the frames that were rendered, and the parts
/// that were wanted of each.
struct Telling {
    info: Info,
    side: u32,
    rendered: Arc<Mutex<Vec<usize>>>,
    parts: Arc<Mutex<Vec<Parts>>>,
    /// First frame after a cut.
    cut: usize,
    /// Frame that takes until a request for another one waits.
    endless: Option<usize>,
    /// Frame whose place to look at is not told while a request for another one waits.
    hidden: Option<usize>,
    /// Numbers of marks that were given, one after the other.
    given: Arc<Mutex<Vec<usize>>>,
    pending: Arc<Pending>,
}

impl FrameSource for Telling {
    fn info(&self) -> &Info {
        &self.info
    }
    fn shot_of(&self, frame: usize) -> Range<usize> {
        if frame < self.cut { 0..self.cut } else { self.cut..FRAMES }
    }
    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        Ok(RgbImage::from_pixel(self.side, self.side, Rgb([frame as u8, 1, 1])))
    }
    fn render(&mut self, view: &FrameView, parts: Parts) -> Result<Rendering> {
        self.rendered.lock().unwrap().push(view.frame);
        self.parts.lock().unwrap().push(parts);
        while self.endless == Some(view.frame) {
            if self.pending.is_elsewhere(|frame| frame == view.frame) {
                return Err(Error::Cancelled);
            }
            std::thread::yield_now();
        }
        let side = self.side as usize;
        let colour = || RgbImage::from_pixel(self.side, self.side, Rgb([view.frame as u8; 3]));
        Ok(Rendering {
            colour: parts.colour.then(colour),
            depth: parts.depth.then(|| ramp(side, view.frame as f32 + 1.0)),
            unseen: None,
        })
    }
    fn renderer(&self) -> String {
        format!("machine {}", self.rendered.lock().unwrap().len())
    }
    fn motion(&mut self, _: &FrameView) -> Result<(Grid<f32>, String)> {
        Ok((Grid::filled(1, 1, 0.0), String::new()))
    }
    fn opacity(&mut self, _: &FrameView) -> Result<Grid<f32>> {
        Ok(Grid::filled(1, 1, 1.0))
    }
    fn scores(&mut self, view: &FrameView, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
        let side = self.side as usize;
        questions.iter().map(|_| Ok(Grid::filled(side, side, score_of(view.frame)))).collect()
    }
    fn set_marks(&mut self, marks: &[Mark]) -> Result<()> {
        self.given.lock().unwrap().push(marks.len());
        let is_refused = marks.iter().any(|mark| mark.name == "refused");
        if is_refused { Err(Error::input("these marks cannot be taken", "")) } else { Ok(()) }
    }
    fn look_here(&mut self, frame: usize) -> Result<Option<LookHere>> {
        let is_elsewhere = self.pending.is_elsewhere(|next| next == frame);
        if self.hidden == Some(frame) && is_elsewhere { Err(Error::Cancelled) } else { Ok(None) }
    }
    fn leave_off_for(&mut self, pending: &Arc<Pending>) {
        self.pending = pending.clone();
    }
    fn answers_at_once(&self, view: &FrameView) -> bool {
        view.frame < FRAMES / 2
    }
}

fn score_of(frame: usize) -> f32 {
    (frame + 1) as f32 / 100.0
}

fn telling(side: u32) -> Telling {
    let info = Info {
        num_frames: FRAMES,
        has_original: true,
        has_reconstruction: true,
        has_features: true,
        has_measured_depth: true,
        ..Info::default()
    };
    Telling {
        info,
        side,
        rendered: Arc::default(),
        parts: Arc::default(),
        cut: FRAMES,
        endless: None,
        hidden: None,
        given: Arc::default(),
        pending: Arc::default(),
    }
}

fn pipeline(side: u32) -> (Pipeline, Arc<Mutex<Vec<usize>>>) {
    let source = telling(side);
    let rendered = source.rendered.clone();
    (Pipeline::new(Box::new(source)), rendered)
}

fn question(text: &str) -> Question {
    Question::words(text, Negatives::of(&RelevancySettings::default()))
}

fn click(name: &str) -> Mark {
    Mark::new(0, name, true, Shape::Click { point_px: [2.0, 2.0], radius_px: 1.0 })
}

/// Depths from `near` to twice that.
fn ramp(side: usize, near: f32) -> Grid<f32> {
    let last = (side * side - 1).max(1) as f32;
    Grid::from_vec(side, side, (0..side * side).map(|k| near * (1.0 + k as f32 / last)).collect())
}

fn request(frame: usize) -> Request {
    Request {
        view: FrameView { frame, ..FrameView::default() },
        jump: 0,
        needs_original: true,
        needs_reconstruction: true,
        layer: None,
        needs_difference: false,
        needs_depth: false,
        prompts: vec![AskedPrompt {
            id: 1,
            question: question("liver"),
            threshold: 0.0,
            colour: [0, 200, 80],
            is_instrument: false,
        }],
        candidates: Vec::new(),
        look: OverlayLook::default(),
        clean_up: CleanUp::default(),
        point: None,
        marks: Default::default(),
        is_typing: false,
    }
}

fn is_all_of(picture: &Picture, frame: usize) {
    let red =
        |pane: &Option<crate::viewer::picture::request::Pane>| pane.as_ref().unwrap().bare.pixels[0].r();
    assert_eq!(picture.request.view.frame, frame);
    assert_eq!(usize::from(red(&picture.original)), frame);
    assert_eq!(usize::from(red(&picture.reconstruction)), frame);
    assert_eq!(picture.depth_values.as_ref().unwrap().data[0], frame as f32 + 1.0);
    assert_eq!(picture.findings[0].outcome.as_ref().unwrap().max_score, score_of(frame));
}

/// Opens a pipeline on a scene of three frames, whose scores a graphics adapter looks up; `None` without one.
fn pipeline_on_adapter() -> Option<(Pipeline, Gpu)> {
    adapter()?;
    // Only three classes need three latent numbers, for which there are tables.
    let mut scene = Scene::clone(engine_on(BackendChoice::Cpu, &["liver", "fat", "grasper"], &[]).scene());
    scene.cameras = vec![scene.cameras[0]; 3];
    let options = EngineOptions { backend: BackendChoice::Gpu, ..Default::default() };
    let mut engine = Engine::new(Arc::new(scene), None, options).unwrap();
    assert_eq!(engine.relevancy_name(), "lattice");
    let gpu = engine.gpu().unwrap().gpu().clone();
    Some((Pipeline::new(source_of(engine)), gpu))
}

/// Returns the bytes that cross to and from the device for a picture.
fn crossed_by(request: Request, pipeline: &mut Pipeline, gpu: &Gpu) -> Traffic {
    let before = gpu.traffic();
    let picture = pipeline.produce(request);
    let found: Vec<bool> = picture.findings.iter().map(|finding| finding.outcome.is_ok()).collect();
    assert!(picture.problem.is_none() && found == [true], "{:?} {found:?}", picture.problem);
    gpu.traffic().since(&before)
}

#[test]
fn what_was_shown_once_is_shown_again_without_the_device() {
    let Some((mut pipeline, gpu)) = pipeline_on_adapter() else { return };
    let turned = |yaw: f32| {
        let mut turned = request(0);
        turned.view.orbit.yaw = yaw;
        turned
    };
    for yaw in [0.0, 0.1] {
        assert!(crossed_by(turned(yaw), &mut pipeline, &gpu).read_back > 0, "the first time");
    }
    let other = |change: &dyn Fn(&mut Request)| {
        let mut request = request(0);
        change(&mut request);
        request
    };
    let again = [
        request(0),
        turned(0.1),
        other(&|request| request.prompts[0].threshold = 0.7),
        other(&|request| request.prompts[0].colour = [200, 0, 0]),
        other(&|request| request.look.opacity = 0.9),
        other(&|request| request.clean_up.min_area_px = 30),
    ];
    for (k, request) in again.into_iter().enumerate() {
        assert_eq!(crossed_by(request, &mut pipeline, &gpu), Traffic::default(), "request {k}");
    }
}

#[test]
fn what_was_prepared_ahead_is_shown_without_the_device() {
    let Some((mut pipeline, gpu)) = pipeline_on_adapter() else { return };
    pipeline.produce(request(0));
    let before = gpu.traffic();
    while pipeline.prepare_ahead() {}
    assert!(gpu.traffic().since(&before).read_back > 0, "nothing was prepared");
    for frame in [1, 2] {
        assert_eq!(crossed_by(request(frame), &mut pipeline, &gpu), Traffic::default(), "frame {frame}");
    }
}

#[test]
fn what_marks_find_is_found_again_without_the_device() {
    let Some((mut pipeline, gpu)) = pipeline_on_adapter() else { return };
    let marked = Request { marks: MarkList::of(vec![click("liver")]), ..request(0) };
    assert!(crossed_by(marked.clone(), &mut pipeline, &gpu).read_back > 0, "the first time");
    let mut higher = marked.clone();
    higher.prompts[0].threshold = 0.7;
    for request in [marked, higher] {
        assert_eq!(crossed_by(request, &mut pipeline, &gpu), Traffic::default());
    }
}

#[test]
fn the_picture_is_shown_while_its_prompts_wait_for_marks() {
    let (mut pipeline, rendered) = pipeline(8);
    let recorded = |frame: usize| Request { needs_reconstruction: false, ..request(frame) };
    let first = pipeline.first_look(&recorded(30)).unwrap();
    assert_eq!(first.original.unwrap().bare.pixels[0].r(), 30);
    assert!(first.findings.is_empty() && rendered.lock().unwrap().is_empty());
    assert_eq!(pipeline.produce(recorded(30)).findings.len(), 1);
    let first = pipeline.first_look(&request(31)).unwrap();
    assert_eq!(first.reconstruction.unwrap().bare.pixels[0].r(), 31);
    assert!(first.findings.is_empty());
    assert!(pipeline.first_look(&recorded(3)).is_none(), "it takes no time");
    assert!(pipeline.first_look(&Request { prompts: Vec::new(), ..recorded(30) }).is_none());
}

#[test]
fn frames_ahead_are_prepared_once_and_then_nothing_runs() {
    let (mut pipeline, rendered) = pipeline(8);
    is_all_of(&pipeline.produce(request(3)), 3);
    while pipeline.prepare_ahead() {}
    assert_eq!(*rendered.lock().unwrap(), (3..=15).collect::<Vec<_>>());
    assert!((0..100).all(|_| !pipeline.prepare_ahead()));
    assert_eq!(rendered.lock().unwrap().len(), 13, "an idle window renders nothing");
    is_all_of(&pipeline.produce(request(9)), 9);
    is_all_of(&pipeline.produce(request(4)), 4);
    assert_eq!(rendered.lock().unwrap().len(), 13, "what was prepared is not rendered again");
    is_all_of(&pipeline.produce(request(FRAMES - 1)), FRAMES - 1);
    assert!(!pipeline.prepare_ahead(), "nothing comes after the last frame");
}

#[test]
fn a_picture_names_the_machine_that_made_it() {
    let (mut pipeline, _) = pipeline(8);
    let machines = [3, 20].map(|frame| pipeline.produce(request(frame)).renderer);
    assert_eq!(machines, ["machine 1", "machine 2"]);
}

#[test]
fn a_picture_can_be_waited_for() {
    let worker = Worker::start(Box::new(telling(8)), &egui::Context::default()).unwrap();
    worker.wait(Duration::from_millis(1));
    assert!(worker.take().is_none(), "nothing was asked");
    worker.submit(request(3));
    worker.wait(Duration::from_secs(600));
    is_all_of(&worker.take().unwrap(), 3);
}

#[test]
fn a_picture_that_takes_long_is_left_for_one_elsewhere() {
    let source = Telling { endless: Some(30), ..telling(8) };
    let rendered = source.rendered.clone();
    let worker = Worker::start(Box::new(source), &egui::Context::default()).unwrap();
    worker.submit(request(30));
    while rendered.lock().unwrap().is_empty() {
        std::thread::yield_now();
    }
    worker.submit(request(3));
    worker.wait(Duration::from_secs(600));
    is_all_of(&worker.take().unwrap(), 3);
    worker.submit(request(30));
    worker.end(Duration::from_secs(600));
    assert_eq!(Arc::strong_count(&rendered), 1, "it is left at the end, too");
}

#[test]
fn what_was_left_off_is_counted_later() {
    let source = Telling { endless: Some(2), ..telling(8) };
    let pending = Arc::new(Pending::default());
    let mut pipeline = Pipeline::new(Box::new(source)).leaving_off_for(pending.clone());
    pipeline.produce(request(20));
    pending.set(Next::Frame(9));
    let counted: Vec<usize> = std::iter::from_fn(|| pipeline.count_next()).map(|m| m.frame).collect();
    assert_eq!(counted, [0, 1], "the third frame was left off");
    assert!(pipeline.produce(request(2)).is_left_off);
    let picture = pipeline.produce(request(9));
    assert!(!picture.is_left_off && picture.problem.is_none());
    assert!(pipeline.count_next().is_none(), "the third frame is next");
}

#[test]
fn a_frame_is_counted_again_if_the_place_to_look_at_was_left_off() {
    let source = Telling { hidden: Some(2), ..telling(8) };
    let pending = Arc::new(Pending::default());
    let mut pipeline = Pipeline::new(Box::new(source)).leaving_off_for(pending.clone());
    pipeline.produce(Request { marks: MarkList::of(vec![click("liver")]), ..request(20) });
    pending.set(Next::Frame(9));
    let counted: Vec<usize> = std::iter::from_fn(|| pipeline.count_next()).map(|m| m.frame).collect();
    assert_eq!(counted, [0, 1], "the third frame was left off");
    pending.clear();
    assert_eq!(pipeline.count_next().map(|measured| measured.frame), Some(2));
}

#[test]
fn nothing_is_drawn_any_more_at_the_end() {
    let source = telling(8);
    let rendered = source.rendered.clone();
    let worker = Worker::start(Box::new(source), &egui::Context::default()).unwrap();
    worker.submit(request(3));
    worker.end(Duration::from_secs(600));
    assert_eq!(Arc::strong_count(&rendered), 1, "the source is gone");
}

#[test]
fn the_next_letter_is_looked_for_in_the_view_that_is_there() {
    let (mut pipeline, rendered) = pipeline(8);
    let typed = |words: &str| {
        let mut typed = Request { is_typing: true, ..request(3) };
        typed.prompts[0].question = question(words);
        typed
    };
    for words in ["l", "li", "liv"] {
        is_all_of(&pipeline.produce(typed(words)), 3);
        while pipeline.prepare_ahead() {}
        assert_eq!(*rendered.lock().unwrap(), [3], "no other frame is rendered between letters");
    }
    pipeline.produce(request(3));
    while pipeline.prepare_ahead() {}
    while pipeline.count_next().is_some() {}
    assert_ne!(rendered.lock().unwrap().last(), Some(&3));
    pipeline.come_back();
    assert_eq!(rendered.lock().unwrap().last(), Some(&3), "the shown view is there for the next word");
}

#[test]
fn scrubbed_frames_never_mix() {
    let (mut pipeline, _) = pipeline(8);
    let mut frame = 7;
    for step in 0..300 {
        frame = (frame * 31 + step * 7 + 11) % FRAMES;
        is_all_of(&pipeline.produce(request(frame)), frame);
        for _ in 0..step % 4 {
            pipeline.prepare_ahead();
        }
    }
}

#[test]
fn memory_is_bounded_and_what_is_shown_stays() {
    // 11 + 4 + 7 bytes a pixel: about 23 MB a frame.
    let (mut pipeline, rendered) = pipeline(1024);
    pipeline.produce(request(0));
    while pipeline.prepare_ahead() {}
    let prepared = rendered.lock().unwrap().len();
    assert!((4..9).contains(&prepared), "{prepared} frames of 23 MB within 128 MB");
    pipeline.produce(request(0));
    assert_eq!(rendered.lock().unwrap().len(), prepared, "the frame shown was not forgotten");
    // Frames behind the shown one make room for those ahead.
    is_all_of(&pipeline.produce(request(3)), 3);
    while pipeline.prepare_ahead() {}
    assert!(*rendered.lock().unwrap().iter().max().unwrap() > prepared);
}

#[test]
fn a_part_is_rendered_once_it_is_shown_and_what_is_known_stays() {
    let mut source = telling(8);
    source.info.has_measured_depth = false;
    let parts = source.parts.clone();
    let mut pipeline = Pipeline::new(Box::new(source));
    let recorded = Request { needs_reconstruction: false, ..request(3) };
    let mut wanted = |request: &Request| {
        let picture = pipeline.produce(request.clone());
        assert_eq!(picture.findings[0].outcome.as_ref().unwrap().max_score, score_of(3));
        std::mem::take(&mut *parts.lock().unwrap())
    };
    let none = Parts::default();
    assert_eq!(wanted(&recorded), [Parts { features: true, ..none }], "the recorded frame is shown");
    let with_depth = Request { layer: Some(Layer::Depth), ..recorded.clone() };
    assert_eq!(wanted(&with_depth), [Parts { depth: true, ..none }]);
    assert_eq!(wanted(&request(3)), [Parts { colour: true, ..none }]);
    for known in [recorded, request(3), with_depth] {
        assert!(wanted(&known).is_empty());
    }
}

#[test]
fn depth_that_is_not_drawn_is_rendered_once_the_picture_is_shown() {
    let source = telling(8);
    let parts = source.parts.clone();
    let wanted = || std::mem::take(&mut *parts.lock().unwrap());
    let mut pipeline = Pipeline::new(Box::new(source));
    let plain = Request { needs_reconstruction: false, prompts: Vec::new(), ..request(3) };
    let measured = Request { needs_depth: true, ..plain.clone() };
    assert!(pipeline.first_look(&plain).is_none());
    assert!(pipeline.produce(plain).depth_values.is_none() && wanted().is_empty());
    let first = pipeline.first_look(&measured).unwrap();
    assert!(first.original.is_some() && first.depth_values.is_none() && wanted().is_empty());
    assert_eq!(pipeline.produce(measured.clone()).depth_values.unwrap().data[0], 4.0);
    assert_eq!(wanted(), [Parts { depth: true, ..Parts::default() }]);
    assert!(pipeline.first_look(&measured).is_none(), "it is known");
    while pipeline.prepare_ahead() {}
    assert!(wanted().is_empty(), "nobody measures on frames ahead");
    let mut guessed = telling(8);
    guessed.info.has_measured_depth = false;
    let picture = Pipeline::new(Box::new(guessed)).produce(measured);
    assert!(picture.original.is_some() && picture.depth_values.is_none());
}

#[test]
fn colours_of_depth_mean_the_same_until_they_no_longer_fit() {
    let (mut pipeline, _) = pipeline(8);
    let mut range = |frame: usize| {
        let asked = Request { layer: Some(Layer::Depth), ..request(frame) };
        pipeline.produce(asked).layer.unwrap().range
    };
    let first = range(9);
    assert!(10.0 <= first.0 && first.0 < 11.0 && 19.0 < first.1 && first.1 <= 20.0, "{first:?}");
    assert_eq!(range(11), first);
    let nearer = range(3);
    assert!(nearer.1 <= 8.0, "{nearer:?}");
    assert_eq!(range(4), nearer);
}

#[test]
fn a_half_size_preview_prepares_nothing() {
    let (mut pipeline, rendered) = pipeline(8);
    let view = FrameView { is_preview: true, ..FrameView::default() };
    pipeline.produce(Request { view, ..request(0) });
    assert!(!pipeline.prepare_ahead());
    assert_eq!(*rendered.lock().unwrap(), [0]);
}

#[test]
fn smoothing_over_time_is_the_mean_of_the_frames_around_on_the_picture_and_on_the_curve() {
    let mut pipeline = Pipeline::new(Box::new(Telling { cut: 30, ..telling(8) }));
    let clean_up = CleanUp { smooth_frames: 2, ..CleanUp::default() };
    let smooth = |frame: usize| {
        let mut asked = Request { clean_up, ..request(frame) };
        asked.prompts[0].threshold = 0.01;
        asked
    };
    // Means over frames 0, 1 and 2 around the first one, over five frames around the tenth, and over three frames
    // on either side of a cut.
    for (frame, mean) in [(0, 0.02), (10, 0.11), (29, 0.29), (30, 0.32)] {
        let picture = pipeline.produce(smooth(frame));
        let found = picture.findings[0].outcome.clone().unwrap();
        assert!((found.max_score - mean).abs() < 1e-6, "{}", found.max_score);
        assert_eq!(picture.reconstruction.unwrap().bare.pixels[0], egui::Color32::from_gray(frame as u8));
    }
    // Without smoothing, the first frame's 0.01 is not above the threshold.
    let mut counted = 0;
    while let Some(measured) = pipeline.count_next() {
        let levels = measured.prompts[0].1.as_ref().unwrap();
        assert_eq!(levels.area_px(0.01), 64, "frame {}", measured.frame);
        counted += 1;
    }
    assert_eq!(counted, FRAMES);
}

#[test]
fn areas_are_counted_once_on_every_frame_and_what_is_kept_is_not_rendered_again() {
    let (mut pipeline, rendered) = pipeline(8);
    pipeline.produce(request(0));
    while pipeline.prepare_ahead() {}
    let mut frames = Vec::new();
    while let Some(measured) = pipeline.count_next() {
        let (asked, levels) = &measured.prompts[0];
        let levels = levels.as_ref().unwrap();
        assert_eq!((&asked.question, measured.prompts.len()), (&question("liver"), 1));
        let is_above = score_of(measured.frame) > 0.2;
        assert_eq!(levels.area_px(0.2), if is_above { 64 } else { 0 }, "frame {}", measured.frame);
        frames.push(measured.frame);
    }
    assert_eq!(frames, (0..FRAMES).collect::<Vec<_>>());
    assert_eq!(rendered.lock().unwrap().len(), FRAMES, "each frame once in all");
    let picture = pipeline.produce(request(20));
    is_all_of(&picture, 20);
}

#[test]
fn areas_are_counted_again_after_marks_that_were_taken_back_at_once() {
    let worker = Worker::start(Box::new(telling(8)), &egui::Context::default()).unwrap();
    let count_all = || {
        let mut counted = 0;
        while counted < FRAMES {
            counted += worker.take_measured().len();
            std::thread::yield_now();
        }
    };
    worker.submit(request(0));
    count_all();
    worker.submit(Request { marks: MarkList::of(vec![click("liver")]), ..request(0) });
    worker.submit(request(0));
    count_all();
}

#[test]
fn marks_that_cannot_be_taken_are_tried_once_and_leave_none_of_the_earlier_ones() {
    let source = telling(8);
    let given = source.given.clone();
    let mut pipeline = Pipeline::new(Box::new(source));
    let mut produce = |names: &[&str]| {
        let marks = MarkList::of(names.iter().map(|name| click(name)).collect());
        let picture = pipeline.produce(Request { marks, ..request(3) });
        (picture.problem, picture.findings[0].outcome.as_ref().unwrap().scores.clone())
    };
    produce(&["liver"]);
    let (problem, scores) = produce(&["liver", "refused"]);
    assert_eq!(problem.as_deref(), Some("these marks cannot be taken."));
    let (again, same) = produce(&["liver", "refused"]);
    assert!(again == problem && Arc::ptr_eq(&scores, &same), "nothing is asked anew");
    assert_eq!(produce(&[]).0, None);
    assert_eq!(*given.lock().unwrap(), [1, 2, 0]);
}

#[test]
fn other_negatives_are_another_question() {
    let (mut pipeline, rendered) = pipeline(8);
    pipeline.produce(request(3));
    let mut asked = request(3);
    asked.prompts[0].question.negatives.phrases.push("smoke".into());
    is_all_of(&pipeline.produce(asked), 3);
    assert_eq!(*rendered.lock().unwrap(), [3], "asked anew, not rendered anew");
}

#[test]
fn results_of_other_prompts_are_kept_while_words_are_typed() {
    let (mut pipeline, _) = pipeline(8);
    let cleaned = |picture: &Picture| picture.findings[0].outcome.as_ref().unwrap().cleaned.clone();
    let mut asked = Request { clean_up: CleanUp { min_area_px: 2, ..CleanUp::default() }, ..request(3) };
    let first = cleaned(&pipeline.produce(asked.clone()));
    let fat =
        AskedPrompt { id: 2, question: question("fat"), is_instrument: true, ..asked.prompts[0].clone() };
    asked.prompts.push(fat);
    let both = pipeline.produce(asked.clone());
    assert_eq!(both.findings.len(), 2);
    assert!(Arc::ptr_eq(&first, &cleaned(&both)));
    asked.prompts[0].threshold = 0.02;
    assert!(!Arc::ptr_eq(&first, &cleaned(&pipeline.produce(asked.clone()))));
    asked.view.frame = 4;
    is_all_of(&pipeline.produce(asked), 4);
}
