//! A small multi-layer perceptron: forward, backward, Adam. ReLU between layers, none after the last.

use ndarray::{Array1, Array2, ArrayView2, Axis, Zip, linalg::general_mat_mul};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::ops::Range;

/// Number of parts of a batch, one per thread. Fixed, so that sums do not depend on the thread count.
const PARTS: usize = 2;
/// Lower limit of lengths before a division by them.
const MIN_LENGTH: f32 = 1e-12;

/// Linear layer `y = x Wᵀ + b`; weight is [out, in].
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// [out, in].
    pub weight: Array2<f32>,
    /// [out].
    pub bias: Array1<f32>,
}

/// Layers of the given widths, He-initialised (weights N(0, 2/in), biases 0).
pub(super) fn init(widths: &[usize], rng: &mut ChaCha8Rng) -> Vec<Linear> {
    let layer = |pair: &[usize]| {
        let deviation = (2.0 / pair[0] as f32).sqrt();
        Linear {
            weight: Array2::from_shape_simple_fn((pair[1], pair[0]), || deviation * normal(rng)),
            bias: Array1::zeros(pair[1]),
        }
    };
    widths.windows(2).map(layer).collect()
}

/// A sample of the standard normal distribution (Box–Muller).
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let (a, b): (f32, f32) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f32::consts::TAU * b).cos()
}

/// The layers' output for `rows` [n, in].
pub(crate) fn apply(layers: &[Linear], rows: ArrayView2<'_, f32>) -> Array2<f32> {
    let mut values = None;
    for (i, layer) in layers.iter().enumerate() {
        let input = values.as_ref().map_or(rows, |v: &Array2<f32>| v.view());
        values = Some(one_layer(layer, input, i + 1 < layers.len()));
    }
    values.unwrap_or_else(|| rows.to_owned())
}

fn one_layer(layer: &Linear, input: ArrayView2<'_, f32>, relu: bool) -> Array2<f32> {
    let mut out = input.dot(&layer.weight.t());
    for mut row in out.outer_iter_mut() {
        Zip::from(&mut row).and(&layer.bias).for_each(|v, b| {
            let sum = *v + b;
            // A comparison, not `max`: NaN must come out as NaN.
            *v = if relu && sum < 0.0 { 0.0 } else { sum };
        });
    }
    out
}

/// Divides each row by its length; rows without a direction (zero, not finite) become zeros.
pub(crate) fn normalise_rows(mut rows: Array2<f32>) -> Array2<f32> {
    for mut row in rows.outer_iter_mut() {
        let length = row.dot(&row).sqrt();
        if length > MIN_LENGTH && length.is_finite() {
            row.mapv_inplace(|v| v / length);
        } else {
            row.fill(0.0);
        }
    }
    rows
}

/// Turns ∂L/∂u into ∂L/∂v for u = v/‖v‖: (g − (g·u) u) / ‖v‖.
pub(super) fn normalise_backward(
    raw: &Array2<f32>,
    unit: &Array2<f32>,
    gradient: &Array2<f32>,
) -> Array2<f32> {
    let mut out = gradient.clone();
    for ((mut g, u), v) in out.outer_iter_mut().zip(unit.outer_iter()).zip(raw.outer_iter()) {
        let along = g.dot(&u);
        let length = v.dot(&v).sqrt().max(MIN_LENGTH);
        Zip::from(&mut g).and(&u).for_each(|g, u| *g = (*g - along * u) / length);
    }
    out
}

/// Output of every layer, the input first.
pub(super) fn forward(layers: &[Linear], rows: Array2<f32>) -> Vec<Array2<f32>> {
    let mut values = vec![rows];
    for (i, layer) in layers.iter().enumerate() {
        values.push(one_layer(layer, values[i].view(), i + 1 < layers.len()));
    }
    values
}

/// Writes the gradients of `layers` to `gradients`, from `values` of [`forward`] and ∂L/∂output, and
/// returns ∂L/∂input.
pub(super) fn backward(
    layers: &[Linear],
    values: &[Array2<f32>],
    out: Array2<f32>,
    gradients: &mut [Linear],
) -> Array2<f32> {
    let mut gradient = out;
    for (i, (layer, at_layer)) in layers.iter().zip(gradients).enumerate().rev() {
        if i + 1 < layers.len() {
            let active = &values[i + 1];
            Zip::from(&mut gradient).and(active).for_each(|g, &a| *g = if a > 0.0 { *g } else { 0.0 });
        }
        general_mat_mul(1.0, &gradient.t(), &values[i], 0.0, &mut at_layer.weight);
        at_layer.bias.assign(&gradient.sum_axis(Axis(0)));
        gradient = gradient.dot(&layer.weight);
    }
    gradient
}

/// Zeros in the shape of `layers`.
pub(super) fn zeros_like(layers: &[Linear]) -> Vec<Linear> {
    let zero = |l: &Linear| Linear {
        weight: Array2::zeros(l.weight.raw_dim()),
        bias: Array1::zeros(l.bias.raw_dim()),
    };
    layers.iter().map(zero).collect()
}

/// Gradients of the parts of a batch. They are kept from step to step: allocating them anew costs more
/// than filling them.
pub(super) struct Parts {
    gradients: Vec<Vec<Linear>>,
    rows: usize,
}

impl Parts {
    /// Allocates gradients for batches of `rows`.
    pub(super) fn new(layers: &[Linear], rows: usize) -> Self {
        Self { gradients: vec![zeros_like(layers); PARTS], rows }
    }

    /// Runs `part` on fixed parts of the batch, on all threads, and adds up their gradients in order.
    pub(super) fn run(&mut self, part: impl Fn(Range<usize>, &mut [Linear]) + Sync) -> &[Linear] {
        let size = self.rows.div_ceil(PARTS).max(1);
        let ranges: Vec<_> =
            (0..PARTS).map(|i| (i * size).min(self.rows)..((i + 1) * size).min(self.rows)).collect();
        self.gradients.par_iter_mut().zip(ranges).for_each(|(gradients, range)| part(range, gradients));
        let [sum, others @ ..] = &mut self.gradients[..] else { return &[] };
        for other in others {
            sum.par_iter_mut().zip(other).for_each(|(a, b)| {
                a.weight += &b.weight;
                a.bias += &b.bias;
            });
        }
        sum
    }
}

/// Adam (β 0.9 and 0.999) with a learning rate that falls along a half cosine to zero.
pub(super) struct Adam {
    rate: f32,
    steps: usize,
    done: usize,
    moments: Vec<[Linear; 2]>,
}

impl Adam {
    /// Prepares the training of `layers`, starting at `rate`, over `steps`.
    pub(super) fn new(layers: &[Linear], rate: f32, steps: usize) -> Self {
        let moments = zeros_like(layers).into_iter().map(|zero| [zero.clone(), zero]).collect();
        Self { rate, steps, done: 0, moments }
    }

    /// Takes one step. Gradients that are not finite leave the layers unchanged.
    pub(super) fn step(&mut self, layers: &mut [Linear], gradients: &[Linear]) {
        let finite = |l: &Linear| l.weight.sum().is_finite() && l.bias.sum().is_finite();
        if !gradients.iter().all(finite) {
            return;
        }
        let progress = self.done as f32 / self.steps.max(1) as f32;
        self.done += 1;
        let rate = self.rate * 0.5 * (1.0 + (std::f32::consts::PI * progress).cos());
        let correction = |beta: f32| 1.0 - beta.powi(self.done.min(100_000) as i32);
        let (first, second) = (correction(0.9), correction(0.999));
        let update = |p: &mut f32, m: &mut f32, v: &mut f32, &g: &f32| {
            *m = 0.9 * *m + 0.1 * g;
            *v = 0.999 * *v + 0.001 * g * g;
            *p -= rate * (*m / first) / ((*v / second).sqrt() + 1e-8);
        };
        layers.par_iter_mut().zip(&mut self.moments).zip(gradients).for_each(|((layer, [m, v]), g)| {
            Zip::from(&mut layer.weight)
                .and(&mut m.weight)
                .and(&mut v.weight)
                .and(&g.weight)
                .for_each(update);
            Zip::from(&mut layer.bias).and(&mut m.bias).and(&mut v.bias).and(&g.bias).for_each(update);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// Compares the gradients of L = Σ c·u, with u = normalised output, with finite differences.
    #[test]
    fn gradients_agree_with_finite_differences() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut layers = init(&[5, 7, 6, 4], &mut rng);
        layers.iter_mut().for_each(|l| l.bias.mapv_inplace(|_| 0.1));
        let rows = Array2::from_shape_simple_fn((6, 5), || normal(&mut rng));
        let towards = Array2::from_shape_simple_fn((6, 4), || normal(&mut rng));
        let loss = |layers: &[Linear], rows: &Array2<f32>| -> f64 {
            let unit = normalise_rows(apply(layers, rows.view()));
            unit.iter().zip(&towards).map(|(u, c)| f64::from(u * c)).sum()
        };
        let values = forward(&layers, rows.clone());
        let raw = values.last().unwrap();
        let out = normalise_backward(raw, &normalise_rows(raw.clone()), &towards);
        let mut gradients = zeros_like(&layers);
        let at_rows = backward(&layers, &values, out, &mut gradients);

        let step = 1e-2_f32;
        let check = |analytic: f32, plus: f64, minus: f64| {
            let numeric = (plus - minus) / (2.0 * f64::from(step));
            assert!(
                (numeric - f64::from(analytic)).abs() < 2e-2 * (1.0 + numeric.abs()),
                "{numeric} {analytic}"
            );
        };
        for (layer, row, column) in [(0, 2, 3), (1, 5, 1), (2, 3, 4), (2, 0, 0)] {
            let mut moved = [layers.clone(), layers.clone()];
            moved[0][layer].weight[[row, column]] += step;
            moved[1][layer].weight[[row, column]] -= step;
            check(gradients[layer].weight[[row, column]], loss(&moved[0], &rows), loss(&moved[1], &rows));
            let mut moved = [layers.clone(), layers.clone()];
            moved[0][layer].bias[row] += step;
            moved[1][layer].bias[row] -= step;
            check(gradients[layer].bias[row], loss(&moved[0], &rows), loss(&moved[1], &rows));
        }
        let mut moved = [rows.clone(), rows.clone()];
        moved[0][[4, 2]] += step;
        moved[1][[4, 2]] -= step;
        check(at_rows[[4, 2]], loss(&layers, &moved[0]), loss(&layers, &moved[1]));
    }

    #[test]
    fn adam_refuses_gradients_that_are_not_finite() {
        let mut layers = init(&[2, 2], &mut ChaCha8Rng::seed_from_u64(0));
        let before = layers.clone();
        let mut gradients = layers.clone();
        gradients[0].weight[[0, 1]] = f32::NAN;
        let mut adam = Adam::new(&layers, 0.1, 10);
        adam.step(&mut layers, &gradients);
        assert_eq!(layers, before);
        adam.step(&mut layers, &before);
        assert_ne!(layers, before);
    }

    #[test]
    fn rows_without_direction_become_zeros() {
        let rows = ndarray::arr2(&[[3.0, 4.0], [0.0, 0.0], [f32::NAN, 1.0], [f32::INFINITY, 1.0]]);
        assert_eq!(normalise_rows(rows), ndarray::arr2(&[[0.6, 0.8], [0.0; 2], [0.0; 2], [0.0; 2]]));
    }
}
