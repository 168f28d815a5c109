//! Training for many rows: an ordinary autoencoder.

use super::{
    mlp::{Adam, Linear, Parts, backward, forward, init, normal, normalise_backward, normalise_rows},
    settings::{CodecSettings, DECODER_HIDDEN, ENCODER_HIDDEN, STAGE},
};
use crate::{
    Result,
    progress::{Observer, Progress},
};
use ndarray::{Array1, Array2, ArrayView2, Axis, s};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Rows per step.
const BATCH: usize = 128;
/// Learning rate at the start.
const RATE: f32 = 2e-3;
/// Standard deviation of the noise added to each latent number, because rendered features are not exact.
const LATENT_NOISE: f32 = 0.01;

/// Maximises the mean cosine between rows and their reconstruction. (For unit vectors the reference's mean
/// squared error is 2(1 − cosine)/dim: the same goal. Its extra cosine term was taken along the wrong axis.)
///
/// Embeddings share a large common part. It is subtracted before the first layer and added after the
/// last. Both are folded into the biases, so that the layers between see only the differences. Returns the
/// layers of encoder and decoder.
pub(super) fn train_autoencoder(
    rows: ArrayView2<'_, f32>,
    weights: &[f32],
    settings: &CodecSettings,
    observer: &mut Observer<'_>,
) -> Result<(Vec<Linear>, Vec<Linear>)> {
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let (dim, latent) = (rows.ncols(), settings.latent_dim);
    let mean = rows.mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(dim));
    let spread = (&rows - &mean).mapv(|v| v * v).mean().unwrap_or(0.0).sqrt().max(1e-6);
    let centred = (&rows - &mean) / spread;

    let mut layers = init(&[&[dim][..], &ENCODER_HIDDEN, &[latent]].concat(), &mut rng);
    let split = layers.len();
    layers.extend(init(&[&[latent][..], &DECODER_HIDDEN, &[dim]].concat(), &mut rng));
    if let Some(last) = layers.last_mut() {
        last.weight *= spread;
        last.bias.assign(&mean);
    }
    let mut adam = Adam::new(&layers, RATE, settings.steps);
    let mut parts = Parts::new(&layers, BATCH);
    let sampler = Sampler::new(weights);
    for step in 0..settings.steps {
        let picked: Vec<usize> = (0..BATCH).map(|_| sampler.pick(&mut rng)).collect();
        let noise = Array2::from_shape_simple_fn((BATCH, latent), || LATENT_NOISE * normal(&mut rng));
        let gradients = parts.run(|part, gradients| {
            let input = centred.select(Axis(0), &picked[part.clone()]);
            let truth = rows.select(Axis(0), &picked[part.clone()]);
            gradients_of_part(&layers, split, input, &truth, noise.slice(s![part, ..]), gradients);
        });
        adam.step(&mut layers, gradients);
        Progress::new(STAGE, step + 1, settings.steps).tell(observer)?;
    }
    let decoder = layers.split_off(split);
    fold_standardisation(&mut layers[0], &mean, spread);
    Ok((layers, decoder))
}

/// Gradients of mean(1 − cosine) over one part of the batch: encoder layers, then decoder layers.
fn gradients_of_part(
    layers: &[Linear],
    split: usize,
    input: Array2<f32>,
    truth: &Array2<f32>,
    noise: ArrayView2<'_, f32>,
    gradients: &mut [Linear],
) {
    let (at_encoder, at_decoder) = gradients.split_at_mut(split);
    let (encoder, decoder) = layers.split_at(split);
    let encoded = forward(encoder, input);
    let latents = normalise_rows(encoded[split].clone());
    let decoded = forward(decoder, &latents + &noise);
    let raw = &decoded[decoder.len()];
    let towards = truth * (-1.0 / BATCH as f32);
    let at_raw = normalise_backward(raw, &normalise_rows(raw.clone()), &towards);
    let at_latents = backward(decoder, &decoded, at_raw, at_decoder);
    let at_encoded = normalise_backward(&encoded[split], &latents, &at_latents);
    backward(encoder, &encoded, at_encoded, at_encoder);
}

/// Changes `layer`, which was trained on (x − mean) / spread, so that it takes x.
pub(super) fn fold_standardisation(layer: &mut Linear, mean: &Array1<f32>, spread: f32) {
    layer.weight /= spread;
    let shift = layer.weight.dot(mean);
    layer.bias -= &shift;
}

/// Picks rows with probabilities proportional to their weights (equal if every weight is zero).
struct Sampler {
    cumulative: Vec<f64>,
}

impl Sampler {
    fn new(weights: &[f32]) -> Self {
        let flat = weights.iter().all(|&w| w == 0.0);
        let mut total = 0.0;
        let add = |&w: &f32| {
            total += if flat { 1.0 } else { f64::from(w) };
            total
        };
        Self { cumulative: weights.iter().map(add).collect() }
    }

    fn pick(&self, rng: &mut ChaCha8Rng) -> usize {
        let total = self.cumulative.last().copied().unwrap_or(0.0);
        let at = rng.random::<f64>() * total;
        self.cumulative.partition_point(|&c| c <= at).min(self.cumulative.len().saturating_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_picked_in_proportion_to_their_weight() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let count = |weights: &[f32], rng: &mut ChaCha8Rng| {
            let sampler = Sampler::new(weights);
            let mut counts = vec![0_usize; weights.len()];
            (0..4000).for_each(|_| counts[sampler.pick(rng)] += 1);
            counts
        };
        let counts = count(&[1.0, 0.0, 3.0], &mut rng);
        assert_eq!(counts[1], 0);
        assert!((counts[2] as f64 / counts[0] as f64 - 3.0).abs() < 0.4, "{counts:?}");
        assert!(count(&[0.0, 0.0], &mut rng).iter().all(|&c| c > 1800));
    }
}
