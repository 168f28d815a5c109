//! `surgtpgs convert`: scenes to and from what other programs read.

use super::{
    Exit,
    console::{ProgressView, print, print_json, say},
};
use crate::{
    args::{ConvertArgs, FrameRange, StillFormat},
    memory::{Work, require_for},
};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    files::write_whole,
    scene::{LANG_DEFORMATION_FILE, Scene},
};

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
struct Report {
    files: Vec<PathBuf>,
    bytes: u64,
    gaussians: usize,
    /// Gaussians of the input that were not made of numbers.
    left_out: u64,
    /// What the files cannot say as the input does.
    lost: Vec<String>,
}

/// What is to be written.
enum Target {
    Scene,
    Reference,
    Still(StillFormat),
    Folder,
}

pub(super) fn run(args: &ConvertArgs) -> Result<Exit> {
    let target = target(args)?;
    if args.output.exists() && !args.force {
        return Err(Error::input_at(
            &args.output,
            "there is something of this name already",
            "Give another name, or --force to overwrite it.",
        ));
    }
    let scene = open(args)?;
    let mut report = Report {
        files: Vec::new(),
        bytes: 0,
        gaussians: scene.gaussians.len(),
        left_out: scene.provenance.settings["gaussians_left_out"].as_u64().unwrap_or(0),
        lost: Vec::new(),
    };
    match target {
        Target::Scene if args.quantize => report.write(&args.output, &scene.to_quantized_bytes()?)?,
        Target::Scene => report.write(&args.output, &scene.to_bytes()?)?,
        Target::Reference => {
            let files = scene.to_reference_ply();
            report.lost = files.lost;
            report.write(&args.output, &files.ply)?;
            report.write(&args.output.with_file_name(LANG_DEFORMATION_FILE), &files.weights.to_bytes())?;
        }
        Target::Still(format) => {
            let frame = args.frame.unwrap_or(0);
            if frame >= scene.num_frames() {
                let what = format!("there is no frame {frame}; the scene has {}, from 0", scene.num_frames());
                return Err(Error::input(what, "Give a smaller --frame."));
            }
            let time = args.time.unwrap_or(scene.time(frame));
            report.write(&args.output, &still(&scene, time, frame, format))?;
        }
        Target::Folder => {
            let mut view = ProgressView::default();
            let frames = FrameRange::frames(args.frames, scene.num_frames())?;
            for (done, &frame) in frames.iter().enumerate() {
                let name = format!("frame{frame:04}.{}", args.format.extension());
                let bytes = still(&scene, scene.time(frame), frame, args.format);
                report.write(&args.output.join(name), &bytes)?;
                view.count("converting", done + 1, frames.len());
            }
        }
    }
    report.lost.iter().for_each(|what| say(&format!("not kept as it was: {what}")));
    if args.json {
        print_json(&report)?;
    } else {
        print(&as_text(&report))?;
    }
    Ok(Exit::Done)
}

fn target(args: &ConvertArgs) -> Result<Target> {
    let extension = args.output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    let target = match extension.as_deref() {
        Some("safetensors") => Target::Scene,
        Some("ply") if args.reference => Target::Reference,
        Some("ply") => Target::Still(StillFormat::Ply),
        Some("glb") => Target::Still(StillFormat::Glb),
        None => Target::Folder,
        Some(_) => {
            return Err(Error::input_at(
                &args.output,
                "this is not a form that scenes are written in",
                "Give a name that ends in .safetensors, .ply or .glb, or a folder.",
            ));
        }
    };
    let refuse = |what: &str, hint: &str| Err(Error::input(what, hint));
    match target {
        Target::Scene if args.frame.is_some() || args.time.is_some() || args.frames.is_some() => {
            refuse("a scene file holds all times", "Leave out --frame, --time and --frames.")
        }
        Target::Still(_) if args.frames.is_some() => {
            refuse("one file holds one frame", "Give --frame, or a folder as OUT.")
        }
        Target::Folder if args.frame.is_some() || args.time.is_some() => {
            refuse("a folder holds a file per frame", "Give --frames, or a file as OUT.")
        }
        Target::Scene | Target::Still(_) | Target::Folder if args.reference => {
            refuse("the released code reads .ply files only", "Give a name that ends in .ply.")
        }
        Target::Still(_) | Target::Folder | Target::Reference if args.quantize => {
            refuse("only scene files are quantised", "Give a name that ends in .safetensors.")
        }
        target => Ok(target),
    }
}

fn open(args: &ConvertArgs) -> Result<Scene> {
    require_for(&Work::Scene(&args.input))?;
    let mut scene = Scene::load(&args.input)?;
    if let Some(path) = &args.like {
        require_for(&Work::Scene(path))?;
        scene.complete_from(&Scene::load(path)?);
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

fn still(scene: &Scene, time: f32, frame: usize, format: StillFormat) -> Vec<u8> {
    let (gaussians, camera) = (scene.all_still(time), scene.cameras.get(frame));
    match format {
        StillFormat::Ply => gaussians.to_ply(camera),
        StillFormat::Glb => gaussians.to_glb(camera),
    }
}

impl Report {
    fn write(&mut self, path: &Path, bytes: &[u8]) -> Result<()> {
        write_whole(path, bytes)?;
        self.files.push(path.to_owned());
        self.bytes += bytes.len() as u64;
        Ok(())
    }
}

fn as_text(report: &Report) -> String {
    let left_out = match report.left_out {
        0 => String::new(),
        n => format!(", {n} left out because they are not made of numbers"),
    };
    let files = match &report.files[..] {
        [first, .., last] if report.files.len() > 2 => {
            format!("{} files, {} to {}", report.files.len(), first.display(), last.display())
        }
        files => files.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", "),
    };
    format!("{} Gaussians{left_out}, {:.1} MB: {files}\n", report.gaussians, report.bytes as f64 / 1e6)
}
