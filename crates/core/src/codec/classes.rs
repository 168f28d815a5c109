//! Training for a handful of rows: latents spread over the sphere, and a decoder that snaps to the nearest.

use super::{
    autoencoder::fold_standardisation,
    mlp::{
        Adam, Linear, Parts, backward, forward, init, normal, normalise_backward, normalise_rows, zeros_like,
    },
    settings::{CodecSettings, DECODER_HIDDEN, ENCODER_HIDDEN, STAGE},
    sphere::spread_points,
};
use crate::{
    Result,
    progress::{Observer, Progress},
};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Decoder samples per step.
const BATCH: usize = 128;
/// Learning rates at the start.
const DECODER_RATE: f32 = 3e-3;
const ENCODER_RATE: f32 = 1e-3;
/// Encoder steps. Few are enough: it only has to hit as many points as there are classes.
const ENCODER_STEPS: usize = 400;
/// Copies of each class. All but one have noise of this length relative to the embedding.
const ENCODER_COPIES: usize = 4;
const EMBEDDING_NOISE: f32 = 0.02;

/// Trains the decoder as a classifier in the latent space, then multiplies its last layer by the class
/// embeddings. The decoded vector is Σ_k s_k(z) e_k, normalised, with scores s that are nearly one-hot.
/// Between two classes it passes from one embedding to the other and never through a third, even if the
/// embeddings are alike (cosines of 0.9 are usual). Its rank is the number of classes. Returns the layers of
/// encoder and decoder.
pub(super) fn train_classes(
    rows: ArrayView2<'_, f32>,
    settings: &CodecSettings,
    observer: &mut Observer<'_>,
) -> Result<(Vec<Linear>, Vec<Linear>)> {
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let points = spread_points(rows.nrows(), settings.latent_dim, settings.seed);
    let encoder = train_encoder(rows, &points, &mut rng);
    // Half the steps of the autoencoder are plenty: there is far less to learn.
    let mut decoder = train_scores(&points, settings.steps.div_ceil(2), &mut rng, observer)?;
    if let Some(last) = decoder.last_mut() {
        last.weight = rows.t().dot(&last.weight);
        last.bias = rows.t().dot(&last.bias);
    }
    Ok((encoder, decoder))
}

/// Trains an encoder that maps each row to its point, also if the row is a little off.
fn train_encoder(rows: ArrayView2<'_, f32>, points: &Array2<f32>, rng: &mut ChaCha8Rng) -> Vec<Linear> {
    let (n, dim) = rows.dim();
    let mean = rows.mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(dim));
    let centred = &rows - &mean;
    let spread = centred.mapv(|v| v * v).mean().unwrap_or(0.0).sqrt().max(1e-3 / (dim as f32).sqrt());
    let mut layers = init(&[&[dim][..], &ENCODER_HIDDEN, &[points.ncols()]].concat(), rng);
    let mut adam = Adam::new(&layers, ENCODER_RATE, ENCODER_STEPS);
    let mut gradients = zeros_like(&layers);
    let noise = EMBEDDING_NOISE / (dim as f32).sqrt();
    let classes: Vec<usize> = (0..n * ENCODER_COPIES).map(|i| i % n).collect();
    let towards = points.select(Axis(0), &classes) * (-1.0 / classes.len() as f32);
    let mut input = centred.select(Axis(0), &classes);
    // The first copy of each class stays exact.
    input.slice_mut(s![n.., ..]).mapv_inplace(|v| v + noise * normal(rng));
    input /= spread;
    for _ in 0..ENCODER_STEPS {
        let values = forward(&layers, input.clone());
        let raw = &values[layers.len()];
        let at_raw = normalise_backward(raw, &normalise_rows(raw.clone()), &towards);
        backward(&layers, &values, at_raw, &mut gradients);
        adam.step(&mut layers, &gradients);
    }
    fold_standardisation(&mut layers[0], &mean, spread);
    layers
}

/// Trains class scores over the latent space: least squares towards one-hot.
fn train_scores(
    points: &Array2<f32>,
    steps: usize,
    rng: &mut ChaCha8Rng,
    observer: &mut Observer<'_>,
) -> Result<Vec<Linear>> {
    let (n, latent) = points.dim();
    let mut layers = init(&[&[latent][..], &DECODER_HIDDEN, &[n]].concat(), rng);
    // Random biases spread the kinks over the latent space. With zeros all of them would meet at the origin.
    layers.iter_mut().for_each(|l| l.bias.mapv_inplace(|_| 0.1 * normal(rng)));
    let mut adam = Adam::new(&layers, DECODER_RATE, steps);
    let mut parts = Parts::new(&layers, BATCH);
    for step in 0..steps {
        let mut latents = Array2::zeros((BATCH, latent));
        let classes: Vec<usize> =
            latents.outer_iter_mut().map(|mut row| sample(points, &mut row, rng)).collect();
        let gradients = parts.run(|part, gradients| {
            let values = forward(&layers, latents.slice(s![part.clone(), ..]).to_owned());
            let mut error = values[layers.len()].clone();
            error.outer_iter_mut().zip(&classes[part]).for_each(|(mut row, &c)| row[c] -= 1.0);
            backward(&layers, &values, error / BATCH as f32, gradients);
        });
        adam.step(&mut layers, gradients);
        Progress::new(STAGE, step + 1, steps).tell(observer)?;
    }
    Ok(layers)
}

/// Writes a latent as rendering may produce it to `latent` and returns the class it should count as.
fn sample(points: &Array2<f32>, latent: &mut ndarray::ArrayViewMut1<'_, f32>, rng: &mut ChaCha8Rng) -> usize {
    let n = points.nrows();
    let (a, b) = (rng.random_range(0..n), rng.random_range(0..n));
    let kind: f32 = rng.random();
    let (share, length, noise) = if kind < 0.5 {
        (1.0, rng.random_range(0.55..1.25), rng.random_range(0.0..0.15))
    } else if kind < 0.9 {
        // The border between two regions: a pixel there sums the features of both.
        (rng.random_range(0.5..1.0), rng.random_range(0.85..1.1), 0.03)
    } else {
        // A random latent: the nearest direction counts.
        latent.mapv_inplace(|_| rng.random_range(-1.3..1.3));
        return nearest(points, latent.view());
    };
    for ((v, a), b) in latent.iter_mut().zip(points.row(a)).zip(points.row(b)) {
        *v = length * (share * a + (1.0 - share) * b + noise * normal(rng));
    }
    a
}

/// Index of the point with the largest dot product.
fn nearest(points: &Array2<f32>, latent: ArrayView1<'_, f32>) -> usize {
    let mut best = (0, f32::NEG_INFINITY);
    for (i, point) in points.outer_iter().enumerate() {
        let along = point.dot(&latent);
        if along > best.1 {
            best = (i, along);
        }
    }
    best.0
}
