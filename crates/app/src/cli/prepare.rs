//! `surgtpgs prepare`: features and codec in a folder beside the recording.

use super::{
    Exit,
    console::{ProgressView, say},
};
use crate::{
    args::{PrepareArgs, encoder_choice},
    jobs::{self, PrepareOptions},
};
use std::path::Path;
use surgtpgs_core::{Error, Result, codec::CodecSettings, prepare::Prepared, sequence::Sequence};

pub(super) fn run(args: &PrepareArgs) -> Result<Exit> {
    let sequence = Sequence::open(&args.sequence)?;
    refuse_occupied(&args.output, args.force)?;
    let options = PrepareOptions {
        eval: args.eval,
        encoder: encoder_choice(&args.text_encoder),
        codec: CodecSettings {
            latent_dim: args.latent_dim as usize,
            seed: args.seed,
            ..CodecSettings::default()
        },
    };
    let mut view = ProgressView::default();
    let prepared = jobs::prepare(sequence, &args.output, &options, &mut |p| view.show(p))?;
    drop(view);
    say(&format!(
        "prepared {} classes of {} frames with the text encoder \"{}\"{} in {}",
        prepared.classes.len(),
        prepared.sequence.num_frames(),
        prepared.encoder.name,
        if prepared.eval { ", test frames held out," } else { "" },
        args.output.display()
    ));
    Ok(Exit::Done)
}

/// A folder with other content, the recording above all, is never written into.
fn refuse_occupied(folder: &Path, force: bool) -> Result<()> {
    let is_empty = match std::fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_none(),
        Err(_) => true,
    };
    match (is_empty, Prepared::is_prepared(folder)) {
        (true, _) => Ok(()),
        (false, true) if force => jobs::remove_folder(folder),
        (false, true) => Err(Error::input_at(
            folder,
            "the folder holds an earlier preparation",
            "Choose a new folder, or replace it with `--force`.",
        )),
        (false, false) => {
            Err(Error::input_at(folder, "the folder is not empty", "Choose a new or empty folder."))
        }
    }
}
