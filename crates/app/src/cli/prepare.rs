//! `surgtpgs prepare`: features and codec in a folder beside the recording.

use super::{
    Exit,
    console::{self, ProgressView, say},
};
use crate::{
    args::{PrepareArgs, encoder_choice},
    jobs::{self, FeatureSource, PrepareOptions},
    memory::{Work, require_for},
};
use std::path::Path;
use surgtpgs_core::{
    Error, Result,
    codec::CodecSettings,
    files::is_free_folder,
    prepare::{Prepared, write_langsplat},
    sequence::Sequence,
};

pub(super) fn run(args: &PrepareArgs) -> Result<Exit> {
    let sequence = Sequence::open(&args.sequence)?;
    // Before anything earlier is removed.
    require_for(&Work::Reading(&sequence))?;
    let source = source(args);
    let reuses = matches!(source, FeatureSource::Masks { .. });
    refuse_occupied(&args.output, args.force, reuses)?;
    console::watch_interrupts();
    let options = PrepareOptions {
        source,
        eval: args.eval,
        encoder: encoder_choice(&args.text_encoder),
        codec: CodecSettings {
            latent_dim: args.latent_dim as usize,
            seed: args.seed,
            ..CodecSettings::default()
        },
        depth_model: args.depth_model.clone(),
    };
    let mut view = ProgressView::default();
    let prepared = jobs::prepare(sequence, &args.output, &options, &mut |p| view.show(p))?;
    if let Some(folder) = &args.langsplat {
        write_langsplat(&prepared, folder, &mut |done, all| view.count("writing .npy files", done, all))?;
    }
    drop(view);
    if let Some(depth) = prepared.sequence.estimated_depth() {
        say(&format!(
            "estimated depth; the scales of single frames differed by a factor of {:.2}",
            depth.drift
        ));
        depth.notes.iter().for_each(|note| say(note));
    }
    let what = match prepared.classes.len() {
        0 => format!("{} regions", prepared.num_rows()),
        classes => format!("{classes} classes"),
    };
    say(&format!(
        "prepared {what} of {} frames with the text encoder \"{}\"{} in {}",
        prepared.sequence.num_frames(),
        prepared.encoder.name,
        if prepared.eval { ", test frames held out," } else { "" },
        args.output.display()
    ));
    Ok(Exit::Done)
}

/// Where features come from; the command line allows no other combination.
fn source(args: &PrepareArgs) -> FeatureSource {
    let level = args.mask_level.into();
    if let Some(network) = &args.dense_encoder {
        return FeatureSource::Dense { network: network.clone() };
    }
    match (&args.masks_model, &args.image_encoder, &args.features) {
        (_, _, Some(folder)) => FeatureSource::LangSplat { folder: folder.clone(), level },
        (Some(model), Some(image_encoder), _) => FeatureSource::Masks {
            model: model.clone(),
            image_encoder: image_encoder.clone(),
            settings: args.mask_density.into(),
            level,
        },
        _ => FeatureSource::Labels,
    }
}

/// A folder with other content, the recording above all, is never written into. One whose preparation was not finished
/// is gone on with; an earlier one is replaced if the user says so, all but its masks where they can be used again.
fn refuse_occupied(folder: &Path, force: bool, reuses: bool) -> Result<()> {
    match (is_free_folder(folder)?, Prepared::is_prepared(folder)) {
        (true, _) => Ok(()),
        (false, true) if force && reuses => Ok(()),
        (false, true) if force => jobs::remove_folder(folder),
        (false, false) if Prepared::is_unfinished(folder) => {
            say("going on with an unfinished preparation");
            Ok(())
        }
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
