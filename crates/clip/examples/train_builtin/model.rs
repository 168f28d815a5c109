//! The network and its training: a sum of trigram embeddings, two hidden layers, and a unit vector as output.
//!
//! ```text
//! text ─▶ letters ─▶ trigrams ─▶ Σ table rows ─▶ relu ─▶ W1 ─▶ relu ─▶ W2 ─▶ embedding
//! ```
//! The sum ignores the position of a word, which suits phrases. Words of templates can learn to add nothing.

use crate::text::{self, NUM_CODES};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// Width of a trigram's row and of the first hidden layer.
pub const HIDDEN_1: usize = 160;
/// Width of the second hidden layer.
pub const HIDDEN_2: usize = 320;
/// Length of an embedding.
pub const DIM: usize = 256;
/// Rows shared by the trigrams that the lexicon does not have.
pub const NUM_STRANGE: usize = 64;

/// Weights, or gradients of weights.
#[derive(Clone)]
pub struct Weights {
    /// [rows][HIDDEN_1].
    pub table: Vec<f32>,
    /// [HIDDEN_1].
    pub bias_0: Vec<f32>,
    /// [HIDDEN_1][HIDDEN_2].
    pub dense_1: Vec<f32>,
    /// [HIDDEN_2].
    pub bias_1: Vec<f32>,
    /// [HIDDEN_2][DIM].
    pub dense_2: Vec<f32>,
    /// [DIM].
    pub bias_2: Vec<f32>,
}

impl Weights {
    fn zeros(rows: usize) -> Self {
        Self {
            table: vec![0.0; rows * HIDDEN_1],
            bias_0: vec![0.0; HIDDEN_1],
            dense_1: vec![0.0; HIDDEN_1 * HIDDEN_2],
            bias_1: vec![0.0; HIDDEN_2],
            dense_2: vec![0.0; HIDDEN_2 * DIM],
            bias_2: vec![0.0; DIM],
        }
    }

    fn parts(&mut self) -> [&mut Vec<f32>; 6] {
        let Self { table, bias_0, dense_1, bias_1, dense_2, bias_2 } = self;
        [table, bias_0, dense_1, bias_1, dense_2, bias_2]
    }
}

/// Row of the table for every trigram code.
pub struct Rows {
    /// [NUM_CODES].
    pub of_code: Vec<u16>,
    /// Number of rows.
    pub count: usize,
}

impl Rows {
    /// Gives each trigram of the texts a row of its own; all others share [`NUM_STRANGE`] rows.
    pub fn new<'a>(texts: impl Iterator<Item = &'a str>) -> Self {
        let known: BTreeSet<usize> = texts.flat_map(text::trigrams).collect();
        // Fibonacci hashing spreads neighbouring codes over the shared rows.
        let mut of_code: Vec<u16> =
            (0..NUM_CODES as u32).map(|code| (code.wrapping_mul(0x9E37_79B9) >> 26) as u16).collect();
        let count = NUM_STRANGE + known.len();
        for (code, row) in known.into_iter().zip(NUM_STRANGE as u16..) {
            of_code[code] = row;
        }
        Self { of_code, count }
    }

    /// Table rows of a text.
    pub fn of(&self, text: &str) -> Vec<usize> {
        text::trigrams(text).map(|code| usize::from(self.of_code[code])).collect()
    }
}

/// Training goal of one embedding: a vector to approach and vectors to stay away from.
pub struct Goal<'a> {
    /// Unit vector to approach.
    pub target: &'a [f32],
    /// Unit vectors, [n][DIM], whose cosine must stay below [`Self::limit`].
    pub avoid: &'a [f32],
    /// Largest cosine with a vector of `avoid`.
    pub limit: f32,
}

/// Activations of one text.
struct Pass {
    hidden_1: Vec<f32>,
    hidden_2: Vec<f32>,
    unit: Vec<f32>,
    norm: f32,
}

fn forward(weights: &Weights, rows: &[usize]) -> Pass {
    let mut hidden_1 = weights.bias_0.clone();
    for row in rows {
        add_scaled(&mut hidden_1, 1.0, &weights.table[row * HIDDEN_1..][..HIDDEN_1]);
    }
    relu(&mut hidden_1);
    let mut hidden_2 = dense(&weights.dense_1, &weights.bias_1, &hidden_1);
    relu(&mut hidden_2);
    let mut unit = dense(&weights.dense_2, &weights.bias_2, &hidden_2);
    let norm = dot(&unit, &unit).sqrt().max(1e-6);
    unit.iter_mut().for_each(|v| *v /= norm);
    Pass { hidden_1, hidden_2, unit, norm }
}

/// The unit embedding of a text.
pub fn embed(weights: &Weights, rows: &[usize]) -> Vec<f32> {
    forward(weights, rows).unit
}

/// Adds the gradient of one example's loss, (1 − c) + 4(1 − c)² + 4·Σ max(0, cᵢ − limit)², with c the
/// cosine to the target and cᵢ those to the avoided vectors. The squares weigh the worst examples most.
fn backward(weights: &Weights, rows: &[usize], goal: &Goal<'_>, grad: &mut Weights) -> f32 {
    let pass = forward(weights, rows);
    let miss = 1.0 - dot(&pass.unit, goal.target);
    let mut loss = miss + 4.0 * miss * miss;
    let mut d_unit: Vec<f32> = goal.target.iter().map(|t| -(1.0 + 8.0 * miss) * t).collect();
    for avoided in goal.avoid.chunks_exact(DIM) {
        let excess = dot(&pass.unit, avoided) - goal.limit;
        if excess > 0.0 {
            loss += 4.0 * excess * excess;
            add_scaled(&mut d_unit, 8.0 * excess, avoided);
        }
    }
    // Gradient through v ↦ v/|v|: only the part perpendicular to v counts.
    let along = dot(&d_unit, &pass.unit);
    add_scaled(&mut d_unit, -along, &pass.unit);
    d_unit.iter_mut().for_each(|d| *d /= pass.norm);

    add_scaled(&mut grad.bias_2, 1.0, &d_unit);
    let d_2 = dense_backward(&weights.dense_2, &pass.hidden_2, &d_unit, &mut grad.dense_2);
    add_scaled(&mut grad.bias_1, 1.0, &d_2);
    let d_1 = dense_backward(&weights.dense_1, &pass.hidden_1, &d_2, &mut grad.dense_1);
    add_scaled(&mut grad.bias_0, 1.0, &d_1);
    for row in rows {
        add_scaled(&mut grad.table[row * HIDDEN_1..][..HIDDEN_1], 1.0, &d_1);
    }
    loss
}

/// Weights in training, with Adam's moments.
pub struct Trainer {
    /// The weights.
    pub weights: Weights,
    /// `true` if the table is no longer trained.
    pub is_table_frozen: bool,
    grad: Weights,
    mean: Weights,
    square: Weights,
    step: i32,
}

impl Trainer {
    /// Random weights.
    pub fn new(rows: usize, rng: &mut ChaCha8Rng) -> Self {
        let zeros = Weights::zeros(rows);
        let mut weights = zeros.clone();
        let mut fill = |part: &mut Vec<f32>, spread: f32| {
            part.iter_mut().for_each(|w| *w = rng.random_range(-spread..spread));
        };
        fill(&mut weights.table, 0.3);
        fill(&mut weights.dense_1, (6.0 / HIDDEN_1 as f32).sqrt());
        fill(&mut weights.dense_2, (6.0 / HIDDEN_2 as f32).sqrt());
        Self {
            weights,
            is_table_frozen: false,
            grad: zeros.clone(),
            mean: zeros.clone(),
            square: zeros,
            step: 0,
        }
    }

    /// Takes one step of Adam on a batch and returns the mean loss.
    pub fn step(&mut self, batch: &[(Vec<usize>, Goal<'_>)], rate: f32) -> f32 {
        self.grad.parts().into_iter().for_each(|part| part.fill(0.0));
        let loss: f32 =
            batch.iter().map(|(rows, goal)| backward(&self.weights, rows, goal, &mut self.grad)).sum();
        self.step += 1;
        let per_example = 1.0 / batch.len() as f32;
        let (fade_mean, fade_square) = (1.0 - 0.9f32.powi(self.step), 1.0 - 0.999f32.powi(self.step));
        let moments = self.mean.parts().into_iter().zip(self.square.parts());
        let parts = self.weights.parts().into_iter().zip(self.grad.parts()).zip(moments);
        for ((weight, grad), (mean, square)) in parts.skip(usize::from(self.is_table_frozen)) {
            for i in 0..weight.len() {
                let g = grad[i] * per_example;
                mean[i] += 0.1 * (g - mean[i]);
                square[i] += 0.001 * (g * g - square[i]);
                weight[i] -= rate * (mean[i] / fade_mean) / ((square[i] / fade_square).sqrt() + 1e-8);
            }
        }
        loss * per_example
    }
}

fn relu(values: &mut [f32]) {
    values.iter_mut().for_each(|v| *v = v.max(0.0));
}

fn dense(weight: &[f32], bias: &[f32], input: &[f32]) -> Vec<f32> {
    let mut output = bias.to_vec();
    for (x, row) in input.iter().zip(weight.chunks_exact(bias.len())) {
        if *x != 0.0 {
            add_scaled(&mut output, *x, row);
        }
    }
    output
}

/// Gradient for the input of a dense layer after a relu; adds the one for the weights to `d_weight`.
fn dense_backward(weight: &[f32], input: &[f32], d_output: &[f32], d_weight: &mut [f32]) -> Vec<f32> {
    let width = d_output.len();
    let mut d_input = vec![0.0; input.len()];
    for (i, x) in input.iter().enumerate() {
        if *x > 0.0 {
            d_input[i] = dot(&weight[i * width..][..width], d_output);
            add_scaled(&mut d_weight[i * width..][..width], *x, d_output);
        }
    }
    d_input
}

fn add_scaled(sum: &mut [f32], factor: f32, values: &[f32]) {
    sum.iter_mut().zip(values).for_each(|(s, v)| *s += factor * v);
}

/// Dot product in eight lanes, so that the compiler can use vector instructions.
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0f32; 8];
    let (a, b) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = a.remainder().iter().zip(b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a.zip(b) {
        (0..8).for_each(|i| lanes[i] += x[i] * y[i]);
    }
    lanes.iter().sum::<f32>() + rest
}
