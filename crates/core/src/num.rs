//! Functions of numbers: sigmoid and logit, lengths and products, percentiles and means. Their behaviour at
//! the edges is documented.

/// 1 / (1 + e^-x) without overflow; NaN stays NaN.
pub fn sigmoid(x: f32) -> f32 {
    if x >= 0.0 {
        1.0 / (1.0 + (-x).exp())
    } else {
        let e = x.exp();
        e / (1.0 + e)
    }
}

/// The inverse of [`sigmoid`]; `p` is first clamped to [1e-6, 1 - 1e-6].
pub fn logit(p: f32) -> f32 {
    let p = p.clamp(1e-6, 1.0 - 1e-6);
    (p / (1.0 - p)).ln()
}

/// `v / ‖v‖`, or `None` if the length is zero or not finite.
pub fn normalised(v: &[f32]) -> Option<Vec<f32>> {
    let length = norm(v);
    (length > 1e-12 && length.is_finite()).then(|| v.iter().map(|x| x / length).collect())
}

/// Euclidean length, summed in f64.
pub fn norm(v: &[f32]) -> f32 {
    v.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt() as f32
}

/// Dot product, summed in f64.
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(&x, &y)| f64::from(x) * f64::from(y)).sum::<f64>() as f32
}

/// Returns up to `count` of the numbers below `n`, evenly spread, in ascending order.
pub fn spread(n: usize, count: usize) -> impl Iterator<Item = usize> {
    let count = count.min(n);
    (0..count).map(move |k| (2 * k + 1) * n / (2 * count))
}

/// The `q`-th percentile (0–100) by linear interpolation, as NumPy's default; `None` if empty. NaN must
/// be filtered out before the call, which changes the order of the values.
pub fn percentile(values: &mut [f32], q: f64) -> Option<f32> {
    let last = values.len().checked_sub(1)?;
    let position = q.clamp(0.0, 100.0) / 100.0 * last as f64;
    let (_, low, above) = values.select_nth_unstable_by(position as usize, f32::total_cmp);
    let (low, share) = (*low, position.fract());
    let next = above.iter().copied().filter(|_| share > 0.0).min_by(f32::total_cmp).unwrap_or(low);
    let (low, next) = (f64::from(low), f64::from(next));
    Some((low + (next - low) * share) as f32)
}

/// The [`percentile`] of those values that are finite; `None` if none is.
pub fn finite_percentile(values: impl Iterator<Item = f32>, q: f64) -> Option<f32> {
    percentile(&mut values.filter(|v| v.is_finite()).collect::<Vec<_>>(), q)
}

/// The median; the mean of the two middle values of an even number. `None` if empty. NaN must be filtered out
/// before the call.
pub fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.len() / 2;
    let upper = *values.get(middle)?;
    Some(if values.len() % 2 == 1 { upper } else { 0.5 * (upper + values[middle - 1]) })
}

/// The mean; `None` if there are no values.
pub fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), v| (sum + v, count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigmoid_never_overflows_and_inverts() {
        assert_eq!(sigmoid(-1e30), 0.0);
        assert_eq!(sigmoid(1e30), 1.0);
        assert_eq!(sigmoid(0.0), 0.5);
        assert!((sigmoid(logit(0.1)) - 0.1).abs() < 1e-7);
        assert!(logit(0.0).is_finite() && logit(1.0).is_finite());
    }

    #[test]
    fn percentile_interpolates_linearly() {
        assert_eq!(percentile(&mut [4.0, 1.0, 2.0, 3.0], 50.0), Some(2.5));
        assert_eq!(percentile(&mut [1.0, 2.0, 3.0, 4.0, 5.0], 3.0), Some(1.12));
        assert_eq!(percentile(&mut [], 50.0), None);
        assert_eq!(percentile(&mut [f32::INFINITY, 2.0, 1.0], 50.0), Some(2.0));
        assert_eq!(finite_percentile([f32::NAN, 3.0, f32::INFINITY, 1.0].into_iter(), 50.0), Some(2.0));
    }

    #[test]
    fn the_median_of_an_even_number_is_between_the_middle_two() {
        assert_eq!(median(&mut [5.0, 1.0, 3.0]), Some(3.0));
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 9.0]), Some(3.0));
        assert_eq!(median(&mut []), None);
    }

    #[test]
    fn no_values_have_no_mean() {
        assert_eq!((mean([].into_iter()), mean([1.0, 3.0].into_iter())), (None, Some(2.0)));
    }

    #[test]
    fn normalised_refuses_what_has_no_direction() {
        assert_eq!(normalised(&[3.0, 4.0]), Some(vec![0.6, 0.8]));
        assert_eq!(normalised(&[0.0, 0.0]), None);
        assert_eq!(normalised(&[f32::NAN, 1.0]), None);
    }
}
