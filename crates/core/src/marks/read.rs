//! Files of marks: our own, and annotations of other programs.

use super::{
    Canvas, Mark, Marks, bad_mark,
    entry::{MarkEntry, whole_number},
    name_of,
};
use crate::{
    Error, Result,
    annotations::{self, Annotation, References},
    dicom::is_dicom,
    grid::{Grid, Mask},
    reading::{opacity, picture, picture_size},
    sequence::Sequence,
};
use serde::de::IgnoredAny;
use serde_json::Value;
use std::path::Path;

const FORM: &str = "It is {\"marks\": [{\"frame\": 24, \"name\": \"liver\", \"kind\": \"click\", \"points_px\": [[320, 200]]}]}, \
                    or a file of annotations: COCO, CVAT, Label Studio, .seg.nrrd or a DICOM segmentation.";

impl Marks {
    /// Endings of the names of files that [`Marks::read`] reads. Files are recognised by content, whatever
    /// their names are; DICOM files often have no ending.
    pub const EXTENSIONS: [&str; 4] = ["json", "xml", "nrrd", "dcm"];

    /// Reads a file of marks, or of [`annotations`]. Mask pictures are named relative to the file; half of the
    /// brightest value and more is marked, or of the opacity if some pixel is not opaque.
    ///
    /// # Errors
    /// A file that cannot be read, and the first mark that does not fit the recording; the message names it.
    pub fn read(path: &Path, canvas: &Canvas) -> Result<Self> {
        Self::read_for(path, canvas, || None)
    }

    /// Reads a file of marks as [`Marks::read`] does. `recording` opens the recording if it is at hand. It is
    /// asked for a DICOM segmentation, which refers to the files that the recording comes from.
    pub fn read_for(
        path: &Path,
        canvas: &Canvas,
        recording: impl FnOnce() -> Option<Sequence>,
    ) -> Result<Self> {
        let found = if is_dicom(path) {
            let references = recording().map_or_else(|| Ok(References::new()), |r| references(&r, canvas))?;
            Self::of_annotations(annotations::read_with(path, canvas, &references)?, canvas)?
        } else {
            let bytes = annotations::bytes_of(path, "read the marks")?;
            let folder = path.parent().unwrap_or(Path::new("."));
            Self::parse(&bytes, folder, canvas).map_err(|e| annotations::in_file(e, path))?
        };
        if found.is_empty() {
            return Err(Error::input_at(path, "there are no marks in this file", FORM));
        }
        Ok(found)
    }

    /// Reads marks from the bytes of a file; `folder` is where it lies.
    pub fn parse(bytes: &[u8], folder: &Path, canvas: &Canvas) -> Result<Self> {
        let none = |e: &dyn std::fmt::Display| Error::input(format!("this is no file of marks: {e}"), FORM);
        if is_bare_list(bytes) {
            return Err(none(&"the list must be in {\"marks\": […]}"));
        }
        if let Some(found) = annotations::parse(bytes, canvas)? {
            return Self::of_annotations(found, canvas);
        }
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let text = str::from_utf8(bytes).map_err(|e| none(&e))?;
        let json: Value = serde_json::from_str(&without_infinite(text)).map_err(|e| none(&e))?;
        let Some(Value::Array(entries)) = json.get("marks") else {
            return Err(none(&"it has no list \"marks\""));
        };
        let each = entries.iter().enumerate().map(|(i, entry)| mark(i, entry, folder, canvas));
        Self::new(each.collect::<Result<Vec<_>>>()?, canvas)
    }

    fn of_annotations(found: Vec<Annotation>, canvas: &Canvas) -> Result<Self> {
        let mark = |a: Annotation| Mark::new(a.frame, &a.name, true, a.shape);
        Self::new(found.into_iter().map(mark).collect(), canvas)
    }

    /// Returns the text of a file with these marks, which [`Marks::parse`] reads. Masks are part of the text.
    pub fn to_text(&self) -> Result<String> {
        let line = |mark: &Mark| serde_json::to_string(mark);
        let lines = self.all().iter().map(line).collect::<Result<Vec<_>, _>>();
        let lines = lines.map_err(|e| Error::input(format!("the marks cannot be written: {e}"), ""))?;
        Ok(format!("{{\"marks\": [\n{}\n]}}\n", lines.join(",\n")))
    }
}

/// Returns the DICOM files that the frames of a recording come from; empty if it comes from none, or is not
/// the one that marks are made on.
fn references(recording: &Sequence, canvas: &Canvas) -> Result<References> {
    let own = recording.canvas();
    let has_names = canvas.frame_names.is_empty() || canvas.frame_names == own.frame_names;
    if own.num_frames != canvas.num_frames || !has_names {
        return Ok(References::new());
    }
    Ok(recording.source_references()?.map(|sources| sources.by_file()).unwrap_or_default())
}

fn mark(i: usize, entry: &Value, folder: &Path, canvas: &Canvas) -> Result<Mark> {
    let name = entry.get("name").and_then(Value::as_str).unwrap_or_default();
    let frame = entry.get("frame").and_then(whole_number);
    let which = name_of(i, name, frame);
    let read_mask = |name: &str| mask(&folder.join(name), canvas);
    let mark = MarkEntry::of(entry).and_then(|entry| entry.mark(read_mask));
    mark.map_err(|problem| bad_mark(&which, &problem))
}

/// Returns `true` for a list of marks alone, which could be taken for one of Label Studio's tasks.
fn is_bare_list(bytes: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Keys {
        kind: Option<IgnoredAny>,
        points_px: Option<IgnoredAny>,
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let is_mark = |keys: &Keys| keys.kind.is_some() || keys.points_px.is_some();
    let is_list = bytes.first() == Some(&b'[');
    is_list && serde_json::from_slice::<Vec<Keys>>(bytes).is_ok_and(|entries| entries.iter().any(is_mark))
}

/// Reads a mask picture of the recording's size.
fn mask(path: &Path, canvas: &Canvas) -> Result<Mask, String> {
    let cannot = |e: Error| e.to_string();
    let (width, height) = picture_size(path).map_err(cannot)?;
    if (width, height) != (canvas.width, canvas.height) {
        let expected = format!("{}×{}", canvas.width, canvas.height);
        return Err(format!("its mask has {width}×{height} pixels, the frames have {expected}"));
    }
    let picture = picture(path).map_err(cannot)?;
    let values =
        opacity(&picture).unwrap_or_else(|| Grid::from_vec(width, height, picture.into_luma16().into_raw()));
    let highest = u32::from(values.data.iter().copied().max().unwrap_or(0)).max(1);
    Ok(values.map(|v| u32::from(*v) * 2 >= highest && *v > 0))
}

/// Replaces what is no finite number, NaN, infinities and numbers like 1e400, by null, so that the mark that
/// holds one can be named.
fn without_infinite(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut in_text) = (text, false);
    while let Some(c) = rest.chars().next() {
        let length = if in_text { 0 } else { length_of_infinite(rest) };
        if length > 0 {
            out.push_str("null");
            rest = &rest[length..];
            continue;
        }
        let mut taken = if in_text { c.len_utf8() } else { length_of_number(rest).max(c.len_utf8()) };
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

/// Returns the length of the number that is not finite at the beginning of a text; 0 if there is none.
fn length_of_infinite(text: &str) -> usize {
    if let Some(word) = ["NaN", "-Infinity", "Infinity"].into_iter().find(|word| text.starts_with(word)) {
        return word.len();
    }
    let number = &text[..length_of_number(text)];
    if number.parse::<f64>().is_ok_and(f64::is_infinite) { number.len() } else { 0 }
}

/// Returns the length of the number at the beginning of a text; 0 if there is none.
fn length_of_number(text: &str) -> usize {
    let is_part = |c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.' | 'e' | 'E');
    let starts = text.starts_with(|c: char| c.is_ascii_digit() || c == '-');
    if starts { text.find(|c: char| !is_part(c)).unwrap_or(text.len()) } else { 0 }
}
