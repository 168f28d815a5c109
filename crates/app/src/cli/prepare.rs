//! `surgtpgs prepare`: features and codec in a folder beside the recording.

use super::{
    Exit,
    console::{self, ProgressView, say},
};
use crate::{
    args::{PrepareArgs, encoder_choice},
    jobs::{self, FeatureSource, PrepareOptions},
    memory::{Work, require_for},
    outputs,
};
use surgtpgs_core::{
    Result,
    codec::CodecSettings,
    prepare::{Prepared, write_langsplat},
    sequence::Sequence,
};

pub(super) fn run(args: &PrepareArgs) -> Result<Exit> {
    let sequence = Sequence::open(&args.sequence)?;
    require_for(&Work::Reading(&sequence))?;
    if Prepared::is_unfinished(&args.output) {
        say("going on with an unfinished preparation");
    }
    console::watch_interrupts();
    let options = PrepareOptions {
        source: source(args),
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
    let inputs = options.inputs().with_recording(&sequence).with("the prepared folder", &args.output);
    let langsplat = args.langsplat.as_ref();
    let langsplat = langsplat
        .map(|folder| outputs::folder(folder, outputs::LANGSPLAT, &inputs, args.force))
        .transpose()?;
    let prepared = jobs::prepare_folder(sequence, &args.output, &options, args.force, &mut |p| view.show(p))?;
    if let Some(output) = langsplat {
        write_langsplat(&prepared, output.path(), &mut |p| view.show(p))?;
        output.finish()?;
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

/// Returns the source of features; the command line allows no other combination.
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
