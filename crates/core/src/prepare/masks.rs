//! Features of image regions: from automatic masks with an image encoder, or from files of other programs.

use super::{
    NO_REGION, Origin, Prepared, RegionMap,
    dense::{MAX_ROWS, cluster},
    files::{Manifest, region_file, write_region_map},
    finish::{clear_folder, finish},
    kept::{self, digest},
};
use crate::{
    Error, Remedy, Result,
    codec::CodecSettings,
    grid::Mask,
    meaning::EncoderIdentity,
    num,
    progress::{Observer, Progress},
    segment::{BitMask, FINDING_MASKS, FrameMasks, Level, MaskSettings, PointSegmenter, automatic_masks},
    sequence::{Sequence, settings_name},
};
use image::RgbImage;
use ndarray::{Array2, ArrayView1, Axis};
use std::{
    ops::Range,
    path::{Path, PathBuf},
};

/// The features of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameFeatures {
    /// Number of the embedding per pixel; [`NO_REGION`] where there is none.
    pub regions: RegionMap,
    /// Embeddings; they are scaled to unit length here.
    pub rows: Vec<Vec<f32>>,
}

/// Turns regions with embeddings into a prepared folder. `features` is called for every frame that is not
/// held out, in order; `None` is a frame without features. `encoder` is the text encoder whose embeddings
/// the rows are compared with.
///
/// Pixels outside the supervision mask get no feature, and embeddings that no pixel shows get no row. There
/// are at most as many rows as 16 bits can number: each frame has its share of those that are left, and where
/// it has more regions, those with nearly the same embeddings are merged.
/// Fails if a frame's regions have another size or point beyond their rows, if rows are not finite or
/// have another length than the text encoder's, and if there are more frames than rows.
/// `folder` is treated as by [`super::prepare_from_labels`].
#[expect(clippy::too_many_arguments, reason = "each is another thing, and there is one caller a kind")]
pub fn prepare_from_features(
    sequence: Sequence,
    encoder: EncoderIdentity,
    origin: Origin,
    features: &mut dyn FnMut(usize) -> Result<Option<FrameFeatures>>,
    eval: bool,
    settings: &CodecSettings,
    folder: &Path,
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    require_few_frames(&sequence, eval)?;
    clear_folder(folder, &sequence)?;
    let mut manifest = Manifest::of(&sequence, folder, eval, encoder, settings)?;
    manifest.origin = origin;
    let mut table = Vec::new();
    let frames = sequence.used_frames(eval);
    for (done, &i) in frames.iter().enumerate() {
        Progress::new("writing features", done, frames.len()).tell(observer)?;
        let Some(found) = features(i)? else { continue };
        let first = manifest.row_pixels.len();
        let most = share(first, frames.len() - done);
        let found = numbered(&sequence, i, found, first..first + most, manifest.encoder.dim)?;
        table.extend(found.table);
        manifest.row_pixels.extend(found.pixels);
        manifest.merged_frames += usize::from(found.is_merged);
        let sha256 = write_region_map(&folder.join(region_file(i)), found.map)?;
        manifest.region_frames.push(i);
        manifest.sha256.insert(region_file(i), sha256);
    }
    if manifest.row_pixels.is_empty() {
        return Err(Error::input_at(
            sequence.path(),
            "no region of the training frames lies inside the supervision mask",
            Remedy::CheckRecording.after("Check the polarity of the masks."),
        ));
    }
    finish(manifest, table, settings, folder, observer)?;
    Prepared::open(folder)
}

/// Fails if a recording has more frames than the feature table can have rows.
pub fn require_few_frames(sequence: &Sequence, eval: bool) -> Result<()> {
    let n = sequence.used_frames(eval).len();
    if n <= MAX_ROWS {
        return Ok(());
    }
    let what = format!("the recording has {n} frames; regions of at most {MAX_ROWS} can be told apart");
    let hint = format!("Prepare a part of it (`[frames]` in {}).", settings_name(sequence.path()));
    Err(Error::input_at(sequence.path(), what, hint))
}

/// Returns the number of rows that the next of `num_left` frames may have if others have `rows` already; at
/// least one, unless there were more frames than rows.
pub(super) fn share(rows: usize, num_left: usize) -> usize {
    (MAX_ROWS - rows) / num_left
}

/// The regions of a frame as rows of the feature table.
pub(super) struct Numbered {
    /// Row per pixel.
    pub(super) map: RegionMap,
    /// The rows, flat and of unit length.
    pub(super) table: Vec<f32>,
    /// Number of pixels of each row.
    pub(super) pixels: Vec<u64>,
    /// `true` if several regions share a row.
    pub(super) is_merged: bool,
}

/// Numbers the regions of frame `i` with `numbers`. If there are more regions, those with nearly the same
/// embeddings are merged.
pub(super) fn numbered(
    sequence: &Sequence,
    i: usize,
    features: FrameFeatures,
    numbers: Range<usize>,
    dim: usize,
) -> Result<Numbered> {
    let FrameFeatures { regions: mut map, rows } = features;
    let wrong = |what: String, hint: &str| {
        Error::input_at(sequence.path(), format!("frame {}: {what}", sequence.frame_name(i)), hint)
    };
    let region_pixels = count_pixels(&mut map, &sequence.mask(i)?, rows.len(), &wrong)?;
    let shown: Vec<usize> = (0..rows.len()).filter(|k| region_pixels[*k] > 0).collect();
    let mut embeddings = Array2::zeros((shown.len(), dim));
    for (&k, mut embedding) in shown.iter().zip(embeddings.outer_iter_mut()) {
        let unit = num::normalised(&rows[k]).filter(|row| row.len() == dim).ok_or_else(|| {
            let what = format!(
                "embedding {k} has {} numbers or no direction; the text encoder's have {dim}",
                rows[k].len()
            );
            wrong(what, "Image and text encoder must be halves of the same model.")
        })?;
        embedding.assign(&ArrayView1::from(&unit));
    }
    let (clusters, means) = cluster(embeddings.view(), numbers.len());
    let mut pixels = vec![0; means.nrows()];
    shown.iter().zip(&clusters).for_each(|(k, cluster)| pixels[*cluster] += region_pixels[*k]);
    // A cluster may have lost all its regions.
    let kept: Vec<usize> = (0..pixels.len()).filter(|cluster| pixels[*cluster] > 0).collect();
    let mut number_of = vec![NO_REGION; rows.len()];
    for (k, cluster) in shown.iter().zip(clusters) {
        number_of[*k] = (numbers.start + kept.partition_point(|other| *other < cluster)) as u16;
    }
    for region in map.data.iter_mut().filter(|region| **region != NO_REGION) {
        *region = number_of[usize::from(*region)];
    }
    Ok(Numbered {
        map,
        table: means.select(Axis(0), &kept).into_iter().collect(),
        pixels: kept.iter().map(|cluster| pixels[*cluster]).collect(),
        is_merged: shown.len() > numbers.len(),
    })
}

/// Counts the pixels of each of `num` regions of a frame inside the supervision mask `keep`; those outside
/// are taken from the map. `wrong` makes an error of what is wrong, and a hint.
fn count_pixels(
    map: &mut RegionMap,
    keep: &Mask,
    num: usize,
    wrong: &dyn Fn(String, &str) -> Error,
) -> Result<Vec<u64>> {
    if (map.width, map.height) != (keep.width, keep.height) {
        let what = format!(
            "its regions are {}×{}, the picture is {}×{}",
            map.width, map.height, keep.width, keep.height
        );
        return Err(wrong(what, "Make the regions from these very pictures."));
    }
    let mut pixels = vec![0_u64; num];
    for (region, keep) in map.data.iter_mut().zip(&keep.data) {
        match pixels.get_mut(usize::from(*region)) {
            _ if !keep || *region == NO_REGION => *region = NO_REGION,
            Some(pixels) => *pixels += 1,
            None => return Err(wrong(format!("a pixel points to embedding {region} of {num}"), "")),
        }
    }
    Ok(pixels)
}

/// The subfolders of a prepared folder that hold minutes of work per frame. Each file is stored with a
/// key of everything it was made from.
pub const MASKS_AND_EMBEDDINGS: [&str; 2] = ["masks", EMBEDDINGS];
/// Subfolder of embeddings, and name of their table in a file.
const EMBEDDINGS: &str = "embeddings";

/// Masks and embeddings of frames, made if they are not on disk already.
pub struct MaskStore<'a> {
    /// The recording.
    pub sequence: &'a Sequence,
    /// The prepared folder that holds them.
    pub folder: &'a Path,
    /// Settings of the mask generation.
    pub settings: &'a MaskSettings,
    /// SHA-256 of the models that make them.
    pub model: &'a str,
}

/// Makes embeddings of the contents of masks on an image.
pub type Embed<'a> = dyn FnMut(&RgbImage, &[&BitMask]) -> Result<Vec<Vec<f32>>> + 'a;

impl MaskStore<'_> {
    /// Makes the masks of all frames that have none yet; `eval` leaves out those held out. If the observer
    /// asks to stop, the error is [`Error::Cancelled`], and finished masks are used the next time.
    pub fn make_masks(
        &self,
        segmenter: &mut dyn PointSegmenter,
        eval: bool,
        observer: &mut Observer<'_>,
    ) -> Result<()> {
        // The folder is marked as ours before hours of work go into it.
        clear_folder(self.folder, self.sequence)?;
        let frames = self.sequence.used_frames(eval);
        for (done, &i) in frames.iter().enumerate() {
            let image = self.sequence.frame(i)?;
            let key = self.key(i, &image)?;
            if FrameMasks::load(&self.mask_file(i), &key)?.is_some() {
                continue;
            }
            let keep = self.sequence.mask(i)?;
            let mut within = |of_frame: &Progress<'_>| {
                let detail = format!("point {} of {}", of_frame.done, of_frame.total);
                observer(&Progress { detail: &detail, ..Progress::new(FINDING_MASKS, done, frames.len()) })
            };
            automatic_masks(segmenter, &image, &keep, self.settings, &mut within)?
                .save(&self.mask_file(i), &key)?;
        }
        Progress::new(FINDING_MASKS, frames.len(), frames.len()).tell(observer)
    }

    /// Returns the features of frame `i` from its masks of `level`, which must have been made. `encoder`
    /// is the SHA-256 of the image encoder.
    pub fn features(
        &self,
        i: usize,
        level: Level,
        encoder: &str,
        embed: &mut Embed<'_>,
    ) -> Result<Option<FrameFeatures>> {
        let image = self.sequence.frame(i)?;
        let key = self.key(i, &image)?;
        let Some(masks) = FrameMasks::load(&self.mask_file(i), &key)? else {
            let what = "the masks of a frame were removed while they were in use";
            return Err(Error::input_at(self.mask_file(i), what, "Prepare the recording again."));
        };
        let found = masks.level(level);
        if found.is_empty() {
            return Ok(None);
        }
        let path = self.embeddings_file(i, level);
        let key =
            digest(&[b"embeddings 1", key.as_bytes(), format!("{level:?}").as_bytes(), encoder.as_bytes()]);
        let rows = match kept::load(&path, &key, EMBEDDINGS)? {
            Some(table) if table.nrows() == found.len() => {
                table.outer_iter().map(|row| row.to_vec()).collect()
            }
            _ => {
                let rows = embed(&image, &found.iter().map(|f| &f.mask).collect::<Vec<_>>())?;
                let shape = (rows.len(), rows.first().map_or(0, Vec::len));
                let table = Array2::from_shape_vec(shape, rows.concat()).map_err(|e| {
                    Error::input_at(&path, format!("the embeddings cannot be tabulated: {e}"), "")
                })?;
                kept::save(&path, &key, EMBEDDINGS, table.view())?;
                rows
            }
        };
        let regions = masks.painted(level).map(|number| number.unwrap_or(NO_REGION));
        Ok(Some(FrameFeatures { regions, rows }))
    }

    /// Returns the masks of frame `i`, if they were made.
    pub fn masks(&self, i: usize) -> Result<Option<FrameMasks>> {
        FrameMasks::load(&self.mask_file(i), &self.key(i, &self.sequence.frame(i)?)?)
    }

    fn mask_file(&self, i: usize) -> PathBuf {
        self.folder.join(MASKS_AND_EMBEDDINGS[0]).join(format!("frame_{i:06}.json"))
    }

    fn embeddings_file(&self, i: usize, level: Level) -> PathBuf {
        let level = format!("{level:?}").to_lowercase();
        self.folder.join(MASKS_AND_EMBEDDINGS[1]).join(format!("frame_{i:06}_{level}.safetensors"))
    }

    /// Returns a key of everything that the masks of frame `i` depend on.
    fn key(&self, i: usize, image: &RgbImage) -> Result<String> {
        let settings = serde_json::to_vec(self.settings).unwrap_or_default();
        let keep: Vec<u8> = self.sequence.mask(i)?.data.iter().map(|keep| u8::from(*keep)).collect();
        let size = format!("{}×{}", image.width(), image.height());
        Ok(digest(&[b"masks 1", self.model.as_bytes(), &settings, size.as_bytes(), image.as_raw(), &keep]))
    }
}
