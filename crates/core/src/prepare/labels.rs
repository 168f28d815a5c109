//! Features from label masks: every pixel gets the embedding of its class name.

use super::{
    NO_REGION, Prepared, RegionMap,
    background::{BACKGROUND, background_class, fill_background, is_more_than_gaps},
    files::{Manifest, has_region, region_file, write_region_map},
    finish::{clear_folder, finish},
};
use crate::{
    Error, Remedy, Result,
    codec::CodecSettings,
    meaning::EncoderIdentity,
    num,
    progress::{Observer, Progress},
    sequence::{NO_LABEL, Sequence},
};
use rayon::prelude::*;
use std::path::Path;

/// Stage of reading labels in its progress.
const STAGE: &str = "reading labels";
/// Number of frames read at once; progress is reported in between.
const FRAMES_AT_ONCE: usize = 8;

/// Turns label masks into features: every pixel gets the embedding of its class name. `embeddings` has
/// one unit row per class of the sequence, and may have one more, of [`super::BACKGROUND`]. Frames held
/// out by `eval` leave no trace.
///
/// Pixels outside the supervision mask get no feature. Pixels without a label get that of the background,
/// where labels leave more than gaps and no class has this name. A class that training frames do
/// not show gets no row, but is kept by name. `folder` is created; a prepared folder is overwritten, any
/// other that is not empty is refused.
pub fn prepare_from_labels(
    sequence: Sequence,
    encoder: EncoderIdentity,
    embeddings: &[Vec<f32>],
    eval: bool,
    settings: &CodecSettings,
    folder: &Path,
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    let embeddings = checked_embeddings(&sequence, &encoder, embeddings)?;
    require_labels(&sequence, eval, observer)?;
    let frames = sequence.used_frames(eval);
    let has_background = sequence.classes().iter().any(|class| class.name == BACKGROUND);
    let may_add_background = embeddings.len() > sequence.classes().len() && !has_background;
    let (pixels, unnamed) = count_pixels(&sequence, &frames, may_add_background, observer)?;
    let adds_background = may_add_background && is_more_than_gaps(unnamed, pixels.iter().sum());
    let present = present(&pixels, sequence.width() * sequence.height());
    clear_folder(folder, &sequence)?;
    let mut manifest = Manifest::of(&sequence, folder, eval, encoder, settings)?;
    manifest.classes = present.iter().map(|&k| sequence.classes()[k].clone()).collect();
    manifest.row_pixels = present.iter().map(|&k| pixels[k]).collect();
    if adds_background {
        manifest.classes.push(background_class());
        manifest.row_pixels.push(unnamed);
    }
    let unseen = (0..pixels.len()).filter(|k| !present.contains(k));
    manifest.words.unseen = unseen.map(|k| sequence.classes()[k].name.clone()).collect();

    let rows = Rows::of(&sequence, &present, adds_background);
    let write = |&i: &usize| -> Result<Option<(usize, String)>> {
        let Some(map) = region_map(&sequence, i, &rows)? else { return Ok(None) };
        Ok(Some((i, write_region_map(&folder.join(region_file(i)), map)?)))
    };
    for (done, part) in frames.chunks(FRAMES_AT_ONCE).enumerate() {
        let written: Vec<_> = part.par_iter().map(write).collect::<Result<_>>()?;
        for (i, sha256) in written.into_iter().flatten() {
            manifest.region_frames.push(i);
            manifest.sha256.insert(region_file(i), sha256);
        }
        let done = done * FRAMES_AT_ONCE + part.len();
        Progress::new("writing features", done, frames.len()).tell(observer)?;
    }

    let background = adds_background.then_some(pixels.len());
    let rows =
        present.iter().copied().chain(background).flat_map(|k| embeddings[k].iter().copied()).collect();
    finish(manifest, rows, settings, folder, observer)?;
    Prepared::open(folder)
}

/// Fails if no pixel of training frames has a label inside the supervision mask. Reads frames until one has.
pub fn require_labels(sequence: &Sequence, eval: bool, observer: &mut Observer<'_>) -> Result<()> {
    let rows = Rows::of_all(sequence, false);
    let frames = sequence.used_frames(eval);
    for (done, &i) in frames.iter().enumerate() {
        if region_map(sequence, i, &rows)?.is_some_and(|map| has_region(&map)) {
            return Ok(());
        }
        Progress::new(STAGE, done + 1, frames.len()).tell(observer)?;
    }
    let what = "no pixel of the training frames has a label inside the supervision mask";
    let hint = Remedy::CheckRecording.after("Check the label masks and the polarity of the masks.");
    Err(Error::input_at(sequence.path(), what, hint))
}

/// Share of one picture that the pixels of a class in all training frames must come to. Fewer are mistakes of
/// labelling: single pixels along the borders of other classes.
const LEAST_SHARE: f64 = 0.0005;

/// Classes that training frames show: those with enough pixels, or with any if none has enough.
fn present(pixels: &[u64], picture_px: usize) -> Vec<usize> {
    let with =
        |least: f64| (0..pixels.len()).filter(|&k| pixels[k] > 0 && pixels[k] as f64 >= least).collect();
    let enough: Vec<usize> = with(LEAST_SHARE * picture_px as f64);
    if enough.is_empty() { with(0.0) } else { enough }
}

/// Checks that there is one unit row per class of the sequence, and one more at most, as long as the encoder
/// says.
fn checked_embeddings(
    sequence: &Sequence,
    encoder: &EncoderIdentity,
    embeddings: &[Vec<f32>],
) -> Result<Vec<Vec<f32>>> {
    let classes = sequence.classes();
    if classes.is_empty() {
        return Err(Error::input_at(
            sequence.path(),
            "the recording has no label masks",
            "Give it labels, or prepare it with image masks and an image encoder.",
        ));
    }
    if embeddings.len() != classes.len() && embeddings.len() != classes.len() + 1 {
        return Err(Error::input(
            format!("{} classes need as many embeddings, found {}", classes.len(), embeddings.len()),
            "",
        ));
    }
    let unit = |(name, row): (&str, &Vec<f32>)| {
        num::normalised(row).filter(|r| r.len() == encoder.dim).ok_or_else(|| {
            Error::input(
                format!(
                    "the embedding of \"{}\" has {} numbers or no direction; expected {} finite numbers",
                    name,
                    row.len(),
                    encoder.dim
                ),
                "Check the text encoder.",
            )
        })
    };
    let names = classes.iter().map(|class| &*class.name).chain([BACKGROUND]);
    names.zip(embeddings).map(unit).collect()
}

/// Counts the pixels of each class over `frames`, in the order of the sequence's classes, and those of the
/// background.
fn count_pixels(
    sequence: &Sequence,
    frames: &[usize],
    with_background: bool,
    observer: &mut Observer<'_>,
) -> Result<(Vec<u64>, u64)> {
    let num_classes = sequence.classes().len();
    let rows = Rows::of_all(sequence, with_background);
    let mut pixels = vec![0_u64; num_classes + 1];
    for (done, part) in frames.chunks(FRAMES_AT_ONCE).enumerate() {
        let maps: Vec<_> = part.par_iter().map(|&i| region_map(sequence, i, &rows)).collect::<Result<_>>()?;
        for row in maps.iter().flatten().flat_map(|m| &m.data).filter(|&&row| row != NO_REGION) {
            pixels[usize::from(*row)] += 1;
        }
        let done = done * FRAMES_AT_ONCE + part.len();
        Progress::new(STAGE, done, frames.len()).tell(observer)?;
    }
    let unnamed = pixels.pop().unwrap_or_default();
    Ok((pixels, unnamed))
}

/// Rows of the feature table.
struct Rows {
    by_id: [u16; 256],
    /// Row of the background, if it has one.
    background: Option<u16>,
}

impl Rows {
    /// Takes the classes `present`: row k is the class `present[k]`. The background comes last.
    fn of(sequence: &Sequence, present: &[usize], with_background: bool) -> Self {
        let mut by_id = [NO_REGION; 256];
        for (row, &class) in present.iter().enumerate() {
            by_id[usize::from(sequence.classes()[class].id)] = row as u16;
        }
        by_id[usize::from(NO_LABEL)] = NO_REGION;
        Self { by_id, background: with_background.then_some(present.len() as u16) }
    }

    /// Takes all classes.
    fn of_all(sequence: &Sequence, with_background: bool) -> Self {
        let all: Vec<usize> = (0..sequence.classes().len()).collect();
        Self::of(sequence, &all, with_background)
    }
}

/// Returns the region map of frame `i`; `None` if the frame has no labels.
fn region_map(sequence: &Sequence, i: usize, rows: &Rows) -> Result<Option<RegionMap>> {
    let Some(labels) = sequence.labels(i)? else { return Ok(None) };
    let keep = sequence.mask(i)?;
    let sizes = [(labels.width, labels.height), (keep.width, keep.height)];
    if sizes.iter().any(|&s| s != (sequence.width(), sequence.height())) {
        return Err(Error::input_at(
            sequence.path(),
            format!(
                "labels ({}×{}) or mask ({}×{}) of frame {i} differ in size from the pictures",
                sizes[0].0, sizes[0].1, sizes[1].0, sizes[1].1
            ),
            Remedy::CheckRecording,
        ));
    }
    let row = |(&label, &keep): (&u8, &bool)| if keep { rows.by_id[usize::from(label)] } else { NO_REGION };
    let data = labels.data.iter().zip(&keep.data).map(row).collect();
    let mut map = RegionMap::from_vec(labels.width, labels.height, data);
    if let Some(row) = rows.background {
        fill_background(&mut map, &keep, row);
    }
    Ok(Some(map))
}
