//! Label Studio's tasks as it exports them: brush masks, polygons and boxes on the image of each task.
//! Corrected annotations count; where a task has none, its predictions do.

pub(crate) mod packed;

use super::{Annotation, Canvas, Images, Shape};
use crate::{Error, Result};
use serde_json::{Map, Value};

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
    let (mut found, mut images) = (Vec::new(), Images::default());
    for (i, task) in tasks.iter().enumerate() {
        let place = task.place(canvas);
        if let Some((frame, image)) = place {
            images.add(frame, image)?;
        }
        for item in task.items() {
            let wrong = |what: &str, hint: &str| {
                Error::input(format!("a region of task [{i}] cannot be used: {what}"), hint)
            };
            let Some(shape) = item.shape(canvas)? else { continue };
            let shape = shape.map_err(|what| wrong(what, "Turn it into a brush mask or a polygon."))?;
            let (frame, _) = place.ok_or_else(|| {
                let hint = "Frames are found by the name of the task's image, or by \"frame\" in its data.";
                wrong("its image is no frame of the recording", hint)
            })?;
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

    /// Returns the frame and the address of its image, if it has one that names the frame. Names come first:
    /// numbers of frames change with the first one that is used. Of the task's texts, those that look like
    /// addresses come before other words.
    fn place(&self, canvas: &Canvas) -> Option<(usize, &str)> {
        let is_address = |text: &&str| text.contains(['/', '\\', '=', '.']);
        let texts = self.data.values().filter_map(Value::as_str);
        let (addresses, words): (Vec<&str>, Vec<&str>) = texts.partition(is_address);
        let named = addresses.into_iter().chain(words).find_map(|address| {
            let name = address.rsplit(['/', '=', '\\']).next().unwrap_or(address);
            // Uploaded files get eight letters and a hyphen before their names.
            let original = name.split_at_checked(9).filter(|(added, _)| added.ends_with('-')).map(|(_, n)| n);
            let frame = canvas.frame_named(name).or_else(|| canvas.frame_named(original?));
            frame.map(|frame| (frame, address))
        });
        let numbered = || canvas.frame(self.data.get("frame")?.as_u64()? as usize);
        named.or_else(|| Some((numbered()?, "")))
    }
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
