//! COCO annotations: each says that the pixels of its mask belong to its category.

use super::{Annotation, Canvas, RunsEntry, Shape};
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
    source: Option<String>,
    file_name: Option<String>,
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

/// Returns the annotations of a COCO file.
pub(super) fn read(text: &[u8], canvas: &Canvas) -> Result<Vec<Annotation>> {
    let malformed = |e| Error::input(format!("this is no file of COCO annotations: {e}"), "");
    let file: Coco = serde_json::from_slice(text).map_err(malformed)?;
    let names: BTreeMap<u64, &str> = file.categories.iter().map(|c| (c.id, c.name.as_str())).collect();
    let frames: BTreeMap<u64, Option<usize>> =
        file.images.iter().map(|image| (image.id, frame_of(image, canvas))).collect();
    let mut found = Vec::new();
    for (i, entry) in file.annotations.iter().enumerate() {
        let wrong = |what: &str| {
            let hint =
                "Frames are found by \"frame\", or by \"source\" or \"file_name\" as in the recording.";
            Error::input(format!("annotations[{i}] cannot be used: {what}"), hint)
        };
        let name = names.get(&entry.category_id).ok_or_else(|| wrong("it has no category"))?;
        let frame = frames.get(&entry.image_id).copied().flatten();
        let frame = frame.ok_or_else(|| wrong("its image is no frame of the recording"))?;
        for shape in shapes(&entry.segmentation).ok_or_else(|| wrong("its segmentation is none"))? {
            found.push(Annotation { frame, name: (*name).to_owned(), shape });
        }
    }
    Ok(found)
}

fn frame_of(image: &Image, canvas: &Canvas) -> Option<usize> {
    let named = || {
        let names = [&image.source, &image.file_name].into_iter().flatten();
        names.into_iter().find_map(|name| canvas.frame_named(name))
    };
    image.frame.or_else(named)
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
