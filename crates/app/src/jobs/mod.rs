//! Long work that the command line and the viewer share: prepare, train, export, build the demo.
//!
//! A job reports through a callback and stops when the callback says so; what is finished is kept.

pub mod backend;
mod chapters;
mod check;
mod demo;
mod export;
mod material;
mod prepare;
mod train;
#[cfg(test)]
mod vanishing_tests;

pub use chapters::{
    Course, DAMAGED, Stopped, begun_chapters, chapter_path, is_finished_chapter, is_whole_scene, join,
    remove_chapters, settings_of_chapters, stopped_at,
};
pub use check::check;
pub use demo::{DemoOptions, DemoPaths, build_demo, record_demo};
pub use export::{ExportQuestion, ExportRequest, export, num_written};
pub use material::Material;
pub use prepare::{FeatureSource, PrepareOptions, faults_of_models, prepare, prepare_folder};
pub use surgtpgs_core::progress::{Observer, Progress};
pub use train::{TRAINING, Trained, Watched, checkpoint_path, go_on, remove_file, train, train_watched};
