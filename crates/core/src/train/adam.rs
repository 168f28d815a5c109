//! Adam with the reference's constants (method §6.2).

use rayon::prelude::*;

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
/// As small as in the reference: parameters with tiny gradients still move at the learning rate.
const EPSILON: f32 = 1e-15;

/// Moments of one tensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Adam {
    /// First moments, as long as the tensor.
    pub first: Vec<f32>,
    /// Second moments.
    pub second: Vec<f32>,
    /// Updates so far.
    pub steps: i32,
}

/// Learning rate and bias corrections of one update.
#[derive(Clone, Copy, Debug)]
struct Update {
    rate: f32,
    second_correction: f32,
}

impl Update {
    fn apply(self, parameter: &mut f32, first: &mut f32, second: &mut f32, gradient: f32, scale: f32) {
        *first = BETA1 * *first + (1.0 - BETA1) * gradient;
        *second = BETA2 * *second + (1.0 - BETA2) * gradient * gradient;
        *parameter -= self.rate * scale * *first / ((*second * self.second_correction).sqrt() + EPSILON);
    }
}

impl Adam {
    /// Zero moments for `len` parameters.
    pub fn new(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len], steps: 0 }
    }

    fn next_update(&mut self, rate: f32) -> Update {
        self.steps += 1;
        Update {
            rate: rate / (1.0 - BETA1.powi(self.steps)),
            second_correction: 1.0 / (1.0 - BETA2.powi(self.steps)),
        }
    }

    /// One update of `parameters` at learning rate `rate`.
    pub fn step(&mut self, parameters: &mut [f32], gradients: &[f32], rate: f32) {
        self.step_rows(parameters, gradients, rate, 1.0, &[1.0]);
    }

    /// One update where the gradient is `gain · gradients` and parameter k's learning rate is
    /// `rate · scales[k mod scales.len()]`.
    pub fn step_rows(
        &mut self,
        parameters: &mut [f32],
        gradients: &[f32],
        rate: f32,
        gain: f32,
        scales: &[f32],
    ) {
        let update = self.next_update(rate);
        let chunk = scales.len() * (16384 / scales.len()).max(1);
        let moments = self.first.par_chunks_mut(chunk).zip(self.second.par_chunks_mut(chunk));
        parameters.par_chunks_mut(chunk).zip(gradients.par_chunks(chunk)).zip(moments).for_each(
            |((p, g), (m, v))| {
                let rows = p.chunks_mut(scales.len()).zip(g.chunks(scales.len()));
                let moments = m.chunks_mut(scales.len()).zip(v.chunks_mut(scales.len()));
                for ((p, g), (m, v)) in rows.zip(moments) {
                    for ((((p, g), m), v), scale) in p.iter_mut().zip(g).zip(m).zip(v).zip(scales) {
                        update.apply(p, m, v, gain * g, *scale);
                    }
                }
            },
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
