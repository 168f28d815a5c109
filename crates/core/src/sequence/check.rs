//! The import report: reads every file once and describes the findings in words.

use super::{
    Layout, NO_LABEL, Sequence,
    ffmpeg::damage,
    labels::{EXAMPLES, Way},
    lens, pace,
    recording::MaskRule,
    settings_file::settings_name,
    shots::{self, Seen, Shot},
};
use crate::{
    Result,
    camera::Camera,
    grid::Grid,
    num,
    progress::{Observer, Progress},
};
use image::RgbImage;
use std::{
    collections::{BTreeMap, BTreeSet},
    hash::{DefaultHasher, Hasher},
};

/// Mean share of a frame that mask files hide. Above it they are probably inverted.
const INVERTED_MASKS: f64 = 0.8;
/// Share of missing values above which depth maps are named in the report.
const DEPTH_GAPS: f64 = 0.25;
/// Share of "unknown" pixels above which label pictures are named in the report.
const MOSTLY_UNKNOWN: f64 = 0.5;
/// Allowed deviation of a rotation's columns from unit length and right angles.
const ROTATION_TOLERANCE: f32 = 1e-3;
/// Stage of the check in its progress.
const STAGE: &str = "checking";
/// Number of frames read in parallel between two reports of progress.
const BATCH: usize = 8;

/// The report of `check`; the JSON keys are a contract.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct CheckReport {
    /// `true` if there are no errors.
    pub ok: bool,
    /// Number of frames.
    pub frames: usize,
    /// Image columns.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// Camera source, field of view, still or moving, in words.
    pub camera: String,
    /// Depth kind, range and share of valid pixels, in words.
    pub depth: String,
    /// Mask polarity, share kept, field of view, in words.
    pub masks: String,
    /// Classes and the number of frames in which each occurs, in words.
    pub labels: String,
    /// The first frame of every shot but the first.
    pub cuts: Vec<usize>,
    /// Runs of frames that show no tissue, as far as colours tell; both ends included.
    pub without_tissue: Vec<(usize, usize)>,
    /// Findings that the user should know.
    pub warnings: Vec<String>,
    /// Findings that would make training wrong.
    pub errors: Vec<String>,
}

/// Reads every frame once and reports. Wrong files become entries of `errors`; it only fails if the observer
/// asks to stop.
pub fn check(sequence: &Sequence, observer: &mut Observer<'_>) -> Result<CheckReport> {
    let n = sequence.num_frames();
    let mut facts = Vec::with_capacity(n);
    let mut last = None;
    Progress::new(STAGE, 0, n).tell(observer)?;
    for start in (0..n).step_by(BATCH) {
        let batch: Vec<usize> = (start..(start + BATCH).min(n)).collect();
        facts.extend(sequence.map_frames(&batch, |i, frame| Facts::of(sequence, i, frame)));
        last = compare(&mut facts[start..], last);
        Progress::new(STAGE, facts.len(), n).tell(observer)?;
    }
    let recording = sequence.recording();
    let warnings = [&recording.notes[..], &recording.cautions].concat();
    let mut says = Findings { warnings, errors: Vec::new() };
    says.warnings.extend(recording.complaints().into_iter().map(|what| damage(&what)));
    says.errors.extend(facts.iter().flat_map(|f| f.errors.iter().cloned()));
    let shots: Vec<Shot> = facts.iter().map(|f| f.shot).collect();
    let report = CheckReport {
        ok: false,
        cuts: shots::cuts(&shots),
        without_tissue: shots::without_tissue(&shots),
        frames: n,
        width: sequence.width(),
        height: sequence.height(),
        camera: camera(sequence, &mut says),
        depth: depth(sequence, &facts, &mut says),
        masks: masks(sequence, &facts, &mut says),
        labels: labels(sequence, &facts, &mut says),
        warnings: Vec::new(),
        errors: Vec::new(),
    };
    repeated_frames(&facts, &mut says);
    strange_parts(&report, &mut says);
    Ok(CheckReport { ok: says.errors.is_empty(), warnings: says.warnings, errors: says.errors, ..report })
}

#[derive(Default)]
struct Findings {
    warnings: Vec<String>,
    errors: Vec<String>,
}

/// Findings about the files of one frame; `None` if a file does not exist or cannot be read.
#[derive(Default)]
struct Facts {
    errors: Vec<String>,
    fingerprint: Option<u64>,
    /// A look at the frame, until it was compared with the one before.
    seen: Option<Seen>,
    shot: Shot,
    /// Share of the frame that the mask file hides.
    hidden_by_file: Option<f64>,
    /// Share of the frame that is supervised.
    kept: Option<f64>,
    depth: Option<DepthFacts>,
    labels: Option<LabelFacts>,
}

struct DepthFacts {
    size: (usize, usize),
    unknown: f64,
    bad_values: usize,
    nearest: f32,
    farthest: f32,
}

struct LabelFacts {
    present: [bool; 256],
    unknown: f64,
    way: Way,
    /// Share of the pixels that name no class.
    strangers: f64,
    examples: BTreeSet<String>,
}

impl Facts {
    fn of(sequence: &Sequence, i: usize, frame: Result<RgbImage>) -> Self {
        let mut facts = Self::default();
        let recording = sequence.recording();
        if let Some(frame) = facts.note(frame) {
            let mut hasher = DefaultHasher::new();
            hasher.write(frame.as_raw());
            facts.fingerprint = Some(hasher.finish());
            facts.seen = Some(Seen::of(&frame));
        }
        let inside = sequence.field_of_view();
        match facts.note(recording.file_mask(i)) {
            Some(Some(mask)) => {
                facts.hidden_by_file = Some(1.0 - mask.share());
                let kept = mask.data.iter().zip(&inside.data).filter(|(m, i)| **m && **i).count();
                facts.kept = Some(kept as f64 / mask.data.len() as f64);
            }
            Some(None) => facts.kept = Some(inside.share()),
            None => {}
        }
        let map =
            recording.frames[i].depth.as_ref().and_then(|path| facts.note(recording.depth_rule.read(path)));
        facts.depth = map.map(|map| DepthFacts::of(&map.depth, map.bad_values));
        facts.labels = facts.note(sequence.read_labels(i)).flatten().map(|read| {
            let labels = read.ids;
            let mut present = [false; 256];
            labels.data.iter().for_each(|&id| present[usize::from(id)] = true);
            let unknown = labels.data.iter().filter(|&&id| id == NO_LABEL).count();
            let share = |count: usize| count as f64 / labels.data.len() as f64;
            LabelFacts {
                present,
                unknown: share(unknown),
                way: read.way,
                strangers: share(read.strangers),
                examples: read.examples,
            }
        });
        facts
    }

    fn note<T>(&mut self, result: crate::Result<T>) -> Option<T> {
        result.map_err(|e| self.errors.push(e.to_string())).ok()
    }
}

impl DepthFacts {
    fn of(depth: &Grid<f32>, bad_values: usize) -> Self {
        let known = || depth.data.iter().copied().filter(|&z| z > 0.0);
        Self {
            size: (depth.width, depth.height),
            unknown: 1.0 - known().count() as f64 / depth.data.len() as f64,
            bad_values,
            nearest: known().fold(f32::INFINITY, f32::min),
            farthest: known().fold(0.0, f32::max),
        }
    }
}

fn camera(sequence: &Sequence, says: &mut Findings) -> String {
    let first = sequence.camera(0);
    let source = match sequence.camera_source() {
        super::CameraSource::Given => "given",
        super::CameraSource::Lens => "given but for its poses",
        super::CameraSource::Assumed(degrees) => {
            says.warnings.push(format!(
                "The camera is unknown: a horizontal field of view of {degrees:.0}° is assumed. Give the true \
                 one under [camera] in {}.",
                settings_name(sequence.path())
            ));
            "assumed"
        }
    };
    for i in 0..sequence.num_frames() {
        let determinant = sequence.camera(i).camera_from_world.matrix3.determinant();
        if !is_rotation(&sequence.camera(i)) {
            let hint = if determinant < 0.0 { ": mirrored axes?" } else { "" };
            says.errors.push(format!("Pose {i} is not a rotation (determinant {determinant:.3}){hint}"));
            // All poses come from one file and share its mistake.
            break;
        }
    }
    if let Some(what) = (0..sequence.num_frames()).find_map(|i| lens::unlikely(&sequence.camera(i))) {
        let file = settings_name(sequence.path());
        says.warnings.push(format!("{what}: look at the recording's camera, or at [camera] in {file}"));
    }
    let motion = if sequence.camera_moves() { "moving" } else { "still" };
    let [across, down] = first.field_of_view_degrees();
    format!(
        "{source}, {motion}, focal length {:.1} × {:.1} pixels, field of view {across:.0}° × {down:.0}°",
        first.fx, first.fy
    )
}

fn is_rotation(camera: &Camera) -> bool {
    let m = camera.camera_from_world.matrix3;
    let identity = m.transpose() * m;
    identity.abs_diff_eq(glam::Mat3A::IDENTITY, ROTATION_TOLERANCE) && m.determinant() > 0.0
}

fn depth(sequence: &Sequence, facts: &[Facts], says: &mut Findings) -> String {
    if !sequence.has_depth() {
        // Only a folder of pictures has a place for them.
        let own = match sequence.layout() {
            Layout::Video | Layout::Dicom => "Have it",
            _ => "Put depth maps into depth/ if there are some, or have them",
        };
        says.warnings.push(format!(
            "There is no depth: the shape of the surface can only be guessed. {own} estimated by a depth network \
             when the recording is prepared."
        ));
        return "none".to_owned();
    }
    if let Some(about) = sequence.estimated_depth() {
        says.warnings.extend(about.notes.iter().cloned());
        return format!(
            "estimated by a network; the scales of frames differed by a factor of {:.2}",
            about.drift
        );
    }
    let maps: Vec<_> =
        facts.iter().enumerate().filter_map(|(i, f)| f.depth.as_ref().map(|d| (i, d))).collect();
    depth_faults(sequence, facts, &maps, says);
    let nearest = maps.iter().map(|(_, d)| d.nearest).fold(f32::INFINITY, f32::min);
    let farthest = maps.iter().map(|(_, d)| d.farthest).fold(0.0, f32::max);
    let known = 100.0 * mean(maps.iter().map(|(_, d)| 1.0 - d.unknown));
    let rule = &sequence.recording().depth_rule;
    let kind = match rule.kind {
        super::DepthKind::Depth => format!("depth, {} units per count", rule.scale),
        super::DepthKind::Disparity => format!("disparity, depth = {} / value", rule.scale),
    };
    format!("{kind}; {nearest:.4} to {farthest:.4} scene units, {known:.1} % of the pixels known")
}

/// Tells what is missing or wrong in depth maps, each given with its frame.
fn depth_faults(sequence: &Sequence, facts: &[Facts], maps: &[(usize, &DepthFacts)], says: &mut Findings) {
    let frames_where = |test: &dyn Fn(&DepthFacts) -> bool| -> Vec<usize> {
        maps.iter().filter(|(_, d)| test(d)).map(|(i, _)| *i).collect()
    };
    for i in frames_where(&|d| d.unknown >= 1.0) {
        says.errors.push(format!("Depth map {i} has no valid value"));
    }
    let gaps = frames_where(&|d| d.unknown > DEPTH_GAPS && d.unknown < 1.0);
    if let [i] = gaps[..] {
        let share = 100.0 * facts[i].depth.as_ref().map_or(0.0, |d| d.unknown);
        says.warnings.push(format!("Depth map {i} has {share:.0} % zeros; training will ignore them"));
    } else if !gaps.is_empty() {
        let limit = 100.0 * DEPTH_GAPS;
        says.warnings.push(format!(
            "The depth maps of {} have more than {limit:.0} % zeros; training will ignore them",
            name_frames(&gaps)
        ));
    }
    let bad = frames_where(&|d| d.bad_values > 0);
    if !bad.is_empty() {
        let count: usize = maps.iter().map(|(_, d)| d.bad_values).sum();
        says.warnings.push(format!(
            "The depth maps of {} hold {count} values that are not a number, infinite or negative; they count as unknown",
            name_frames(&bad)
        ));
    }
    let other_size = frames_where(&|d| d.size != (sequence.width(), sequence.height()));
    if let Some(&i) = other_size.first() {
        let size = facts[i].depth.as_ref().map_or((0, 0), |d| d.size);
        says.warnings.push(format!(
            "The depth maps of {} are not of the frames' size ({}×{}); they are resized",
            name_frames(&other_size),
            size.0,
            size.1
        ));
    }
    let without: Vec<_> =
        (0..sequence.num_frames()).filter(|&i| sequence.recording().frames[i].depth.is_none()).collect();
    if !without.is_empty() {
        says.warnings.push(format!("There is no depth for {}", name_frames(&without)));
    }
}

fn masks(sequence: &Sequence, facts: &[Facts], says: &mut Findings) -> String {
    let hidden = mean(facts.iter().filter_map(|f| f.hidden_by_file));
    let (side, flipped) = match sequence.recording().mask_rule {
        MaskRule::KeepWhite => ("white is kept", "black"),
        MaskRule::KeepBlack => ("black is kept", "white"),
        MaskRule::DropCode(_) => ("the labelled background is left out", ""),
    };
    if hidden > INVERTED_MASKS && !flipped.is_empty() {
        says.warnings.push(format!(
            "Masks hide {:.0} % of the frames on average; they are probably inverted. If so, write keep = \
             \"{flipped}\" under [masks] in {}.",
            100.0 * hidden,
            settings_name(sequence.path())
        ));
    }
    let empty: Vec<_> = (0..facts.len()).filter(|&i| facts[i].kept == Some(0.0)).collect();
    if !empty.is_empty() {
        says.errors.push(format!(
            "Nothing of {} is left to learn from: masks and field of view together hide every pixel",
            name_frames(&empty)
        ));
    }
    let files = match facts.iter().filter(|f| f.hidden_by_file.is_some()).count() {
        0 => "none".to_owned(),
        count if count == facts.len() => format!("{side}, {:.1} % hidden", 100.0 * hidden),
        count => format!("{side}, {:.1} % hidden, in {count} of {} frames", 100.0 * hidden, facts.len()),
    };
    let kept = 100.0 * mean(facts.iter().filter_map(|f| f.kept));
    let inside = sequence.found_field_of_view().describe();
    format!("{files}; field of view: {inside}; {kept:.1} % of the pixels are used")
}

fn labels(sequence: &Sequence, facts: &[Facts], says: &mut Findings) -> String {
    if !sequence.has_labels() {
        return "none".to_owned();
    }
    let labelled: Vec<_> = facts.iter().filter_map(|f| f.labels.as_ref()).collect();
    let unknown = mean(labelled.iter().map(|l| l.unknown));
    strange_labels(sequence, facts, says);
    let occurrences = sequence.classes().iter().filter_map(|class| {
        let frames = labelled.iter().filter(|l| l.present[usize::from(class.id)]).count();
        (frames > 0).then(|| format!("{} ({frames})", class.name))
    });
    let occurrences: Vec<_> = occurrences.collect();
    format!(
        "{} of {} classes occur (in how many of {} labelled frames): {}; {:.1} % of their pixels unknown",
        occurrences.len(),
        sequence.classes().len(),
        labelled.len(),
        occurrences.join(", "),
        100.0 * unknown
    )
}

/// Warns about label pictures that were not read in the ordinary way, or not completely.
fn strange_labels(sequence: &Sequence, facts: &[Facts], says: &mut Findings) {
    let frames_where = |test: &dyn Fn(&LabelFacts) -> bool| -> Vec<usize> {
        (0..facts.len()).filter(|&i| facts[i].labels.as_ref().is_some_and(test)).collect()
    };
    for (way, what) in [
        (
            Way::PalettePlaces,
            "have a palette of colours that are not the classes'; the places in it are taken as ids",
        ),
        (Way::GreyColours, "are grey pictures saved in colour; the greys are taken as ids"),
    ] {
        let frames = frames_where(&|l| l.way == way);
        if !frames.is_empty() {
            says.warnings.push(format!("The label pictures of {} {what}", name_frames(&frames)));
        }
    }
    let frames = frames_where(&|l| l.unknown - l.strangers > MOSTLY_UNKNOWN);
    if !frames.is_empty() {
        let limit = 100.0 * MOSTLY_UNKNOWN;
        says.warnings.push(format!(
            "More than {limit:.0} % of the pixels of the label pictures of {} are 255, which means unknown. If that is a class, \
             write its other ids under [[classes]] in {}.",
            name_frames(&frames),
            settings_name(sequence.path())
        ));
    }
    let frames = frames_where(&|l| l.strangers > 0.0);
    if frames.is_empty() {
        return;
    }
    let labelled = || facts.iter().filter_map(|f| f.labels.as_ref());
    let share = 100.0 * mean(labelled().map(|l| l.strangers));
    let share = if share < 0.1 { "less than 0.1".to_owned() } else { format!("{share:.1}") };
    let examples: BTreeSet<&str> = labelled().flat_map(|l| l.examples.iter().map(String::as_str)).collect();
    let some: Vec<&str> = examples.iter().copied().take(EXAMPLES).collect();
    says.warnings.push(format!(
        "{share} % of the labelled frames' pixels have a value or colour that names no class ({}{}), in {}; they \
         count as unknown",
        some.join(", "),
        if examples.len() > some.len() { ", …" } else { "" },
        name_frames(&frames)
    ));
}

/// Compares frames with the ones before, of which `last` is the last. Returns the look at the last frame.
fn compare(facts: &mut [Facts], mut last: Option<Seen>) -> Option<Seen> {
    for facts in facts {
        let seen = facts.seen.take();
        facts.shot = seen.as_ref().map_or(Shot::UNREAD, |seen| seen.after(last.as_ref()));
        last = seen;
    }
    last
}

/// Tells of cuts, and of parts that show no tissue.
fn strange_parts(report: &CheckReport, says: &mut Findings) {
    if !report.cuts.is_empty() {
        says.warnings.push(format!(
            "The shot changes at {}. Each shot is reconstructed as a part of its own.",
            name_frames(&report.cuts)
        ));
    }
    if let [first, others @ ..] = &report.without_tissue[..] {
        let more =
            if others.is_empty() { String::new() } else { format!(" and {} more parts", others.len()) };
        says.warnings.push(format!(
            "Frames {} to {}{more} are probably seen outside of the body, or show nothing. Leave them out.",
            first.0, first.1
        ));
    }
}

fn repeated_frames(facts: &[Facts], says: &mut Findings) {
    let differences: Vec<_> = facts.iter().map(|f| f.shot.difference).collect();
    let repeats = pace::repeats(&differences);
    let at_once: Vec<usize> = (0..facts.len()).filter(|&i| repeats[i]).collect();
    if !at_once.is_empty() {
        says.warnings.push(format!(
            "Pictures that show the one before again, as a changed frame rate leaves them: {}. Training gives \
             them the time of that one",
            name_frames(&at_once)
        ));
    }
    let mut first = BTreeMap::new();
    let mut repeated = Vec::new();
    for (i, fingerprint) in facts.iter().enumerate().filter_map(|(i, f)| f.fingerprint.map(|p| (i, p))) {
        let original = *first.entry(fingerprint).or_insert(i);
        if original != i && !repeats[i] {
            repeated.push((i, original));
        }
    }
    match repeated[..] {
        [] => {}
        [(i, original)] => says.warnings.push(format!("Frame {i} is the same picture as frame {original}")),
        _ => {
            let frames: Vec<_> = repeated.iter().map(|(i, _)| *i).collect();
            says.warnings.push(format!("The pictures of {} repeat earlier ones", name_frames(&frames)));
        }
    }
}

/// Returns the mean of `values`; 0 if there are none.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    num::mean(values).unwrap_or(0.0)
}

/// Names frames in words: "frame 3", "frames 3, 4, 5", "frames 3, 4, 5, 6, 7 and 12 more".
pub fn name_frames(frames: &[usize]) -> String {
    const NAMED: usize = 5;
    let named: Vec<_> = frames.iter().take(NAMED).map(ToString::to_string).collect();
    let more = frames.len().saturating_sub(NAMED);
    let word = if frames.len() == 1 { "frame" } else { "frames" };
    let tail = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{word} {}{tail}", named.join(", "))
}
