//! A plain folder of pictures, or one with `images/`. `masks/` (white = tool), `depth/`, and `labels/`
//! with `labels.json` may lie beside them. The demo writes this layout too.

use crate::{
    Result,
    sequence::{
        read,
        recording::{MaskRule, Recording},
        video,
    },
};
use std::path::Path;

/// Returns `true` if `folder` holds pictures, here or in `images/`.
pub(super) fn matches(folder: &Path) -> Result<bool> {
    Ok(read::holds(&folder.join("images"), read::PICTURES) || read::holds(folder, read::PICTURES))
}

pub(super) fn open(folder: &Path) -> Result<Recording> {
    let inner = folder.join("images");
    let is_inside = read::holds(&inner, read::PICTURES);
    let images = super::frames_in(if is_inside { &inner } else { folder })?;
    let mut recording = Recording::of_pictures(folder, &images)?;
    if !is_inside && let Some(video) = read::list(folder, video::VIDEOS)?.first() {
        let name = read::file_name(video);
        recording.notes.push(format!("{name} and other videos here are not read: open a video by itself"));
    }
    recording.mask_rule = MaskRule::KeepBlack;
    recording.add_masks(&folder.join("masks"))?;
    recording.add_depth(&folder.join("depth"))?;
    recording.add_labels(&folder.join("labels"), &folder.join("labels.json"))?;
    Ok(recording)
}
