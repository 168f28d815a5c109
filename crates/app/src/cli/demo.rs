//! `surgtpgs demo`: the built-in recording as an ordinary sequence folder.

use super::{
    Exit,
    console::{ProgressView, say},
};
use crate::args::DemoArgs;
use surgtpgs_core::{
    Error, Result,
    demo::{self, DemoSettings},
};

pub(super) fn run(args: &DemoArgs) -> Result<Exit> {
    let is_empty = std::fs::read_dir(&args.output).map_or(true, |mut entries| entries.next().is_none());
    if !is_empty {
        return Err(Error::input_at(
            &args.output,
            "the folder is not empty",
            "Choose a new or empty folder.",
        ));
    }
    let settings = DemoSettings {
        width: args.width as usize,
        height: args.height as usize,
        frames: args.frames as usize,
        moving_camera: args.moving_camera,
        seed: args.seed,
    };
    let mut view = ProgressView::default();
    demo::write(&settings, &args.output, &mut |done, total| view.count("recording the demo", done, total))?;
    drop(view);
    say(&format!("wrote {} frames to {}", args.frames, args.output.display()));
    Ok(Exit::Done)
}
