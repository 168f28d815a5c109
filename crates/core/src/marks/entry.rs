//! Marks as they are written in files and sessions.

use super::{Mark, Shape};
use crate::{annotations::RunsEntry, grid::Mask};
use serde::{Deserialize, Deserializer, de::Error as _};
use serde_json::{Map, Value};
use std::sync::Arc;

/// Radius of clicks and strokes that give none, px.
const RADIUS_PX: f32 = 6.0;

/// A mark as it is written.
#[derive(serde::Serialize)]
pub(super) struct MarkEntry {
    pub(super) frame: Option<usize>,
    pub(super) name: String,
    pub(super) kind: Option<Kind>,
    pub(super) add: bool,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) points_px: Vec<[Option<f32>; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) radius_px: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mask: Option<MaskEntry>,
}

/// Names of the parts of a mark.
const PARTS: [&str; 7] = ["frame", "name", "kind", "add", "points_px", "radius_px", "mask"];

const IS_OBJECT: &str = "{\"frame\": …, \"name\": …, \"kind\": …}";
const IS_FRAME: &str = "a whole number, 0 or more";
const IS_NAME: &str = "text";
const IS_KIND: &str = "\"click\", \"stroke\", \"polygon\", \"box\" or \"mask\"";
const IS_ADD: &str = "true or false";
const IS_POINTS: &str = "a list of points, [[x, y], …]";
const IS_RADIUS: &str = "a number";
const IS_MASK: &str = "the name of a picture, or run lengths, {\"size\": [height, width], \"counts\": …}";
const WRONG_RUNS: &str = "the run lengths of its mask do not come to its size: \
                          the size is [height, width], and runs go down the columns";

/// Largest number of characters that messages tell of a part.
const MOST_TOLD: usize = 40;

impl<'de> Deserialize<'de> for MarkEntry {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Self::of(&Value::deserialize(from)?).map_err(D::Error::custom)
    }
}

/// Returns what `read` makes of a part of a mark, if the mark has it. A part that cannot be read has to be
/// what `expected` says.
fn part<T>(
    mark: &Map<String, Value>,
    name: &str,
    expected: &str,
    read: impl Fn(&Value) -> Option<T>,
) -> Result<Option<T>, String> {
    let Some(value) = mark.get(name) else { return Ok(None) };
    let refused = || format!("{name} must be {expected}, not {}", told(value));
    read(value).map(Some).ok_or_else(refused)
}

/// Reads a value as `read` does; null is none.
fn or_none<T>(read: impl Fn(&Value) -> Option<T>) -> impl Fn(&Value) -> Option<Option<T>> {
    move |value: &Value| if value.is_null() { Some(None) } else { read(value).map(Some) }
}

/// Returns a value as messages tell it: of a long one, the beginning.
fn told(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= MOST_TOLD {
        return text;
    }
    text.chars().take(MOST_TOLD).chain(['…']).collect()
}

/// Reads points; a coordinate that is no finite number is `None`.
fn points(value: &Value) -> Option<Vec<[Option<f32>; 2]>> {
    let coordinate = |value: &Value| match value {
        Value::Null => Some(None),
        value => value.as_f64().map(|v| Some(v as f32)),
    };
    let point = |value: &Value| match value.as_array()?.as_slice() {
        [x, y] => Some([coordinate(x)?, coordinate(y)?]),
        _ => None,
    };
    value.as_array()?.iter().map(point).collect()
}

/// Returns a whole number, which some programs write as 2.0.
pub(super) fn whole_number(value: &Value) -> Option<usize> {
    let is_whole = |v: &f64| v.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(v);
    let rounded = || value.as_f64().filter(is_whole).map(|v| v as usize);
    value.as_u64().map(|v| v as usize).or_else(rounded)
}

/// Kind of a mark.
#[derive(Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    Click,
    Stroke,
    Polygon,
    Box,
    Mask,
}

/// The pixels of a mask: a picture's file, or run lengths as in COCO files.
#[derive(Clone, serde::Serialize)]
#[serde(untagged)]
pub(super) enum MaskEntry {
    File(String),
    Runs(RunsEntry),
}

impl MaskEntry {
    /// Reads the name of a picture or run lengths; `None` if it is neither.
    fn of(value: &Value) -> Option<Self> {
        match value {
            Value::String(name) => Some(Self::File(name.clone())),
            runs => RunsEntry::deserialize(runs).ok().map(Self::Runs),
        }
    }
}

impl MarkEntry {
    /// Reads a mark; says what is wrong with the first part that is not as expected. No frame, no kind and no
    /// mask may be written as null.
    pub(super) fn of(value: &Value) -> Result<Self, String> {
        let refused = || format!("it must be {IS_OBJECT}, not {}", told(value));
        let mark = value.as_object().ok_or_else(refused)?;
        if let Some(other) = mark.keys().find(|name| !PARTS.contains(&name.as_str())) {
            return Err(format!(
                "it has a part \"{other}\" that marks do not have; they have {}",
                PARTS.join(", ")
            ));
        }
        Ok(Self {
            frame: part(mark, "frame", IS_FRAME, or_none(whole_number))?.flatten(),
            name: part(mark, "name", IS_NAME, |value| value.as_str().map(str::to_owned))?.unwrap_or_default(),
            kind: part(mark, "kind", IS_KIND, or_none(|value| Kind::deserialize(value).ok()))?.flatten(),
            add: part(mark, "add", IS_ADD, Value::as_bool)?.unwrap_or(true),
            points_px: part(mark, "points_px", IS_POINTS, points)?.unwrap_or_default(),
            radius_px: part(mark, "radius_px", IS_RADIUS, |value| value.as_f64().map(|v| v as f32))?,
            mask: part(mark, "mask", IS_MASK, or_none(MaskEntry::of))?.flatten(),
        })
    }

    /// Returns the mark. `read_mask` reads the picture of a mask.
    pub(super) fn mark(&self, read_mask: impl Fn(&str) -> Result<Mask, String>) -> Result<Mark, String> {
        if self.name.contains(char::is_control) {
            return Err("its name has control characters".into());
        }
        let shape = self.shape(read_mask)?;
        let frame = self.frame.ok_or("it has no frame")?;
        Ok(Mark::new(frame, &self.name, self.add, shape))
    }

    fn shape(&self, read_mask: impl Fn(&str) -> Result<Mask, String>) -> Result<Shape, String> {
        let point = |p: &[Option<f32>; 2]| match p {
            [Some(x), Some(y)] => Ok([*x, *y]),
            _ => Err("a coordinate is not a number that can be used".to_owned()),
        };
        let points_px = self.points_px.iter().map(point).collect::<Result<Vec<_>, _>>()?;
        let radius_px = self.radius_px.unwrap_or(RADIUS_PX);
        match (self.kind, points_px.as_slice()) {
            (None, _) => Err("it has no kind".into()),
            (Some(kind), _) if kind != Kind::Mask && self.mask.is_some() => {
                Err("it has a mask, which goes with the kind \"mask\" alone".into())
            }
            (Some(Kind::Mask), [_, ..]) => Err("it has points_px, which a mask does not have".into()),
            (Some(Kind::Click), [point_px]) => Ok(Shape::Click { point_px: *point_px, radius_px }),
            (Some(Kind::Click), points) => Err(format!("a click has one point, not {}", points.len())),
            (Some(Kind::Box), [a, b]) => Ok(Shape::Box { corners_px: [*a, *b] }),
            (Some(Kind::Box), points) => Err(format!("a box has two points, not {}", points.len())),
            (Some(Kind::Stroke), _) => Ok(Shape::Stroke { points_px, radius_px }),
            (Some(Kind::Polygon), _) => Ok(Shape::Polygon { points_px }),
            (Some(Kind::Mask), _) => match &self.mask {
                None => Err("it names no mask picture".into()),
                Some(MaskEntry::File(name)) => read_mask(name).map(|mask| Shape::from(&mask)),
                Some(MaskEntry::Runs(entry)) => {
                    let runs = entry.runs().ok_or(WRONG_RUNS)?;
                    Ok(Shape::Mask(Arc::new(runs)))
                }
            },
        }
    }
}

impl From<Mark> for MarkEntry {
    fn from(mark: Mark) -> Self {
        let (kind, points_px, radius_px, mask) = match mark.shape {
            Shape::Click { point_px, radius_px } => (Kind::Click, vec![point_px], Some(radius_px), None),
            Shape::Stroke { points_px, radius_px } => (Kind::Stroke, points_px, Some(radius_px), None),
            Shape::Polygon { points_px } => (Kind::Polygon, points_px, None, None),
            Shape::Box { corners_px } => (Kind::Box, corners_px.to_vec(), None, None),
            Shape::Mask(mask) => {
                (Kind::Mask, Vec::new(), None, Some(MaskEntry::Runs(RunsEntry::from(&*mask))))
            }
        };
        let points_px = points_px.into_iter().map(|point| point.map(Some)).collect();
        let (frame, kind) = (Some(mark.frame), Some(kind));
        Self { frame, name: mark.name, kind, add: mark.add, points_px, radius_px, mask }
    }
}

impl TryFrom<MarkEntry> for Mark {
    type Error = String;

    fn try_from(entry: MarkEntry) -> Result<Self, String> {
        entry.mark(|name| Err(format!("the picture {name} is not part of it")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_whole_numbers_however_they_are_written() {
        let read = |frame: &str| {
            let text =
                format!(r#"{{"frame": {frame}, "name": "liver", "kind": "click", "points_px": [[1, 1]]}}"#);
            serde_json::from_str::<MarkEntry>(&text).map(|entry| entry.frame).map_err(|e| e.to_string())
        };
        for (frame, expected) in [("2", Some(2)), ("2.0", Some(2)), ("2e1", Some(20)), ("null", None)] {
            assert_eq!(read(frame), Ok(expected), "{frame}");
        }
        for wrong in ["2.5", "-1", "-1.0", "1e300", "\"2\"", "[2]"] {
            assert!(read(wrong).unwrap_err().contains("frame must be a whole number"), "{wrong}");
        }
    }
}
