//! Label Studio's tasks as it exports them: brush masks, polygons and boxes on the image of each task.
//! Corrected annotations count; where a task has none, its predictions do.

pub(crate) mod packed;

use super::{
    Annotation, Canvas, Shape,
    images::{Clue, Place, places},
    names::{FrameNames, is_picture},
};
use crate::{Error, Result};
use serde_json::{Map, Value};

/// Key of the data of a task that is its image, unless its project is set up otherwise.
const IMAGE: &str = "image";

#[derive(serde::Deserialize)]
struct Task {
    #[serde(default)]
    data: Map<String, Value>,
    #[serde(default)]
    annotations: Vec<Answer>,
    #[serde(default)]
    predictions: Vec<Answer>,
}

#[derive(serde::Deserialize)]
struct Answer {
    #[serde(default)]
    was_cancelled: bool,
    result: Vec<Item>,
}

#[derive(serde::Deserialize)]
struct Item {
    #[serde(rename = "type", default)]
    kind: String,
    original_width: Option<usize>,
    original_height: Option<usize>,
    #[serde(default)]
    value: Region,
}

/// A region; lengths and points are in percent of the picture.
#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct Region {
    rle: Vec<u8>,
    points: Vec<[f32; 2]>,
    x: f32,
    y: f32,
    width: f32,
    height: f32,
    rotation: f32,
    #[serde(alias = "polygonlabels", alias = "rectanglelabels")]
    brushlabels: Vec<String>,
}

/// Returns the annotations of a list of tasks.
pub(super) fn read(text: &[u8], canvas: &Canvas) -> Result<Vec<Annotation>> {
    let tasks: Vec<Task> = serde_json::from_slice(text).map_err(|e| {
        let hint = "Export the tasks of Label Studio as JSON.";
        Error::input(format!("this is no file of Label Studio's tasks: {e}"), hint)
    })?;
    let frames = FrameNames::of(canvas);
    let clues: Vec<Clue<'_>> = tasks.iter().map(|task| task.clue(&frames)).collect();
    let mut found = Vec::new();
    for (i, (task, place)) in tasks.iter().zip(places(&clues, canvas)?).enumerate() {
        if place == Place::LeftOut {
            continue;
        }
        for item in task.items() {
            let wrong = |what: &str, hint: &str| {
                Error::input(format!("a region of task [{i}] cannot be used: {what}"), hint)
            };
            let Some(shape) = item.shape(canvas)? else { continue };
            let shape = shape.map_err(|what| wrong(what, "Turn it into a brush mask or a polygon."))?;
            let Place::Frame(frame) = place else {
                let hint = "Frames are found by the name of the task's image, or by \"frame\" in its data.";
                return Err(wrong("its image is no frame of the recording", hint));
            };
            let name = item.value.brushlabels.first().cloned();
            let name = name.ok_or_else(|| wrong("it has no label", "Give every region a label."))?;
            found.push(Annotation { frame, name, shape });
        }
    }
    Ok(found)
}

impl Task {
    fn items(&self) -> impl Iterator<Item = &Item> {
        let is_valid = |answer: &&Answer| !answer.was_cancelled;
        let corrected = self.annotations.iter().find(is_valid);
        corrected.or(self.predictions.first()).into_iter().flat_map(|answer| &answer.result)
    }

    /// Returns what tells its frame: the address of its image, or else its number. Other words count if there
    /// is neither. Of several addresses, one of a frame counts, or else that of the image.
    fn clue<'a>(&'a self, frames: &FrameNames<'_>) -> Clue<'a> {
        let number = self.data.get("frame").and_then(Value::as_u64).map(|number| number as usize);
        let of = |text: &'a str| Clue::of_file(text, &names_in(text), number, frames);
        let texts = || self.data.values().filter_map(Value::as_str);
        let image = self.data.get(IMAGE).and_then(Value::as_str);
        let addresses = image.into_iter().chain(texts().filter(|text| is_address(text)));
        let clues: Vec<Clue<'a>> = addresses.map(of).collect();
        let first = |is_it: fn(&Clue<'a>) -> bool| clues.iter().copied().find(is_it);
        let told = first(Clue::names_a_frame).or_else(|| image.map(of));
        let told = told.or_else(|| first(|clue| !clue.is_another())).or(clues.first().copied());
        let numbered = || number.map(|_| Clue::NONE.numbered(number));
        let worded = || texts().map(of).find(Clue::names_a_frame);
        told.or_else(numbered).or_else(worded).unwrap_or(Clue::NONE)
    }
}

/// Returns `true` for a text that is the address of a picture. That of a page or a video has another ending.
fn is_address(text: &str) -> bool {
    let [path, end] = ends_of(text);
    let has_no_ending = !end.is_empty() && !path.contains('.') && !end.contains('.');
    let has_folders = text.starts_with('/') || text.contains("://");
    is_picture(text) || has_folders && (is_picture(path) || has_no_ending)
}

/// Returns the names that an address may stand for, the image's own last. Uploaded files get eight digits and
/// a hyphen before their names.
fn names_in(address: &str) -> Vec<&str> {
    let [path, end] = ends_of(address);
    let name = if is_picture(path) { path } else { end };
    let is_added = |added: &str| added.len() == 8 && added.bytes().all(|digit| digit.is_ascii_hexdigit());
    let original = name.split_once('-').filter(|(added, _)| is_added(added));
    std::iter::once(name).chain(original.map(|(_, original)| original)).collect()
}

/// Returns the names at the end of an address before a question mark, with which signed ones go on, and at
/// its very end.
fn ends_of(address: &str) -> [&str; 2] {
    [end_of(address.split('?').next().unwrap_or(address)), end_of(address)]
}

/// Returns what follows the last separator of an address.
fn end_of(address: &str) -> &str {
    address.rsplit(['/', '=', '\\']).next().unwrap_or(address)
}

impl Item {
    /// Returns the shape, or the reason why it cannot be read; `None` for what is no region.
    fn shape(&self, canvas: &Canvas) -> Result<Option<Result<Shape, &'static str>>> {
        let shape = match self.kind.as_str() {
            "brushlabels" => self.brush(canvas),
            "polygonlabels" => Ok(Shape::Polygon { points_px: self.points(canvas) }),
            "rectanglelabels" if self.value.rotation == 0.0 => {
                let Region { x, y, width, height, .. } = self.value;
                let corner = |x, y| in_px([x, y], canvas);
                Ok(Shape::Box { corners_px: [corner(x, y), corner(x + width, y + height)] })
            }
            "rectanglelabels" => Err("it is a box that is turned"),
            "ellipselabels" | "keypointlabels" | "vectorlabels" | "videorectangle" | "bitmasklabels" => {
                Err("its kind has no area that can be read")
            }
            _ => return Ok(None),
        };
        if let (Some(width), Some(height)) = (self.original_width, self.original_height) {
            canvas.expect_size(width, height)?;
        }
        Ok(Some(shape))
    }

    fn brush(&self, canvas: &Canvas) -> Result<Shape, &'static str> {
        let mask = packed::mask(&self.value.rle, canvas.width, canvas.height);
        Ok(Shape::from(&mask.ok_or("its mask is none")?))
    }

    fn points(&self, canvas: &Canvas) -> Vec<[f32; 2]> {
        self.value.points.iter().map(|point| in_px(*point, canvas)).collect()
    }
}

/// Returns a point in pixels that is given in percent of the picture.
fn in_px([x, y]: [f32; 2], canvas: &Canvas) -> [f32; 2] {
    [x * canvas.width as f32 / 100.0, y * canvas.height as f32 / 100.0]
}
