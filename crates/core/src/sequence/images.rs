//! A plain folder of pictures, or one with `images/`. `masks/` (white = tool), `depth/`, and `labels/`
//! with `labels.json` may lie beside them. The demo writes this layout too.

use super::{
    Layout,
    layout::{MaskRule, Recording},
    read,
};
use crate::Result;
use std::path::Path;

pub(super) fn open(folder: &Path) -> Result<Recording> {
    let inner = folder.join("images");
    let images = read::list(if inner.is_dir() { &inner } else { folder }, read::PICTURES)?;
    let mut recording = Recording::of_pictures(folder, Layout::Images, &images)?;
    recording.mask_rule = MaskRule::KeepBlack;
    recording.add_masks(&folder.join("masks"))?;
    recording.add_depth(&folder.join("depth"))?;
    recording.add_labels(&folder.join("labels"), &folder.join("labels.json"))?;
    Ok(recording)
}
