//! Marks as they are written in files and sessions.

use super::{Mark, Shape};
use crate::{annotations::RunsEntry, grid::Mask};
use serde::{Deserialize, Deserializer, de::Error as _};
use serde_json::Value;
use std::sync::Arc;

/// Radius of clicks and strokes that give none, px.
const RADIUS_PX: f32 = 6.0;

/// A mark as it is written.
#[derive(serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MarkEntry {
    #[serde(default, deserialize_with = "frame")]
    pub(super) frame: Option<usize>,
    #[serde(default)]
    pub(super) name: String,
    pub(super) kind: Option<Kind>,
    #[serde(default = "yes")]
    pub(super) add: bool,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) points_px: Vec<[Option<f32>; 2]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) radius_px: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) mask: Option<MaskEntry>,
}

fn yes() -> bool {
    true
}

/// Reads the number of a frame, if there is one.
fn frame<'de, D: Deserializer<'de>>(from: D) -> Result<Option<usize>, D::Error> {
    let refused = || D::Error::custom("frame must be a whole number, 0 or more");
    let value = Option::<Value>::deserialize(from)?;
    value.map(|value| whole_number(&value).ok_or_else(refused)).transpose()
}

/// Returns a whole number, which some programs write as 2.0.
pub(super) fn whole_number(value: &Value) -> Option<usize> {
    let is_whole = |v: &f64| v.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(v);
    let rounded = || value.as_f64().filter(is_whole).map(|v| v as usize);
    value.as_u64().map(|v| v as usize).or_else(rounded)
}

/// Kind of a mark.
#[derive(Clone, Copy, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    Click,
    Stroke,
    Polygon,
    Box,
    Mask,
}

/// The pixels of a mask: a picture's file, or run lengths as in COCO files.
#[derive(Clone, serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
pub(super) enum MaskEntry {
    File(String),
    Runs(RunsEntry),
}

impl MarkEntry {
    /// Returns the mark. `read_mask` reads the picture of a mask.
    pub(super) fn mark(&self, read_mask: impl Fn(&str) -> Result<Mask, String>) -> Result<Mark, String> {
        let shape = self.shape(read_mask)?;
        let frame = self.frame.ok_or("it has no frame")?;
        Ok(Mark::new(frame, &self.name, self.add, shape))
    }

    fn shape(&self, read_mask: impl Fn(&str) -> Result<Mask, String>) -> Result<Shape, String> {
        let point = |p: &[Option<f32>; 2]| match p {
            [Some(x), Some(y)] => Ok([*x, *y]),
            _ => Err("a coordinate is not a number".to_owned()),
        };
        let points_px = self.points_px.iter().map(point).collect::<Result<Vec<_>, _>>()?;
        let radius_px = self.radius_px.unwrap_or(RADIUS_PX);
        match (self.kind, points_px.as_slice()) {
            (None, _) => Err("it has no kind".into()),
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
                    let runs = entry.runs().ok_or("its mask is none")?;
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
