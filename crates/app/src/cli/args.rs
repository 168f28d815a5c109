//! Arguments that several verbs share.

use super::console::say;
use crate::{
    engine::{BackendChoice, EncoderChoice, Engine, EngineOptions, Negatives, Question},
    text::split_words,
};
use clap::{Args, ValueEnum, ValueHint};
use std::path::{Path, PathBuf};
use surgtpgs_clip::Provider;
use surgtpgs_core::{
    Error, Result, relevancy::RelevancySettings, scene::Scene, segment::MaskSettings,
    sequence::HiddenRectangle,
};

/// Arguments of every verb.
#[derive(Debug, Args)]
pub(super) struct CommonArgs {
    /// Device that ONNX Runtime runs the models on; an accelerator needs a library that was built for it
    #[arg(long, value_enum, global = true, default_value_t = ProviderArg::Cpu)]
    pub(super) execution_provider: ProviderArg,
}

/// Device that ONNX Runtime runs the models on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ProviderArg {
    /// The processor
    Cpu,
    /// NVIDIA's GPUs
    Cuda,
    /// GPUs on Windows
    Directml,
    /// Apple's accelerators
    Coreml,
}

impl From<ProviderArg> for Provider {
    fn from(arg: ProviderArg) -> Self {
        match arg {
            ProviderArg::Cpu => Self::Cpu,
            ProviderArg::Cuda => Self::Cuda,
            ProviderArg::Directml => Self::DirectMl,
            ProviderArg::Coreml => Self::CoreMl,
        }
    }
}

/// Parts of a recording that nobody may see.
#[derive(Debug, Args)]
pub(super) struct HideArgs {
    /// Part of every frame to make black, in pixels, such as a burnt-in name; may be given several times. What is
    /// made of the recording remembers it
    #[arg(long, value_name = "X,Y,W,H", allow_hyphen_values = true)]
    pub(super) hide: Vec<HiddenRectangle>,
}

/// Arguments that open a scene.
#[derive(Debug, Args)]
pub(super) struct SceneArgs {
    /// Scene file
    pub(super) scene: PathBuf,
    /// Device to render on
    #[arg(long, value_enum, default_value_t = BackendChoice::Auto)]
    pub(super) backend: BackendChoice,
}

impl SceneArgs {
    /// Opens the scene and says what renders it. Prompts are answered as `relevancy` says.
    pub(super) fn open(&self, relevancy: &RelevancyArgs, sequence: Option<PathBuf>) -> Result<Engine> {
        let encoder = encoder_for_scene(relevancy.text_encoder.as_deref());
        let mut engine = self.open_with(EngineOptions { backend: self.backend, encoder, sequence })?;
        engine.change_settings(|usual| relevancy.settings(usual));
        Ok(engine)
    }

    /// Opens the scene, for pictures alone, and says what renders it.
    pub(super) fn open_to_render(&self) -> Result<Engine> {
        self.open_with(EngineOptions { backend: self.backend, ..Default::default() })
    }

    fn open_with(&self, options: EngineOptions) -> Result<Engine> {
        let engine = Engine::open(&self.scene, options)?;
        say(&format!("rendering on {}", engine.renderer_name()));
        let scene = engine.scene();
        let notes = unfinished_note(scene).into_iter().chain(not_shown_note(scene));
        notes.for_each(|note| say(&format!("note: {note}")));
        Ok(engine)
    }
}

/// Refuses to write a scene under the name of another form.
pub(super) fn require_scene_name(path: &Path) -> Result<()> {
    const OTHERS: [&str; 6] = ["ply", "spz", "glb", "gltf", "html", "htm"];
    match path.extension() {
        Some(ending) if OTHERS.iter().any(|other| ending.eq_ignore_ascii_case(other)) => {
            let hint = "Give a name that ends in .safetensors; `surgtpgs convert` makes other forms of it.";
            Err(Error::input_at(path, "a scene is not written in the form that this name says", hint))
        }
        _ => Ok(()),
    }
}

/// Says that the training of a scene was stopped early; `None` if it was not, or if that is not known.
fn unfinished_note(scene: &Scene) -> Option<String> {
    let (steps, planned) = (scene.provenance.steps, scene.provenance.planned_steps()?);
    (steps < planned)
        .then(|| format!("the training of this scene was stopped after {steps} of {planned} steps"))
}

/// Names the frames that no chapter of a scene shows; `None` if there is none.
pub(super) fn not_shown_note(scene: &Scene) -> Option<String> {
    let runs = scene.frames_not_shown();
    let count: usize = runs.iter().map(|[first, last]| last - first + 1).sum();
    let run = |[first, last]: &[usize; 2]| match first == last {
        true => first.to_string(),
        false => format!("{first}–{last}"),
    };
    let places = runs.iter().map(run).collect::<Vec<_>>().join(", ");
    match count {
        0 => None,
        1 => Some(format!("1 frame is shown by no chapter: {places}")),
        _ => Some(format!("{count} frames are shown by no chapter: {places}")),
    }
}

/// Arguments that decide how prompts are answered.
#[derive(Debug, Args)]
pub(super) struct RelevancyArgs {
    /// `builtin`, or the text encoder's folder; needed only if it is not where it was when preparing
    #[arg(long, value_name = "DIR|builtin", value_hint = ValueHint::DirPath)]
    text_encoder: Option<String>,
    /// Way to understand prompts [default: meaning; paper for scenes of the profile "paper"]
    #[arg(long, value_enum)]
    ask_by: Option<AskBy>,
    /// Score above which a pixel is found [default: 0.5, as likely as not; by the paper 0.4]
    #[arg(long, value_parser = unit_number)]
    threshold: Option<f32>,
    /// Sharpness of scores
    #[arg(long, default_value_t = RelevancySettings::default().temperature, value_parser = positive_number)]
    temperature: f32,
    /// Compare prompts with these words as well; may be given several times
    #[arg(long, value_name = "TEXT", num_args = 1.., value_parser = words)]
    negative: Vec<String>,
    /// Do not use that listed classes without a pixel in training frames are known to be absent
    #[arg(long)]
    forget_unseen: bool,
}

/// Way to understand prompts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum AskBy {
    /// The meaning of the words in the scene, against everything that means something else
    Meaning,
    /// The words as they are, against those of --negative alone
    Embedding,
    /// The paper's way: the words as they are, against the phrases object, things, stuff and texture alone
    Paper,
}

impl RelevancyArgs {
    /// Returns the settings of queries; `usual` are those of the scene.
    fn settings(&self, usual: RelevancySettings) -> RelevancySettings {
        let standard = match self.ask_by {
            None => usual,
            Some(AskBy::Meaning) => RelevancySettings::default(),
            Some(AskBy::Embedding) => RelevancySettings { class_negatives: false, ..Default::default() },
            Some(AskBy::Paper) => RelevancySettings::paper(),
        };
        RelevancySettings {
            threshold: self.threshold.unwrap_or(standard.threshold),
            temperature: self.temperature,
            phrases: Negatives::of(&standard).with(&self.negative).phrases,
            knows_unseen: !self.forget_unseen,
            ..standard
        }
    }
}

/// Marks by hand.
#[derive(Debug, Args)]
pub(super) struct MarkArgs {
    /// A file of marks on frames of the recording, or of annotations (COCO, CVAT, Label Studio, .seg.nrrd, DICOM
    /// segmentations): prompts find what they name, and marks of what the scene finds by itself correct it
    #[arg(long, value_name = "MARKS")]
    pub(super) marks: Option<PathBuf>,
    /// A folder with a Segment Anything: clicks and boxes of the marks become the masks that it finds there
    #[arg(long, value_name = "DIR", requires = "marks")]
    marks_model: Option<PathBuf>,
}

impl MarkArgs {
    /// Carries the marks to the scene, if there are any, and names those that show nothing.
    pub(super) fn give_to(&self, engine: &mut Engine) -> Result<()> {
        let Some(path) = self.marks.as_deref() else { return Ok(()) };
        engine.read_marks(path, self.marks_model.as_deref())?;
        engine.mark_notes().iter().for_each(|note| say(&format!("note: {note}")));
        Ok(())
    }
}

/// Prompts to look for.
#[derive(Debug, Args)]
pub(super) struct PromptArgs {
    /// Words to look for; may be given several times
    #[arg(long, visible_alias = "prompts", value_name = "TEXT", required = true, num_args = 1.., value_parser = words)]
    prompt: Vec<String>,
    /// Words that one prompt is not, such as "liver=fat, bile": it alone is compared with these words as well
    #[arg(long, value_name = "PROMPT=TEXT,…", value_parser = but_not)]
    but_not: Vec<(String, Vec<String>)>,
}

impl PromptArgs {
    /// Returns the prompts, each compared with the negatives of `settings` and with the words that it is not.
    pub(super) fn questions(&self, settings: &RelevancySettings) -> Result<Vec<Question>> {
        let is_asked = |name: &String| self.prompt.iter().any(|p| p.eq_ignore_ascii_case(name));
        if let Some((name, _)) = self.but_not.iter().find(|(name, _)| !is_asked(name)) {
            return Err(Error::input(
                format!("--but-not is about \"{name}\", which is no prompt"),
                "Write one of the prompts before the equals sign.",
            ));
        }
        let question = |text: &String| {
            let own = self.but_not.iter().filter(|(name, _)| name.eq_ignore_ascii_case(text));
            let negatives = Negatives::of(settings).with(own.flat_map(|(_, words)| words));
            Question::words(text, negatives)
        };
        Ok(self.prompt.iter().map(question).collect())
    }
}

/// Reads `builtin` or the path of a folder.
pub(super) fn encoder_choice(arg: &str) -> EncoderChoice {
    if arg == "builtin" { EncoderChoice::Builtin } else { EncoderChoice::Folder(arg.into()) }
}

/// Returns the choice that an argument names; without one, the encoder of the scene.
pub(super) fn encoder_for_scene(arg: Option<&str>) -> EncoderChoice {
    arg.map_or(EncoderChoice::OfScene, encoder_choice)
}

/// Density of the points at which masks are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum MaskDensity {
    /// 8×8 points, and groups of points that look alike
    Coarse,
    /// 16×16 points, and the same groups
    Medium,
    /// 32×32 points, and the same groups
    Fine,
    /// 32×32 points on the picture and on each of four crops, as the paper's authors: many minutes a
    /// frame on a CPU
    Paper,
}

impl From<MaskDensity> for MaskSettings {
    fn from(density: MaskDensity) -> Self {
        match density {
            MaskDensity::Coarse => Self::of_grid(8),
            MaskDensity::Medium => Self::of_grid(16),
            MaskDensity::Fine => Self::of_grid(32),
            MaskDensity::Paper => Self::paper(),
        }
    }
}

/// Frames to work on.
#[derive(Debug, Args)]
pub(super) struct FrameArgs {
    /// Frames, e.g. 12 or 10..20 (the end is not included)
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    frames: Option<FrameRange>,
}

impl FrameArgs {
    /// Returns the frames in a recording of `num_frames`; all of them unless some were chosen.
    pub(super) fn of(&self, num_frames: usize) -> Result<Vec<usize>> {
        FrameRange::frames(self.frames, num_frames)
    }
}

/// Frames from `start` up to, not including, `end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FrameRange {
    start: usize,
    end: usize,
}

impl FrameRange {
    /// Returns the frames of the range in a recording of `num_frames`; all of them for `None`.
    pub(super) fn frames(range: Option<Self>, num_frames: usize) -> Result<Vec<usize>> {
        let Self { start, end } = range.unwrap_or(Self { start: 0, end: num_frames });
        let end = end.min(num_frames);
        if start >= end {
            return Err(Error::input(
                format!("no frame is in the range; the scene has {num_frames}, counted from 0"),
                "Give a range such as 0..10.",
            ));
        }
        Ok((start..end).collect())
    }
}

/// Reads a frame such as `12`, or a range such as `10..20`.
pub(super) fn frame_range(text: &str) -> Result<FrameRange, String> {
    let number = |t: &str, empty: usize| {
        if t.is_empty() { Ok(empty) } else { t.parse().map_err(|_| format!("\"{t}\" is not a frame number")) }
    };
    let range = match text.split_once("..") {
        Some((start, end)) => FrameRange { start: number(start, 0)?, end: number(end, usize::MAX)? },
        None => {
            let start: usize =
                text.parse().map_err(|_| "give a frame such as 12, or a range such as 10..20")?;
            FrameRange { start, end: start.saturating_add(1) }
        }
    };
    if range.start < range.end { Ok(range) } else { Err("no frame is in it: its end is not included".into()) }
}

fn but_not(text: &str) -> Result<(String, Vec<String>), String> {
    let parts = text.split_once('=').map(|(prompt, more)| (prompt.trim().to_owned(), split_words(more)));
    let is_whole = |(prompt, more): &(String, Vec<String>)| !prompt.is_empty() && !more.is_empty();
    parts
        .filter(is_whole)
        .ok_or_else(|| "give a prompt and what it is not, such as \"liver=fat, bile\"".into())
}

/// Reads words to look for, of which there is at least one.
pub(super) fn words(text: &str) -> Result<String, String> {
    let text = text.trim();
    if text.is_empty() { Err("give a few words".into()) } else { Ok(text.to_owned()) }
}

/// Reads a number from 0 to 1.
pub(super) fn unit_number(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|v| (0.0..=1.0).contains(v)).ok_or_else(|| "give a number from 0 to 1".into())
}

fn positive_number(text: &str) -> Result<f32, String> {
    text.parse()
        .ok()
        .filter(|v: &f32| v.is_finite() && *v > 0.0)
        .ok_or_else(|| "give a number above 0".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use surgtpgs_core::{scene::Chapter, stress};

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        prompts: PromptArgs,
        #[command(flatten)]
        relevancy: RelevancyArgs,
    }

    #[test]
    fn frame_ranges_are_half_open_and_clipped() {
        let frames =
            |text| FrameRange::frames(Some(frame_range(text).unwrap()), 5).map_err(|e| e.to_string());
        assert_eq!(frames("1..3").unwrap(), [1, 2]);
        assert_eq!(frames("3..").unwrap(), [3, 4]);
        assert_eq!(frames("4").unwrap(), [4]);
        assert_eq!(frames("..99").unwrap().len(), 5);
        assert!(frames("5..9").unwrap_err().contains("counted from 0"));
        assert!(frame_range("a..b").is_err() && frame_range("").is_err() && frame_range("-1").is_err());
        for empty in ["5..3", "4..4", "..0"] {
            assert!(frame_range(empty).unwrap_err().contains("no frame is in it"), "{empty}");
        }
        assert_eq!(frames("..").unwrap().len(), 5);
    }

    #[test]
    fn frames_that_no_chapter_shows_are_named() {
        let of_frames = |shown: std::ops::Range<usize>| {
            let mut scene = stress::ordinary(3);
            scene.cameras = vec![scene.cameras[0]; 9];
            let chapter = Chapter { index: 0, count: 2, learned: shown.clone(), shown };
            scene.provenance.settings = serde_json::json!({ "chapter": chapter });
            not_shown_note(&scene.as_chapter())
        };
        assert_eq!(of_frames(0..9), None);
        assert_eq!(of_frames(0..8).unwrap(), "1 frame is shown by no chapter: 8");
        assert_eq!(of_frames(1..4).unwrap(), "6 frames are shown by no chapter: 0, 4–8");
        assert_eq!(not_shown_note(&stress::ordinary(3)), None);
    }

    #[test]
    fn scenes_are_not_named_like_other_forms() {
        for name in ["x.ply", "x.PLY", "x.spz", "x.glb", "x.html"] {
            assert!(
                require_scene_name(Path::new(name)).unwrap_err().to_string().contains("convert"),
                "{name}"
            );
        }
        for name in ["x.safetensors", "x", "x.scene"] {
            require_scene_name(Path::new(name)).unwrap();
        }
    }

    #[test]
    fn prompts_may_be_given_together_or_apart() {
        let line = Line::parse_from(["query", "--prompt", "liver", "fat", "--prompt", "bile sac"]);
        assert_eq!(line.prompts.prompt, ["liver", "fat", "bile sac"]);
    }

    #[test]
    fn prompts_without_words_are_refused() {
        for line in [&["--prompt", ""][..], &["--prompt="], &["--prompt", "liver", "  "]] {
            let refused = Line::try_parse_from([&["query"][..], line].concat()).err().unwrap().to_string();
            assert!(refused.contains("give a few words"), "{line:?}: {refused}");
        }
    }

    #[test]
    fn thresholds_are_those_of_the_way_of_asking_unless_given() {
        let threshold = |more: &[&str], usual: RelevancySettings| {
            let line = Line::parse_from(["query", "--prompt", "liver"].iter().chain(more));
            line.relevancy.settings(usual).threshold
        };
        let standard = RelevancySettings::default;
        assert_eq!((threshold(&[], standard()), threshold(&[], RelevancySettings::paper())), (0.5, 0.4));
        assert_eq!(threshold(&["--ask-by", "paper"], standard()), 0.4);
        assert_eq!(threshold(&["--ask-by", "meaning"], RelevancySettings::paper()), 0.5);
        assert_eq!(threshold(&["--threshold", "0.3"], RelevancySettings::paper()), 0.3);
    }

    #[test]
    fn a_prompt_is_compared_with_what_is_said_once() {
        let line = |more: &[&str]| {
            let words = ["query", "--prompt", "liver", "fat"];
            let line = Line::parse_from(words.iter().chain(more));
            line.prompts.questions(&line.relevancy.settings(RelevancySettings::default()))
        };
        let phrases = |more: &[&str], k: usize| line(more).unwrap().swap_remove(k).negatives.phrases;
        assert!(phrases(&[], 0).is_empty());
        assert_eq!(phrases(&["--ask-by", "paper"], 0), RelevancySettings::CANONICAL);
        assert_eq!(phrases(&["--ask-by", "paper", "--negative", "smoke", "Stuff"], 1)[4..], ["smoke"]);
        assert_eq!(phrases(&["--ask-by", "embedding", "--negative", "smoke"], 0), ["smoke"]);
        let exception = ["--but-not", "Liver=bile, smoke", "--negative", "smoke"];
        assert_eq!(phrases(&exception, 0), ["smoke", "bile"]);
        assert_eq!(phrases(&exception, 1), ["smoke"]);
        assert!(line(&["--but-not", "spleen=fat"]).unwrap_err().to_string().contains("\"spleen\""));
        for wrong in ["liver", "=fat", "liver= ,"] {
            assert!(Line::try_parse_from(["query", "--prompt", "liver", "--but-not", wrong]).is_err());
        }
    }
}
