//! Reads and writes the files of a prepared folder.

use super::origin::{NO_REGION, Origin, RegionMap};
use crate::{
    Error, Result,
    codec::{Codec, CodecSettings},
    files::{PREPARED_FILE, full_path, located_path, png, write_whole},
    hash::{require_sha256, sha256},
    meaning::{EncoderIdentity, WordFacts},
    reading::{MOST_BYTES, read_regular, values},
    sequence::{Class, EstimatedDepth, Identity, Sequence, shared_identity},
};
use half::f16;
use image::{DynamicImage, ImageBuffer, Luma};
use ndarray::{Array2, ArrayD, ArrayView2, ArrayViewD, Ix2, IxDyn};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::{
    collections::BTreeMap,
    path::{Component, Path, PathBuf},
    sync::Arc,
};

pub(super) const REGIONS: &str = "regions";
const CODEC: &str = "codec.safetensors";
const FEATURES: &str = "features.safetensors";
pub(super) const WORDS: &str = "words.f16";
/// Largest size of a manifest in bytes: that of some million frames.
const MOST_MANIFEST: u64 = 1 << 28;
const VERSION: u32 = 1;
pub(super) const AGAIN: &str = "Prepare the recording again.";

/// Contents of `prepared.json`.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct Manifest {
    pub(super) version: u32,
    pub(super) made_by: String,
    /// Path of the recording relative to the prepared folder; absent if there is no such path
    /// (another drive).
    pub(super) recording_relative: Option<PathBuf>,
    /// Path of the recording at the time of preparation.
    pub(super) recording: PathBuf,
    /// Identity of the recording; absent in older folders, which know it by number and size of the frames.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "shared_identity")]
    pub(super) identity: Option<Arc<Identity>>,
    pub(super) eval: bool,
    pub(super) frames: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) encoder: EncoderIdentity,
    #[serde(default)]
    pub(super) origin: Origin,
    /// Depth that a network estimated, if the recording has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) depth: Option<EstimatedDepth>,
    /// Classes of the feature table: row k is class k.
    pub(super) classes: Vec<Class>,
    /// Facts about words; absent in older folders.
    #[serde(default, skip_serializing_if = "WordFacts::is_empty")]
    pub(super) words: WordFacts,
    /// Number of pixels of each row over all training frames.
    pub(super) row_pixels: Vec<u64>,
    /// Number of frames with merged regions; older folders have none.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub(super) merged_frames: usize,
    /// Frames with a region file, ascending.
    pub(super) region_frames: Vec<usize>,
    pub(super) codec_settings: CodecSettings,
    /// SHA-256 of the files that training reads, hexadecimal, by path inside the folder; older folders
    /// have only those of the tensors.
    pub(super) sha256: BTreeMap<String, String>,
}

impl Manifest {
    /// Creates a manifest for `sequence` prepared into `folder`, to be filled in. Reads the whole recording.
    pub(super) fn of(
        sequence: &Sequence,
        folder: &Path,
        eval: bool,
        encoder: EncoderIdentity,
        settings: &CodecSettings,
    ) -> Result<Self> {
        let mut manifest = Self {
            version: VERSION,
            made_by: concat!("surgtpgs ", env!("CARGO_PKG_VERSION")).to_owned(),
            recording_relative: None,
            recording: PathBuf::new(),
            identity: Some(sequence.identity()?),
            eval,
            frames: sequence.num_frames(),
            width: sequence.width(),
            height: sequence.height(),
            encoder,
            origin: Origin::Labels,
            depth: sequence.estimated_depth().cloned(),
            classes: Vec::new(),
            words: WordFacts::default(),
            row_pixels: Vec::new(),
            merged_frames: 0,
            region_frames: Vec::new(),
            codec_settings: settings.clone(),
            sha256: BTreeMap::new(),
        };
        manifest.point_to(folder, sequence.path());
        Ok(manifest)
    }

    /// Stores the path of the recording, also relative to the prepared folder.
    pub(super) fn point_to(&mut self, folder: &Path, recording: &Path) {
        self.recording = located_path(recording);
        self.recording_relative = relative_path(&full_path(folder), &self.recording);
    }

    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(PREPARED_FILE);
        let text = match read_regular(&path, MOST_MANIFEST) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                return Err(Error::input_at(
                    folder,
                    format!("this is not a prepared folder: it has no {PREPARED_FILE}"),
                    "If preparing was interrupted, start it again.",
                ));
            }
            read => read.map_err(|e| Error::io("read the file", &path, e))?,
        };
        let malformed = |e| Error::input_at(&path, format!("the file cannot be understood: {e}"), AGAIN);
        let json: serde_json::Value = serde_json::from_slice(&text).map_err(malformed)?;
        if json["version"] != VERSION {
            return Err(Error::input_at(
                &path,
                format!(
                    "the folder has format version {}, this program reads version {VERSION}",
                    json["version"]
                ),
                AGAIN,
            ));
        }
        serde_json::from_value(json).map_err(malformed)
    }

    /// Writes the manifest, which marks the folder as complete.
    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let path = folder.join(PREPARED_FILE);
        let text = serde_json::to_vec_pretty(self)
            .map_err(|e| Error::input_at(&path, format!("the settings cannot be written: {e}"), ""))?;
        write_whole(&path, &text)
    }

    /// Opens the recording. The relative path is tried first: both may have moved together.
    pub(super) fn open_recording(&self, folder: &Path) -> Result<Sequence> {
        // The folder may be moved once it is whole, and the recording is read later, too.
        let beside = self.recording_relative.as_ref().map(|r| full_path(&folder.join(r)));
        let places = beside.into_iter().chain([self.recording.clone()]);
        match places.into_iter().find(|p| p.exists()) {
            Some(path) => Sequence::open_with(
                &path,
                None,
                self.identity.as_ref().map_or(&[], |identity| identity.hidden()),
            ),
            None => Err(Error::input_at(
                &self.recording,
                "the recording that this folder was prepared from is not there any more",
                "Put it back, or prepare the recording again from where it is now.",
            )),
        }
    }

    /// Writes codec, table and latents, and keeps their checksums.
    pub(super) fn write_tensors(
        &mut self,
        folder: &Path,
        codec: &Codec,
        table: ArrayView2<'_, f32>,
        latents: ArrayView2<'_, f32>,
    ) -> Result<()> {
        let features =
            vec![("table".to_owned(), table.into_dyn()), ("latents".to_owned(), latents.into_dyn())];
        for (name, tensors) in [(CODEC, codec.tensors()), (FEATURES, features)] {
            let path = folder.join(name);
            let bytes = to_safetensors(&tensors, None)
                .map_err(|e| Error::input_at(&path, format!("the tensors cannot be written: {e}"), ""))?;
            write_whole(&path, &bytes)?;
            self.sha256.insert(name.to_owned(), sha256(&bytes));
        }
        Ok(())
    }

    /// Reads codec, table rows and latents (flat), after comparing the checksums.
    pub(super) fn read_tensors(&self, folder: &Path) -> Result<(Codec, Array2<f32>, Vec<f32>)> {
        let codec = self.read_checked(folder, CODEC)?;
        let codec = Codec::from_tensors(|name| codec.get(name).cloned())?;
        let features = self.read_checked(folder, FEATURES)?;
        let matrix =
            |name: &str| features.get(name).and_then(|t| t.clone().into_dimensionality::<Ix2>().ok());
        let wrong = |what: String| Err(Error::input_at(folder.join(FEATURES), what, AGAIN));
        let (Some(table), Some(latents)) = (matrix("table"), matrix("latents")) else {
            return wrong("the file lacks the matrices \"table\" and \"latents\"".into());
        };
        let expected = (codec.embedding_dim(), codec.latent_dim(), table.nrows());
        let labelled = self.classes.is_empty() || self.classes.len() == table.nrows();
        if (table.ncols(), latents.ncols(), latents.nrows()) != expected || !labelled || table.is_empty() {
            return wrong(format!(
                "table ({}×{}), latents ({}×{}), {} classes and codec ({}→{}) do not fit together",
                table.nrows(),
                table.ncols(),
                latents.nrows(),
                latents.ncols(),
                self.classes.len(),
                expected.0,
                expected.1
            ));
        }
        if !table.iter().chain(&latents).all(|v| v.is_finite()) {
            return wrong("the features are not all finite".into());
        }
        Ok((codec, table, latents.iter().copied().collect()))
    }

    /// Writes the vectors of words, and keeps their checksum.
    pub(super) fn write_vectors(&mut self, folder: &Path) -> Result<()> {
        let bytes: Vec<u8> = self.words.vectors.iter().flat_map(|v| v.to_le_bytes()).collect();
        write_whole(&folder.join(WORDS), &bytes)?;
        self.sha256.insert(WORDS.to_owned(), sha256(&bytes));
        Ok(())
    }

    /// Reads the vectors of words; none if the folder is older than they are.
    pub(super) fn read_vectors(&self, folder: &Path) -> Result<Arc<Vec<f16>>> {
        let Some(expected) = self.sha256.get(WORDS) else { return Ok(Arc::default()) };
        let path = folder.join(WORDS);
        let bytes = read_regular(&path, MOST_BYTES).map_err(|e| Error::io("read the file", &path, e))?;
        require_sha256(&path, &bytes, expected, AGAIN)?;
        Ok(Arc::new(bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b)).collect()))
    }

    fn read_checked(&self, folder: &Path, name: &str) -> Result<BTreeMap<String, ArrayD<f32>>> {
        let path = folder.join(name);
        let bytes = read_regular(&path, MOST_BYTES).map_err(|e| Error::io("read the file", &path, e))?;
        require_sha256(&path, &bytes, self.sha256.get(name).map_or("", String::as_str), AGAIN)?;
        from_safetensors(&bytes).map_err(|e| Error::input_at(&path, e, AGAIN))
    }
}

fn is_zero(number: &usize) -> bool {
    *number == 0
}

/// Returns the path of the region map of frame `i`, inside the folder.
pub(super) fn region_file(i: usize) -> String {
    format!("{REGIONS}/frame_{i:06}.png")
}

/// Returns `true` if any pixel has a feature.
pub(super) fn has_region(map: &RegionMap) -> bool {
    map.data.iter().any(|row| *row != NO_REGION)
}

/// Writes a 16-bit grey PNG; returns its checksum.
pub(super) fn write_region_map(path: &Path, map: RegionMap) -> Result<String> {
    let (width, height) = (map.width as u32, map.height as u32);
    let Some(image) = ImageBuffer::<Luma<u16>, _>::from_raw(width, height, map.data) else {
        return Err(Error::input_at(path, "the region map has the wrong number of pixels", ""));
    };
    let bytes = png(image, "")?;
    write_whole(path, &bytes)?;
    Ok(sha256(&bytes))
}

/// Reads a map that [`write_region_map`] wrote; older folders have no checksum to compare with.
pub(super) fn read_region_map(path: &Path, sha256: Option<&str>) -> Result<RegionMap> {
    if let Some(sha256) = sha256 {
        let bytes = read_regular(path, MOST_BYTES).map_err(|e| Error::io("read the region map", path, e))?;
        require_sha256(path, &bytes, sha256, AGAIN)?;
    }
    match values(path)?.image {
        DynamicImage::ImageLuma16(image) => {
            let (width, height) = (image.width() as usize, image.height() as usize);
            Ok(RegionMap::from_vec(width, height, image.into_raw()))
        }
        other => Err(Error::input_at(
            path,
            format!("a region map must be a 16-bit grey picture, found {:?}", other.color()),
            AGAIN,
        )),
    }
}

/// Writes tensors as a safetensors file; `key` is stored with them.
pub(super) fn to_safetensors(
    tensors: &[(String, ArrayViewD<'_, f32>)],
    key: Option<&str>,
) -> Result<Vec<u8>, safetensors::SafeTensorError> {
    let bytes: Vec<Vec<u8>> =
        tensors.iter().map(|(_, t)| t.iter().flat_map(|v| v.to_le_bytes()).collect()).collect();
    let views = tensors.iter().zip(&bytes).map(|((name, t), bytes)| {
        Ok((name.as_str(), TensorView::new(Dtype::F32, t.shape().to_vec(), bytes)?))
    });
    let views: Vec<_> = views.collect::<Result<_, safetensors::SafeTensorError>>()?;
    let metadata = key.map(|key| [("key".to_owned(), key.to_owned())].into());
    safetensors::serialize(views, metadata)
}

/// Returns the key that a safetensors file was written with.
pub(super) fn key_of(bytes: &[u8]) -> Option<String> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).ok()?;
    metadata.metadata().as_ref()?.get("key").cloned()
}

pub(super) fn from_safetensors(bytes: &[u8]) -> Result<BTreeMap<String, ArrayD<f32>>, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| format!("the tensors cannot be read: {e}"))?;
    let tensor = |(name, view): (String, TensorView<'_>)| {
        let floats =
            view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        match ArrayD::from_shape_vec(IxDyn(view.shape()), floats) {
            Ok(array) if view.dtype() == Dtype::F32 => Ok((name, array)),
            _ => Err(format!("the tensor \"{name}\" is {:?}, expected F32", view.dtype())),
        }
    };
    file.tensors().into_iter().map(tensor).collect()
}

/// Returns the relative path from one absolute folder to another absolute path; `None` if they share no root.
fn relative_path(from: &Path, to: &Path) -> Option<PathBuf> {
    let shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    if shared == 0 {
        return None;
    }
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    Some(up.chain(to.components().skip(shared)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_paths_go_up_and_down() {
        let way = |from: &str, to: &str| relative_path(Path::new(from), Path::new(to));
        assert_eq!(way("/a/b/prep", "/a/clip"), Some("../../clip".into()));
        assert_eq!(way("/a", "/a/clip"), Some("clip".into()));
        assert_eq!(way("a", "/b"), None);
    }
}
