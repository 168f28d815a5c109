//! The scale of depth over time. A network that sees single pictures gives each of them a scale of its
//! own. In a recording by a still camera most of the surface stays in place, so scales can be
//! separated from motion.

use crate::num::percentile;
use rayon::prelude::*;

/// Number of frames that all others are compared with: enough that no single one matters.
const REFERENCES: usize = 48;

/// Returns the logarithm of each frame's scale, their median 0, from logarithms of depth at the same
/// places of every frame, [frames][places], NaN where unknown. The difference of two frames is the median
/// over their places, so that moving or hidden places do not count. A frame's scale is the median of its
/// differences from frames spread over the recording. A frame without a value has scale 0.
pub(super) fn log_scales(log_depth: &[Vec<f32>]) -> Vec<f32> {
    let n = log_depth.len();
    let some = n.min(REFERENCES);
    let references: Vec<&Vec<f32>> = (0..some).map(|k| &log_depth[(2 * k + 1) * n / (2 * some)]).collect();
    let apart = |a: &[f32], b: &[f32]| median(a.iter().zip(b).map(|(a, b)| a - b));
    let scale = |row: &Vec<f32>| median(references.iter().filter_map(|reference| apart(row, reference)));
    let scales: Vec<f32> = log_depth.par_iter().map(|row| scale(row).unwrap_or(f32::NAN)).collect();
    let middle = median(scales.iter().copied()).unwrap_or(0.0);
    scales.iter().map(|s| if s.is_finite() { s - middle } else { 0.0 }).collect()
}

/// Returns the median of the finite values.
fn median(values: impl Iterator<Item = f32>) -> Option<f32> {
    percentile(&mut values.filter(|v| v.is_finite()).collect::<Vec<_>>(), 50.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns logarithms of depth of a slope under drifting scales, a third of the places covered by
    /// something that moves.
    fn drifting(scales: &[f32]) -> Vec<Vec<f32>> {
        let value = |i: usize, p: usize| match (p + 7 * i) % 3 {
            0 => -2.0 + 0.05 * i as f32,
            _ => 0.01 * p as f32 + scales[i],
        };
        (0..scales.len()).map(|i| (0..90).map(|p| value(i, p)).collect()).collect()
    }

    #[test]
    fn scales_are_found_beside_motion() {
        let truth = [0.3, -0.2, 0.0, 0.1, -0.4, 0.0, 0.25];
        let found = log_scales(&drifting(&truth));
        for (found, truth) in found.iter().zip(truth) {
            assert!((found - truth).abs() < 0.02, "{found} {truth}");
        }
    }

    #[test]
    fn unknown_places_and_frames_are_passed_over() {
        let mut values = drifting(&[0.2, 0.0, -0.2]);
        values[1] = vec![f32::NAN; 90];
        values[0][..20].fill(f32::NAN);
        let found = log_scales(&values);
        assert!((found[0] - found[2] - 0.4).abs() < 0.03 && found[1] == 0.0, "{found:?}");
        assert!(log_scales(&[]).is_empty());
    }
}
