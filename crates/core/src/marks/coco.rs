//! COCO annotations as marks: each adds the pixels of its mask to the name of its category.

use super::{Canvas, Mark, Shape, entry::Runs};
use crate::{Error, Result};
use serde_json::Value;
use std::{collections::BTreeMap, sync::Arc};

#[derive(serde::Deserialize)]
struct Coco {
    categories: Vec<Category>,
    images: Vec<Image>,
    annotations: Vec<Annotation>,
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
struct Annotation {
    image_id: u64,
    category_id: u64,
    segmentation: Value,
}

/// Returns the marks of a COCO file.
pub(super) fn marks(json: &Value, canvas: &Canvas) -> Result<Vec<Mark>> {
    let malformed = |e| Error::input(format!("this is no file of COCO annotations: {e}"), "");
    let file: Coco = serde_json::from_value(json.clone()).map_err(malformed)?;
    let names: BTreeMap<u64, &str> = file.categories.iter().map(|c| (c.id, c.name.as_str())).collect();
    let frames: BTreeMap<u64, Option<usize>> =
        file.images.iter().map(|image| (image.id, frame_of(image, canvas))).collect();
    let mut marks = Vec::new();
    for (i, annotation) in file.annotations.iter().enumerate() {
        let wrong = |what: &str| {
            let hint =
                "Frames are found by \"frame\", or by \"source\" or \"file_name\" as in the recording.";
            Error::input(format!("annotations[{i}] cannot be used: {what}"), hint)
        };
        let name = names.get(&annotation.category_id).ok_or_else(|| wrong("it has no category"))?;
        let frame = frames.get(&annotation.image_id).copied().flatten();
        let frame = frame.ok_or_else(|| wrong("its image is no frame of the recording"))?;
        for shape in shapes(&annotation.segmentation).ok_or_else(|| wrong("its segmentation is none"))? {
            marks.push(Mark::new(frame, name, true, shape));
        }
    }
    Ok(marks)
}

fn frame_of(image: &Image, canvas: &Canvas) -> Option<usize> {
    let named = |name: &String| {
        let stem = |name: &str| name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned();
        canvas.frame_names.iter().position(|known| known == name || stem(known) == stem(name))
    };
    image.frame.or_else(|| [&image.source, &image.file_name].into_iter().flatten().find_map(named))
}

fn shapes(segmentation: &Value) -> Option<Vec<Shape>> {
    if let Value::Array(polygons) = segmentation {
        return polygons.iter().map(polygon).collect();
    }
    let runs: Runs = serde_json::from_value(segmentation.clone()).ok()?;
    Some(vec![Shape::Mask(Arc::new(runs.mask()?))])
}

fn polygon(flat: &Value) -> Option<Shape> {
    let numbers: Vec<f32> = serde_json::from_value(flat.clone()).ok()?;
    let (points, rest) = numbers.as_chunks::<2>();
    rest.is_empty().then(|| Shape::Polygon { points_px: points.to_vec() })
}
