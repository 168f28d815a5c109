//! Segmentations of 3-D Slicer (`.seg.nrrd`): a volume of x, y and frame, with layers where segments overlap.
//! Slicer saves the part of the volume that is not empty; its place is in the header.

use super::{Annotation, Canvas, Shape};
use crate::{Error, Result, grid::Mask, mask::Runs};
use flate2::read::GzDecoder;
use std::{collections::BTreeMap, io::Read, sync::Arc};

/// Largest number of runs in all masks: a million masks with a border like a coast do not have as many. Few
/// bytes can unpack to any number of them.
const MOST_RUNS: usize = 1 << 26;
/// Largest number of layers.
const MOST_LAYERS: usize = 255;

/// Returns the annotations of a segmentation.
pub(super) fn read(bytes: &[u8], canvas: &Canvas) -> Result<Vec<Annotation>> {
    let (header, data) = Header::split(bytes).ok_or_else(|| malformed("its header has no end"))?;
    let volume = Volume::of(&header, canvas)?;
    let mut data: Box<dyn Read + '_> = match header.field("encoding")? {
        "raw" => Box::new(data),
        "gzip" | "gz" => Box::new(GzDecoder::new(data)),
        other => return Err(malformed(format!("its encoding is \"{other}\""))),
    };
    let mut slice = vec![0; volume.layers * volume.width * volume.height * volume.bytes];
    let (mut found, mut num_runs) = (Vec::new(), 0);
    for z in 0..volume.depth {
        data.read_exact(&mut slice).map_err(|e| malformed(format!("its voxels cannot be read: {e}")))?;
        for segment in &volume.segments {
            let part = volume.part(segment, &slice);
            if !part.data.contains(&true) {
                continue;
            }
            let frame = (volume.first_frame + z) as usize;
            let runs = Runs::placed(&part, volume.corner, (canvas.width, canvas.height));
            num_runs += runs.lengths().len();
            if frame >= canvas.num_frames || num_runs > MOST_RUNS {
                return Err(malformed("it has more frames or borders than the recording can have"));
            }
            let (name, shape) = (segment.name.clone(), Shape::Mask(Arc::new(runs)));
            found.push(Annotation { frame, name, shape });
        }
    }
    Ok(found)
}

fn malformed(what: impl std::fmt::Display) -> Error {
    let hint = "It is a .seg.nrrd whose third axis counts the frames of the recording.";
    Error::input(format!("this is no segmentation of 3D Slicer that can be read: {what}"), hint)
}

/// Fields and keys of the header.
struct Header(BTreeMap<String, String>);

impl Header {
    fn split(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let mut lines = BTreeMap::new();
        let mut rest = bytes;
        loop {
            let end = rest.iter().position(|byte| *byte == b'\n')?;
            let line = String::from_utf8_lossy(&rest[..end]);
            let line = line.trim_end_matches('\r');
            rest = &rest[end + 1..];
            if line.is_empty() {
                return Some((Self(lines), rest));
            }
            let pair = line.split_once(":=").or_else(|| line.split_once(": "));
            if let Some((name, value)) = pair.filter(|_| !line.starts_with('#')) {
                lines.insert(name.trim().to_owned(), value.trim().to_owned());
            }
        }
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    fn field(&self, name: &str) -> Result<&str> {
        self.get(name).ok_or_else(|| malformed(format!("its header has no \"{name}\"")))
    }

    /// Returns the whole numbers of a field.
    fn numbers(&self, name: &str) -> Result<Vec<u32>> {
        let text = self.field(name)?;
        let numbers: Result<Vec<u32>, _> = text.split_whitespace().map(str::parse).collect();
        numbers.map_err(|_| malformed(format!("{name} is \"{text}\"")))
    }
}

struct Segment {
    name: String,
    layer: usize,
    value: u16,
}

/// Layout of the voxels, fastest axis first: layer, x, y, frame.
struct Volume {
    layers: usize,
    width: usize,
    height: usize,
    depth: u32,
    /// Bytes per voxel.
    bytes: usize,
    is_big_endian: bool,
    /// Place of the first voxel in a frame.
    corner: (usize, usize),
    first_frame: u32,
    segments: Vec<Segment>,
}

impl Volume {
    fn of(header: &Header, canvas: &Canvas) -> Result<Self> {
        let (layers, [width, height, depth]) = match header.numbers("sizes")?[..] {
            [width, height, depth] => (1, [width, height, depth]),
            [layers, width, height, depth] => (layers as usize, [width, height, depth]),
            _ => return Err(malformed("it has neither three axes nor four")),
        };
        let [left, top, first] = match header.get("Segmentation_ReferenceImageExtentOffset") {
            None => [0; 3],
            Some(_) => <[u32; 3]>::try_from(header.numbers("Segmentation_ReferenceImageExtentOffset")?)
                .map_err(|_| malformed("its offset has not three numbers"))?,
        };
        let first_frame = match header.get("first_frame") {
            None => first,
            Some(_) => header.numbers("first_frame")?.first().map_or(first, |f| f.saturating_add(first)),
        };
        let fits = |at: u32, size: u32, whole: usize| u64::from(at) + u64::from(size) <= whole as u64;
        let is_inside = fits(left, width, canvas.width)
            && fits(top, height, canvas.height)
            && fits(first_frame, depth, canvas.num_frames);
        if !is_inside || layers > MOST_LAYERS {
            let what = format!(
                "{width}×{height}×{depth} voxels at ({left}, {top}, {first_frame}) do not fit into {} frames of {}×{}",
                canvas.num_frames, canvas.width, canvas.height
            );
            return Err(malformed(what));
        }
        Ok(Self {
            layers,
            width: width as usize,
            height: height as usize,
            depth,
            bytes: voxel_bytes(header.field("type")?)?,
            is_big_endian: header.get("endian") == Some("big"),
            corner: (left as usize, top as usize),
            first_frame,
            segments: segments(header, layers)?,
        })
    }

    /// Returns the pixels of a segment in a slice of the volume.
    fn part(&self, segment: &Segment, slice: &[u8]) -> Mask {
        let voxels = slice.chunks_exact(self.bytes).skip(segment.layer).step_by(self.layers.max(1));
        let value = |voxel: &[u8]| match *voxel {
            [low] => u16::from(low),
            [a, b] if self.is_big_endian => u16::from_be_bytes([a, b]),
            [a, b] => u16::from_le_bytes([a, b]),
            _ => 0,
        };
        Mask::from_vec(self.width, self.height, voxels.map(|voxel| value(voxel) == segment.value).collect())
    }
}

fn voxel_bytes(kind: &str) -> Result<usize> {
    match kind {
        "unsigned char" | "uchar" | "uint8" | "uint8_t" | "signed char" | "int8" | "int8_t" => Ok(1),
        "short" | "signed short" | "short int" | "int16" | "int16_t" | "unsigned short" | "ushort"
        | "uint16" | "uint16_t" => Ok(2),
        other => Err(malformed(format!("its voxels are of the type \"{other}\""))),
    }
}

fn segments(header: &Header, layers: usize) -> Result<Vec<Segment>> {
    let number = |i: usize, what: &str, otherwise: usize| {
        let text = header.get(&format!("Segment{i}_{what}"));
        let number = text.map_or(Ok(otherwise), |text| text.parse());
        number.map_err(|_| malformed(format!("Segment{i}_{what} is no number")))
    };
    let whole = header.get("segment_names").and_then(|json| serde_json::from_str(json).ok());
    let whole: Vec<String> = whole.unwrap_or_default();
    let mut segments = Vec::new();
    while let Some(name) = header.get(&format!("Segment{}_Name", segments.len())) {
        let i = segments.len();
        let (layer, value) = (number(i, "Layer", 0)?, number(i, "LabelValue", i + 1)?);
        let value = u16::try_from(value).ok().filter(|value| *value > 0 && layer < layers);
        let value = value.ok_or_else(|| malformed(format!("segment {i} is in no layer, or has no label")))?;
        segments.push(Segment { name: with_letters(unescaped(name), whole.get(i)), layer, value });
    }
    if segments.is_empty() { Err(malformed("it names no segment")) } else { Ok(segments) }
}

/// Returns the name of a segment, with the letters that programs like pynrrd dropped when they wrote the file
/// again. A name that was changed on purpose stays as it is.
fn with_letters(name: String, whole: Option<&String>) -> String {
    let in_ascii = |whole: &String| whole.chars().filter(char::is_ascii).collect::<String>();
    whole.filter(|whole| in_ascii(whole).trim() == name).map_or(name, |whole| whole.trim().to_owned())
}

/// Returns the text of a value whose line breaks and backslashes are escaped.
fn unescaped(value: &str) -> String {
    let mut text = String::with_capacity(value.len());
    let mut letters = value.chars();
    while let Some(c) = letters.next() {
        match (c, letters.clone().next()) {
            ('\\', Some(escaped @ ('n' | '\\'))) => {
                text.push(if escaped == 'n' { '\n' } else { '\\' });
                letters.next();
            }
            _ => text.push(c),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_are_undone_once() {
        let pairs = [(r"a\nb", "a\nb"), (r"C:\\new", r"C:\new"), (r"\t\", r"\t\"), (r"\\\n:=", "\\\n:=")];
        for (written, read) in pairs {
            assert_eq!(unescaped(written), read);
        }
    }

    #[test]
    fn letters_that_were_dropped_come_back() {
        let whole = "Gallenblase ü".to_owned();
        let name = |written: &str| with_letters(written.into(), Some(&whole));
        assert_eq!((name("Gallenblase"), name("Gallenblase ü")), (whole.clone(), whole.clone()));
        assert_eq!((name("Leber"), with_letters("Leber".into(), None)), ("Leber".into(), "Leber".into()));
    }
}
