//! Masks that another program predicted, read from a folder.

mod place;

use crate::{
    Error, Result,
    export::exported_files,
    grid::Mask,
    reading::{self, is_present, opacity, read_text},
    sequence::{Class, NO_LABEL, NumbersAre, PictureOfIds, Sequence, lightness},
};
use place::{Names, mask_format, place, place_exported};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

/// Largest number of remembered values that name no class.
const MOST_FOREIGN: usize = 8;

/// Predicted masks by frame. A folder is understood if its pictures are
///
/// - `K/CLASS.png`, K counting the held-out frames from 0 as the released code does, white where found;
/// - `CLASS/FRAME.png`, white where found;
/// - `FRAME_CLASS.png`, white where found: the export `binary` of this program;
/// - `FRAME.png`, label pictures: the value of a pixel is the id of its class in the recording, or a
///   value as in the recording's own label pictures. If a `labels.json` beside them names the ids, as in
///   the export `index` of this program, classes are found by these names.
///
/// CLASS is the name of a class, or listed words that mean one class of the recording and no other, as
/// prompts are understood.
///
/// FRAME is the name of the recorded frame, or ends in its number, counted from 0. The record of an export
/// comes before both: recorded frames may have names that are numbers counted from 1.
#[derive(Clone, Debug)]
pub struct PredictedMasks {
    sequence: Sequence,
    frames: BTreeMap<usize, Vec<Prediction>>,
    /// Meaning of the numbers of label pictures.
    numbers: NumbersAre,
    /// The recording's class of each id that a `labels.json` names, by folder.
    named: BTreeMap<PathBuf, Vec<(u8, Option<u8>)>>,
    notes: Vec<String>,
    /// Some values in the read pictures that name no class.
    foreign: BTreeSet<String>,
    /// `true` for the id of each class that the read pictures are about.
    given: [bool; 256],
}

#[derive(Clone, Debug)]
enum Prediction {
    /// A picture that is white where the class is, or opaque if some of it is transparent.
    OfClass(u8, PathBuf),
    /// A cut-out, which is opaque where the class is.
    Cutout(u8, PathBuf),
    /// A picture of class ids.
    Labels(PathBuf),
}

impl Prediction {
    /// Returns the path of the label picture, if it is one.
    fn labels(&self) -> Option<&Path> {
        match self {
            Self::Labels(path) => Some(path),
            Self::OfClass(..) | Self::Cutout(..) => None,
        }
    }
}

impl PredictedMasks {
    /// Looks through `folder`. A picture that fits no layout is an error, so that nothing is
    /// silently left out.
    pub fn open(folder: &Path, sequence: &Sequence) -> Result<Self> {
        let mut frames: BTreeMap<usize, Vec<Prediction>> = BTreeMap::new();
        let (names, exported) = (Names::of(sequence), exported_files(folder));
        for path in pictures(folder)? {
            let recorded = path.strip_prefix(folder).ok().and_then(|path| exported.get(path));
            let placed = match recorded.map(|file| (file, mask_format(file))) {
                Some((_, None)) => continue,
                Some((file, Some(format))) => place_exported(&path, file, format, &names),
                None => place(&path, folder, &names),
            };
            let (frame, prediction) = placed.ok_or_else(|| {
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
        let labels = frames.values().flatten().filter_map(Prediction::labels).collect::<Vec<_>>();
        let mut opened = Self {
            sequence: sequence.clone(),
            numbers: sequence.numbers_of(&labels),
            frames,
            named: BTreeMap::new(),
            notes: Vec::new(),
            foreign: BTreeSet::new(),
            given: [false; 256],
        };
        opened.read_names(&names)?;
        Ok(opened)
    }

    /// Returns notes for the user about how the masks read so far were understood.
    pub fn notes(&self) -> Vec<String> {
        let some: Vec<&str> = self.foreign.iter().map(String::as_str).collect();
        let foreign = format!("label pictures hold values that name no class ({})", some.join(", "));
        self.notes.iter().cloned().chain((!some.is_empty()).then_some(foreign)).collect()
    }

    /// Reads each `labels.json` beside label pictures.
    fn read_names(&mut self, known: &Names<'_>) -> Result<()> {
        let labels = self.frames.values().flatten().filter_map(Prediction::labels);
        let folders: BTreeSet<PathBuf> = labels.filter_map(Path::parent).map(Path::to_owned).collect();
        for folder in folders {
            let list = folder.join("labels.json");
            if !is_present(&list) {
                continue;
            }
            let names = names(&list)?;
            let ids: Vec<_> = names.iter().map(|(id, name)| (*id, known.class(name))).collect();
            let foreign: Vec<&str> = names
                .iter()
                .zip(&ids)
                .filter(|(_, id)| id.1.is_none())
                .map(|((_, name), _)| name.as_str())
                .collect();
            if !foreign.is_empty() {
                let what = format!("the recording has no class called {}", foreign.join(", "));
                if ids.iter().all(|(_, class)| class.is_none()) {
                    let classes: Vec<&str> =
                        self.sequence.classes().iter().map(|c| c.name.as_str()).collect();
                    let hint = format!("Its classes are {}.", classes.join(", "));
                    return Err(Error::input_at(&list, what, hint));
                }
                self.notes.push(format!("{what}: that label is left out ({})", list.display()));
            }
            self.named.insert(folder, ids);
        }
        Ok(())
    }

    /// Returns `true` if the pictures read so far have masks of a class, or name it.
    pub fn has_masks_of(&self, class: &Class) -> bool {
        self.given[usize::from(class.id)]
    }

    /// Returns the frames that have masks.
    pub fn frames(&self) -> Vec<usize> {
        self.frames.keys().copied().collect()
    }

    /// Reads the mask of each class on a frame; a class without a file counts as not found.
    pub fn masks(&mut self, frame: usize, classes: &[Class], size: (usize, usize)) -> Result<Vec<Mask>> {
        let mut masks = vec![Mask::filled(size.0, size.1, false); classes.len()];
        for prediction in self.frames.get(&frame).cloned().into_iter().flatten() {
            match prediction {
                Prediction::OfClass(id, ref path) | Prediction::Cutout(id, ref path) => {
                    self.given[usize::from(id)] = true;
                    let found = found_in(path, matches!(prediction, Prediction::Cutout(..)))?;
                    expect_size(path, (found.width, found.height), size)?;
                    let masks = classes.iter().zip(&mut masks).filter(|(class, _)| class.id == id);
                    for (_, mask) in masks {
                        mask.data.iter_mut().zip(&found.data).for_each(|(mask, found)| *mask |= found);
                    }
                }
                Prediction::Labels(path) => {
                    let ids = self.ids(&path, size)?;
                    for (class, mask) in classes.iter().zip(&mut masks).filter(|(c, _)| c.id != NO_LABEL) {
                        mask.data.iter_mut().zip(&ids).for_each(|(mask, id)| *mask |= *id == class.id);
                    }
                }
            }
        }
        Ok(masks)
    }

    /// Reads the class ids of the pixels of a label picture. A picture in which nothing names a
    /// class is refused.
    fn ids(&mut self, path: &Path, size: (usize, usize)) -> Result<Vec<u8>> {
        let names = path.parent().and_then(|folder| self.named.get(folder));
        let PictureOfIds { ids, known, strangers, examples } =
            self.sequence.picture_of_ids(path, self.numbers, names.map(Vec::as_slice))?;
        expect_size(path, (ids.width, ids.height), size)?;
        if strangers > 0 && known == 0 {
            let ids: Vec<String> = self.sequence.classes().iter().map(|c| c.id.to_string()).collect();
            return Err(Error::input_at(
                path,
                format!("no pixel of this label picture names a class; it holds {}", examples.join(", ")),
                format!(
                    "The ids of the recording's classes are {}. Write these, or a labels.json beside the pictures that names others.",
                    ids.join(", ")
                ),
            ));
        }
        let named = names.into_iter().flatten().filter_map(|(_, class)| *class);
        named.chain(ids.data.iter().copied()).for_each(|id| self.given[usize::from(id)] = true);
        if self.foreign.len() < MOST_FOREIGN {
            self.foreign.extend(examples);
        }
        Ok(ids.data)
    }
}

/// Reads a mask: where the picture is opaque, or white if all of it is opaque. A cut-out that is opaque all
/// over is found all over.
fn found_in(path: &Path, is_cutout: bool) -> Result<Mask> {
    let picture = reading::picture(path)?;
    let (values, largest) = match opacity(&picture) {
        Some(opacity) => (opacity, u16::MAX),
        None if is_cutout => {
            return Ok(Mask::filled(picture.width() as usize, picture.height() as usize, true));
        }
        None => {
            let color = picture.color();
            let is_deep = color.bytes_per_pixel() > color.channel_count();
            (lightness(path)?, if is_deep { u16::MAX } else { u16::from(u8::MAX) })
        }
    };
    let limit = white_above(&values.data, largest);
    Ok(values.map(|value| *value > limit))
}

/// Returns the limit above which a pixel of a mask counts as found: 0 in a mask of two values, else half
/// of the `largest` possible value.
fn white_above(picture: &[u16], largest: u16) -> u16 {
    let some = picture.iter().copied().find(|value| *value > 0);
    let has_two_values = picture.iter().all(|value| *value == 0 || Some(*value) == some);
    if has_two_values { 0 } else { largest / 2 }
}

fn expect_size(path: &Path, found: (usize, usize), wanted: (usize, usize)) -> Result<()> {
    if found == wanted {
        return Ok(());
    }
    Err(Error::input_at(
        path,
        format!("the mask is {}×{}, the recording {}×{}", found.0, found.1, wanted.0, wanted.1),
        "Bring it to the recording's size, without smoothing.",
    ))
}

/// Reads ids and names from a `labels.json`: that of the export `index`, or a list of classes.
fn names(path: &Path) -> Result<Vec<(u8, String)>> {
    #[derive(serde::Deserialize)]
    struct Label {
        #[serde(alias = "classid")]
        id: u8,
        #[serde(alias = "prompt")]
        name: String,
    }
    #[derive(serde::Deserialize)]
    #[serde(untagged)]
    enum File {
        Export { labels: Vec<Label> },
        Classes(Vec<Label>),
    }
    let text = read_text(path).map_err(|e| Error::io("read the names of the labels", path, e))?;
    let file = serde_json::from_str(&text).map_err(|e| {
        let what = format!("the names of the labels cannot be read: {e}");
        Error::input_at(path, what, "It is a list of entries like {\"id\": 1, \"name\": \"liver\"}.")
    })?;
    let (File::Export { labels } | File::Classes(labels)) = file;
    Ok(labels.into_iter().map(|label| (label.id, label.name)).collect())
}

/// Lists all pictures in a folder and its subfolders, in order.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::{self, DemoSettings};
    use crate::export::{Export, Format, PROVENANCE_FILE, tests::plain_provenance};
    use crate::grid::Grid;
    use crate::progress::unobserved;
    use image::{GrayImage, Luma};

    fn recording() -> (tempfile::TempDir, Sequence) {
        let folder = tempfile::tempdir().unwrap();
        let settings = DemoSettings::of_size(32, 24, 12);
        demo::write(&settings, folder.path(), &mut unobserved).unwrap();
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
            let mut masks = PredictedMasks::open(folder.path(), &sequence).unwrap();
            assert_eq!(masks.frames(), [9], "{file}");
            let found = masks.masks(9, sequence.classes(), (32, 24)).unwrap();
            for (class, mask) in sequence.classes().iter().zip(&found) {
                assert_eq!(mask.count() > 0, class.name == "liver", "{file}");
            }
        }
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &format!("{name}.png"), liver.id);
        let mut masks = PredictedMasks::open(folder.path(), &sequence).unwrap();
        assert_eq!(masks.masks(9, std::slice::from_ref(liver), (32, 24)).unwrap()[0].count(), 32 * 24);
        assert_eq!(masks.masks(3, std::slice::from_ref(liver), (32, 24)).unwrap()[0].count(), 0);
    }

    #[test]
    fn classes_without_masks_are_known() {
        let (_kept, sequence) = recording();
        let class = |name: &str| sequence.classes().iter().find(|c| c.name == name).unwrap();
        let has = |folder: &Path| {
            let mut masks = PredictedMasks::open(folder, &sequence).unwrap();
            masks.masks(9, sequence.classes(), (32, 24)).unwrap();
            ["liver", "grasper"].map(|name| masks.has_masks_of(class(name)))
        };
        let folder = tempfile::tempdir().unwrap();
        // An empty mask says that the class is not there.
        save(folder.path(), "frame_000009_liver.png", 0);
        assert_eq!(has(folder.path()), [true, false]);
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), "frame_000009.png", class("liver").id);
        assert_eq!(has(folder.path()), [true, false]);
        let list =
            [class("liver"), class("grasper")].map(|c| format!(r#"{{"id":{},"name":"{}"}}"#, c.id, c.name));
        std::fs::write(folder.path().join("labels.json"), format!("[{}]", list.join(","))).unwrap();
        assert_eq!(has(folder.path()), [true, true]);
    }

    #[test]
    fn white_is_what_is_not_nothing_or_the_brighter_half() {
        let two_values = [&[0, 1, 1][..], &[0, 38], &[255], &[0, 9000]];
        assert_eq!(two_values.map(|picture| white_above(picture, 255)), [0; 4]);
        assert_eq!((white_above(&[0, 1, 200], 255), white_above(&[3, 50, 90], 65535)), (127, 32767));
    }

    #[test]
    fn faint_scores_of_16_bits_are_no_mask() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("faint.png");
        image::ImageBuffer::<Luma<u16>, _>::from_fn(8, 8, |x, y| Luma([30 * (x + y) as u16]))
            .save(&path)
            .unwrap();
        assert_eq!(found_in(&path, false).unwrap().count(), 0);
    }

    #[test]
    fn a_cut_out_of_everything_is_found_everywhere() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("all.png");
        image::RgbaImage::from_fn(8, 8, |x, y| image::Rgba([(x * y) as u8, 9, 9, 255])).save(&path).unwrap();
        assert_eq!(found_in(&path, true).unwrap().count(), 64);
        assert_eq!(found_in(&path, false).unwrap().count(), 0, "a dark picture is no mask");
    }

    #[test]
    fn masks_of_ones_are_white() {
        let (_kept, sequence) = recording();
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), "frame_000009_liver.png", 1);
        let mut masks = PredictedMasks::open(folder.path(), &sequence).unwrap();
        let found = masks.masks(9, sequence.classes(), (32, 24)).unwrap();
        assert_eq!(found.iter().map(Mask::count).sum::<usize>(), 32 * 24);
    }

    #[test]
    fn the_recordings_own_labels_are_met_exactly() {
        let (kept, sequence) = recording();
        let mut masks = PredictedMasks::open(&kept.path().join("labels"), &sequence).unwrap();
        for frame in masks.frames() {
            let found = masks.masks(frame, sequence.classes(), (32, 24)).unwrap();
            let labels = sequence.labels(frame).unwrap().unwrap();
            for (class, mask) in sequence.classes().iter().zip(&found) {
                assert!(mask.data.iter().zip(&labels.data).all(|(m, id)| *m == (*id == class.id)));
            }
        }
        assert!(!masks.frames().is_empty() && masks.notes().is_empty());
    }

    #[test]
    fn ids_are_those_of_the_names_beside_them() {
        let (_kept, sequence) = recording();
        let liver = sequence.classes().iter().find(|c| c.name == "liver").unwrap();
        let folder = tempfile::tempdir().unwrap();
        let other = sequence.classes().iter().map(|c| c.id).max().unwrap() + 50;
        save(folder.path(), "frame_000009.png", other);
        let open = || PredictedMasks::open(folder.path(), &sequence);
        let liver_px = |masks: &mut PredictedMasks| {
            masks.masks(9, std::slice::from_ref(liver), (32, 24)).map(|found| found[0].count())
        };
        let what = liver_px(&mut open().unwrap()).unwrap_err().to_string();
        assert!(what.contains(&format!("it holds {other}")) && what.contains("labels.json"), "{what}");
        let list = |text: String| std::fs::write(folder.path().join("labels.json"), text).unwrap();
        list(format!(
            r#"{{"background":0,"labels":[{{"id":{other},"prompt":"Liver","colour":[1,2,3]}},{{"id":2,"prompt":"moon"}}]}}"#
        ));
        let mut masks = open().unwrap();
        assert_eq!(liver_px(&mut masks).unwrap(), 32 * 24);
        assert!(masks.notes()[0].contains("no class called moon"));
        list(format!(r#"[{{"id":{other},"name":"LIVER"}}]"#));
        assert_eq!(liver_px(&mut open().unwrap()).unwrap(), 32 * 24);
        list(format!(r#"[{{"id":{other},"name":"moon"}}]"#));
        assert!(open().unwrap_err().to_string().contains("no class called moon"));
        // 0 stands for nothing if the names do not contain it.
        list(format!(r#"[{{"id":{other},"name":"liver"}}]"#));
        save(folder.path(), "frame_000009.png", 0);
        assert_eq!(liver_px(&mut open().unwrap()).unwrap(), 0);
    }

    #[test]
    fn cut_outs_are_found_where_they_are_opaque() {
        let (_kept, sequence) = recording();
        let folder = tempfile::tempdir().unwrap();
        let mut how = plain_provenance();
        how.options.formats = vec![Format::Cutout];
        let found = |x: usize| x < 20;
        let scores =
            Grid::from_vec(32, 24, (0..32 * 24).map(|i| if found(i % 32) { 0.9 } else { 0.1 }).collect());
        let scores = vec![scores; how.prompts.len()];
        // Dark and bright tissue, and black.
        let picture = image::RgbImage::from_fn(32, 24, |x, _| image::Rgb([8 * x as u8; 3]));
        let mut export = Export::begin(folder.path(), vec![9], how).unwrap();
        export.write(&picture, &scores, None).unwrap();
        export.finish().unwrap();
        let liver = sequence.classes().iter().find(|c| c.name == "liver").unwrap();
        let mut masks = PredictedMasks::open(&folder.path().join("cutout"), &sequence).unwrap();
        let mask = masks.masks(9, std::slice::from_ref(liver), (32, 24)).unwrap().swap_remove(0);
        assert!((0..32 * 24).all(|i| mask.data[i] == found(i % 32)));
    }

    #[test]
    fn other_words_for_a_class_are_understood() {
        let (_kept, sequence) = recording();
        let px_of = |folder: &Path, name: &str| {
            let class = sequence.classes().iter().find(|c| c.name == name).unwrap();
            let mut masks = PredictedMasks::open(folder, &sequence).unwrap();
            assert_eq!(masks.notes(), Vec::<String>::new());
            masks.masks(9, std::slice::from_ref(class), (32, 24)).unwrap()[0].count()
        };
        // Both as exports name them whose prompt is "grasping forceps".
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), "binary/frame_000009_grasping-forceps.png", 255);
        assert_eq!((px_of(folder.path(), "grasper"), px_of(folder.path(), "liver")), (32 * 24, 0));
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), "index/frame_000009.png", 1);
        let list = r#"{"background":0,"labels":[{"id":1,"prompt":"grasping forceps","colour":[1,2,3]}]}"#;
        std::fs::write(folder.path().join("index/labels.json"), list).unwrap();
        assert_eq!((px_of(folder.path(), "grasper"), px_of(folder.path(), "liver")), (32 * 24, 0));
    }

    #[test]
    fn exports_are_of_the_frames_that_their_record_says() {
        let (kept, _) = recording();
        // Recorded frames are numbered from 1, as ffmpeg does.
        let labels = kept.path().join("labels");
        for kind in ["images", "masks", "labels", "depth"].map(|kind| kept.path().join(kind)) {
            for frame in (0..12).rev() {
                let name = |number: usize| kind.join(format!("frame_{number:06}.png"));
                std::fs::rename(name(frame), name(frame + 1)).unwrap();
            }
        }
        let sequence = Sequence::open(kept.path()).unwrap();
        assert_eq!(sequence.frame_name(8), "frame_000009");
        let folder = tempfile::tempdir().unwrap();
        let mut how = plain_provenance();
        how.options.formats = vec![Format::Binary, Format::Index, Format::Overlay, Format::Score];
        let scores = vec![Grid::filled(32, 24, 0.9); how.prompts.len()];
        let mut export = Export::begin(folder.path(), vec![9], how).unwrap();
        export.write(&image::RgbImage::new(32, 24), &scores, None).unwrap();
        export.finish().unwrap();
        let frames = |folder: &Path| PredictedMasks::open(folder, &sequence).unwrap().frames();
        for inside in ["", "binary", "index"] {
            assert_eq!(frames(&folder.path().join(inside)), [9], "{inside}");
        }
        let overlays = PredictedMasks::open(&folder.path().join("overlay"), &sequence).unwrap_err();
        assert!(overlays.to_string().contains("no mask"), "{overlays}");
        assert_eq!(frames(&labels).len(), 12);
        // Without a record, recorded names count.
        std::fs::remove_file(folder.path().join(PROVENANCE_FILE)).unwrap();
        assert_eq!(frames(folder.path()), [8]);
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
        let mut masks = PredictedMasks::open(small.path(), &sequence).unwrap();
        assert!(masks.masks(1, sequence.classes(), (16, 24)).unwrap_err().to_string().contains("32×24"));
    }
}
