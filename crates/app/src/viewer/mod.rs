//! The viewer's window.
//!
//! ```text
//! keys ─▶ command ─┐            ┌─▶ picture: request ─▶ worker ─▶ pipeline ─▶ backend (engine)
//!                  ├─▶ shared ──┤                        │
//! panels ─▶ action ┘   ▲  │     └◀──── picture, newest only
//!    ▲                 │  └─▶ work: opening, training, saving ─▶ backend (tasks)
//!    └── shell ────────┘
//! ```
//!
//! Arrows go one way, from top to bottom of this list; every room uses only those below it:
//!
//! | room | is |
//! |---|---|
//! | `shell` | joins everything, once per frame: news and keys, panels, their actions, the next request |
//! | `panels` | one file each: reads [`shared`], pushes actions, holds half-typed text at most |
//! | `action` | everything that a panel can ask for |
//! | `command` | everything that menus and keys can ask for: a row with words, keys, condition and act |
//! | `work` | what happens over time: opening, requesting pictures, training, saving |
//! | `shared` | the state of the window |
//! | `picture` | from a request to textures |
//! | `state` | decisions of the user, clock, preferences, and their files |
//! | `backend` | the seam to the engine, and tasks on threads of their own |
//!
//! The thread of the window polls and never waits: pictures come from a worker thread; opening, training and
//! exporting are tasks. A picture carries the request that it answers. All its parts are of one frame, so
//! that nothing found on another frame is ever drawn. When nothing changes, nothing is requested and nothing
//! is painted.

mod action;
mod backend;
mod command;
mod panels;
mod picture;
#[cfg(feature = "fuzz")]
pub mod readers;
mod remedy;
mod shared;
mod shell;
mod state;
#[cfg(test)]
mod tests;
mod text;
mod theme;
mod work;

use backend::engine::EngineBackend;
use shell::Shell;
use state::{autosave::Autosave, preferences::Preferences};
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
        let mut shell = Shell::new(&cc.egui_ctx, Arc::new(EngineBackend), preferences, autosave);
        let shared = &mut shell.shared;
        match &input {
            ViewerInput::Scene(path) | ViewerInput::Sequence(path) => shared.open_path(path, &cc.egui_ctx),
            ViewerInput::Demo { work_dir } => shared.open_demo(work_dir, &cc.egui_ctx),
        }
        Ok(Box::new(shell) as Box<dyn eframe::App>)
    };
    eframe::run_native("surgtpgs", options, Box::new(start)).map_err(|e| Error::Missing {
        what: format!("the window could not be opened: {e}"),
        hint: "A display and a graphics driver are needed (a software driver will do); \
               `surgtpgs --help` lists what works without."
            .into(),
    })
}
