//! Preparation from marks by hand: the marked pixels of marked frames have the embedding of the name.
//! Training carries them to all frames once the motion is learned.

use super::{
    NO_REGION, Origin, Prepared, RegionMap,
    background::{BACKGROUND, background_class},
    files::{AGAIN, Manifest, has_region, region_file, write_region_map},
    finish::{clear_folder, finish},
};
use crate::{
    Error, Result,
    codec::CodecSettings,
    files::write_whole,
    hash::{require_sha256, sha256},
    marks::{Evidence, Marks},
    meaning::EncoderIdentity,
    num,
    progress::{Observer, Progress},
    reading::{MOST_BYTES, read_regular},
    sequence::{Class, NO_LABEL, Sequence, class_colour},
};
use std::path::Path;

/// Stage of reading marks in its progress.
const STAGE: &str = "reading marks";
/// File of the marks in a prepared folder.
const MARKS: &str = "regions/marks.json";

/// Marks whose names are embedded.
#[derive(Clone, Debug)]
pub struct MarkedNames<'a> {
    /// The marks.
    pub marks: &'a Marks,
    /// The text encoder that made the embeddings.
    pub encoder: EncoderIdentity,
    /// One row for each of the marks' names, in their order. There may be one more, of [`super::BACKGROUND`].
    pub embeddings: &'a [Vec<f32>],
}

/// Prepares a recording from marks. Frames held out by `eval` leave no trace, their marks neither.
pub fn prepare_from_marks(
    sequence: Sequence,
    MarkedNames { marks, encoder, embeddings }: MarkedNames<'_>,
    eval: bool,
    settings: &CodecSettings,
    folder: &Path,
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    require_marks(&sequence, marks, eval, observer)?;
    let names = marks.names();
    let frames = marked_frames(&sequence, marks, eval);
    let mut pixels = vec![0_u64; names.len()];
    for (done, &frame) in frames.iter().enumerate() {
        // It is made again when it is written: maps of thousands of frames would fill the memory.
        let map = region_map(&sequence, marks, frame, &names)?;
        for row in map.data.iter().filter(|row| **row != NO_REGION) {
            pixels[usize::from(*row)] += 1;
        }
        Progress::new(STAGE, done + 1, frames.len()).tell(observer)?;
    }
    let present: Vec<usize> = (0..names.len()).filter(|k| pixels[*k] > 0).collect();
    if present.len() > usize::from(NO_LABEL) {
        let hint = format!("At most {NO_LABEL} can be marked.");
        return Err(Error::input(format!("there are more than {NO_LABEL} names"), hint));
    }
    clear_folder(folder, &sequence)?;
    let mut manifest = Manifest::of(&sequence, folder, eval, encoder, settings)?;
    manifest.origin = Origin::Marks;
    let class = |(id, k): (usize, &usize)| {
        let (id, name) = (id as u8, names[*k].clone());
        Class { id, name, colour: class_colour(usize::from(id)) }
    };
    manifest.classes = present.iter().enumerate().map(class).collect();
    manifest.row_pixels = present.iter().map(|k| pixels[*k]).collect();
    let adds_background = embeddings.len() > names.len() && !names.iter().any(|name| name == BACKGROUND);
    if adds_background {
        // Where it lies is known once the marks are carried: it weighs as much as all names together.
        manifest.row_pixels.push(manifest.row_pixels.iter().sum());
        manifest.classes.push(background_class());
    }
    let row_of = |k: u16| present.iter().position(|p| *p == usize::from(k)).map_or(NO_REGION, |r| r as u16);
    for (done, &frame) in frames.iter().enumerate() {
        let map = region_map(&sequence, marks, frame, &names)?.map(|k| row_of(*k));
        let sha256 = write_region_map(&folder.join(region_file(frame)), map)?;
        manifest.region_frames.push(frame);
        manifest.sha256.insert(region_file(frame), sha256);
        Progress::new("writing features", done + 1, frames.len()).tell(observer)?;
    }
    let seen = marks.filtered(|mark| frames.binary_search(&mark.frame).is_ok()).to_text()?;
    write_whole(&folder.join(MARKS), seen.as_bytes())?;
    manifest.sha256.insert(MARKS.to_owned(), sha256(seen.as_bytes()));
    let mut rows = Vec::new();
    for k in present.into_iter().chain(adds_background.then_some(names.len())) {
        let row = embeddings.get(k).and_then(|row| num::normalised(row));
        let row = row.filter(|row| row.len() == manifest.encoder.dim).ok_or_else(|| {
            let name = names.get(k).map_or(BACKGROUND, String::as_str);
            let what = format!("the embedding of \"{name}\" is no unit vector");
            Error::input(what, "Check the text encoder.")
        })?;
        rows.extend(row);
    }
    finish(manifest, rows, settings, folder, observer)?;
    Prepared::open(folder)
}

/// Fails if no pixel of training frames is marked. Reads frames until one is.
pub fn require_marks(
    sequence: &Sequence,
    marks: &Marks,
    eval: bool,
    observer: &mut Observer<'_>,
) -> Result<()> {
    let names = marks.names();
    let frames = marked_frames(sequence, marks, eval);
    for (done, &frame) in frames.iter().enumerate() {
        if has_region(&region_map(sequence, marks, frame, &names)?) {
            return Ok(());
        }
        Progress::new(STAGE, done + 1, frames.len()).tell(observer)?;
    }
    Err(nothing_marked(sequence, marks, eval))
}

/// Creates the error about marks that show nothing on the training frames, with the reason.
fn nothing_marked(sequence: &Sequence, marks: &Marks, eval: bool) -> Error {
    let used = sequence.used_frames(eval);
    let counts = |frame: usize| used.binary_search(&frame).is_ok();
    let notes = marks.notes(&sequence.canvas(), sequence.field_of_view(), counts);
    let shows_some = marks.all().iter().any(|mark| mark.add && counts(mark.frame));
    let (why, hint): (String, &str) = match notes.is_empty() {
        _ if !marks.all().iter().any(|mark| counts(mark.frame)) => {
            ("all marked frames are held out".into(), "Mark frames that are not.")
        }
        false => (notes.join("; "), "Mark what the endoscope shows."),
        true if shows_some => {
            ("the masks of the recording hide what is marked".into(), "Mark what these masks keep.")
        }
        true => ("all marks say what is not there".into(), "Mark what is there, too."),
    };
    let what = format!("no pixel of the training frames is marked: {why}");
    Error::input_at(sequence.path(), what, hint)
}

/// Returns the frames with marks that training may see.
fn marked_frames(sequence: &Sequence, marks: &Marks, eval: bool) -> Vec<usize> {
    let used = sequence.used_frames(eval);
    marks.frames().into_iter().filter(|frame| used.binary_search(frame).is_ok()).collect()
}

/// Returns the place among `names` of what each supervised pixel is marked as. Pixels that several names
/// share belong to none.
fn region_map(sequence: &Sequence, marks: &Marks, frame: usize, names: &[String]) -> Result<RegionMap> {
    let (width, height) = (sequence.width(), sequence.height());
    let evidence = Evidence::of(marks, frame, names, [width, height]);
    let keep = sequence.mask(frame)?;
    let mut map = RegionMap::filled(width, height, NO_REGION);
    for (pixels, shown) in evidence.all_shown() {
        if let [name] = shown[..] {
            pixels.filter(|i| keep.data[*i]).for_each(|i| map.data[i] = name as u16);
        }
    }
    Ok(map)
}

impl Prepared {
    /// Returns the marks that the folder was prepared from. `None` if features come from elsewhere.
    pub(crate) fn marks(&self) -> Result<Option<Marks>> {
        if self.origin != Origin::Marks {
            return Ok(None);
        }
        let path = self.folder.join(MARKS);
        let Some(expected) = self.sha256.get(MARKS) else {
            return Err(Error::input_at(
                &path,
                "the marks that the folder was prepared from are missing",
                AGAIN,
            ));
        };
        let bytes = read_regular(&path, MOST_BYTES).map_err(|e| Error::io("read the marks", &path, e))?;
        require_sha256(&path, &bytes, expected, AGAIN)?;
        Marks::parse(&bytes, &self.folder, &self.sequence.canvas()).map(Some)
    }
}
