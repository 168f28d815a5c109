//! The layout that the authors of SurgTPGS use for CholecSeg8K and EndoVis18: `images/`, `masks/` (white =
//! kept), `disps/*.npy` from a monocular network or `depth_mu/*.png`, and `test_seg/K/CLASS.png` with one
//! mask per class for the K-th held-out frame. The camera stands still.

use crate::{
    Error, Result,
    camera::Camera,
    sequence::{
        classes::{self, Class, ClassEntry},
        depth::{DepthKind, DepthRule},
        labels::LabelFiles,
        read,
        recording::{CameraSource, MaskRule, Recording, is_test_frame},
    },
};
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

/// Focal length of every such recording, in pixels (whatever its size).
const FOCAL: f32 = 1_087.412_8;
/// Depth = focal length · baseline / disparity, in the scene's units.
pub(crate) const BASELINE: f64 = 1.087_703_9;

/// Returns `true` if `folder` has the marks of this layout.
pub(super) fn matches(folder: &Path) -> Result<bool> {
    Ok(read::holds(&folder.join("images"), read::PICTURES)
        && (["disps", "depth_mu", "test_seg"].iter().any(|name| folder.join(name).is_dir())))
}

pub(super) fn open(folder: &Path) -> Result<Recording> {
    let images = super::frames_in(&folder.join("images"))?;
    let mut recording = Recording::of_pictures(folder, &images)?;
    let (width, height) = (recording.width as u32, recording.height as u32);
    let camera = Camera { fx: FOCAL, fy: FOCAL, ..Camera::with_field_of_view(width, height, 60.0) };
    recording.cameras.fill(camera);
    recording.camera_source = CameraSource::Given;
    recording.mask_rule = MaskRule::KeepWhite;
    recording.add_masks(&folder.join("masks"))?;
    let disparities = folder.join("disps");
    if read::holds(&disparities, &["npy"]) {
        recording.add_depth(&disparities)?;
        recording.depth_rule = DepthRule { kind: DepthKind::Disparity, scale: f64::from(FOCAL) * BASELINE };
    } else {
        recording.add_depth(&folder.join("depth_mu"))?;
    }
    if folder.join("test_seg").is_dir() {
        add_test_masks(&mut recording, &folder.join("test_seg"))?;
    }
    Ok(recording)
}

/// Adds the labels of held-out frames from one mask per class.
fn add_test_masks(recording: &mut Recording, folder: &Path) -> Result<()> {
    let test_frames: Vec<_> = (0..recording.frames.len()).filter(|&i| is_test_frame(i)).collect();
    let per_frame: Vec<Vec<PathBuf>> = test_frames
        .iter()
        .enumerate()
        .map(|(k, _)| folder.join(format!("{k:05}")))
        .map(|inner| if inner.is_dir() { read::list(&inner, &["png"]) } else { Ok(Vec::new()) })
        .collect::<Result<_>>()?;
    recording.classes = class_list(&per_frame, folder)?;
    let id = |path: &Path| {
        let name = classes::plain_words(&read::stem(path));
        recording.classes.iter().find(|c: &&Class| c.name == name).map(|c| c.id)
    };
    for (&i, files) in test_frames.iter().zip(per_frame).filter(|(_, files)| !files.is_empty()) {
        let masks = files.into_iter().filter_map(|path| id(&path).map(|id| (id, path)));
        recording.frames[i].labels = Some(LabelFiles::PerClass(masks.collect()));
    }
    Ok(())
}

/// Returns every class that has a mask in some frame, by name.
fn class_list(per_frame: &[Vec<PathBuf>], folder: &Path) -> Result<Vec<Class>> {
    let names: BTreeSet<String> =
        per_frame.iter().flatten().map(|path| classes::plain_words(&read::stem(path))).collect();
    if names.len() > 255 {
        return Err(Error::input_at(
            folder,
            format!("there are masks of {} classes", names.len()),
            "At most 255.",
        ));
    }
    let entry = |(i, name)| ClassEntry { id: i as u8, name, colour: None };
    classes::from_entries(&names.into_iter().enumerate().map(entry).collect::<Vec<_>>(), folder)
}
