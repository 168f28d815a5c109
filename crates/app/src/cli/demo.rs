//! `surgtpgs demo`: the built-in recording as an ordinary sequence folder.

use super::{
    Exit,
    console::{ProgressView, say},
};
use crate::{
    args::DemoArgs,
    jobs,
    memory::{Work, require_for},
};
use surgtpgs_core::{Result, demo::DemoSettings};

pub(super) fn run(args: &DemoArgs) -> Result<Exit> {
    require_for(&Work::Recording(args.width, args.height))?;
    let settings = DemoSettings {
        width: args.width as usize,
        height: args.height as usize,
        frames: args.frames as usize,
        moving_camera: args.moving_camera,
        seed: args.seed,
    };
    let mut view = ProgressView::default();
    jobs::record_demo(&settings, &args.output, args.force, &mut |p| view.show(p))?;
    drop(view);
    say(&format!("wrote {} frames to {}", args.frames, args.output.display()));
    Ok(Exit::Done)
}
