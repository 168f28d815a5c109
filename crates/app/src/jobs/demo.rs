//! The built-in demo: its recording, its features and its scene.

use super::{
    material::Material,
    prepare::{PrepareOptions, prepare_folder},
    train::{Trained, train},
};
use crate::{
    engine::BackendChoice,
    memory::{Work, require_for},
    outputs,
};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    demo::{self, DemoSettings},
    files::{Claim, Inputs, OutputFolder, claim_collection},
    progress::Observer,
    sequence::Sequence,
    train::TrainSettings,
};

/// Paths of the demo's files, under one folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DemoPaths {
    /// The synthetic recording.
    pub recording: PathBuf,
    /// Folder with the recording's features.
    pub prepared: PathBuf,
    /// The scene.
    pub scene: PathBuf,
}

impl DemoPaths {
    /// Returns the paths under `folder`.
    pub fn under(folder: &Path) -> Self {
        Self {
            recording: folder.join("recording"),
            prepared: folder.join("prepared"),
            scene: folder.join("scene.safetensors"),
        }
    }
}

/// Size of the demo.
#[derive(Clone, Debug)]
pub struct DemoOptions {
    /// Settings of the recording.
    pub recording: DemoSettings,
    /// Number of training steps.
    pub iterations: usize,
}

impl Default for DemoOptions {
    fn default() -> Self {
        Self { recording: DemoSettings::default(), iterations: 2000 }
    }
}

/// Builds the demo under `folder`: records it, prepares it (test frames held out), trains it and saves the
/// scene. Earlier files of the demo are replaced. A demo that is stopped half-way has no scene.
pub fn build_demo(folder: &Path, options: &DemoOptions, observer: &mut Observer<'_>) -> Result<Trained> {
    require_for(&Work::Recording(options.recording.width as u32, options.recording.height as u32))?;
    let folder = claim_collection(folder, outputs::DEMO, &Inputs::none())?;
    let paths = DemoPaths::under(&folder);
    let scene = outputs::scene_file(&paths.scene, &Inputs::none(), true)?;
    record_demo(&options.recording, &paths.recording, true, observer)?;
    let sequence = Sequence::open(&paths.recording)?;
    let how = PrepareOptions { eval: true, ..Default::default() };
    let prepared = prepare_folder(sequence, &paths.prepared, &how, true, observer)?;
    let settings = TrainSettings { iterations: options.iterations, eval: true, ..Default::default() };
    let material = Material::Prepared(Box::new(prepared));
    let trained = train(&material, settings, BackendChoice::Auto, observer)?;
    if trained.steps < options.iterations {
        return Err(Error::Cancelled);
    }
    scene.write(&trained.scene.to_bytes()?)?;
    Ok(trained)
}

/// Writes the synthetic recording into `folder`, which must be new, empty, or hold the same recording.
/// Another one that this program recorded is replaced if `replace` says so.
pub fn record_demo(
    settings: &DemoSettings,
    folder: &Path,
    replace: bool,
    observer: &mut Observer<'_>,
) -> Result<()> {
    let inputs = Inputs::none();
    let is_same = |there: &Path| demo::is_written(settings, there);
    let claim = Claim {
        is_same: &is_same,
        completes_same: !replace,
        ..Claim::new(outputs::DEMO_RECORDING, &inputs, replace)
    };
    let output = OutputFolder::claim(folder, claim)?;
    demo::write(settings, output.path(), observer)?;
    output.finish()
}
