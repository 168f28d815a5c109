//! `sequence.toml`: facts that the user knows better than the files. It lies in the recording's folder (for a
//! video file, or a folder of only one: beside the video, as `NAME.mp4.toml`). Every part is optional, and it
//! overrides the layout.
//!
//! ```toml
//! [camera]                    # intrinsics in pixels of the frames …
//! fx = 569.5                  # fy = fx · width / height of a pixel, cx = width / 2, cy = height / 2
//!                             # unless given
//! # fov_x_degrees = 60.0      # … or the horizontal field of view alone
//!
//! [depth]
//! kind = "depth"              # z = scale · value, or "disparity": z = scale / value
//! scale = 0.001               # scene units per count
//!
//! [masks]
//! keep = "white"              # which side of the mask files is tissue: "white" or "black"
//! field_of_view = "detect"    # or "whole": no border is looked for
//!
//! [labels]
//! file = "annotations.xml"    # labels of another program, or a DICOM segmentation, instead of
//!                             # the recording's own
//!
//! [time]
//! frames_per_second = 25.0    # of the files
//! every = 2                   # use each second frame
//!
//! [frames]
//! first = 0                   # numbers of the first and last file that are used, counted from 0
//! last = 79
//!
//! [[hidden]]                  # a part of every frame that is black, in pixels: burnt-in names, for example
//! x = 10
//! y = 8
//! width = 200
//! height = 24
//!
//! [[classes]]                 # replaces the class list; ids are values of the label files
//! id = 1
//! name = "liver"
//! colour = [255, 114, 114]    # optional
//! ```
//!
//! The program reads this file and never writes it; decisions made in the program are in [`super::decided`].

use super::{
    classes::{self, ClassEntry},
    depth::DepthKind,
    hidden::HiddenRectangle,
    labels::LabelCoding,
    lens,
    recording::{CameraSource, Keep, MaskRule, Recording, Selection},
};
use crate::{
    Error, Result,
    camera::Camera,
    reading::{is_present, read_text},
};
use serde::{Deserialize, Serialize};
use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

/// Scales of depth that are believed: with them, whatever a file holds stays a number of the usual size.
const DEPTH_SCALES: RangeInclusive<f64> = 1e-9..=1e9;

/// Largest frame rate that is believed, and that can be exported as a video.
pub const MAX_FRAMES_PER_SECOND: f32 = 10_000.0;

/// The contents of a `sequence.toml`; see the module for its meaning.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// `[camera]`
    #[serde(skip_serializing_if = "is_default")]
    pub camera: CameraSettings,
    /// `[depth]`
    #[serde(skip_serializing_if = "is_default")]
    pub depth: DepthSettings,
    /// `[masks]`
    #[serde(skip_serializing_if = "is_default")]
    pub masks: MaskSettings,
    /// `[labels]`
    #[serde(skip_serializing_if = "is_default")]
    pub labels: LabelSettings,
    /// `[time]`
    #[serde(skip_serializing_if = "is_default")]
    pub time: TimeSettings,
    /// `[frames]`
    #[serde(skip_serializing_if = "is_default")]
    pub frames: FrameSettings,
    /// `[[hidden]]`
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hidden: Vec<HiddenRectangle>,
    /// `[[classes]]`
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub classes: Vec<ClassEntry>,
}

/// `[camera]`: either `fov_x_degrees`, or `fx` and what else is known; pixels of the frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(missing_docs, reason = "explained together above")]
pub struct CameraSettings {
    pub fov_x_degrees: Option<f32>,
    pub fx: Option<f32>,
    pub fy: Option<f32>,
    pub cx: Option<f32>,
    pub cy: Option<f32>,
}

/// `[depth]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthSettings {
    /// Meaning of the values.
    pub kind: Option<DepthKind>,
    /// Scene units per count (for disparity: the numerator).
    pub scale: Option<f64>,
}

/// `[masks]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaskSettings {
    /// The side of the mask files that is supervised.
    pub keep: Option<Keep>,
    /// Treatment of the border around the endoscopic picture.
    pub field_of_view: Option<FieldOfViewSetting>,
}

/// Treatment of the border around the endoscopic picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FieldOfViewSetting {
    /// The border is found from the frames and left out.
    Detect,
    /// Everything is inside.
    Whole,
}

/// `[labels]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LabelSettings {
    /// File of annotations, or DICOM segmentation, with the labels, seen from the settings file.
    pub file: Option<PathBuf>,
}

/// `[time]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TimeSettings {
    /// Frames per second of the files (before `every`).
    pub frames_per_second: Option<f32>,
    /// Use every k-th frame.
    pub every: Option<usize>,
}

/// `[frames]`: numbers of files, counted from 0, both included.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(missing_docs, reason = "explained together above")]
pub struct FrameSettings {
    pub first: Option<usize>,
    pub last: Option<usize>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Settings {
    /// Reads `path`; a missing file means no settings. Unknown keys are errors that name the key.
    pub fn read(path: &Path) -> Result<Self> {
        let text = match read_text(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound && !is_present(path) => {
                return Ok(Self::default());
            }
            Err(e) => return Err(Error::io("read the settings", path, e)),
        };
        let settings: Self = toml::from_str(&text).map_err(|e| {
            let line = e.span().map_or(1, |span| text[..span.start].matches('\n').count() + 1);
            let what = in_plain_words(e.message().trim_end_matches('.'));
            Error::input_at(path, format!("line {line}: {what}"), "")
        })?;
        settings.validate().map_err(|what| Error::input_at(path, what, ""))?;
        Ok(settings)
    }

    fn validate(&self) -> Result<(), String> {
        let camera = &self.camera;
        let pixels = [camera.fx, camera.fy, camera.cx, camera.cy];
        if camera.fov_x_degrees.is_some() && pixels.iter().any(Option::is_some) {
            return Err("[camera] has both fov_x_degrees and intrinsics in pixels".to_owned());
        }
        if camera.fx.is_none() && pixels.iter().any(Option::is_some) {
            return Err("[camera] lacks fx".to_owned());
        }
        let positive = |name: &str, value: Option<f64>, limit: f64| match value {
            Some(v) if !(v.is_finite() && v > 0.0 && v < limit) => Err(format!("{name} is {v}")),
            _ => Ok(()),
        };
        if let Some(scale) = self.depth.scale.filter(|scale| !DEPTH_SCALES.contains(scale)) {
            let (least, most) = DEPTH_SCALES.into_inner();
            return Err(format!("[depth] scale is {scale:?}, it must lie between {least:?} and {most:?}"));
        }
        positive("[camera] fov_x_degrees", camera.fov_x_degrees.map(f64::from), 180.0)?;
        positive("[camera] fx", camera.fx.map(f64::from), f64::INFINITY)?;
        positive("[camera] fy", camera.fy.map(f64::from), f64::INFINITY)?;
        positive("[time] frames_per_second", self.time.frames_per_second.map(f64::from), f64::INFINITY)?;
        if let Some(speed) = self.time.frames_per_second.filter(|speed| *speed > MAX_FRAMES_PER_SECOND) {
            return Err(format!(
                "[time] frames_per_second is {speed}, {MAX_FRAMES_PER_SECOND} is the most that can be written again"
            ));
        }
        positive("[time] every", self.time.every.map(|v| v as f64), f64::INFINITY)
    }

    /// Returns the selection of files that are used.
    pub(super) fn selection(&self) -> Selection {
        Selection {
            first: self.frames.first.unwrap_or(0),
            last: self.frames.last,
            every: self.time.every.unwrap_or(1),
        }
    }

    /// Overrides what the layout found. `path` is the settings file, for messages.
    pub(super) fn apply(&self, recording: &mut Recording, path: &Path) -> Result<()> {
        self.apply_camera(recording, path)?;
        recording.hidden.extend(&self.hidden);
        recording.depth_rule.kind = self.depth.kind.unwrap_or(recording.depth_rule.kind);
        recording.depth_rule.scale = self.depth.scale.unwrap_or(recording.depth_rule.scale);
        match (self.masks.keep, recording.mask_rule) {
            (None, _) => {}
            (Some(_), MaskRule::DropCode(_)) => {
                return Err(Error::input_at(
                    path,
                    "[masks] keep is set, but this recording has no mask files",
                    "Remove that line.",
                ));
            }
            (Some(keep), _) => recording.mask_rule = keep.rule(),
        }
        recording.detect_field_of_view = self.masks.field_of_view != Some(FieldOfViewSetting::Whole);
        let every = self.time.every.unwrap_or(1) as f32;
        if let Some(speed) = recording.frames_per_second.take_if(|speed| *speed > MAX_FRAMES_PER_SECOND) {
            recording.notes.push(format!(
                "The video claims {speed:.0} frames per second, which is not believed: its speed counts as unknown"
            ));
        }
        if self.time.frames_per_second.is_some() || recording.frames_per_second.is_none() {
            recording.seconds.clear();
        }
        let frames_per_second = self.time.frames_per_second.or(recording.frames_per_second);
        recording.frames_per_second = frames_per_second.map(|fps| fps / every);
        if !self.classes.is_empty() {
            recording.classes = classes::from_entries(&self.classes, path)?;
            recording.coding = LabelCoding::IdsOrColours;
        }
        Ok(())
    }

    fn apply_camera(&self, recording: &mut Recording, path: &Path) -> Result<()> {
        let given = &self.camera;
        let (width, height) = (recording.width as u32, recording.height as u32);
        let aspect = recording.pixel_aspect;
        let intrinsics = if let Some(degrees) = given.fov_x_degrees {
            let camera = Camera::with_field_of_view(width, height, degrees);
            Camera { fy: camera.fx * aspect, ..camera }
        } else if let Some(fx) = given.fx {
            Camera {
                fx,
                fy: given.fy.unwrap_or(fx * aspect),
                cx: given.cx.unwrap_or(0.5 * width as f32),
                cy: given.cy.unwrap_or(0.5 * height as f32),
                ..Camera::with_field_of_view(width, height, 60.0)
            }
        } else {
            return Ok(());
        };
        if let Some(what) = lens::impossible(&intrinsics) {
            let hint = "Give fx, fy, cx and cy in pixels of the frames, or fov_x_degrees alone.";
            return Err(Error::input_at(path, format!("[camera] cannot be right: {what}"), hint));
        }
        for camera in &mut recording.cameras {
            *camera = Camera { camera_from_world: camera.camera_from_world, ..intrinsics };
        }
        if let CameraSource::Assumed(_) = recording.camera_source {
            recording.camera_source = CameraSource::Lens;
        }
        Ok(())
    }
}

/// Replaces the name of a type, by which a message of the TOML reader ends, by plain words.
fn in_plain_words(message: &str) -> String {
    let Some((what, expected)) = message.rsplit_once(", expected ") else { return message.to_owned() };
    let plain = match expected {
        "usize" => "a whole number that is not negative",
        "u8" => "a whole number from 0 to 255",
        "f32" | "f64" => "a number",
        "a string" | "path string" => "a text",
        "a sequence" => "a list",
        table if table.starts_with("struct ") => "a table of settings",
        other => other,
    };
    format!("{what}, expected {plain}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::SETTINGS_FILE;

    fn read(text: &str) -> Result<Settings> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(SETTINGS_FILE);
        std::fs::write(&path, text).unwrap();
        Settings::read(&path)
    }

    #[test]
    fn unknown_keys_are_named_with_their_line() {
        let error = read("[depth]\nscale = 2.0\nfactor = 3\n").unwrap_err().to_string();
        assert!(error.contains("line 3") && error.contains("factor"), "{error}");
        let error = read("[masks]\nkeep = \"grey\"\n").unwrap_err().to_string();
        assert!(error.contains("line 2") && error.contains("grey"), "{error}");
    }

    #[test]
    fn values_of_another_kind_are_told_in_plain_words() {
        for (text, expected) in [
            ("[frames]\nfirst = -1\n", "expected a whole number that is not negative"),
            ("[frames]\nlast = \"all\"\n", "expected a whole number that is not negative"),
            ("[camera]\nfx = \"long\"\n", "expected a number"),
            ("frames = 3\n", "expected a table of settings"),
            ("[[classes]]\nid = 300\nname = \"fat\"\n", "expected a whole number from 0 to 255"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn contradictions_and_nonsense_are_refused() {
        for text in [
            "[camera]\nfov_x_degrees = 60.0\nfx = 500.0\n",
            "[camera]\ncx = 5.0\n",
            "[camera]\nfov_x_degrees = 180.0\n",
            "[camera]\nfx = nan\n",
            "[depth]\nscale = 0.0\n",
            "[depth]\nscale = 1e30\n",
            "[depth]\nscale = 1e-30\n",
            "[time]\nevery = 0\n",
            "[time]\nframes_per_second = 100000.0\n",
        ] {
            assert!(read(text).is_err(), "{text}");
        }
    }

    #[test]
    fn what_is_written_reads_back() {
        let settings = Settings {
            camera: CameraSettings { fx: Some(300.5), ..Default::default() },
            depth: DepthSettings { scale: Some(0.01), kind: Some(DepthKind::Disparity) },
            masks: MaskSettings { keep: Some(Keep::White), field_of_view: Some(FieldOfViewSetting::Whole) },
            labels: LabelSettings { file: Some("tasks.json".into()) },
            time: TimeSettings { frames_per_second: Some(25.0), every: Some(2) },
            frames: FrameSettings { first: Some(1), last: Some(9) },
            hidden: vec![HiddenRectangle { x: 1, y: 2, width: 3, height: 4 }],
            classes: vec![ClassEntry { id: 3, name: "fat".into(), colour: None }],
        };
        assert_eq!(read(&toml::to_string(&settings).unwrap()).unwrap(), settings);
        assert_eq!(read("").unwrap(), Settings::default());
    }
}
