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
//! The thread of the window polls and does not wait, but for a moment for the answer to a letter: pictures
//! come from a worker thread; opening, training and exporting are tasks. A picture carries the request that
//! it answers. All its parts are of one frame, so that nothing found on another frame is ever drawn. When
//! nothing changes, nothing is requested and nothing is painted.

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
pub(crate) use picture::timed::time_pictures;
use picture::{meshes, texture};
use shell::Shell;
pub use shell::ViewerInput;
use state::{autosave::Autosave, preferences::Preferences};
use std::{path::PathBuf, sync::Arc};
use surgtpgs_core::{Error, Result};

/// Size of the first window, points.
const FIRST_SIZE: [f32; 2] = [1280.0, 800.0];

/// Opens the window and returns when it is closed. `demo_folder` is for the files of the built-in demo.
pub fn run(input: ViewerInput, demo_folder: Option<PathBuf>) -> Result<()> {
    let preferences = Preferences::load(Preferences::user_file());
    let viewport = egui::ViewportBuilder::default()
        .with_title("SurgTPGS")
        .with_app_id("surgtpgs")
        .with_inner_size(preferences.window_size.unwrap_or(FIRST_SIZE))
        .with_clamp_size_to_monitor_size(true)
        .with_min_inner_size([900.0, 600.0])
        .with_drag_and_drop(true);
    let options = eframe::NativeOptions { viewport, ..Default::default() };
    let start = move |cc: &eframe::CreationContext<'_>| {
        if let Some(state) = &cc.wgpu_render_state {
            texture::install(state);
            meshes::install(state, &cc.egui_ctx);
        }
        let autosave = Autosave::open(Autosave::user_folder());
        let mut shell = Shell::new(&cc.egui_ctx, Arc::<EngineBackend>::default(), preferences, autosave);
        shell.shared.opening.demo_folder.clone_from(&demo_folder);
        shell.begin(&input, &cc.egui_ctx);
        Ok(Box::new(shell) as Box<dyn eframe::App>)
    };
    eframe::run_native("surgtpgs", options, Box::new(start)).map_err(|e| Error::Missing {
        what: format!("the window could not be opened: {e}"),
        hint: "A display and a graphics driver are needed (a software driver will do); \
               `surgtpgs --help` lists what works without."
            .into(),
    })
}
