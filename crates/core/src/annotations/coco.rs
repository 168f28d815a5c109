//! COCO annotations: each says that the pixels of its mask belong to its category.

use super::{Annotation, Canvas, Images, RunsEntry, Shape};
use crate::{Error, Result};
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

/// The place of an image in the recording.
#[derive(Clone, Copy)]
enum Place {
    Frame(usize),
    /// The recording has other frames of the same file, but not this one.
    LeftOut,
    Unknown,
}

#[derive(serde::Deserialize)]
struct Entry {
    image_id: u64,
    category_id: u64,
    #[serde(default)]
    segmentation: Segmentation,
}

#[derive(Default, serde::Deserialize)]
#[serde(untagged)]
enum Segmentation {
    Runs(RunsEntry),
    Polygons(Vec<Vec<f32>>),
    #[default]
    Other,
}

impl Image {
    /// Everything by which its frame is found.
    fn named(&self) -> (Option<usize>, Option<&str>, Option<&str>) {
        (self.frame, self.source.as_deref(), self.file_name.as_deref())
    }
}

/// Returns the annotations of a COCO file.
pub(super) fn read(text: &[u8], canvas: &Canvas) -> Result<Vec<Annotation>> {
    let malformed = |e| Error::input(format!("this is no file of COCO annotations: {e}"), "");
    let file: Coco = serde_json::from_slice(text).map_err(malformed)?;
    let names = by_id(file.categories.iter().map(|c| (c.id, c.name.as_str())), "categories")?;
    by_id(file.images.iter().map(|image| (image.id, image.named())), "images")?;
    let places = places(&file.images, canvas)?;
    let mut found = Vec::new();
    for (i, entry) in file.annotations.iter().enumerate() {
        let wrong = |what: &str| {
            let hint =
                "Frames are found by \"source\" as in the recording, by \"frame\", or by \"file_name\".";
            Error::input(format!("annotations[{i}] cannot be used: {what}"), hint)
        };
        let name = names.get(&entry.category_id).ok_or_else(|| wrong("it has no category"))?;
        let frame = match places.get(&entry.image_id) {
            Some(Place::Frame(frame)) => *frame,
            Some(Place::LeftOut) => continue,
            Some(Place::Unknown) | None => return Err(wrong("its image is no frame of the recording")),
        };
        for shape in shapes(&entry.segmentation).ok_or_else(|| wrong("its segmentation is none"))? {
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

/// Returns the place of every image, by its id. Names of recorded frames come first: their numbers change
/// with the first frame that is used.
fn places(images: &[Image], canvas: &Canvas) -> Result<BTreeMap<u64, Place>> {
    let named = |name: &Option<String>| canvas.frame_named(name.as_deref()?);
    let by_source: Vec<Option<usize>> = images.iter().map(|image| named(&image.source)).collect();
    let are_of_recording = by_source.iter().any(Option::is_some);
    let mut known = Images::default();
    let place = |(image, by_source): (&Image, Option<usize>)| {
        if by_source.is_none() && are_of_recording && image.source.is_some() {
            return Ok((image.id, Place::LeftOut));
        }
        let frame = by_source.or(image.frame).or_else(|| named(&image.file_name));
        if let Some(frame) = frame {
            known.add(frame, image.source.as_ref().or(image.file_name.as_ref()).map_or("", |name| name))?;
            if let (Some(width), Some(height)) = (image.width, image.height) {
                canvas.expect_size(width as usize, height as usize)?;
            }
        }
        Ok((image.id, frame.map_or(Place::Unknown, Place::Frame)))
    };
    images.iter().zip(by_source).map(place).collect()
}

fn shapes(segmentation: &Segmentation) -> Option<Vec<Shape>> {
    match segmentation {
        Segmentation::Runs(entry) => Some(vec![Shape::Mask(Arc::new(entry.runs()?))]),
        Segmentation::Polygons(polygons) if polygons.is_empty() => None,
        Segmentation::Polygons(polygons) => polygons.iter().map(|flat| polygon(flat)).collect(),
        Segmentation::Other => None,
    }
}

fn polygon(flat: &[f32]) -> Option<Shape> {
    let (points, rest) = flat.as_chunks::<2>();
    rest.is_empty().then(|| Shape::Polygon { points_px: points.to_vec() })
}
