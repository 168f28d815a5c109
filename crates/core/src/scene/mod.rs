//! The scene file: one safetensors file with everything the viewer needs.

mod file;
mod ply;

use crate::{
    Error, Result, camera::Camera, codec::Codec, deform::Deformation, gaussian::Gaussians, grid::Mask,
    prepare::EncoderIdentity, sequence::Class,
};
use std::{
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
};

/// A trained reconstruction.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The Gaussians at rest.
    pub gaussians: Gaussians,
    /// How they move.
    pub deformation: Deformation,
    /// Camera of each frame; frame i is at time i / N.
    pub cameras: Vec<Camera>,
    /// The area that was supervised: `true` inside the endoscopic picture.
    pub field_of_view: Mask,
    /// Embeddings ⇄ latents; `None` for a scene without features (then prompts find nothing).
    pub codec: Option<Codec>,
    /// Class names with embeddings, where known.
    pub classes: Vec<(Class, Vec<f32>)>,
    /// The text encoder the features belong to.
    pub encoder: Option<EncoderIdentity>,
    /// Where it comes from and how it was made.
    pub provenance: Provenance,
}

/// How a scene was made.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Provenance {
    /// Program and version.
    pub made_by: String,
    /// The recording's folder or file name.
    pub sequence_name: String,
    /// Where the recording was, to find the original frames again.
    pub sequence_path: PathBuf,
    /// Whether test frames were held out of training.
    pub held_out: bool,
    /// Recording speed, where known.
    pub frames_per_second: Option<f32>,
    /// Optimiser steps done.
    pub steps: usize,
    /// Training wall time, seconds.
    pub seconds: f64,
    /// Training settings.
    pub settings: serde_json::Value,
}

impl Scene {
    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        self.cameras.len()
    }
    /// Time of frame `i`.
    pub fn time(&self, i: usize) -> f32 {
        i as f32 / self.num_frames().max(1) as f32
    }
    /// Tells scenes in memory apart without reading them whole: where the Gaussians' arrays lie, how long they are, and
    /// samples of their values. Call it again after editing; a few values edited in place may go unnoticed.
    pub fn fingerprint(&self) -> u64 {
        let (gaussians, deformation) = (&self.gaussians, &self.deformation);
        let mut hasher = DefaultHasher::new();
        (gaussians.sh_degree, gaussians.latent_dim, deformation.num_bases, deformation.stride)
            .hash(&mut hasher);
        (deformation.shape as u8, deformation.gate_slope.to_bits(), deformation.gate_channel)
            .hash(&mut hasher);
        let arrays: [&[f32]; 12] = [
            gaussians.means.as_flattened(),
            gaussians.rotations.as_flattened(),
            gaussians.log_scales.as_flattened(),
            &gaussians.opacity_logits,
            gaussians.colours.as_flattened(),
            &gaussians.sh_rest,
            &gaussians.features,
            &deformation.weights,
            &deformation.centres,
            &deformation.widths,
            &deformation.feature_weight,
            &deformation.feature_bias,
        ];
        const SAMPLES: usize = 128;
        for array in arrays {
            (array.as_ptr() as usize, array.len()).hash(&mut hasher);
            for value in array.iter().step_by((array.len() / SAMPLES).max(1)) {
                value.to_bits().hash(&mut hasher);
            }
        }
        hasher.finish()
    }
    /// Writes the file whole.
    pub fn save(&self, path: &Path) -> Result<()> {
        crate::files::write_whole(path, &file::to_bytes(self)?)
    }
    /// Reads and validates a file.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io("read the scene file", path, e))?;
        file::from_bytes(&bytes).map_err(|what| {
            Error::input_at(path, what, "Choose another scene file, or train the recording again.")
        })
    }
}
