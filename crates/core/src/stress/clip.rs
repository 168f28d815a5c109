//! A small recording to train on.

use crate::{
    Result,
    codec::{CodecKind, CodecSettings},
    demo::{self, DemoSettings},
    meaning::EncoderIdentity,
    prepare::{Prepared, prepare_from_labels},
    progress::unobserved,
    sequence::Sequence,
};
use std::path::Path;

/// Length of the made-up embeddings.
const DIM: usize = 8;

/// Returns the identity of an encoder that does not exist, for made-up embeddings of this length.
pub(crate) fn made_up_encoder(dim: usize) -> EncoderIdentity {
    EncoderIdentity { name: "made up".into(), sha256: "00".into(), dim, template: "{}".into(), folder: None }
}

/// Returns embeddings of which each has its own direction.
#[cfg(test)]
pub(crate) fn one_hot(count: usize, dim: usize) -> Vec<Vec<f32>> {
    let row = |k: usize| (0..dim).map(|j| f32::from(u8::from(j == k))).collect();
    (0..count).map(row).collect()
}

/// Writes the demo's clip at 64×48 to `folder/recording`, and prepares it with made-up embeddings of its
/// classes in `folder/prepared`. Test frames are held out if there are more than two frames.
pub fn small_clip(folder: &Path, frames: usize) -> Result<Prepared> {
    let recording = folder.join("recording");
    let settings = DemoSettings::of_size(64, 48, frames);
    demo::write(&settings, &recording, &mut unobserved)?;
    let sequence = Sequence::open(&recording)?;
    let embedding = |k: usize| (0..DIM).map(|j| ((k * 5 + j * 3) as f32).sin()).collect();
    let embeddings: Vec<Vec<f32>> = (0..sequence.classes().len()).map(embedding).collect();
    let encoder = made_up_encoder(DIM);
    let codec = CodecSettings { kind: CodecKind::Network, latent_dim: 3, steps: 60, seed: 0 };
    let to = folder.join("prepared");
    prepare_from_labels(sequence, encoder, &embeddings, frames > 2, &codec, &to, &mut unobserved)
}
