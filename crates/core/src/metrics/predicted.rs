//! Masks that another program made, in a folder.

use crate::{
    Error, Result,
    export::slugs,
    grid::Mask,
    sequence::{Class, NO_LABEL, Sequence, plain_words},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Where a pixel of a mask is found: grey above this.
const WHITE_ABOVE: u8 = 127;

/// Predicted masks by frame. A folder is understood if its pictures are
///
/// - `K/CLASS.png`, K counting the held-out frames from 0 as the released code does, white where found;
/// - `CLASS/FRAME.png`, white where found;
/// - `FRAME_CLASS.png`, white where found: the export `binary` of this program;
/// - `FRAME.png`, the value of a pixel being the id of its class in the recording.
///
/// FRAME is the name of the recorded frame, or ends in its number, counted from 0.
#[derive(Clone, Debug)]
pub struct PredictedMasks {
    frames: BTreeMap<usize, Vec<Prediction>>,
}

#[derive(Clone, Debug)]
enum Prediction {
    /// White where the class is.
    OfClass(u8, PathBuf),
    /// Class ids.
    Labels(PathBuf),
}

impl PredictedMasks {
    /// Looks through `folder`; pictures that fit nothing are an error, so that nothing is left out unseen.
    pub fn open(folder: &Path, sequence: &Sequence) -> Result<Self> {
        let mut frames: BTreeMap<usize, Vec<Prediction>> = BTreeMap::new();
        for path in pictures(folder)? {
            let (frame, prediction) = place(&path, folder, sequence).ok_or_else(|| {
                Error::input_at(
                    &path,
                    "it cannot be told from its name which frame and class this mask is of",
                    "Name masks FRAME_CLASS.png, CLASS/FRAME.png, FRAME.png (class ids) or K/CLASS.png (K-th held-out frame).",
                )
            })?;
            frames.entry(frame).or_default().push(prediction);
        }
        if frames.is_empty() {
            return Err(Error::input_at(
                folder,
                "there is no mask (.png) in this folder",
                "Choose another folder.",
            ));
        }
        Ok(Self { frames })
    }

    /// The frames that there are masks of.
    pub fn frames(&self) -> Vec<usize> {
        self.frames.keys().copied().collect()
    }

    /// The mask of each class on a frame; a class without a file is not found.
    pub fn masks(&self, frame: usize, classes: &[Class], size: (usize, usize)) -> Result<Vec<Mask>> {
        let mut masks = vec![Mask::filled(size.0, size.1, false); classes.len()];
        for prediction in self.frames.get(&frame).into_iter().flatten() {
            let (Prediction::OfClass(_, path) | Prediction::Labels(path)) = prediction;
            let picture = image::open(path)
                .map_err(|e| {
                    Error::input_at(path, format!("the mask cannot be read: {e}"), "Write it again.")
                })?
                .into_luma8();
            if (picture.width() as usize, picture.height() as usize) != size {
                return Err(Error::input_at(
                    path,
                    format!(
                        "the mask is {}×{}, the recording {}×{}",
                        picture.width(),
                        picture.height(),
                        size.0,
                        size.1
                    ),
                    "Bring it to the recording's size, without smoothing.",
                ));
            }
            for (class, mask) in classes.iter().zip(&mut masks) {
                let is_found = |value: &u8| match prediction {
                    Prediction::OfClass(id, _) => *id == class.id && *value > WHITE_ABOVE,
                    Prediction::Labels(_) => *value == class.id && class.id != NO_LABEL,
                };
                mask.data
                    .iter_mut()
                    .zip(picture.as_raw())
                    .for_each(|(found, value)| *found |= is_found(value));
            }
        }
        Ok(masks)
    }
}

/// All pictures in a folder and the folders in it, in order.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io("read the folder of masks", folder, e);
    let (mut found, mut open) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(&next).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

/// The frame and class a picture is of.
fn place(path: &Path, root: &Path, sequence: &Sequence) -> Option<(usize, Prediction)> {
    let stem = path.file_stem()?.to_str()?;
    let parent = path.parent().filter(|p| *p != root).and_then(|p| p.file_name()).and_then(|n| n.to_str());
    let of_class = |id: u8| Prediction::OfClass(id, path.to_owned());
    let class = |name: &str| {
        let words = plain_words(name);
        sequence.classes().iter().find(|c| c.name == words).map(|c| c.id)
    };
    if let (Some(k), Some(id)) = (parent.and_then(|p| p.parse::<usize>().ok()), class(stem)) {
        let frame = (0..sequence.num_frames()).filter(|&i| Sequence::is_test_frame(i)).nth(k)?;
        return Some((frame, of_class(id)));
    }
    if let Some(id) = parent.and_then(class) {
        return Some((frame_of(stem, sequence)?, of_class(id)));
    }
    let names = slugs(sequence.classes().iter().map(|c| c.name.as_str()));
    for (class, slug) in sequence.classes().iter().zip(&names) {
        if let Some(frame) = stem.strip_suffix(&format!("_{slug}")) {
            return Some((frame_of(frame, sequence)?, of_class(class.id)));
        }
    }
    Some((frame_of(stem, sequence)?, Prediction::Labels(path.to_owned())))
}

fn frame_of(name: &str, sequence: &Sequence) -> Option<usize> {
    let by_name = (0..sequence.num_frames()).find(|&i| sequence.frame_name(i) == name);
    let digits = name.len() - name.bytes().rev().take_while(u8::is_ascii_digit).count();
    by_name.or_else(|| name[digits..].parse().ok().filter(|i| *i < sequence.num_frames()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::{self, DemoSettings};
    use image::{GrayImage, Luma};

    fn recording() -> (tempfile::TempDir, Sequence) {
        let folder = tempfile::tempdir().unwrap();
        let settings = DemoSettings { width: 32, height: 24, frames: 12, ..Default::default() };
        demo::write(&settings, folder.path(), &mut |_, _| {}).unwrap();
        let sequence = Sequence::open(folder.path()).unwrap();
        (folder, sequence)
    }

    fn save(folder: &Path, name: &str, value: u8) {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        GrayImage::from_pixel(32, 24, Luma([value])).save(path).unwrap();
    }

    #[test]
    fn every_layout_is_understood() {
        let (_kept, sequence) = recording();
        let liver = sequence.classes().iter().find(|c| c.name == "liver").unwrap();
        let name = sequence.frame_name(9);
        // Held-out frames are 1 and 9.
        for file in
            ["00001/Liver.png", &format!("liver/{name}.png"), "frame_000009_liver.png", "liver/000009.png"]
        {
            let folder = tempfile::tempdir().unwrap();
            save(folder.path(), file, 255);
            let masks = PredictedMasks::open(folder.path(), &sequence).unwrap();
            assert_eq!(masks.frames(), [9], "{file}");
            let found = masks.masks(9, sequence.classes(), (32, 24)).unwrap();
            for (class, mask) in sequence.classes().iter().zip(&found) {
                assert_eq!(mask.count() > 0, class.name == "liver", "{file}");
            }
        }
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &format!("{name}.png"), liver.id);
        let masks = PredictedMasks::open(folder.path(), &sequence).unwrap();
        assert_eq!(masks.masks(9, std::slice::from_ref(liver), (32, 24)).unwrap()[0].count(), 32 * 24);
        assert_eq!(masks.masks(3, std::slice::from_ref(liver), (32, 24)).unwrap()[0].count(), 0);
    }

    #[test]
    fn what_fits_nothing_is_refused() {
        let (_kept, sequence) = recording();
        let refused = |name: &str| {
            let folder = tempfile::tempdir().unwrap();
            save(folder.path(), name, 255);
            PredictedMasks::open(folder.path(), &sequence).unwrap_err().to_string()
        };
        assert!(refused("something.png").contains("something"));
        assert!(refused("frame_000099.png").contains("which frame"));
        assert!(refused("00007/liver.png").contains("which frame"));
        assert!(refused("notes.txt.png").contains("notes"));
        let empty = tempfile::tempdir().unwrap();
        assert!(PredictedMasks::open(empty.path(), &sequence).unwrap_err().to_string().contains("no mask"));
        let small = tempfile::tempdir().unwrap();
        save(small.path(), "frame_000001_liver.png", 255);
        let masks = PredictedMasks::open(small.path(), &sequence).unwrap();
        assert!(masks.masks(1, sequence.classes(), (16, 24)).unwrap_err().to_string().contains("32×24"));
    }
}
