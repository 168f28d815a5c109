//! Folders of what networks found in a recording before, which stay.

use crate::{
    jobs::Material,
    viewer::backend::{Models, task::TaskContext},
};
use image::RgbImage;
use std::path::{Path, PathBuf};
use surgtpgs_clip::{ImageEncoder, SegmentAnything};
use surgtpgs_core::{
    Error, Result,
    prepare::{MASKS_AND_EMBEDDINGS, MaskStore},
    segment::{BitMask, Level, MaskSettings},
    sequence::Sequence,
};

/// Level of the masks that become regions.
pub(super) const LEVEL: Level = Level::Default;

/// Returns the first of these folders that holds what these networks found in a recording. In any other one,
/// preparing with them would replace what others found.
pub(super) fn found_before(
    models: &Models,
    recording: &Path,
    folders: &[PathBuf],
    task: &TaskContext,
) -> Result<Option<PathBuf>> {
    let Material::Bare(sequence) = Material::open(recording)? else { return Ok(None) };
    let settings = MaskSettings::of_grid(models.points_per_side);
    let model = SegmentAnything::open(&models.masks)?.sha256().to_owned();
    task.check()?;
    let encoder = ImageEncoder::open(&models.images)?.sha256().to_owned();
    for folder in folders {
        let store = MaskStore { sequence: &sequence, folder, settings: &settings, model: &model };
        if holds_work(&store, &encoder, &sequence, task)? {
            return Ok(Some(folder.clone()));
        }
    }
    Ok(None)
}

/// Returns `true` if the first masks are those of the store's networks, and their embeddings, unless there
/// are none yet, those of an image encoder.
fn holds_work(store: &MaskStore<'_>, encoder: &str, sequence: &Sequence, task: &TaskContext) -> Result<bool> {
    let mut embed = |_: &RgbImage, _: &[&BitMask]| -> Result<Vec<Vec<f32>>> { Err(Error::Cancelled) };
    let embeddings = std::fs::read_dir(store.folder.join(MASKS_AND_EMBEDDINGS[1]));
    let has_embeddings = embeddings.is_ok_and(|mut files| files.next().is_some());
    for frame in 0..sequence.num_frames() {
        task.check()?;
        if store.masks(frame)?.is_none() {
            return Ok(frame > 0 && !has_embeddings);
        }
        match store.features(frame, LEVEL, encoder, &mut embed) {
            // There is nothing to embed.
            Ok(None) => {}
            Ok(Some(_)) => return Ok(true),
            Err(Error::Cancelled) => return Ok(!has_embeddings),
            Err(error) => return Err(error),
        }
    }
    Ok(true)
}
