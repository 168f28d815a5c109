//! The viewer's window.
//!
//! ```text
//! keys, mouse ─▶ command ─▶ app (document, playback) ─▶ request ─▶ worker ─▶ pipeline ─▶ source (engine)
//!                    │            ▲   panels draw it                  │
//!         undo ◀─ document        └──────── picture, newest only ◀────┘
//!                    └─▶ session file, autosave
//! ```
//!
//! The thread of the window polls and never waits: pictures come from [`worker`]; opening, training and
//! exporting run in [`jobs`]. A picture carries the request that it answers. All its parts are of one frame,
//! so that nothing found on another frame is ever drawn. When nothing changes, nothing is requested and
//! nothing is painted.

mod app;
mod areas;
mod autosave;
mod bookmarks;
mod bookmarks_ui;
mod clean_up_ui;
mod command;
mod compare;
mod curves;
mod document;
#[cfg(test)]
mod document_tests;
mod drawing;
mod engine_source;
mod excluded;
mod export_dialog;
#[cfg(test)]
mod export_tests;
mod found;
mod help;
mod histogram;
mod history;
mod import_check;
mod jobs;
mod keep;
mod key_router;
mod keymap;
mod layer_colours;
mod layout;
mod legend;
mod loss_curve;
mod measure;
mod negatives;
mod obey;
mod orbit;
mod pipeline;
#[cfg(test)]
mod pipeline_tests;
mod playback;
mod preferences;
mod probe;
mod prompt_menu;
mod prompts;
mod quality;
pub mod readers;
mod remedy;
mod ruler;
mod session;
mod shown;
mod source;
mod start;
mod status;
mod suggestions;
#[cfg(test)]
mod tests;
mod theme;
mod timeline;
mod training;
mod view_mode;
mod viewport;
mod widgets;
mod worker;
mod zoom;

use app::ViewerApp;
use autosave::Autosave;
use engine_source::EngineBackend;
use preferences::Preferences;
use std::{path::PathBuf, sync::Arc};
use surgtpgs_core::{Error, Result};

/// First content of the window.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ViewerInput {
    /// A trained scene.
    Scene(PathBuf),
    /// A recording or prepared folder, to look at and to train on.
    Sequence(PathBuf),
    /// The built-in demo: its scene if `work_dir` has one, else the demo is built there in the background.
    Demo {
        /// Folder of the demo's files.
        work_dir: PathBuf,
    },
}

/// Opens the window and returns when it is closed.
pub fn run(input: ViewerInput) -> Result<()> {
    let viewport = egui::ViewportBuilder::default()
        .with_title("SurgTPGS")
        .with_app_id("surgtpgs")
        .with_inner_size([1360.0, 860.0])
        .with_min_inner_size([900.0, 600.0])
        .with_drag_and_drop(true);
    let options = eframe::NativeOptions { viewport, ..Default::default() };
    let start = move |cc: &eframe::CreationContext<'_>| {
        let preferences = Preferences::load(Preferences::user_file());
        let autosave = Autosave::open(Autosave::user_folder());
        let mut app = ViewerApp::new(&cc.egui_ctx, Arc::new(EngineBackend), preferences, autosave);
        match &input {
            ViewerInput::Scene(path) | ViewerInput::Sequence(path) => app.open_path(path, &cc.egui_ctx),
            ViewerInput::Demo { work_dir } => app.open_demo(work_dir, &cc.egui_ctx),
        }
        Ok(Box::new(app) as Box<dyn eframe::App>)
    };
    eframe::run_native("surgtpgs", options, Box::new(start)).map_err(|e| Error::Missing {
        what: format!("the window could not be opened: {e}"),
        hint: "A display and a graphics driver are needed (a software driver will do); \
               `surgtpgs --help` lists what works without."
            .into(),
    })
}
