//! Times of the passes of a shown frame.

use std::time::Instant;
use surgtpgs_core::{Result, num::median};

/// Number of rounds over the frames; the first one warms up.
pub(super) const ROUNDS: usize = 3;

/// Measurements of one way to do a pass.
#[derive(serde::Serialize)]
pub(super) struct Timing {
    pub(super) pass: &'static str,
    pub(super) way: String,
    /// Median and 95th percentile, milliseconds.
    pub(super) median_ms: f64,
    pub(super) p95_ms: f64,
    /// Largest and mean difference of a score (or of a colour, opacity or feature) from the exact way.
    pub(super) max_error: Option<f64>,
    pub(super) mean_error: Option<f64>,
    /// IoU with the masks of the exact way, at the thresholds 0.4 and 0.5.
    pub(super) iou_40: Option<f64>,
    pub(super) iou_50: Option<f64>,
    /// PSNR of colours against the exact way, dB.
    pub(super) psnr_db: Option<f64>,
}

/// Returns the milliseconds that `work` takes for each item, after one round to warm up if `rounds` > 1.
pub(super) fn time<T>(
    items: &[T],
    rounds: usize,
    mut work: impl FnMut(&T) -> Result<()>,
) -> Result<Vec<f64>> {
    let mut ms = Vec::new();
    for round in 0..rounds {
        for item in items {
            let started = Instant::now();
            work(item)?;
            if round > 0 || rounds == 1 {
                ms.push(started.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    Ok(ms)
}

impl Timing {
    /// Returns the median and the 95th percentile of `ms`, without errors.
    pub(super) fn of(pass: &'static str, way: impl Into<String>, mut ms: Vec<f64>) -> Self {
        ms.sort_by(f64::total_cmp);
        let at = |share: f64| ms.get(((ms.len().max(1) - 1) as f64 * share).round() as usize).copied();
        Self {
            pass,
            way: way.into(),
            p95_ms: at(0.95).unwrap_or(0.0),
            median_ms: median(&mut ms).unwrap_or(0.0),
            max_error: None,
            mean_error: None,
            iou_40: None,
            iou_50: None,
            psnr_db: None,
        }
    }
}
