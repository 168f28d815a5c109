//! `surgtpgs convert`: scenes to and from files of other programs.

use super::{
    args::{FrameRange, encoder_for_scene, frame_range, unit_number, words},
    console::{ProgressView, print_report, say, watch_interrupts},
    page,
    verb::{Exit, Run},
};
use crate::{
    engine::EncoderChoice,
    memory::{Work, require_for},
    outputs,
};
use clap::{Args, ValueEnum, ValueHint};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use surgtpgs_core::{
    Error, Result,
    files::{Inputs, write_whole},
    reading::{MOST_TEXT, read_regular},
    scene::{LANG_DEFORMATION_FILE, Released, Scene},
    train::{REFIT_STEPS, refit},
};

/// Turn scenes into files of other programs, and back
#[derive(Debug, Args)]
pub(super) struct ConvertArgs {
    /// A scene, an .spz, or a .ply: ordinary Gaussian splats, or the released code's deforming ones (its feature
    /// network is taken from a lang_deformation.safetensors beside it)
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// NAME.safetensors, NAME.ply, NAME.spz, NAME.glb, or NAME.html for a page that plays in a browser; a name
    /// without extension is a folder of frame0000.ply, frame0001.ply …
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// The frame whose Gaussians are written (default: the first that is shown)
    #[arg(long, value_name = "I", conflicts_with_all = ["time", "frames"])]
    frame: Option<usize>,
    /// The time whose Gaussians are written, 0 to 1
    #[arg(long, value_name = "T", value_parser = unit_number, conflicts_with = "frames")]
    time: Option<f32>,
    /// Frames for a folder, e.g. 12 or 10..20 (the end is not included)
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    frames: Option<FrameRange>,
    /// The chapter of a long scene that a page or the released form shows, from 0
    #[arg(long, value_name = "K", conflicts_with_all = ["frame", "time", "frames", "quantize"])]
    chapter: Option<usize>,
    /// Files in a folder [default: ply]
    #[arg(long, value_enum)]
    format: Option<StillFormat>,
    /// Write the deforming .ply of the released code, with its feature network as
    /// lang_deformation.safetensors beside it
    #[arg(long, conflicts_with_all = ["frame", "time", "frames"])]
    reference: bool,
    /// Steps of fitting the pictures of --reference to the scene's; 0 for none
    #[arg(long, value_name = "N", requires = "reference", default_value_t = REFIT_STEPS)]
    fit_steps: usize,
    /// A scene of the same recording: what a .ply does not hold (cameras, codec, classes) is taken from it
    #[arg(long, value_name = "SCENE")]
    like: Option<PathBuf>,
    /// Write a scene in few bits, about a sixth of the size
    #[arg(long, conflicts_with_all = ["frame", "time", "frames", "reference"])]
    quantize: bool,
    /// Words to show in a page, with what they find; may be given several times
    #[arg(long, visible_alias = "prompts", value_name = "TEXT", num_args = 1.., value_parser = words)]
    prompt: Vec<String>,
    /// `builtin`, or the text encoder's folder; needed only if it is not where it was when preparing
    #[arg(long, value_name = "DIR|builtin", value_hint = ValueHint::DirPath, requires = "prompt")]
    text_encoder: Option<String>,
    /// Overwrite what is there
    #[arg(long)]
    force: bool,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Files of Gaussians that do not move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StillFormat {
    /// 3D Gaussian splatting's .ply
    Ply,
    /// Niantic's compressed .spz, about a quarter of the size
    Spz,
    /// Binary glTF with KHR_gaussian_splatting
    Glb,
}

impl StillFormat {
    /// Returns the ending of file names.
    fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Spz => "spz",
            Self::Glb => "glb",
        }
    }
}

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
struct Conversion {
    files: Vec<PathBuf>,
    bytes: u64,
    gaussians: usize,
    /// Number of Gaussians of the input that are left out because their values are not numbers.
    left_out: u64,
    /// Properties of the input that the files cannot express.
    lost: Vec<String>,
}

/// Kind of output to write.
enum Target {
    Scene,
    Reference,
    Still(StillFormat),
    /// A file for each frame.
    Folder(StillFormat),
    Page,
}

impl Run for ConvertArgs {
    fn run(&self) -> Result<Exit> {
        let target = target(self)?;
        let scene = part(self, &target, open(self)?)?;
        let inputs = inputs(self, &scene);
        let mut done = Conversion::of(&scene);
        write(self, &target, scene, &inputs, &mut done)?;
        done.lost.iter().for_each(|what| say(&format!("not kept as it was: {what}")));
        print_report(&done, &as_text(&done), self.json)?;
        Ok(Exit::Done)
    }

    fn output(&self) -> Option<&Path> {
        Some(&self.output)
    }
}

/// Returns the chapter that is asked for, the only one if the form holds one, or the scene.
fn part(args: &ConvertArgs, target: &Target, scene: Scene) -> Result<Scene> {
    let holds_one = matches!(target, Target::Reference | Target::Page);
    let count = scene.chapters.iter().len();
    let only = scene.chapters.iter().next().filter(|_| holds_one && count == 1);
    match args.chapter.or(only.map(|chapter| chapter.index)) {
        Some(_) if !holds_one => {
            Err(Error::input("only pages and the released form show one chapter", "Leave out --chapter."))
        }
        Some(index) => scene.chapter_alone(index),
        None if holds_one && count > 1 => {
            let what = format!("this form holds one chapter, and the scene has {count}, from 0");
            Err(Error::input(what, "Choose one with --chapter."))
        }
        None => Ok(scene),
    }
}

impl ConvertArgs {
    /// Returns the text encoder that the words of a page are asked with.
    fn encoder(&self) -> EncoderChoice {
        encoder_for_scene(self.text_encoder.as_deref())
    }
}

/// Returns the files that the conversion reads.
fn inputs(args: &ConvertArgs, scene: &Scene) -> Inputs {
    let inputs = Inputs::none()
        .with("the scene", &args.input)
        .with_some("the other scene", args.like.as_deref())
        .with_some("the text encoder", args.encoder().folder())
        .with("the scene's recording", &scene.provenance.sequence_path);
    match args.input.extension() {
        Some(ending) if ending.eq_ignore_ascii_case("ply") => {
            inputs.with("the feature network of the scene", &args.input.with_file_name(LANG_DEFORMATION_FILE))
        }
        _ => inputs,
    }
}

fn write(
    args: &ConvertArgs,
    target: &Target,
    scene: Scene,
    inputs: &Inputs,
    done: &mut Conversion,
) -> Result<()> {
    match target {
        Target::Scene => write_scene(args, &scene, inputs, done),
        Target::Reference => write_reference(args, &scene, inputs, done),
        Target::Still(format) => write_still(args, &scene, *format, inputs, done),
        Target::Folder(format) => write_folder(args, &scene, *format, inputs, done),
        Target::Page => write_page(args, scene, inputs, done),
    }
}

fn write_scene(args: &ConvertArgs, scene: &Scene, inputs: &Inputs, done: &mut Conversion) -> Result<()> {
    let output = outputs::scene_file(&args.output, inputs, args.force)?;
    output.write_with(|file| scene.write(file, args.quantize))?;
    done.gaussians = scene.num_gaussians()?;
    done.add_file(&args.output)
}

fn write_reference(args: &ConvertArgs, scene: &Scene, inputs: &Inputs, done: &mut Conversion) -> Result<()> {
    let weights_path = args.output.with_file_name(LANG_DEFORMATION_FILE);
    let mut released = scene.released();
    let weights_bytes = released.scene.reference_weights().to_bytes();
    let is_another = weights_path.exists()
        && read_regular(&weights_path, MOST_TEXT).ok().as_deref() != Some(&weights_bytes);
    if is_another && !args.output.exists() {
        let what = "the feature network of another scene is here, under the name that the format gives it";
        return Err(Error::input_at(&weights_path, what, "Choose a folder for this scene alone."));
    }
    let file = |path: &Path| outputs::scene_file(path, inputs, args.force);
    let (ply, weights) = (file(&args.output)?, file(&weights_path)?);
    if !released.lost.is_empty() && args.fit_steps > 0 {
        fit(&mut released, scene, args.fit_steps)?;
    }
    let ply_bytes = released.scene.to_reference_ply();
    (done.gaussians, done.lost) = (released.scene.gaussians.len(), released.lost);
    ply.write(&ply_bytes)?;
    weights.write(&weights_bytes)?;
    done.add(args.output.clone(), &ply_bytes);
    done.add(weights_path, &weights_bytes);
    Ok(())
}

/// Brings the pictures of the released form as near to the scene's as the form allows.
fn fit(released: &mut Released, scene: &Scene, steps: usize) -> Result<()> {
    require_for(&Work::Fitting(scene))?;
    watch_interrupts();
    let mut view = ProgressView::default();
    let likeness = refit(&mut released.scene, scene, steps, &mut |p| view.show(p))?;
    if let [Some(before), Some(after)] = likeness {
        released.lost.push(format!(
            "pictures were fitted to the scene's: PSNR against them is {after:.1} dB, {before:.1} dB before"
        ));
    }
    Ok(())
}

fn write_still(
    args: &ConvertArgs,
    scene: &Scene,
    format: StillFormat,
    inputs: &Inputs,
    done: &mut Conversion,
) -> Result<()> {
    let frame = args.frame.or_else(|| frame_at(scene, args.time)).unwrap_or(0);
    if frame >= scene.num_frames() {
        let what = format!("there is no frame {frame}; the scene has {}, from 0", scene.num_frames());
        return Err(Error::input(what, "Give a smaller --frame."));
    }
    let time = args.time.unwrap_or(scene.time(frame));
    if !scene.shows(time) {
        return Err(not_shown(&args.time.map_or(format!("frame {frame}"), |time| format!("time {time}"))));
    }
    let output = outputs::scene_file(&args.output, inputs, args.force)?;
    let now = scene.at(time)?;
    done.gaussians = now.gaussians.len();
    let bytes = still(&now, time, frame, format, done);
    output.write(&bytes)?;
    done.add(args.output.clone(), &bytes);
    Ok(())
}

/// Returns the last frame that is shown and not after `time`, or else the first that is shown.
fn frame_at(scene: &Scene, time: Option<f32>) -> Option<usize> {
    let shown = || (0..scene.num_frames()).filter(|f| scene.shows_frame(*f));
    let before = time.and_then(|time| shown().rev().find(|f| scene.time(*f) <= time));
    before.or_else(|| shown().next())
}

/// Error of frames that no chapter shows.
fn not_shown(what: &str) -> Error {
    let what = format!(
        "no chapter of the scene shows {what}: it was left out of the training, or is not reached yet"
    );
    Error::input(what, "Choose another one, or train the recording to its end.")
}

/// Writes frames into a folder. Those that no chapter shows are left out.
fn write_folder(
    args: &ConvertArgs,
    scene: &Scene,
    format: StillFormat,
    inputs: &Inputs,
    done: &mut Conversion,
) -> Result<()> {
    let frames = FrameRange::frames(args.frames, scene.num_frames())?;
    let (frames, missing): (Vec<usize>, Vec<usize>) =
        frames.into_iter().partition(|frame| scene.shows_frame(*frame));
    if frames.is_empty() {
        return Err(not_shown("any of these frames"));
    }
    let output = outputs::folder(&args.output, outputs::CONVERSION, inputs, args.force)?;
    let mut view = ProgressView::default();
    let mut now = scene.at(scene.time(frames[0]))?;
    done.gaussians = now.gaussians.len();
    for (k, &frame) in frames.iter().enumerate() {
        let name = format!("frame{frame:04}.{}", format.extension());
        if !now.is_at(scene.time(frame)) {
            now = scene.at(scene.time(frame))?;
            done.gaussians += now.gaussians.len();
        }
        let bytes = still(&now, scene.time(frame), frame, format, done);
        write_whole(&output.path().join(&name), &bytes)?;
        done.add(args.output.join(name), &bytes);
        view.count("converting", k + 1, frames.len())?;
    }
    done.lost.extend(match &missing[..] {
        [] => None,
        [one] => Some(format!("frame {one} is left out: no chapter shows it")),
        [first, .., last] => Some(format!(
            "{} frames from {first} to {last} are left out: no chapter shows them",
            missing.len()
        )),
    });
    output.finish()
}

fn write_page(args: &ConvertArgs, scene: Scene, inputs: &Inputs, done: &mut Conversion) -> Result<()> {
    let output = outputs::scene_file(&args.output, inputs, args.force)?;
    let scene = Arc::new(scene);
    done.gaussians = scene.gaussians.len();
    let bytes = scene.to_page(&page::prompts(&scene, &args.prompt, args.encoder())?);
    output.write(&bytes)?;
    done.add(args.output.clone(), &bytes);
    Ok(())
}

fn target(args: &ConvertArgs) -> Result<Target> {
    let extension = args.output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    let target = match extension.as_deref() {
        Some("safetensors") => Target::Scene,
        Some("ply") if args.reference => Target::Reference,
        Some("ply") => Target::Still(StillFormat::Ply),
        Some("spz") => Target::Still(StillFormat::Spz),
        Some("glb") => Target::Still(StillFormat::Glb),
        Some("html" | "htm") => Target::Page,
        None => Target::Folder(args.format.unwrap_or(StillFormat::Ply)),
        Some(_) => {
            return Err(Error::input_at(
                &args.output,
                "this is not a form that scenes are written in",
                "Give a name that ends in .safetensors, .ply, .spz, .glb or .html, or a folder.",
            ));
        }
    };
    let refuse = |what: &str, hint: &str| Err(Error::input(what, hint));
    let own_form = match target {
        Target::Still(format) | Target::Folder(format) => Some(format),
        Target::Scene | Target::Reference | Target::Page => None,
    };
    match target {
        _ if args.format.is_some_and(|format| own_form != Some(format)) => {
            refuse("the ending of OUT says its form", "Leave out --format, or give a folder as OUT.")
        }
        Target::Scene if args.frame.is_some() || args.time.is_some() || args.frames.is_some() => {
            refuse("a scene file holds all times", "Leave out --frame, --time and --frames.")
        }
        Target::Page if args.frame.is_some() || args.time.is_some() || args.frames.is_some() => {
            refuse("a page holds all frames", "Leave out --frame, --time and --frames.")
        }
        Target::Still(_) if args.frames.is_some() => {
            refuse("one file holds one frame", "Give --frame, or a folder as OUT.")
        }
        Target::Folder(_) if args.frame.is_some() || args.time.is_some() => {
            refuse("a folder holds a file per frame", "Give --frames, or a file as OUT.")
        }
        Target::Scene | Target::Still(_) | Target::Folder(_) | Target::Page if args.reference => {
            refuse("the released code reads .ply files only", "Give a name that ends in .ply.")
        }
        Target::Still(_) | Target::Folder(_) | Target::Reference | Target::Page if args.quantize => {
            refuse("only scene files are quantised", "Give a name that ends in .safetensors.")
        }
        Target::Scene | Target::Still(_) | Target::Folder(_) | Target::Reference
            if !args.prompt.is_empty() =>
        {
            refuse("only pages show prompts", "Give a name that ends in .html.")
        }
        target => Ok(target),
    }
}

fn open(args: &ConvertArgs) -> Result<Scene> {
    require_for(&Work::Scene(&args.input))?;
    let mut scene = Scene::load(&args.input)?;
    if let Some(path) = &args.like {
        if Scene::provenance_of(&args.input).is_some() {
            let what = "this is a scene, which holds all that --like gives";
            return Err(Error::input_at(
                &args.input,
                what,
                "Leave out --like, or give a .ply or .spz as IN.",
            ));
        }
        require_for(&Work::Scene(path))?;
        scene.complete_from(&Scene::load(path)?);
        if scene.provenance.held_out && scene.provenance.steps == 0 {
            say("note: the frames that --like held out count as held out: nothing tells how IN was trained");
        }
    }
    if scene.gaussians.is_empty() {
        return Err(Error::input_at(
            &args.input,
            "there is no Gaussian in this file",
            "Choose another file.",
        ));
    }
    Ok(scene)
}

fn still(scene: &Scene, time: f32, frame: usize, format: StillFormat, done: &mut Conversion) -> Vec<u8> {
    let (gaussians, camera) = (scene.all_still(time), scene.cameras.get(frame));
    match format {
        StillFormat::Ply => gaussians.to_ply(camera),
        StillFormat::Spz => {
            let beyond = gaussians.beyond_spz();
            if beyond > 0 {
                done.lost.push(format!(
                    "the sizes of {beyond} of {} Gaussians, on frame {frame}, are cut to what .spz can tell",
                    gaussians.len()
                ));
            }
            gaussians.to_spz()
        }
        StillFormat::Glb => gaussians.to_glb(camera),
    }
}

impl Conversion {
    /// Begins the report about files of a scene.
    fn of(scene: &Scene) -> Self {
        let left_out = scene.provenance.settings["gaussians_left_out"].as_u64().unwrap_or(0);
        Self { files: Vec::new(), bytes: 0, gaussians: 0, left_out, lost: Vec::new() }
    }

    fn add(&mut self, path: PathBuf, bytes: &[u8]) {
        self.files.push(path);
        self.bytes += bytes.len() as u64;
    }

    /// Adds a file that was written bit by bit.
    fn add_file(&mut self, path: &Path) -> Result<()> {
        let about = path.metadata().map_err(|e| Error::io("look at the file", path, e))?;
        self.files.push(path.to_owned());
        self.bytes += about.len();
        Ok(())
    }
}

fn as_text(done: &Conversion) -> String {
    let left_out = match done.left_out {
        0 => String::new(),
        n => format!(", {n} left out because they are not made of numbers"),
    };
    let files = match &done.files[..] {
        [first, .., last] if done.files.len() > 2 => {
            format!("{} files, {} to {}", done.files.len(), first.display(), last.display())
        }
        files => files.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", "),
    };
    format!("{} Gaussians{left_out}, {:.1} MB: {files}\n", done.gaussians, done.bytes as f64 / 1e6)
}

#[cfg(test)]
mod tests;
