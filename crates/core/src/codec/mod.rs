//! The autoencoder that compresses embeddings (512 numbers and the like) to D latent numbers per pixel
//! (method §7).
//!
//! There are two ways of training for the same stored form. Many different rows (features of image masks)
//! get an ordinary autoencoder, [`train_autoencoder`]. A handful of rows (the class names of labelled
//! frames) get latents spread over the sphere and a decoder that snaps noisy and blended latents to the
//! nearest class, [`train_classes`]. Up to 16 rows can have a [`codebook`] instead, which needs no training.

mod autoencoder;
mod classes;
mod codebook;
mod mlp;
mod released;
mod settings;
mod sphere;

use crate::{Error, Result, num, progress::Observer};
use autoencoder::train_autoencoder;
use classes::train_classes;
use codebook::codebook;
use ndarray::{Array2, ArrayD, ArrayView2, ArrayViewD, Axis, Ix1, Ix2};
use rayon::prelude::*;

pub use mlp::Linear;
pub(crate) use mlp::{apply, normal, normalise_rows};
pub use released::AUTOENCODER_FILE;
pub use settings::{CodecKind, CodecSettings};

/// Most latent numbers of a codec.
pub(crate) const MAX_LATENT_DIM: usize = 16;
/// Largest number of different rows for which latents are spread over the sphere and the decoder snaps to
/// them.
const MAX_CLASSES: usize = 64;
/// Rows with a larger cosine are one class: no decoder can tell them apart, nor does it have to.
const SAME_ROW_COSINE: f32 = 0.999_99;
/// Rows that one thread decodes or encodes at once: enough for efficient matrix products, few enough for
/// the cache.
const ROWS_AT_ONCE: usize = 256;

/// Encoder (dim → D, unit length) and decoder (D → dim, unit length). The mean and spread by which training
/// standardises embeddings are folded into the encoder's first layer. There is a ReLU between layers, and
/// none after the last.
#[derive(Clone, Debug, PartialEq)]
pub struct Codec {
    /// Encoder layers in order.
    pub encoder: Vec<Linear>,
    /// Decoder layers in order.
    pub decoder: Vec<Linear>,
}

impl Codec {
    /// Trains on embedding rows [n, dim] (made unit length here) with occurrence `weights` [n].
    /// The same rows and settings give the same bytes.
    ///
    /// Fails on no rows, rows that are not finite or have no direction, and settings out of range, and if
    /// the observer asks to stop.
    pub fn train(
        rows: ArrayView2<'_, f32>,
        weights: &[f32],
        settings: &CodecSettings,
        observer: &mut Observer<'_>,
    ) -> Result<Self> {
        check_training_input(rows, weights, settings)?;
        let rows = normalise_rows(rows.to_owned());
        let groups = same_rows(&rows);
        let num_classes = groups.iter().max().map_or(0, |g| g + 1);
        let first = |g| groups.iter().position(|&other| other == g).unwrap_or(0);
        let firsts: Vec<usize> = (0..num_classes).map(first).collect();
        let distinct = rows.select(Axis(0), &firsts);
        let trained = match settings.kind {
            CodecKind::Codebook => codebook(distinct.view()),
            CodecKind::Network if num_classes <= MAX_CLASSES => {
                train_classes(distinct.view(), settings, observer)
            }
            CodecKind::Network => train_autoencoder(rows.view(), weights, settings, observer),
        };
        trained.map(|(encoder, decoder)| Self { encoder, decoder })
    }

    /// Latent numbers per pixel, D.
    pub fn latent_dim(&self) -> usize {
        self.decoder.first().map_or(0, |l| l.weight.ncols())
    }

    /// Length of an embedding.
    pub fn embedding_dim(&self) -> usize {
        self.decoder.last().map_or(0, |l| l.weight.nrows())
    }

    /// Returns the codec if it makes as many latent numbers as Gaussians have; otherwise says what differs,
    /// without a full stop.
    pub(crate) fn of_latents(self, latent_dim: usize) -> Result<Self, String> {
        let encoded = self.encoder.last().map_or(0, |l| l.weight.nrows());
        match self.latent_dim() {
            own if own == latent_dim && own == encoded => Ok(self),
            own => Err(format!("the codec has {own} latent numbers, the Gaussians {latent_dim}")),
        }
    }

    /// Encodes [n, dim] → [n, D], unit rows. Rows without a direction (zero, not finite) give zeros.
    /// Panics if rows have another length than [`Self::embedding_dim`] (a programming error).
    pub fn encode(&self, rows: ArrayView2<'_, f32>) -> Array2<f32> {
        unit_rows_through(&self.encoder, rows)
    }

    /// Decodes [n, D] → [n, dim], unit rows. Latents that are not finite give zeros. Panics if rows have
    /// another length than [`Self::latent_dim`] (a programming error).
    pub fn decode(&self, latents: ArrayView2<'_, f32>) -> Array2<f32> {
        unit_rows_through(&self.decoder, latents)
    }

    /// Every weight and bias with its name in files: `encoder.0.weight` [out, in], `encoder.0.bias` [out], …
    pub fn tensors(&self) -> Vec<(String, ArrayViewD<'_, f32>)> {
        let halves = [("encoder", &self.encoder), ("decoder", &self.decoder)];
        let named = halves.iter().flat_map(|(half, layers)| {
            layers.iter().enumerate().flat_map(move |(i, layer)| {
                [
                    (format!("{half}.{i}.weight"), layer.weight.view().into_dyn()),
                    (format!("{half}.{i}.bias"), layer.bias.view().into_dyn()),
                ]
            })
        });
        named.collect()
    }

    /// Inverse of [`Self::tensors`]: `get` finds a tensor by name. Layers are read until a number is missing.
    pub fn from_tensors(get: impl Fn(&str) -> Option<ArrayD<f32>>) -> Result<Self> {
        let half = |name: &str| -> Result<Vec<Linear>> {
            let mut layers = Vec::new();
            while let Some(weight) = get(&format!("{name}.{}.weight", layers.len())) {
                let bias = get(&format!("{name}.{}.bias", layers.len()));
                let pair = weight.into_dimensionality::<Ix2>().ok();
                match pair.zip(bias.and_then(|b| b.into_dimensionality::<Ix1>().ok())) {
                    Some((weight, bias)) => layers.push(Linear { weight, bias }),
                    None => return Err(broken(format!("layer {} of its {name} is malformed", layers.len()))),
                }
            }
            Ok(layers)
        };
        let codec = Self { encoder: half("encoder")?, decoder: half("decoder")? };
        codec.validate()?;
        Ok(codec)
    }

    /// Checks that layers fit together, D is 1..=16, and every number is finite.
    pub fn validate(&self) -> Result<()> {
        for (name, layers) in [("encoder", &self.encoder), ("decoder", &self.decoder)] {
            if layers.is_empty() {
                return Err(broken(format!("it has no {name}")));
            }
            for (i, layer) in layers.iter().enumerate() {
                let (rows, columns) = layer.weight.dim();
                let expected = if i == 0 { columns } else { layers[i - 1].weight.nrows() };
                if rows == 0 || columns == 0 || layer.bias.len() != rows || columns != expected {
                    let bias = layer.bias.len();
                    return Err(broken(format!(
                        "layer {i} of its {name} has weight {rows}×{columns} and bias {bias}, where {expected} \
                         numbers come in"
                    )));
                }
                if !layer.weight.iter().chain(&layer.bias).all(|v| v.is_finite()) {
                    return Err(broken(format!("layer {i} of its {name} has numbers that are not finite")));
                }
            }
        }
        let ends = |layers: &[Linear]| (layers[0].weight.ncols(), layers[layers.len() - 1].weight.nrows());
        let ((dim, latent), (latent_in, dim_out)) = (ends(&self.encoder), ends(&self.decoder));
        if dim != dim_out || latent != latent_in || !(1..=MAX_LATENT_DIM).contains(&latent) {
            return Err(broken(format!(
                "its encoder maps {dim} numbers to {latent}, its decoder {latent_in} to {dim_out}"
            )));
        }
        Ok(())
    }
}

fn broken(what: String) -> Error {
    Error::input(format!("the codec is not usable: {what}"), "Prepare the recording again.")
}

fn check_training_input(rows: ArrayView2<'_, f32>, weights: &[f32], settings: &CodecSettings) -> Result<()> {
    if !(1..=MAX_LATENT_DIM).contains(&settings.latent_dim) || settings.steps == 0 {
        return Err(Error::input(
            format!(
                "the codec settings ask for {} latent numbers and {} steps; expected 1 to {MAX_LATENT_DIM} and \
                 at least 1",
                settings.latent_dim, settings.steps
            ),
            "Change the settings.",
        ));
    }
    if rows.nrows() == 0 || rows.ncols() == 0 || weights.len() != rows.nrows() {
        return Err(Error::input(
            format!(
                "a codec needs feature rows with one weight each, found {} rows of {} numbers and {} weights",
                rows.nrows(),
                rows.ncols(),
                weights.len()
            ),
            "Check that the recording has labels or masks on its training frames.",
        ));
    }
    let bad = rows.outer_iter().position(|row| num::normalised(&row.to_vec()).is_none());
    let bad = bad.or(weights.iter().position(|w| !w.is_finite() || *w < 0.0));
    bad.map_or(Ok(()), |row| {
        Err(Error::input(
            format!("feature row {row} is zero or not finite, or its weight is not a number ≥ 0"),
            "Check the encoder that made the features.",
        ))
    })
}

/// Group number of each row; the rows of a group point (almost) the same way. Grouping stops at more than
/// [`MAX_CLASSES`] groups.
fn same_rows(rows: &Array2<f32>) -> Vec<usize> {
    let mut firsts: Vec<usize> = Vec::new();
    let mut groups = Vec::with_capacity(rows.nrows());
    for (i, row) in rows.outer_iter().enumerate() {
        let known = firsts.iter().position(|&f| rows.row(f).dot(&row) > SAME_ROW_COSINE);
        groups.push(known.unwrap_or(firsts.len()));
        if known.is_none() {
            firsts.push(i);
        }
        if firsts.len() > MAX_CLASSES {
            break;
        }
    }
    groups
}

fn unit_rows_through(layers: &[Linear], rows: ArrayView2<'_, f32>) -> Array2<f32> {
    let width = layers.last().map_or(0, |l| l.weight.nrows());
    let mut out = Array2::zeros((rows.nrows(), width));
    let chunks: Vec<_> = rows
        .axis_chunks_iter(Axis(0), ROWS_AT_ONCE)
        .zip(out.axis_chunks_iter_mut(Axis(0), ROWS_AT_ONCE))
        .collect();
    chunks.into_par_iter().for_each(|(rows, mut out)| out.assign(&normalise_rows(apply(layers, rows))));
    out
}

#[cfg(test)]
mod tests;
