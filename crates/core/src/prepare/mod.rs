//! A prepared folder: per-pixel features of a recording, and the codec that compresses them. The
//! recording itself is never modified; the folder points to it.
//!
//! | file | holds |
//! |---|---|
//! | `prepared.json` | path of the recording, what was prepared and how, checksums; written last |
//! | `codec.safetensors` | `encoder.K.weight` [out, in], `encoder.K.bias` [out], `decoder.K.…` |
//! | `features.safetensors` | `table` [rows, dim] (unit rows) and `latents` [rows, D] (unit rows), f32 |
//! | `words.f16` | vectors of the vocabulary's texts, one after the other, little-endian half precision |
//! | `regions/frame_000000.png` | 16-bit row of the table per pixel, 65535 where there is no feature |
//! | `regions/marks.json` | if features come from marks by hand: those on training frames |
//! | `masks/frame_000000.json` | if features come from automatic masks: these, as pycocotools reads them |
//! | `depth/frame_000000.npy` | if a network estimated depth: z in scene units, [h, w] of any size |
//! | `estimates/frame_000000.safetensors` | `estimates` [h, w]: what the depth network gave |
//! | `embeddings/frame_000000.safetensors` | `embeddings` [masks, dim]: one per mask of the level in use |
//!
//! Masks and embeddings take minutes per frame, estimates seconds. They stay, and are used again if nothing
//! they depend on has changed. With `eval`, held-out frames leave no trace: no region file, no row, no share
//! in the codec.

mod background;
mod dense;
mod depth;
#[cfg(test)]
mod depth_tests;
mod drift;
mod files;
mod finish;
mod kept;
mod labels;
mod langsplat;
mod marks;
#[cfg(test)]
mod mask_tests;
mod masks;
mod origin;
#[cfg(test)]
mod tests;

pub use background::{BACKGROUND, is_background};
pub use depth::{DEPTH_ESTIMATES, Estimator, estimate_depth};
pub use labels::{prepare_from_labels, require_labels};
pub use langsplat::{holds_langsplat, read_langsplat, write_langsplat};
pub use marks::{MarkedNames, prepare_from_marks, require_marks};
pub use masks::{FrameFeatures, MASKS_AND_EMBEDDINGS, MaskStore, prepare_from_features, require_few_frames};
pub use origin::{NO_REGION, Origin, RegionMap};

use crate::{
    Error, Result,
    codec::Codec,
    hash::sha256,
    meaning::{Calibration, EncoderIdentity, WordFacts, names_alike},
    sequence::{Class, Identity, Sequence},
};
use files::{Manifest, WORDS, has_region, region_file};
use half::f16;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Relation of a folder to its recording, in the words that [`Identity::require`] puts into its message.
const WAS_PREPARED: &str = "this folder was prepared from";

/// An opened prepared folder.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The recording.
    pub sequence: Sequence,
    /// `true` if test frames are held out of everything.
    pub eval: bool,
    /// The text encoder that made the embeddings.
    pub encoder: EncoderIdentity,
    /// Source of the features.
    pub origin: Origin,
    /// Class names with their unit embeddings, if features come from labels: row k of the feature table
    /// is class k. Only classes that occur in training frames.
    pub classes: Vec<(Class, Vec<f32>)>,
    /// Facts about words.
    pub words: WordFacts,
    /// The trained codec.
    pub codec: Codec,
    /// Latents of the feature table, [rows][D] flat, unit rows.
    pub latents: Vec<f32>,
    /// Number of frames whose regions were merged, because 16 bits number those of all frames.
    pub merged_frames: usize,
    /// The prepared folder.
    pub folder: PathBuf,
    /// Frames that have a region file, ascending.
    region_frames: Vec<usize>,
    /// Identity of the recording; older folders have none.
    identity: Option<Arc<Identity>>,
    /// SHA-256 of files by their path inside the folder.
    sha256: Arc<BTreeMap<String, String>>,
}

impl Prepared {
    /// Returns `true` if `path` is a prepared folder.
    pub fn is_prepared(path: &Path) -> bool {
        crate::files::is_prepared(path)
    }

    /// Returns `true` if a preparation into `path` was begun and not finished.
    pub fn is_unfinished(path: &Path) -> bool {
        finish::is_unfinished(path)
    }

    /// Opens a prepared folder and the recording it points to. Fails if either is incomplete, was
    /// changed, or does not fit the other.
    pub fn open(path: &Path) -> Result<Self> {
        let manifest = Manifest::read(path)?;
        let (codec, rows, latents) = manifest.read_tensors(path)?;
        let mut sequence = manifest.open_recording(path)?;
        if let Some(identity) = &manifest.identity {
            sequence.outline().require(identity, sequence.path(), WAS_PREPARED)?;
        }
        let sha256 = Arc::new(manifest.sha256.clone());
        if let Some(depth) = &manifest.depth {
            sequence = sequence.with_estimated_depth(path, depth.clone(), sha256.clone());
        }
        let found = [sequence.num_frames(), sequence.width(), sequence.height()];
        let expected = [manifest.frames, manifest.width, manifest.height];
        if found != expected {
            return Err(Error::input_at(
                sequence.path(),
                format!(
                    "the recording has {} frames of {}×{}, but {} frames of {}×{} were prepared",
                    found[0], found[1], found[2], expected[0], expected[1], expected[2]
                ),
                "Prepare the recording again.",
            ));
        }
        let vectors = manifest.read_vectors(path)?;
        let from_marks = manifest.origin == Origin::Marks;
        let classes = manifest.classes.into_iter().zip(rows.outer_iter().map(|row| row.to_vec())).collect();
        Ok(Self {
            sequence,
            eval: manifest.eval,
            encoder: manifest.encoder,
            origin: manifest.origin,
            classes,
            words: WordFacts { from_marks, vectors, ..manifest.words },
            codec,
            latents,
            merged_frames: manifest.merged_frames,
            folder: path.to_owned(),
            region_frames: manifest.region_frames,
            identity: manifest.identity,
            sha256,
        })
    }

    /// Returns the same prepared folder after it was moved to `folder`.
    pub fn moved_to(self, folder: &Path) -> Self {
        Self { sequence: self.sequence.with_depth_at(folder), folder: folder.to_owned(), ..self }
    }

    /// Returns an error if the content of a frame differs from the prepared recording; reads the
    /// whole recording.
    pub fn require_recording(&self) -> Result<()> {
        let Some(identity) = &self.identity else { return Ok(()) };
        self.sequence.identity()?.require(identity, self.sequence.path(), WAS_PREPARED)
    }

    /// Points the prepared folder `folder` to the new path of its recording; the recording
    /// itself is not read.
    pub fn relocate(folder: &Path, recording: &Path) -> Result<()> {
        let mut manifest = Manifest::read(folder)?;
        manifest.point_to(folder, recording);
        manifest.write(folder)
    }

    /// Keeps in the prepared folder how well the text encoder tells words apart, and the vectors of the
    /// vocabulary's texts, one after the other.
    pub fn keep_words(&mut self, calibration: Calibration, vectors: Vec<f16>) -> Result<()> {
        let mut manifest = Manifest::read(&self.folder)?;
        let known = std::mem::take(&mut self.words);
        self.words = WordFacts { calibration: Some(calibration), vectors: vectors.into(), ..known };
        manifest.words.clone_from(&self.words);
        manifest.write_vectors(&self.folder)?;
        manifest.write(&self.folder)
    }

    /// Returns notes on classes that words will not find.
    pub fn cautions(&self) -> Vec<String> {
        names_alike(self.classes.iter().map(|(class, row)| (class.name.as_str(), row.as_slice())))
    }

    /// Returns the number of rows of the feature table.
    pub fn num_rows(&self) -> usize {
        self.latents.len() / self.codec.latent_dim().max(1)
    }

    /// Returns the SHA-256, hexadecimal, over the files that training reads. Vectors of words are not among them.
    pub(crate) fn digest(&self) -> String {
        let files = self.sha256.iter().filter(|(name, _)| *name != WORDS);
        let lines: String = files.map(|(name, sha256)| format!("{sha256} {name}\n")).collect();
        sha256(lines.as_bytes())
    }

    /// Returns `true` if any pixel of these frames has a feature.
    pub(crate) fn has_features(&self, frames: &[usize]) -> Result<bool> {
        for &i in frames {
            if self.regions(i)?.is_some_and(|map| has_region(&map)) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Returns the feature-table rows per pixel of frame `i`; `None` if that frame has none (or is held out).
    pub fn regions(&self, i: usize) -> Result<Option<RegionMap>> {
        if self.region_frames.binary_search(&i).is_err() {
            return Ok(None);
        }
        let path = self.folder.join(region_file(i));
        let map = files::read_region_map(&path, self.sha256.get(&region_file(i)).map(String::as_str))?;
        let expected = (self.sequence.width(), self.sequence.height());
        let rows = self.num_rows();
        if (map.width, map.height) != expected {
            return Err(Error::input_at(
                &path,
                format!(
                    "the region map is {}×{}, the frames {}×{}",
                    map.width, map.height, expected.0, expected.1
                ),
                "Prepare the recording again.",
            ));
        }
        match map.data.iter().find(|&&row| row != NO_REGION && usize::from(row) >= rows) {
            Some(row) => Err(Error::input_at(
                &path,
                format!("the region map points to row {row} of a feature table with {rows} rows"),
                "Prepare the recording again.",
            )),
            None => Ok(Some(map)),
        }
    }
}
