//! `bench marks`: what is marked on a frame or a few, against the labels of all others, for every way of
//! marking and without single parts of the method; flow alone beside it.

mod rules;

use super::measure::{Files, Measure};
use crate::{
    cli::{
        console::{ProgressView, print_report, say},
        verb::Exit,
    },
    tables,
};
use clap::Args;
use rules::{LEAST_PX, Rule, largest_part, stroke};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::Arc,
    time::Instant,
};
use surgtpgs_core::{
    Error, Result,
    files::Inputs,
    flow::{Vector, joined, luma, optical_flow, patch_flow},
    grid::{Grid, Mask},
    marks::{Canvas, Carried, CarrySettings, Graph, LookHere, Mark, Marks, Shape},
    mask::threshold,
    metrics::{ClassOnFrame, MaskScores},
    prepare::is_background,
    scene::Scene,
    sequence::{Class, NO_LABEL, Sequence},
};

/// Number of corrections.
const CORRECTIONS: usize = 5;

/// Compare what marks are carried to with labels, for every way of marking: marks.csv
#[derive(Debug, Args)]
pub(super) struct BenchMarksArgs {
    /// A scene; its features are not used
    scene: PathBuf,
    /// The recording that it was trained on, with label masks
    sequence: PathBuf,
    /// Frame to mark [default: the one in the middle]
    #[arg(long)]
    frame: Option<usize>,
    /// Folder for marks.csv
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Measures of one way of marking.
#[derive(serde::Serialize)]
struct Outcome {
    way: String,
    frames: Vec<usize>,
    paper_iou: Option<f64>,
    strict_iou: Option<f64>,
    false_find_rate: Option<f64>,
    /// Seconds of the scene's graph, once before the first mark; `None` for ways that need none.
    graph_s: Option<f64>,
    /// Seconds until the marks are on a marked frame, with the graph at hand; `None` where that is not timed.
    marked_s: Option<f64>,
    /// Seconds per frame without marks.
    frame_s: f64,
    classes: BTreeMap<String, f64>,
}

impl Measure for BenchMarksArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let (scene, sequence) = (Scene::load(&self.scene)?, Sequence::open(&self.sequence)?);
        let inputs = Inputs::none().with_recording(&sequence).with("the scene", &self.scene);
        let files = Files::claim(self.output.as_ref(), &inputs, force)?;
        let bench = Bench::new(scene, sequence)?;
        say(&format!(
            "graph of the scene, once before the first mark: {}",
            milliseconds(Some(bench.graph_s))
        ));
        let n = bench.sequence.num_frames();
        let middle = self.frame.unwrap_or(n / 2).min(n - 1);
        let mut outcomes = Vec::new();
        let mut add = |outcome: Outcome| {
            say(&line(&outcome));
            outcomes.push(outcome);
        };
        for (name, frame) in [("full masks", middle), ("full masks of frame 0", 0)] {
            add(bench.by_flow(&format!("{name}, optical flow alone"), frame, optical_flow)?);
            add(bench.by_flow(&format!("{name}, patch flow alone"), frame, patch_flow)?);
            add(bench.by_rule(name, Rule::Mask, &[frame], CarrySettings::default())?);
        }
        for (name, settings) in parts() {
            add(bench.by_rule(&format!("full masks, {name}"), Rule::Mask, &[middle], settings)?);
        }
        let all_parts = CarrySettings::default();
        add(bench.by_rule("full masks, borders 5 px off", Rule::Sloppy, &[middle], all_parts)?);
        add(bench.by_rule("one stroke per class", Rule::Stroke, &[middle], all_parts)?);
        add(bench.by_rule(
            "one broad, unsteady stroke per class",
            Rule::BroadStroke,
            &[middle],
            all_parts,
        )?);
        add(bench.by_rule("three clicks per class", Rule::Clicks, &[middle], all_parts)?);
        for (name, rule) in [("full masks", Rule::Mask), ("one stroke per class", Rule::Stroke)] {
            let way = format!("{name}, every other class on another frame");
            let marks = Marks::new(bench.alternately(rule, [middle, 5 * n / 6])?, &bench.canvas)?;
            add(bench.by_marks(&way, &marks, all_parts)?);
        }
        for (name, rule) in [("full mask", Rule::Mask), ("one stroke", Rule::Stroke)] {
            add(bench.by_classes(&format!("{name} of every class by itself"), rule, middle)?);
        }
        add(bench.by_rule(
            "strokes on three frames",
            Rule::Stroke,
            &[n / 6, middle, 5 * n / 6],
            all_parts,
        )?);
        bench.corrected("corrections", middle, |_| true, Bench::painted_over, &mut add)?;
        let complete = bench.frames_like(middle)?;
        let may = |frame: usize| complete.contains(&frame);
        let which = "corrections on completely labelled frames";
        bench.corrected(which, middle, may, Bench::painted_over, &mut add)?;
        let which = "more strokes on completely labelled frames";
        bench.corrected(which, middle, may, Bench::stroked, &mut add)?;
        let table = tables::csv(&outcomes.iter().map(Row::from).collect::<Vec<_>>())?;
        files.write("marks.csv", &table)?;
        print_report(&outcomes, &String::from_utf8_lossy(&table), self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

/// Parts of the method that are left out, one by one.
fn parts() -> [(&'static str, CarrySettings); 3] {
    let all_parts = CarrySettings::default();
    [
        ("Gaussians alone", CarrySettings { uses_flow: false, ..all_parts }),
        ("flow not mended", CarrySettings { corrects_drift: false, ..all_parts }),
        ("borders not refined", CarrySettings { refines_borders: false, ..all_parts }),
    ]
}

/// A way to correct what is found on a frame.
type Correct = fn(&Bench, &Carried, &[Grid<f32>], usize) -> Result<Vec<Mark>>;

/// Displacement of every pixel of one frame in another one.
type Flow = fn(&Grid<f32>, &Grid<f32>) -> Grid<Vector>;

/// A scene and its labelled recording.
struct Bench {
    scene: Scene,
    graph: Arc<Graph>,
    /// Seconds that making it took.
    graph_s: f64,
    sequence: Sequence,
    canvas: Canvas,
    classes: Vec<Class>,
}

impl Bench {
    fn new(scene: Scene, sequence: Sequence) -> Result<Self> {
        let is_asked = |c: &&Class| !is_background(&c.name);
        let classes: Vec<Class> = sequence.classes().iter().filter(is_asked).cloned().collect();
        if classes.is_empty() {
            let what = "the recording has no label masks to compare with";
            return Err(Error::input_at(sequence.path(), what, "Give one that has."));
        }
        let size = scene.cameras.first().map(|c| (c.width as usize, c.height as usize));
        if size != Some((sequence.width(), sequence.height())) || scene.num_frames() != sequence.num_frames()
        {
            let what = "this is not the scene's recording: sizes or numbers of frames differ";
            return Err(Error::input_at(sequence.path(), what, "Give the recording it was trained on."));
        }
        let (width, height, num_frames) = (sequence.width(), sequence.height(), sequence.num_frames());
        let canvas = Canvas { width, height, frame_names: Vec::new(), num_frames };
        let started = Instant::now();
        let graph = Arc::new(Graph::of(&scene));
        let graph_s = started.elapsed().as_secs_f64();
        Ok(Self { scene, graph, graph_s, sequence, canvas, classes })
    }

    /// Returns the pixels of each class on a frame.
    fn truth(&self, frame: usize) -> Result<Vec<Mask>> {
        let labels = self.sequence.labels(frame)?;
        let (width, height) = (self.canvas.width, self.canvas.height);
        let labels = labels.unwrap_or_else(|| Grid::filled(width, height, NO_LABEL));
        Ok(self.classes.iter().map(|class| labels.map(|id| *id == class.id)).collect())
    }

    fn marks(&self, rule: Rule, frames: &[usize]) -> Result<Vec<Mark>> {
        let mut marks = Vec::new();
        for &frame in frames {
            for (class, mask) in self.classes.iter().zip(self.truth(frame)?) {
                marks.extend(rules::marks(rule, frame, &class.name, &mask));
            }
        }
        Ok(marks)
    }

    /// Marks classes that follow each other on one frame and on the other in turn.
    fn alternately(&self, rule: Rule, frames: [usize; 2]) -> Result<Vec<Mark>> {
        let place = |mark: &Mark| self.classes.iter().position(|class| class.name == mark.name);
        let is_here = |mark: &Mark| place(mark).is_some_and(|k| frames[k % 2] == mark.frame);
        Ok(self.marks(rule, &frames)?.into_iter().filter(is_here).collect())
    }

    fn by_rule(&self, way: &str, rule: Rule, frames: &[usize], settings: CarrySettings) -> Result<Outcome> {
        self.by_marks(way, &Marks::new(self.marks(rule, frames)?, &self.canvas)?, settings)
    }

    fn by_marks(&self, way: &str, marks: &Marks, settings: CarrySettings) -> Result<Outcome> {
        let started = Instant::now();
        let mut carried = self.carried(marks, settings);
        if let Some(shown) = marks.frames().last() {
            self.scores(&mut carried, *shown)?;
        }
        let marked_s = Some(started.elapsed().as_secs_f64());
        let found = |frame: usize| -> Result<Vec<Mask>> {
            let scores = self.scores(&mut carried, frame)?;
            Ok(self.classes.iter().map(|class| self.found(class, &carried, &scores)).collect())
        };
        let outcome = self.measured(way, &marks.frames(), found)?;
        Ok(Outcome { graph_s: Some(self.graph_s), marked_s, ..outcome })
    }

    /// Marks every class by itself, as if there were no other.
    fn by_classes(&self, way: &str, rule: Rule, frame: usize) -> Result<Outcome> {
        let marks = Marks::new(self.marks(rule, &[frame])?, &self.canvas)?;
        let own = |class: &Class| self.carried(&marks.named(&[&class.name]), CarrySettings::default());
        let mut carried: Vec<Carried> = self.classes.iter().map(own).collect();
        let found = |frame: usize| -> Result<Vec<Mask>> {
            let mut masks = Vec::new();
            for (class, carried) in self.classes.iter().zip(&mut carried) {
                let scores = self.scores(carried, frame)?;
                masks.push(self.found(class, carried, &scores));
            }
            Ok(masks)
        };
        Ok(Outcome { graph_s: Some(self.graph_s), ..self.measured(way, &[frame], found)? })
    }

    fn carried(&self, marks: &Marks, settings: CarrySettings) -> Carried {
        let marks = marks.with_outsides(&self.scene, &(0..self.canvas.num_frames));
        Carried::new(&self.scene, Arc::clone(&self.graph), &marks, settings)
    }

    /// Returns where a class is found, nowhere if it was not marked.
    fn found(&self, class: &Class, carried: &Carried, scores: &[Grid<f32>]) -> Mask {
        let place = carried.names().iter().position(|name| *name == class.name);
        let nowhere = || Mask::filled(self.canvas.width, self.canvas.height, false);
        place.map_or_else(nowhere, |k| threshold(&scores[k], 0.5))
    }

    fn scores(&self, carried: &mut Carried, frame: usize) -> Result<Vec<Grid<f32>>> {
        Ok(carried.on_frame(&self.scene, frame, &mut |i| self.sequence.frame(i))?.scores)
    }

    /// Measures what is found on all frames without a mark.
    fn measured(
        &self,
        way: &str,
        marked: &[usize],
        mut found: impl FnMut(usize) -> Result<Vec<Mask>>,
    ) -> Result<Outcome> {
        let mut measures = MaskScores::default();
        let (mut seconds, mut frames) = (0.0, 0);
        let mut view = ProgressView::default();
        for frame in (0..self.canvas.num_frames).filter(|f| !marked.contains(f)) {
            let started = Instant::now();
            let masks = found(frame)?;
            seconds += started.elapsed().as_secs_f64();
            frames += 1;
            let keep = self.sequence.mask(frame)?;
            for ((class, mask), truth) in self.classes.iter().zip(&masks).zip(self.truth(frame)?) {
                measures.add(ClassOnFrame::measure(frame, &class.name, mask, &truth, &keep)?);
            }
            view.count(way, frame + 1, self.canvas.num_frames)?;
        }
        let paper = measures.paper();
        Ok(Outcome {
            way: way.to_owned(),
            frames: marked.to_vec(),
            paper_iou: paper.mean,
            strict_iou: measures.strict().mean,
            false_find_rate: measures.summary().all.absent.false_find_rate,
            graph_s: None,
            marked_s: None,
            frame_s: seconds / f64::from(frames.max(1)),
            classes: paper.classes,
        })
    }

    /// Carries the labels of a frame along the flow from frame to frame, as if there were no scene.
    fn by_flow(&self, way: &str, marked: usize, flow: Flow) -> Result<Outcome> {
        let labels = self.truth(marked)?;
        let gray = |frame: usize| -> Result<Grid<f32>> { Ok(luma(&self.sequence.frame(frame)?)) };
        let mut ways: BTreeMap<usize, Grid<Vector>> = BTreeMap::new();
        ways.insert(marked, Grid::filled(self.canvas.width, self.canvas.height, [0.0; 2]));
        let after = (marked + 1..self.canvas.num_frames).map(|frame| (frame, frame - 1));
        let before = (0..marked).rev().map(|frame| (frame, frame + 1));
        for (frame, next) in after.chain(before) {
            let step = flow(&gray(frame)?, &gray(next)?);
            ways.insert(frame, joined(&step, &ways[&next]));
        }
        let found = |frame: usize| Ok(labels.iter().map(|mask| seen_along(mask, &ways[&frame])).collect());
        self.measured(way, &[marked], found)
    }

    /// Returns the frames whose labels show every class that those of `frame` show.
    fn frames_like(&self, frame: usize) -> Result<BTreeSet<usize>> {
        let is_shown = |frame: usize| -> Result<Vec<bool>> {
            Ok(self.truth(frame)?.iter().map(|mask| mask.count() > 0).collect())
        };
        let wanted = is_shown(frame)?;
        let mut frames = BTreeSet::new();
        for other in 0..self.canvas.num_frames {
            if is_shown(other)?.iter().zip(&wanted).all(|(shown, wanted)| *shown || !wanted) {
                frames.insert(other);
            }
        }
        Ok(frames)
    }

    /// Strokes first; then marks of a way to `correct` on the frame where one more would help most, of those that
    /// `may` be marked, and so on.
    fn corrected(
        &self,
        which: &str,
        middle: usize,
        may: impl Fn(usize) -> bool,
        correct: Correct,
        add: &mut dyn FnMut(Outcome),
    ) -> Result<()> {
        let mut marks = self.marks(Rule::Stroke, &[middle])?;
        for correction in 1..=CORRECTIONS {
            let current = Marks::new(marks.clone(), &self.canvas)?;
            let mut carried = self.carried(&current, CarrySettings::default());
            let mut places = carried.in_doubt(&self.scene, &mut |i| self.sequence.frame(i))?;
            places.retain(|here| may(here.frame));
            let Some(here) = LookHere::best(&places) else { break };
            let scores = self.scores(&mut carried, here.frame)?;
            marks.extend(correct(self, &carried, &scores, here.frame)?);
            let way = format!("one stroke per class, {correction} {which}");
            add(self.by_marks(&way, &Marks::new(marks.clone(), &self.canvas)?, CarrySettings::default())?);
        }
        Ok(())
    }

    /// Returns marks of the missing part of every class on a frame.
    fn painted_over(&self, carried: &Carried, scores: &[Grid<f32>], frame: usize) -> Result<Vec<Mark>> {
        let keep = self.sequence.mask(frame)?;
        let mut marks = Vec::new();
        for (class, truth) in self.classes.iter().zip(self.truth(frame)?) {
            let place = carried.names().iter().position(|name| *name == class.name);
            let is_missing =
                |i: usize| truth.data[i] && keep.data[i] && place.is_none_or(|k| scores[k].data[i] <= 0.5);
            let missing =
                Mask::from_vec(truth.width, truth.height, (0..truth.data.len()).map(is_missing).collect());
            if missing.count() > 0 {
                marks.push(Mark::new(frame, &class.name, true, Shape::from(&missing)));
            }
        }
        Ok(marks)
    }

    /// Returns a stroke through the largest part of a frame that is wrong: this, or not this.
    fn stroked(&self, carried: &Carried, scores: &[Grid<f32>], frame: usize) -> Result<Vec<Mark>> {
        let keep = self.sequence.mask(frame)?;
        let mut largest: Option<(usize, Mark)> = None;
        for (class, truth) in self.classes.iter().zip(self.truth(frame)?) {
            let place = carried.names().iter().position(|name| *name == class.name);
            let found = |i: usize| place.is_some_and(|k| scores[k].data[i] > 0.5);
            for add in [true, false] {
                let is_wrong = |i: usize| keep.data[i] && truth.data[i] == add && found(i) != add;
                let wrong = (0..truth.data.len()).map(is_wrong).collect();
                let part = largest_part(&Mask::from_vec(truth.width, truth.height, wrong));
                let area = part.count();
                if area >= LEAST_PX && largest.as_ref().is_none_or(|(most, _)| area > *most) {
                    largest = Some((area, Mark::new(frame, &class.name, add, stroke(&part))));
                }
            }
        }
        Ok(largest.into_iter().map(|(_, mark)| mark).collect())
    }
}

/// Returns a mask as it is seen where `way` leads from, by nearest neighbour.
fn seen_along(mask: &Mask, way: &Grid<Vector>) -> Mask {
    let at = |i: usize| {
        let [u, v] = way.data[i];
        let x = ((i % mask.width) as f32 + u + 0.5).clamp(0.0, (mask.width - 1) as f32);
        let y = ((i / mask.width) as f32 + v + 0.5).clamp(0.0, (mask.height - 1) as f32);
        mask.at(x as usize, y as usize)
    };
    Mask::from_vec(mask.width, mask.height, (0..mask.data.len()).map(at).collect())
}

fn text(value: Option<f64>) -> String {
    value.map_or("–".into(), |v| format!("{v:.3}"))
}

fn milliseconds(seconds: Option<f64>) -> String {
    seconds.map_or("–".into(), |s| format!("{:.0} ms", 1e3 * s))
}

fn line(outcome: &Outcome) -> String {
    format!(
        "{}: IoU {}, strict {}, absent found {}; {} to the marked frame, {} a frame",
        outcome.way,
        text(outcome.paper_iou),
        text(outcome.strict_iou),
        text(outcome.false_find_rate),
        milliseconds(outcome.marked_s),
        milliseconds(Some(outcome.frame_s))
    )
}

/// A row of `marks.csv`.
#[derive(serde::Serialize)]
struct Row<'a> {
    way: &'a str,
    frames: String,
    paper_iou: Option<f64>,
    strict_iou: Option<f64>,
    false_find_rate: Option<f64>,
    graph_s: Option<f64>,
    marked_s: Option<f64>,
    frame_s: f64,
}

impl<'a> From<&'a Outcome> for Row<'a> {
    fn from(o: &'a Outcome) -> Self {
        Self {
            way: &o.way,
            frames: o.frames.iter().map(usize::to_string).collect::<Vec<_>>().join(" "),
            paper_iou: o.paper_iou,
            strict_iou: o.strict_iou,
            false_find_rate: o.false_find_rate,
            graph_s: o.graph_s,
            marked_s: o.marked_s,
            frame_s: o.frame_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_timed_has_no_time() {
        let outcome = |graph_s, marked_s| Outcome {
            way: "flow".into(),
            frames: vec![3, 9],
            paper_iou: Some(0.5),
            strict_iou: None,
            false_find_rate: None,
            graph_s,
            marked_s,
            frame_s: 0.25,
            classes: BTreeMap::new(),
        };
        let outcomes = [outcome(None, None), outcome(Some(0.5), Some(0.125))];
        let table = tables::csv(&outcomes.iter().map(Row::from).collect::<Vec<_>>()).unwrap();
        let expected = "way,frames,paper_iou,strict_iou,false_find_rate,graph_s,marked_s,frame_s\n\
                        flow,3 9,0.5,,,,,0.25\nflow,3 9,0.5,,,0.5,0.125,0.25\n";
        assert_eq!(String::from_utf8_lossy(&table), expected);
        assert!(line(&outcomes[0]).ends_with("; – to the marked frame, 250 ms a frame"));
        assert!(line(&outcomes[1]).ends_with("; 125 ms to the marked frame, 250 ms a frame"));
    }
}
