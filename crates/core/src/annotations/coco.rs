//! COCO annotations: each says that the pixels of its mask belong to its category.

use super::{
    Annotation, Canvas, RunsEntry, Shape,
    images::{Clue, Place, places},
    names::{FrameNames, last_part, stem},
};
use crate::{Error, Result};
use serde::de::IgnoredAny;
use std::{collections::BTreeMap, sync::Arc};

#[derive(serde::Deserialize)]
struct Coco {
    categories: Vec<Category>,
    images: Vec<Image>,
    annotations: Vec<Entry>,
}

#[derive(serde::Deserialize)]
struct Category {
    id: u64,
    name: String,
}

#[derive(serde::Deserialize)]
struct Image {
    id: u64,
    /// Number of the frame; our own files have it.
    frame: Option<usize>,
    /// Name of the recorded frame; our own files have it.
    source: Option<String>,
    file_name: Option<String>,
    width: Option<f64>,
    height: Option<f64>,
}

#[derive(serde::Deserialize)]
struct Entry {
    image_id: u64,
    category_id: Option<u64>,
    segmentation: Option<Segmentation>,
}

#[derive(serde::Deserialize)]
#[serde(untagged)]
enum Segmentation {
    Runs(RunsEntry),
    Polygons(Vec<Vec<f32>>),
    Other(IgnoredAny),
}

/// Flaw of an annotation, and advice on it.
type Flaw = (&'static str, &'static str);

const NO_CATEGORY: Flaw =
    ("it has no category", "Its \"category_id\" has to be the id of one of the categories.");
const NO_IMAGE: Flaw = ("it has no image", "Its \"image_id\" has to be the id of one of the images.");
const NO_FRAME: Flaw = (
    "its image is no frame of the recording",
    "Frames are found by \"source\" as in the recording, by \"frame\", or by \"file_name\".",
);
const NO_SEGMENTATION: Flaw =
    ("it has no segmentation", "A box alone is not read: turn it into a polygon, or leave it out.");
const NO_SHAPE: Flaw = (
    "its segmentation is neither polygons nor run lengths",
    "Polygons are a list of lists: [[x, y, x, y, x, y], ...].",
);
const ODD_POLYGON: Flaw = (
    "its segmentation has a polygon with an odd number of coordinates",
    "A polygon has two for each corner: [x, y, x, y, x, y].",
);
const WRONG_RUNS: Flaw = (
    "the run lengths of its segmentation do not come to its size",
    "The size is [height, width], and runs go down the columns.",
);

impl Image {
    /// Everything by which its frame is found.
    fn named(&self) -> (Option<usize>, Option<&str>, Option<&str>) {
        (self.frame, self.source.as_deref(), self.file_name.as_deref())
    }

    /// Returns what tells its frame. The names of files count exported frames in our own.
    fn clue(&self, frames: &FrameNames<'_>) -> Clue<'_> {
        let (number, source, file) = self.named();
        let own = number.map(|number| format!("frame_{number:06}"));
        match (source, file) {
            (Some(source), file) => Clue::of(source, &[source], number, frames).in_file(file),
            (None, Some(file)) if own.as_deref() == Some(stem(last_part(file))) => {
                Clue::called(file).numbered(number)
            }
            (None, Some(file)) => Clue::of_file(file, &[file], number, frames),
            (None, None) => Clue::NONE.numbered(number),
        }
    }
}

/// Returns the annotations of a COCO file.
pub(super) fn read(text: &[u8], canvas: &Canvas) -> Result<Vec<Annotation>> {
    let malformed = |e| Error::input(format!("this is no file of COCO annotations: {e}"), "");
    let file: Coco = serde_json::from_slice(text).map_err(malformed)?;
    let names = by_id(file.categories.iter().map(|c| (c.id, c.name.as_str())), "categories")?;
    by_id(file.images.iter().map(|image| (image.id, image.named())), "images")?;
    let places = places_by_id(&file.images, canvas)?;
    let mut found = Vec::new();
    for (i, entry) in file.annotations.iter().enumerate() {
        let wrong =
            |(what, hint): Flaw| Error::input(format!("annotations[{i}] cannot be used: {what}"), hint);
        let frame = match places.get(&entry.image_id) {
            Some(Place::Frame(frame)) => *frame,
            Some(Place::LeftOut) => continue,
            Some(Place::Unknown) => return Err(wrong(NO_FRAME)),
            None => return Err(wrong(NO_IMAGE)),
        };
        let name = entry.category_id.and_then(|id| names.get(&id)).ok_or_else(|| wrong(NO_CATEGORY))?;
        for shape in shapes(entry.segmentation.as_ref()).map_err(wrong)? {
            found.push(Annotation { frame, name: (*name).to_owned(), shape });
        }
    }
    Ok(found)
}

/// Returns entries by their ids. Those of the same id have to be the same: two files that were put together
/// have them twice.
fn by_id<T: PartialEq>(entries: impl Iterator<Item = (u64, T)>, kind: &str) -> Result<BTreeMap<u64, T>> {
    let mut known = BTreeMap::new();
    for (id, entry) in entries {
        if known.get(&id).is_some_and(|other| *other != entry) {
            let what = format!("two {kind} have the id {id}");
            return Err(Error::input(what, "Give every one its own, or read the files one after the other."));
        }
        known.insert(id, entry);
    }
    Ok(known)
}

/// Returns the place of every image, by its id.
fn places_by_id(images: &[Image], canvas: &Canvas) -> Result<BTreeMap<u64, Place>> {
    let frames = FrameNames::of(canvas);
    let clues: Vec<Clue<'_>> = images.iter().map(|image| image.clue(&frames)).collect();
    let places = places(&clues, canvas)?;
    for (image, place) in images.iter().zip(&places) {
        if let (Place::Frame(_), Some(width), Some(height)) = (place, image.width, image.height) {
            canvas.expect_size(width as usize, height as usize)?;
        }
    }
    Ok(images.iter().map(|image| image.id).zip(places).collect())
}

fn shapes(segmentation: Option<&Segmentation>) -> Result<Vec<Shape>, Flaw> {
    match segmentation {
        Some(Segmentation::Runs(entry)) => Ok(vec![Shape::Mask(Arc::new(entry.runs().ok_or(WRONG_RUNS)?))]),
        Some(Segmentation::Polygons(polygons)) if !polygons.is_empty() => {
            polygons.iter().map(|flat| polygon(flat).ok_or(ODD_POLYGON)).collect()
        }
        Some(Segmentation::Other(IgnoredAny)) => Err(NO_SHAPE),
        Some(Segmentation::Polygons(_)) | None => Err(NO_SEGMENTATION),
    }
}

fn polygon(flat: &[f32]) -> Option<Shape> {
    let (points, rest) = flat.as_chunks::<2>();
    rest.is_empty().then(|| Shape::Polygon { points_px: points.to_vec() })
}
