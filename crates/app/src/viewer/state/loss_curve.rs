//! The loss during training, thinned to as many points as a curve can show.

use surgtpgs_core::train::LossTerms;

/// Number of points that are kept; a curve of this size cannot show more.
const MAX_POINTS: usize = 240;

/// The loss over the steps so far, as means of equally many steps.
#[derive(Debug)]
pub(crate) struct LossCurve {
    /// Means, each with its last step.
    pub(crate) points: Vec<(usize, LossTerms<f32>)>,
    /// Number of steps in a mean.
    every: usize,
    /// The unfinished mean: the number of its steps so far, and their sum.
    open: (usize, LossTerms<f32>),
}

impl Default for LossCurve {
    fn default() -> Self {
        Self { points: Vec::new(), every: 1, open: Default::default() }
    }
}

impl LossCurve {
    /// Adds a step. A step whose loss is not finite is left out, because nothing was learned from it. One
    /// that is not after the last begins the next part of a long recording, whose curve is another one.
    pub(crate) fn push(&mut self, step: usize, terms: LossTerms<f32>) {
        if !terms.total().is_finite() {
            return;
        }
        if self.points.last().is_some_and(|(last, _)| step <= *last) {
            *self = Self::default();
        }
        self.open = (self.open.0 + 1, combined(self.open.1, terms, 1.0));
        if self.open.0 < self.every {
            return;
        }
        let (count, sum) = std::mem::take(&mut self.open);
        self.points.push((step, combined(LossTerms::default(), sum, 1.0 / count as f32)));
        if self.points.len() >= MAX_POINTS {
            let pairs = self.points.chunks_exact(2);
            self.points = pairs.map(|p| (p[1].0, combined(scaled(p[0].1, 0.5), p[1].1, 0.5))).collect();
            self.every *= 2;
        }
    }

    /// Returns the latest mean.
    pub(crate) fn last(&self) -> Option<&LossTerms<f32>> {
        self.points.last().map(|(_, terms)| terms)
    }
}

fn scaled(terms: LossTerms<f32>, by: f32) -> LossTerms<f32> {
    combined(LossTerms::default(), terms, by)
}

/// Computes a + share · b, term by term.
fn combined(a: LossTerms<f32>, b: LossTerms<f32>, share: f32) -> LossTerms<f32> {
    let (a, b) = (a.values(), b.values());
    LossTerms::of(std::array::from_fn(|k| a[k] + share * b[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terms(colour: f32) -> LossTerms<f32> {
        LossTerms { colour, depth: 2.0 * colour, ..Default::default() }
    }

    #[test]
    fn a_long_training_is_thinned_to_means() {
        let mut curve = LossCurve::default();
        (1..=5000).for_each(|step| curve.push(step, terms(step as f32)));
        assert!(curve.points.len() < MAX_POINTS && curve.points.len() > MAX_POINTS / 4);
        let (step, mean) = curve.points[0];
        assert!((mean.colour - (1 + step) as f32 / 2.0).abs() < 1e-3, "{step} {mean:?}");
        assert!((mean.depth - 2.0 * mean.colour).abs() < 1e-3);
        assert!(curve.points.windows(2).all(|p| p[1].0 - p[0].0 == curve.every));
    }

    #[test]
    fn every_part_of_a_long_recording_has_a_curve_of_its_own() {
        let mut curve = LossCurve::default();
        (1..=1001).for_each(|step| curve.push(step, terms(9.0)));
        curve.push(1, terms(1.0));
        curve.push(2, terms(2.0));
        let points: Vec<(usize, f32)> =
            curve.points.iter().map(|(step, mean)| (*step, mean.colour)).collect();
        assert_eq!(points, [(1, 1.0), (2, 2.0)]);
    }

    #[test]
    fn what_is_not_finite_is_left_out() {
        let mut curve = LossCurve::default();
        curve.push(1, terms(f32::NAN));
        assert!(curve.last().is_none());
        curve.push(2, terms(0.5));
        assert_eq!(curve.last().map(LossTerms::total), Some(1.5));
    }
}
