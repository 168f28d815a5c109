//! From a request to a picture: decode or render, score, draw. Keeps what the next requests may need again, so that a
//! moved threshold costs a redraw of the overlay and nothing else, and prepares the frames ahead while nothing is asked
//! for. Runs on the worker thread.

use super::{
    areas::{Counted, Levels, Measured},
    compare::Difference,
    document::{PREVIEW, PromptId},
    found::Found,
    negatives::Question,
    source::{FrameSource, Rendering, View},
};
use egui::ColorImage;
use image::RgbImage;
use std::{collections::VecDeque, sync::Arc, time::Instant};
use surgtpgs_core::{
    Error, Result,
    grid::Grid,
    overlay::{OverlayPrompt, OverlayStyle, overlay},
};

/// A prompt that is to be looked for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct AskedPrompt {
    pub(crate) id: PromptId,
    pub(crate) question: Question,
    pub(crate) threshold: f32,
    pub(crate) colour: [u8; 3],
}

/// What the window wants to show.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Request {
    pub(crate) view: View,
    pub(crate) needs_original: bool,
    pub(crate) needs_reconstruction: bool,
    pub(crate) needs_depth: bool,
    pub(crate) needs_difference: bool,
    pub(crate) prompts: Vec<AskedPrompt>,
    /// Words whose scores are wanted without being drawn.
    pub(crate) candidates: Vec<Question>,
    pub(crate) style: OverlayStyle,
    pub(crate) opacity: f32,
}

/// One picture, without and with what was found drawn over it. All of one frame: nothing of another frame is ever mixed in.
#[derive(Clone, Debug)]
pub(crate) struct Pane {
    pub(crate) bare: Arc<ColorImage>,
    /// `None` without prompts.
    pub(crate) marked: Option<Arc<ColorImage>>,
}

/// The depth picture with what its colours mean.
#[derive(Clone, Debug)]
pub(crate) struct DepthPane {
    pub(crate) image: Arc<ColorImage>,
    /// Depth at the near and the far end of the colour scale, scene units.
    pub(crate) range: (f32, f32),
}

/// The answer to a [`Request`].
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub(crate) request: Request,
    pub(crate) original: Option<Pane>,
    pub(crate) reconstruction: Option<Pane>,
    pub(crate) depth: Option<DepthPane>,
    pub(crate) difference: Option<Difference>,
    /// Depth of every pixel, scene units, 0 where unknown.
    pub(crate) depth_values: Option<Arc<Grid<f32>>>,
    pub(crate) findings: Vec<Finding>,
    /// Scores of [`Request::candidates`], of those that have any.
    pub(crate) candidates: Vec<(String, Arc<Grid<f32>>)>,
    /// What went wrong, for the user.
    pub(crate) problem: Option<String>,
    /// How long it took, milliseconds.
    pub(crate) took_ms: f64,
    /// How many of the passes of a frame had to run for it.
    pub(crate) passes_run: usize,
}

/// What a prompt found in this view.
#[derive(Clone, Debug)]
pub(crate) struct Finding {
    pub(crate) id: PromptId,
    pub(crate) text: String,
    /// What was found, or why the question could not be asked.
    pub(crate) outcome: Result<Found, String>,
}

/// Frames that are prepared ahead of the one that is shown.
const FRAMES_AHEAD: usize = 12;
/// Memory for pictures that may be needed again, bytes.
const KEPT_BYTES: usize = 128 << 20;

/// Makes pictures from a source, with a memory of the last ones and of those to come.
pub(crate) struct Pipeline {
    source: Box<dyn FrameSource>,
    /// Recorded frames, the one used last at the end.
    originals: VecDeque<(usize, Arc<RgbImage>, Arc<ColorImage>)>,
    /// Rendered views, the one used last at the end.
    rendered: VecDeque<Rendered>,
    depth_range: Option<(f32, f32)>,
    /// What was asked for last.
    last: Option<Request>,
    /// `None` for a passing state of a scene, such as one that is being trained.
    counted: Option<Counted>,
}

/// A prompt's score image, or why there is none.
type PromptScores = (Question, Result<Arc<Grid<f32>>, String>);

struct Rendered {
    view: View,
    has_features: bool,
    colour: RgbImage,
    bare: Arc<ColorImage>,
    depth: Arc<Grid<f32>>,
    scores: Vec<PromptScores>,
}

impl Pipeline {
    pub(crate) fn new(source: Box<dyn FrameSource>) -> Self {
        Self {
            source,
            originals: VecDeque::new(),
            rendered: VecDeque::new(),
            depth_range: None,
            last: None,
            counted: Some(Counted::default()),
        }
    }

    /// Shows another state of the same recording from now on; decoded frames are kept.
    pub(crate) fn replace(&mut self, source: Box<dyn FrameSource>) {
        self.source = source;
        self.rendered.clear();
        self.counted = None;
    }

    /// Makes the picture. What fails becomes [`Picture::problem`].
    pub(crate) fn produce(&mut self, request: Request) -> Picture {
        self.last = Some(request.clone());
        let began = Instant::now();
        let passes_before = self.source.clock();
        let mut picture = Picture {
            original: None,
            reconstruction: None,
            depth: None,
            difference: None,
            depth_values: None,
            findings: Vec::new(),
            candidates: Vec::new(),
            problem: None,
            took_ms: 0.0,
            passes_run: 0,
            request,
        };
        if let Err(e) = self.fill(&mut picture) {
            picture.problem = Some(e.to_string());
        }
        let is_drawn = !picture.findings.is_empty();
        picture.passes_run = self.source.clock().ran_since(&passes_before) + usize::from(is_drawn);
        picture.took_ms = began.elapsed().as_secs_f64() * 1000.0;
        picture
    }

    fn fill(&mut self, picture: &mut Picture) -> Result<()> {
        let request = picture.request.clone();
        let Needs { decodes, renders, asks } = self.needs(&request);
        // The recorded frame first: where rendering fails, it can be shown all the same.
        let original = if decodes { Some(self.original(request.view.frame)?) } else { None };
        if let Some((_, bare)) = &original {
            picture.original = Some(Pane { bare: bare.clone(), marked: None });
        }
        if !renders {
            return Ok(());
        }
        self.render(&request.view, asks)?;
        if asks {
            self.score(&request);
        }
        let range = if request.needs_depth { Some(self.depth_range()) } else { None };
        let Some(rendered) = self.rendered.back() else { return Ok(()) };
        picture.findings = findings(rendered, &request.prompts);
        picture.candidates = rendered.candidates(&request.candidates);
        picture.depth_values = Some(rendered.depth.clone());
        picture.depth =
            range.map(|range| DepthPane { image: Arc::new(colour_depth(&rendered.depth, range)), range });
        if request.needs_reconstruction {
            let marked = mark(&rendered.colour, &picture.findings, &request);
            picture.reconstruction = Some(Pane { bare: rendered.bare.clone(), marked });
        }
        if let (Some((frame, _)), Some(pane)) = (&original, &mut picture.original) {
            pane.marked = mark(frame, &picture.findings, &request);
            picture.difference = request.needs_difference.then(|| Difference::of(frame, &rendered.colour));
        }
        Ok(())
    }

    fn needs(&self, request: &Request) -> Needs {
        let info = self.source.info();
        let asks = info.has_features && !(request.prompts.is_empty() && request.candidates.is_empty());
        let renders = request.needs_reconstruction || request.needs_depth || asks;
        Needs {
            decodes: info.has_original && request.needs_original,
            renders: info.has_reconstruction && renders,
            asks,
        }
    }

    /// Prepares the next frame that is likely to be asked for; `false` if there is none. What fails will fail again, and
    /// be said, when it is asked for.
    pub(crate) fn prepare_ahead(&mut self) -> bool {
        let Some(last) = self.last.clone().filter(|l| !l.view.is_preview && self.source.prepares_ahead())
        else {
            return false;
        };
        let end = self.source.info().num_frames.min(last.view.frame + 1 + FRAMES_AHEAD);
        for frame in last.view.frame + 1..end {
            let view = View { frame, ..last.view };
            let request = Request { view, candidates: Vec::new(), ..last.clone() };
            let Needs { decodes, renders, asks } = self.needs(&request);
            let decodes = decodes && !self.originals.iter().any(|(i, ..)| *i == frame);
            let known = self.rendered.iter().find(|r| r.is_of(&view, asks));
            let renders = renders && known.is_none_or(|r| asks && !r.new_questions(&request).is_empty());
            if !decodes && !renders {
                continue;
            }
            // Never at the cost of what will be needed sooner.
            if !self.has_room_for(frame - last.view.frame) {
                return false;
            }
            let is_decoded = !decodes || self.original(frame).is_ok();
            let is_rendered = !renders || self.render(&view, asks).is_ok();
            if is_rendered && renders && asks {
                self.score(&request);
            }
            return is_decoded && is_rendered;
        }
        false
    }

    /// Counts what the prompts asked for last found on the next frame that was not counted; `None` if there is none.
    pub(crate) fn count_next(&mut self) -> Option<Measured> {
        let last = self.last.as_ref().filter(|l| !l.view.is_preview)?;
        let info = self.source.info();
        if !info.has_features || !self.source.prepares_ahead() {
            return None;
        }
        let num_frames = info.num_frames;
        let prompts: Vec<Question> =
            last.prompts.iter().filter(|p| p.id != PREVIEW).map(|p| p.question.clone()).collect();
        let (frame, new) = self.counted.as_ref()?.next(&prompts, num_frames)?;
        let view = View { frame, ..View::default() };
        let kept = self.rendered.iter().find(|r| r.view == view).and_then(|r| r.levels(&new));
        let levels = match kept {
            Some(levels) => levels,
            None => match self.source.render(&view, true) {
                Ok(_) => ask(&mut *self.source, &view, &new)
                    .iter()
                    .map(|scores| scores.as_ref().ok().map(Levels::of))
                    .collect(),
                Err(_) => vec![None; new.len()],
            },
        };
        let prompts = new.into_iter().zip(levels).collect();
        let measured = Measured { frame, prompts };
        self.counted.as_mut()?.note(&measured, num_frames);
        Some(measured)
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

    /// Makes sure that the view is the last of those rendered.
    fn render(&mut self, view: &View, with_features: bool) -> Result<()> {
        if let Some(k) = self.rendered.iter().position(|r| r.is_of(view, with_features)) {
            let known = self.rendered.remove(k);
            self.rendered.extend(known);
            return Ok(());
        }
        self.rendered.retain(|r| r.view != *view);
        let Rendering { colour, depth } = self.source.render(view, with_features)?;
        self.make_room();
        self.rendered.push_back(Rendered {
            view: *view,
            has_features: with_features,
            bare: Arc::new(color_image(&colour)),
            colour,
            depth: Arc::new(depth),
            scores: Vec::new(),
        });
        Ok(())
    }

    /// Scores those prompts that the view rendered last was not asked for yet.
    fn score(&mut self, request: &Request) {
        let Some(rendered) = self.rendered.back_mut() else { return };
        let new = rendered.new_questions(request);
        if new.is_empty() {
            return;
        }
        let answers = ask(&mut *self.source, &request.view, &new);
        let answers = answers.into_iter().map(|scores| scores.map(Arc::new).map_err(|e| e.to_string()));
        rendered.scores.extend(new.into_iter().zip(answers));
    }

    fn kept_bytes(&self) -> usize {
        let originals: usize = self.originals.iter().map(|(_, image, _)| 7 * image.as_raw().len() / 3).sum();
        originals + self.rendered.iter().map(Rendered::bytes).sum::<usize>()
    }

    /// How many frames ahead of the one shown a kept picture is; the largest number for what is behind or seen otherwise.
    fn distance(&self, frame: usize, view: Option<&View>) -> usize {
        let Some(shown) = self.last.as_ref().map(|last| last.view) else { return 0 };
        let is_alike = view.is_none_or(|view| View { frame: shown.frame, ..*view } == shown);
        if is_alike { frame.checked_sub(shown.frame).unwrap_or(usize::MAX) } else { usize::MAX }
    }

    /// The place and the distance of the rendered view and of the recorded frame that will be needed last.
    fn farthest(&self) -> [Option<(usize, usize)>; 2] {
        let rendered = self.rendered.iter().map(|r| self.distance(r.view.frame, Some(&r.view)));
        let originals = self.originals.iter().map(|(frame, ..)| self.distance(*frame, None));
        [rendered.enumerate().max_by_key(|(_, d)| *d), originals.enumerate().max_by_key(|(_, d)| *d)]
    }

    fn has_room_for(&self, distance: usize) -> bool {
        let is_farther = |farthest: &(usize, usize)| farthest.1 > distance;
        self.kept_bytes() < KEPT_BYTES || self.farthest().iter().flatten().any(is_farther)
    }

    /// Forgets what will be needed last until there is room for another picture.
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

    /// The depth scale: taken from the first depth picture and then kept, so that colours mean the same on all frames.
    fn depth_range(&mut self) -> (f32, f32) {
        let measured = || {
            let rendered = self.rendered.back()?;
            let mut depths: Vec<f32> =
                rendered.depth.data.iter().copied().filter(|d| d.is_finite() && *d > 0.0).collect();
            depths.sort_unstable_by(f32::total_cmp);
            let at = |share: f32| depths.get(((depths.len() as f32 - 1.0) * share) as usize).copied();
            Some((at(0.02)?, at(0.98)?))
        };
        if self.depth_range.is_none() {
            self.depth_range = measured();
        }
        self.depth_range.unwrap_or((0.0, 1.0))
    }
}

/// What a request takes.
struct Needs {
    decodes: bool,
    renders: bool,
    asks: bool,
}

impl Rendered {
    /// Whether it is what was asked for, or has more.
    fn is_of(&self, view: &View, with_features: bool) -> bool {
        self.view == *view && (self.has_features || !with_features)
    }

    /// Questions of a request that it was not asked yet.
    fn new_questions(&self, request: &Request) -> Vec<Question> {
        let asked = request.prompts.iter().map(|p| &p.question).chain(&request.candidates);
        let mut new: Vec<Question> = Vec::new();
        for question in asked {
            if !new.contains(question) && !self.scores.iter().any(|(q, _)| q == question) {
                new.push(question.clone());
            }
        }
        new
    }

    /// The scores of those of `wanted` that have any.
    fn candidates(&self, wanted: &[Question]) -> Vec<(String, Arc<Grid<f32>>)> {
        let known = self.scores.iter().filter(|(question, _)| wanted.contains(question));
        known.filter_map(|(q, scores)| Some((q.text.clone(), scores.as_ref().ok()?.clone()))).collect()
    }

    /// What the prompts found in it, if all of them were asked.
    fn levels(&self, prompts: &[Question]) -> Option<Vec<Option<Levels>>> {
        let of = |question: &Question| {
            let (_, scores) = self.scores.iter().find(|(q, _)| q == question)?;
            Some(scores.as_ref().ok().map(|s| Levels::of(s)))
        };
        prompts.iter().map(of).collect()
    }

    fn bytes(&self) -> usize {
        // Colour twice, depth, scores.
        self.depth.data.len() * (3 + 4 + 4 + 4 * self.scores.len())
    }
}

/// Asks questions, those that are compared with the same together; the answers are in the order of the questions.
fn ask(source: &mut dyn FrameSource, view: &View, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
    let mut answers: Vec<Option<Result<Grid<f32>>>> = questions.iter().map(|_| None).collect();
    while let Some(first) = answers.iter().position(Option::is_none) {
        let negatives = &questions[first].negatives;
        let alike: Vec<usize> =
            (first..questions.len()).filter(|k| questions[*k].negatives == *negatives).collect();
        let words: Vec<&str> = alike.iter().map(|k| questions[*k].text.as_str()).collect();
        let mut scores = match source.set_negatives(negatives) {
            Ok(()) => source.scores(view, &words).into_iter(),
            Err(e) => {
                let failed = words.iter().map(|_| Err(Error::input(e.to_string(), "")));
                failed.collect::<Vec<_>>().into_iter()
            }
        };
        let missing = || Err(Error::input("there is no score for these words", ""));
        alike.into_iter().for_each(|k| answers[k] = Some(scores.next().unwrap_or_else(missing)));
    }
    answers.into_iter().flatten().collect()
}

fn findings(rendered: &Rendered, prompts: &[AskedPrompt]) -> Vec<Finding> {
    prompts
        .iter()
        .filter_map(|prompt| {
            let (_, scores) = rendered.scores.iter().find(|(question, _)| *question == prompt.question)?;
            let outcome = scores.clone().map(|scores| Found::new(scores, prompt.threshold));
            Some(Finding { id: prompt.id, text: prompt.question.text.clone(), outcome })
        })
        .collect()
}

/// The frame with everything found drawn over it; `None` if there is nothing to draw.
fn mark(frame: &RgbImage, findings: &[Finding], request: &Request) -> Option<Arc<ColorImage>> {
    let drawn = |finding: &Finding| -> Option<(Arc<Grid<f32>>, f32, [u8; 3])> {
        let prompt = request.prompts.iter().find(|p| p.id == finding.id)?;
        let found = finding.outcome.as_ref().ok()?;
        Some((found.scores.clone(), prompt.threshold, prompt.colour))
    };
    let layers: Vec<_> = findings.iter().filter_map(drawn).collect();
    let (first, ..) = layers.first()?;
    let (width, height) = (first.width as u32, first.height as u32);
    let resized;
    let frame = if frame.dimensions() == (width, height) {
        frame
    } else {
        resized = image::imageops::thumbnail(frame, width, height);
        &resized
    };
    let prompts: Vec<OverlayPrompt<'_>> = layers
        .iter()
        .map(|(scores, threshold, colour)| OverlayPrompt { scores, threshold: *threshold, colour: *colour })
        .collect();
    Some(Arc::new(color_image(&overlay(frame, &prompts, request.style, request.opacity))))
}

pub(crate) fn color_image(image: &RgbImage) -> ColorImage {
    ColorImage::from_rgb([image.width() as usize, image.height() as usize], image.as_raw())
}

/// Colours of depth from near to far: cividis, readable with any colour vision.
const DEPTH_COLOURS: [[u8; 3]; 6] =
    [[255, 234, 70], [203, 186, 105], [149, 143, 120], [102, 105, 112], [49, 68, 107], [0, 32, 77]];

/// The colour of a depth; `share` is 0 at the near and 1 at the far end of the scale.
pub(crate) fn depth_colour(share: f32) -> egui::Color32 {
    let at = if share.is_finite() { share.clamp(0.0, 1.0) } else { 1.0 } * (DEPTH_COLOURS.len() - 1) as f32;
    let k = (at as usize).min(DEPTH_COLOURS.len() - 2);
    let mix = |c: usize| {
        let (a, b) = (f32::from(DEPTH_COLOURS[k][c]), f32::from(DEPTH_COLOURS[k + 1][c]));
        (a + (b - a) * (at - k as f32)).round() as u8
    };
    egui::Color32::from_rgb(mix(0), mix(1), mix(2))
}

/// Pixels without depth are hatched, so that they are not taken for near or far ones.
fn colour_depth(depth: &Grid<f32>, (near, far): (f32, f32)) -> ColorImage {
    let span = (far - near).max(f32::MIN_POSITIVE);
    let pixel = |(i, &d): (usize, &f32)| {
        if d > 0.0 {
            return depth_colour((d - near) / span);
        }
        let is_line = (i % depth.width + i / depth.width) % 8 < 2;
        egui::Color32::from_gray(if is_line { 70 } else { 30 })
    };
    ColorImage::new([depth.width, depth.height], depth.data.iter().enumerate().map(pixel).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_colours_run_from_the_first_to_the_last_and_holes_are_grey() {
        assert_eq!(depth_colour(0.0), egui::Color32::from_rgb(255, 234, 70));
        assert_eq!(depth_colour(1.0), egui::Color32::from_rgb(0, 32, 77));
        assert_eq!(depth_colour(f32::NAN), depth_colour(1.0));
        let image = colour_depth(&Grid::from_vec(2, 1, vec![0.0, 10.0]), (10.0, 20.0));
        assert_eq!(image.pixels[0], egui::Color32::from_gray(70));
        assert_eq!(image.pixels[1], depth_colour(0.0));
    }
}
