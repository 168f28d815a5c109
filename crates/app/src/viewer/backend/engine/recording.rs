//! A recording that is not reconstructed yet, as the window's source of pictures.

use super::info::{examples, output_folder};
use crate::viewer::backend::{FrameSource, FrameView, Info, Parts, Rendering, earlier};
use crate::{engine::Question, jobs::Material};
use image::RgbImage;
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    demo::{self, DemoSettings},
    files::full_path,
    grid::Grid,
};

/// A recording that is not reconstructed yet.
pub(super) struct RecordingSource {
    frame: Box<dyn Fn(usize) -> Result<RgbImage> + Send>,
    info: Info,
}

impl RecordingSource {
    pub(super) fn new(material: &Material, path: PathBuf) -> Self {
        let sequence = material.sequence().clone();
        let outline = sequence.outline();
        let mut info = Info {
            name: sequence.name(),
            output_folder: output_folder(&path),
            recording: Some(path.clone()),
            path,
            sequence: Some(full_path(sequence.path())),
            frames_sha256: Some(outline.outline_digest()),
            spots_sha256: outline.spots_digest(),
            num_frames: sequence.num_frames(),
            frame_names: outline.names().map(str::to_owned).collect(),
            width: sequence.width(),
            height: sequence.height(),
            frames_per_second: sequence.frames_per_second(),
            frame_seconds: sequence.frame_seconds().into(),
            camera_moves: sequence.camera_moves(),
            has_original: true,
            has_labels: material.prepared().is_some() || !sequence.classes().is_empty(),
            example_prompts: examples(sequence.classes().iter().map(|c| c.name.as_str())),
            ..Info::default()
        };
        info.made_before = earlier::made_before(&info);
        Self { frame: Box::new(move |i| sequence.frame(i)), info }
    }

    /// Makes a source of the demo that is being written to `path`.
    pub(super) fn of_demo(demo: demo::Demo, path: &Path) -> Self {
        let DemoSettings { width, height, frames, moving_camera, .. } = *demo.settings();
        let info = Info {
            name: path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            output_folder: output_folder(path),
            path: path.to_owned(),
            recording: Some(path.to_owned()),
            sequence: Some(full_path(path)),
            num_frames: frames,
            width,
            height,
            frames_per_second: Some(demo::FRAMES_PER_SECOND),
            camera_moves: moving_camera,
            has_original: true,
            has_labels: true,
            ..Info::default()
        };
        Self { frame: Box::new(move |i| Ok(demo.frame(i).colour)), info }
    }
}

impl FrameSource for RecordingSource {
    fn info(&self) -> &Info {
        &self.info
    }
    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        (self.frame)(frame)
    }
    fn render(&mut self, _: &FrameView, _: Parts) -> Result<Rendering> {
        Err(not_reconstructed())
    }
    fn motion(&mut self, _: &FrameView) -> Result<(Grid<f32>, String)> {
        Err(not_reconstructed())
    }
    fn opacity(&mut self, _: &FrameView) -> Result<Grid<f32>> {
        Err(not_reconstructed())
    }
    fn scores(&mut self, _: &FrameView, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
        questions.iter().map(|_| Err(not_reconstructed())).collect()
    }
}

fn not_reconstructed() -> Error {
    Error::input("this recording has not been reconstructed yet", "Press Reconstruct.")
}
