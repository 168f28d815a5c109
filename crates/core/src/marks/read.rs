//! Files of marks: our own, COCO annotations, and DICOM segmentations.

use super::{Canvas, Mark, Marks, bad_mark, coco, entry::MarkEntry, name_of, segmentation};
use crate::{
    Error, Result,
    dicom::is_dicom,
    grid::Mask,
    reading::{picture, picture_size, read_text},
};
use serde_json::Value;
use std::path::Path;

const FORM: &str = "It is {\"marks\": [{\"frame\": 24, \"name\": \"liver\", \"kind\": \"click\", \"points_px\": [[320, 200]]}]}, \
                    or a file of COCO annotations.";

impl Marks {
    /// Reads a file of marks, a DICOM segmentation, or COCO annotations as exports write them. Mask pictures are named relative to
    /// the file; half of the brightest value and more is marked.
    ///
    /// # Errors
    /// A file that cannot be read, and the first mark that does not fit the recording; the message names it.
    pub fn read(path: &Path, canvas: &Canvas) -> Result<Self> {
        if is_dicom(path) {
            return Self::new(segmentation::marks(path, canvas)?, canvas);
        }
        let text = read_text(path).map_err(|e| Error::io("read the marks", path, e))?;
        let folder = path.parent().unwrap_or(Path::new("."));
        Self::parse(&text, folder, canvas).map_err(|e| match e {
            Error::Input { what, hint, path: None } => {
                Error::Input { what, hint, path: Some(path.to_owned()) }
            }
            other => other,
        })
    }

    /// Reads marks from the text of a file; `folder` is where it lies.
    pub fn parse(text: &str, folder: &Path, canvas: &Canvas) -> Result<Self> {
        let json: Value = serde_json::from_str(&without_nan(text))
            .map_err(|e| Error::input(format!("this is no file of marks: {e}"), FORM))?;
        let marks = match (json.get("marks"), json.get("annotations")) {
            (Some(Value::Array(entries)), _) => {
                let each = entries.iter().enumerate().map(|(i, entry)| mark(i, entry, folder, canvas));
                each.collect::<Result<Vec<_>>>()?
            }
            (None, Some(_)) => coco::marks(&json, canvas)?,
            _ => return Err(Error::input("this is no file of marks: it has no list \"marks\"", FORM)),
        };
        Self::new(marks, canvas)
    }

    /// Returns the text of a file with these marks, which [`Marks::parse`] reads. Masks are part of the text.
    pub fn to_text(&self) -> Result<String> {
        let line = |mark: &Mark| serde_json::to_string(mark);
        let lines = self.all().iter().map(line).collect::<Result<Vec<_>, _>>();
        let lines = lines.map_err(|e| Error::input(format!("the marks cannot be written: {e}"), ""))?;
        Ok(format!("{{\"marks\": [\n{}\n]}}\n", lines.join(",\n")))
    }
}

fn mark(i: usize, entry: &Value, folder: &Path, canvas: &Canvas) -> Result<Mark> {
    let name = entry.get("name").and_then(Value::as_str).unwrap_or_default();
    let frame = entry.get("frame").and_then(Value::as_u64).map(|frame| frame as usize);
    let which = name_of(i, name, frame);
    let entry: MarkEntry =
        serde_json::from_value(entry.clone()).map_err(|e| bad_mark(&which, &e.to_string()))?;
    let read_mask = |name: &str| mask(&folder.join(name), canvas);
    entry.mark(read_mask).map_err(|problem| bad_mark(&which, &problem))
}

/// Reads a mask picture of the recording's size.
fn mask(path: &Path, canvas: &Canvas) -> Result<Mask, String> {
    let cannot = |e: Error| e.to_string();
    let (width, height) = picture_size(path).map_err(cannot)?;
    if (width, height) != (canvas.width, canvas.height) {
        let expected = format!("{}×{}", canvas.width, canvas.height);
        return Err(format!("its mask has {width}×{height} pixels, the frames have {expected}"));
    }
    let grey = picture(path).map_err(cannot)?.into_luma8();
    let brightest = grey.iter().copied().max().unwrap_or(0).max(1);
    let marked = grey.iter().map(|v| u16::from(*v) * 2 >= u16::from(brightest) && *v > 0).collect();
    Ok(Mask::from_vec(width, height, marked))
}

/// Replaces numbers that JSON does not have, NaN and infinities, by null, so that the mark that holds one can
/// be named.
fn without_nan(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut in_text) = (text, false);
    while let Some(c) = rest.chars().next() {
        let none = ["NaN", "-Infinity", "Infinity"].into_iter().find(|n| !in_text && rest.starts_with(n));
        if let Some(none) = none {
            out.push_str("null");
            rest = &rest[none.len()..];
            continue;
        }
        let mut taken = c.len_utf8();
        match c {
            // The next letter belongs to it.
            '\\' if in_text => taken += rest[1..].chars().next().map_or(0, char::len_utf8),
            '"' => in_text = !in_text,
            _ => {}
        }
        out.push_str(&rest[..taken]);
        rest = &rest[taken..];
    }
    out
}
