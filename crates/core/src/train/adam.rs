//! Adam with the reference's constants (method §6.2).

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Decay of the first moments.
pub const BETA1: f32 = 0.9;
/// Decay of the second moments.
pub const BETA2: f32 = 0.999;
/// Added to the root of the second moment. As small as in the reference: parameters with tiny gradients
/// still move at the learning rate.
pub const EPSILON: f32 = 1e-15;

/// Moments of one tensor.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Adam {
    /// First moments, as long as the tensor.
    pub first: Vec<f32>,
    /// Second moments.
    pub second: Vec<f32>,
    /// Number of updates so far.
    pub steps: i32,
}

/// Learning rate and bias correction of one update.
#[derive(Clone, Copy, Debug)]
pub(super) struct Update {
    rate: f32,
    second_correction: f32,
    /// Factor of the gradients.
    gain: f32,
}

/// Number of parameters updated at once.
pub const WIDTH: usize = 16;
/// Number of parameters per parallel piece.
const CHUNK: usize = 1024 * WIDTH;

/// Factors of the first and second moments in the `steps`-th update.
pub fn bias_corrections(steps: i32) -> [f32; 2] {
    [BETA1, BETA2].map(|beta| 1.0 / (1.0 - beta.powi(steps)))
}

impl Update {
    /// Updates [`WIDTH`] parameters; parameter k's learning rate is `rate · scales[k]`.
    #[inline(always)]
    pub(super) fn apply(
        self,
        parameters: &mut [f32; WIDTH],
        (first, second): (&mut [f32; WIDTH], &mut [f32; WIDTH]),
        gradients: &[f32; WIDTH],
        scales: &[f32; WIDTH],
    ) {
        for k in 0..WIDTH {
            let gradient = self.gain * gradients[k];
            first[k] = BETA1 * first[k] + (1.0 - BETA1) * gradient;
            second[k] = BETA2 * second[k] + (1.0 - BETA2) * gradient * gradient;
            let spread = (second[k] * self.second_correction).sqrt() + EPSILON;
            parameters[k] -= self.rate * scales[k] * first[k] / spread;
        }
    }
}

impl Adam {
    /// Zero moments for `len` parameters.
    pub fn new(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len], steps: 0 }
    }

    /// Counts an update and returns its factors.
    pub(super) fn next_update(&mut self, rate: f32, gain: f32) -> Update {
        self.steps += 1;
        let [first_correction, second_correction] = bias_corrections(self.steps);
        Update { rate: rate * first_correction, second_correction, gain }
    }

    /// Updates `parameters` once at learning rate `rate`.
    pub fn step(&mut self, parameters: &mut [f32], gradients: &[f32], rate: f32) {
        self.step_rows(parameters, gradients, rate, 1.0, &[1.0; WIDTH]);
    }

    /// Updates once with the gradient `gain · gradients` and, for parameter k, the learning rate `rate ·
    /// scales[k mod scales.len()]`. There are [`WIDTH`] scales or a multiple, at most [`CHUNK`].
    pub fn step_rows(
        &mut self,
        parameters: &mut [f32],
        gradients: &[f32],
        rate: f32,
        gain: f32,
        scales: &[f32],
    ) {
        let update = self.next_update(rate, gain);
        let level = Level::new();
        let moments = self.first.par_chunks_mut(CHUNK).zip(self.second.par_chunks_mut(CHUNK));
        parameters.par_chunks_mut(CHUNK).zip(gradients.par_chunks(CHUNK)).zip(moments).for_each(
            |((p, g), (m, v))| dispatch!(level, simd => update_chunk(simd, update, p, (m, v), g, scales)),
        );
    }

    /// Keeps the rows (of `width` numbers) listed in `rows`, in that order; `None` starts a row afresh.
    pub fn rearrange(&mut self, rows: &[Option<u32>], width: usize) {
        for moments in [&mut self.first, &mut self.second] {
            *moments = rows
                .iter()
                .flat_map(|row| match row {
                    Some(r) => moments[*r as usize * width..(*r as usize + 1) * width].to_vec(),
                    None => vec![0.0; width],
                })
                .collect();
        }
    }
}

#[simd]
fn update_chunk<S: Simd>(
    _: S,
    update: Update,
    parameters: &mut [f32],
    (first, second): (&mut [f32], &mut [f32]),
    gradients: &[f32],
    scales: &[f32],
) {
    let mut scales = scales.as_chunks().0.iter().cycle();
    let mut next_scales = || scales.next().unwrap_or(&[1.0; WIDTH]);
    let (p_rows, p_rest) = parameters.as_chunks_mut::<WIDTH>();
    let (m_rows, m_rest) = first.as_chunks_mut::<WIDTH>();
    let (v_rows, v_rest) = second.as_chunks_mut::<WIDTH>();
    let (g_rows, g_rest) = gradients.as_chunks::<WIDTH>();
    for (((p, m), v), g) in p_rows.iter_mut().zip(m_rows).zip(v_rows).zip(g_rows) {
        update.apply(p, (m, v), g, next_scales());
    }
    let padded = |values: &[f32]| {
        let mut row = [0.0; WIDTH];
        row[..values.len()].copy_from_slice(values);
        row
    };
    let (mut p, mut m, mut v) = (padded(p_rest), padded(m_rest), padded(v_rest));
    update.apply(&mut p, (&mut m, &mut v), &padded(g_rest), next_scales());
    p_rest.copy_from_slice(&p[..p_rest.len()]);
    m_rest.copy_from_slice(&m[..m_rest.len()]);
    v_rest.copy_from_slice(&v[..v_rest.len()]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_is_the_learning_rate_whatever_the_gradient() {
        let mut adam = Adam::new(3);
        let mut p = vec![0.0; 3];
        adam.step(&mut p, &[1e-6, -300.0, 0.0], 0.1);
        assert!((p[0] + 0.1).abs() < 1e-6 && (p[1] - 0.1).abs() < 1e-6);
        assert_eq!(p[2], 0.0);
    }

    #[test]
    fn a_quadratic_is_minimised() {
        let mut adam = Adam::new(1);
        let mut p = vec![5.0];
        for _ in 0..2000 {
            let g = [2.0 * (p[0] - 1.5)];
            adam.step(&mut p, &g, 0.02);
        }
        assert!((p[0] - 1.5).abs() < 1e-2);
    }

    #[test]
    fn rearranging_keeps_moments_with_their_rows() {
        let mut adam = Adam { first: vec![1.0, 2.0, 3.0, 4.0], second: vec![5.0, 6.0, 7.0, 8.0], steps: 3 };
        adam.rearrange(&[Some(1), None, Some(0)], 2);
        assert_eq!(adam.first, vec![3.0, 4.0, 0.0, 0.0, 1.0, 2.0]);
        assert_eq!(adam.second, vec![7.0, 8.0, 0.0, 0.0, 5.0, 6.0]);
    }
}
