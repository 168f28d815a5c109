//! Errors of depth compared with the truth.

use crate::grid::{Grid, Mask};

/// Errors of depth over the pixels where both are known.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct DepthErrors {
    /// Root mean square error, scene units.
    pub rmse: f64,
    /// Mean of |error| / truth.
    pub abs_rel: f64,
    /// Root mean square of the difference of logarithms.
    pub rmse_log: f64,
    /// Share of pixels that are off by a factor of less than 1.25.
    pub within_1_25: f64,
}

/// Compares depth where both are known (finite, > 0) and `mask` is true; `None` if there is no such pixel
/// or sizes differ.
pub fn depth_errors(depth: &Grid<f32>, truth: &Grid<f32>, mask: Option<&Mask>) -> Option<DepthErrors> {
    let size = (depth.width, depth.height);
    if size != (truth.width, truth.height) || mask.is_some_and(|m| (m.width, m.height) != size) {
        return None;
    }
    let known = |d: f32| (d.is_finite() && d > 0.0).then_some(f64::from(d));
    let (mut sums, mut count) = ([0.0; 4], 0_usize);
    for (i, pair) in depth.data.iter().zip(&truth.data).enumerate() {
        let (Some(z), Some(truth)) = (known(*pair.0), known(*pair.1)) else { continue };
        if mask.is_some_and(|m| !m.data[i]) {
            continue;
        }
        let factor = (z / truth).max(truth / z);
        let errors =
            [(z - truth).powi(2), (z - truth).abs() / truth, factor.ln().powi(2), f64::from(factor < 1.25)];
        sums.iter_mut().zip(errors).for_each(|(sum, e)| *sum += e);
        count += 1;
    }
    let [squared, relative, squared_log, within] = sums.map(|s| s / count as f64);
    let errors = DepthErrors {
        rmse: squared.sqrt(),
        abs_rel: relative,
        rmse_log: squared_log.sqrt(),
        within_1_25: within,
    };
    (count > 0).then_some(errors)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_error_ignores_unknown_pixels() {
        let depth = Grid::from_vec(5, 1, vec![10.0, 20.0, 0.0, f32::NAN, 50.0]);
        let truth = Grid::from_vec(5, 1, vec![13.0, 16.0, 9.0, 1.0, 0.0]);
        let errors = depth_errors(&depth, &truth, None).unwrap();
        assert!((errors.rmse - 12.5_f64.sqrt()).abs() < 1e-9);
        assert!((errors.abs_rel - 0.5 * (3.0 / 13.0 + 0.25)).abs() < 1e-9);
        let logs = [(13.0_f64 / 10.0).ln(), 1.25_f64.ln()];
        assert!((errors.rmse_log - ((logs[0].powi(2) + logs[1].powi(2)) / 2.0).sqrt()).abs() < 1e-9);
        assert_eq!(errors.within_1_25, 0.0, "1.25 is not less than 1.25");
        let first = Mask::from_vec(5, 1, vec![true, false, true, true, true]);
        assert_eq!(depth_errors(&depth, &truth, Some(&first)).unwrap().rmse, 3.0);
        assert_eq!(depth_errors(&depth, &truth, Some(&first.map(|_| false))), None);
        assert_eq!(depth_errors(&depth, &Grid::filled(1, 1, 1.0), None), None);
        assert_eq!(depth_errors(&truth, &truth, None).unwrap().within_1_25, 1.0);
    }
}
