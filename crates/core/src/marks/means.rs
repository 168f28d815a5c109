//! Means over windows of an image.

use rayon::prelude::*;

/// Rows that one thread takes at once.
const ROWS_AT_ONCE: usize = 16;

/// Returns means over windows of 2 `reach` + 1 pixels each way, cut at the border.
pub(super) fn window_means(values: &[f32], [width, height]: [usize; 2], reach: usize) -> Vec<f32> {
    let window = |at: usize, size: usize| at.saturating_sub(reach)..(at + reach + 1).min(size);
    let mut rows = vec![0.0; values.len()];
    let lines = rows.par_chunks_mut(width.max(1)).zip(values.par_chunks(width.max(1)));
    lines.with_min_len(ROWS_AT_ONCE).for_each_init(Vec::new, |sums, (row, line)| {
        // Sums of all values before each one.
        sums.clear();
        sums.push(0.0);
        let mut sum = 0.0;
        sums.extend(line.iter().map(|v| {
            sum += f64::from(*v);
            sum
        }));
        for (x, mean) in row.iter_mut().enumerate() {
            let window = window(x, width);
            *mean = ((sums[window.end] - sums[window.start]) / window.len() as f64) as f32;
        }
    });
    let mut out = vec![0.0; values.len()];
    let lines = out.par_chunks_mut(width.max(1)).with_min_len(ROWS_AT_ONCE);
    lines.enumerate().for_each(|(y, row)| {
        let window = window(y, height);
        let part = 1.0 / window.len() as f32;
        for other in window {
            row.iter_mut().zip(&rows[other * width..(other + 1) * width]).for_each(|(o, v)| *o += v);
        }
        row.iter_mut().for_each(|o| *o *= part);
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_end_at_the_border() {
        let values: Vec<f32> = (0..12).map(|i| i as f32).collect();
        let means = window_means(&values, [4, 3], 1);
        // Corner, edge and middle.
        assert_eq!([means[0], means[1], means[5]], [2.5, 3.0, 5.0]);
        assert_eq!(window_means(&values, [4, 3], 9), [5.5; 12]);
    }
}
