//! Implementation of the window's [`Backend`] by the real engine.

mod features;
mod info;
mod pointing;
mod recording;
mod scene;
mod training;

use crate::viewer::backend::{
    Backend, Checked, Demo, FrameSource, ModelFaults, Models, TrainNews, TrainRequest, Words,
    paths::{self, PathAsk, Picked},
    task::TaskContext,
};
use crate::viewer::remedy::message;
use crate::{
    engine::{Engine, EngineOptions, Negatives},
    evaluation::{self, Evaluation, Extras},
    jobs::{self, DemoPaths, ExportRequest, Material},
    memory::{self, Work, require_for},
    outputs,
};
use pointing::Segmenter;
use recording::RecordingSource;
use scene::SceneSource;
use std::{
    path::{Path, PathBuf},
    sync::Mutex,
};
use surgtpgs_core::{
    Result,
    demo::{self, DemoSettings},
    export::ExportSummary,
    files::{Inputs, claim_collection},
    marks::Mark,
    relevancy::RelevancySettings,
    scene::Scene,
    sequence::Sequence,
    train::Quality,
};

/// Returns the source of pictures of a scene in memory, without its recording.
pub(crate) fn source_of(engine: Engine) -> Box<dyn FrameSource> {
    Box::new(SceneSource::new(engine, PathBuf::new(), None))
}

/// Opens, exports and trains with the program's own engine.
#[derive(Default)]
pub(crate) struct EngineBackend {
    /// The network that finds borders, once it was asked.
    segmenter: Mutex<Option<Segmenter>>,
}

impl Backend for EngineBackend {
    fn open(&self, path: &Path) -> Result<Box<dyn FrameSource>> {
        if Scene::is_named_like_one(path) {
            let engine = Engine::open(path, EngineOptions::default())?;
            let recording = engine.sequence().map(|s| s.path().to_owned());
            Ok(Box::new(SceneSource::new(engine, path.to_owned(), recording)))
        } else {
            let material = Material::open(path)?;
            require_for(&Work::Reading(material.sequence()))?;
            Ok(Box::new(RecordingSource::new(&material, path.to_owned())))
        }
    }

    fn pick(&self, ask: &PathAsk) -> Picked {
        paths::pick(ask)
    }

    fn check(&self, path: &Path, task: &TaskContext) -> Result<Checked> {
        let material = Material::open(path)?;
        let sequence = material.sequence();
        let report = jobs::check(sequence, &mut |p| task.follow(p))?;
        Ok(Checked { report, can_flip: sequence.has_mask_files() })
    }

    fn flip_masks(&self, path: &Path) -> Result<PathBuf> {
        Material::open(path)?.sequence().flip_masks()
    }

    fn demo(&self, folder: &Path, task: &TaskContext<Box<dyn FrameSource>>) -> Result<Demo> {
        let paths = DemoPaths::under(folder);
        if paths.scene.is_file() {
            return Ok(Demo { path: paths.scene, train: None });
        }
        if Sequence::open(&paths.recording).is_err() {
            claim_collection(folder, outputs::DEMO, &Inputs::none())?;
            let settings = DemoSettings::default();
            task.update(Box::new(RecordingSource::of_demo(demo::Demo::new(&settings)?, &paths.recording)));
            jobs::record_demo(&settings, &paths.recording, true, &mut |p| task.follow(p))?;
        }
        let train = TrainRequest {
            recording: paths.recording.clone(),
            scene: paths.scene,
            replaces: false,
            quality: Quality::default(),
            excluded: Vec::new(),
            words: Words::Labels,
            features: None,
        };
        Ok(Demo { path: paths.recording, train: Some(train) })
    }

    fn export(
        &self,
        request: &ExportRequest,
        negatives: &Negatives,
        task: &TaskContext,
    ) -> Result<ExportSummary> {
        let mut engine = Engine::open(&request.scene, EngineOptions::default())?;
        engine.change_settings(|usual| RelevancySettings {
            phrases: negatives.phrases.clone(),
            class_negatives: negatives.uses_classes,
            ..usual
        });
        jobs::export(&mut engine, request, &mut |p| task.follow(p))
    }

    fn show_folder(&self, folder: &Path) -> Result<()> {
        paths::show_folder(folder)
    }

    fn evaluate(&self, scene: &Path, left_out: &[(usize, usize)], task: &TaskContext) -> Result<Evaluation> {
        let mut engine = Engine::open(scene, EngineOptions::default())?;
        let extras = Extras { left_out, ..Default::default() };
        evaluation::evaluate(&mut engine, extras, &mut |p| task.follow(p))
    }

    fn check_models(&self, models: &Models, task: &TaskContext) -> Result<ModelFaults> {
        let faults = jobs::faults_of_models(&models.masks, &models.images, &training::text_encoder(models));
        task.check()?;
        let [masks, images, texts] = faults.map(|fault| fault.map(|e| message(&e)));
        Ok(ModelFaults { masks, images, texts })
    }

    fn found_before(
        &self,
        models: &Models,
        recording: &Path,
        folders: &[PathBuf],
        task: &TaskContext,
    ) -> Result<Option<PathBuf>> {
        features::found_before(models, recording, folders, task)
    }

    fn with_mask(&self, model: &Path, recording: &Path, mark: &Mark) -> Result<Mark> {
        pointing::with_mask(&self.segmenter, model, recording, mark)
    }

    fn available_bytes(&self) -> Option<u64> {
        crate::memory::available_bytes()
    }

    fn reconstruct(&self, request: &TrainRequest, task: &TaskContext<TrainNews>) -> Result<PathBuf> {
        let scene = training::reconstruct(request, task);
        memory::give_back();
        scene
    }
}
