//! One basis function over time.

use crate::real::Real;

/// Shape of one basis function over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BasisShape {
    /// exp(−(t − θ)² / (2σ²)): the paper's Eq. 1.
    Gaussian,
    /// exp(−((t − θ)² / (σ² + 1e-4))²): what the released code computes (method §3.1).
    Quartic,
    /// Cubic B-spline of (t − θ)/σ, 2/3 at its centre: nearly a Gaussian of 0.58 σ, but exactly 0 beyond
    /// 2σ. If the centres are σ apart, four are live at any time, however many there are.
    Spline,
}

/// A basis function counts as 0 at times where its value is not above this. If it is shared, its weights are
/// not updated by frames of these times.
pub const LIVE_BASIS: f32 = 1e-4;

/// Lower limit of widths, so that the paper's form cannot divide by zero.
pub const MIN_WIDTH: f64 = 1e-7;

/// Added to σ² in the quartic form, as in the released code.
pub const QUARTIC_EPSILON: f64 = 1e-4;

/// G(t; θ, σ), in 0–1.
pub fn basis<T: Real>(shape: BasisShape, time: T, centre: T, width: T) -> T {
    let d = time - centre;
    match shape {
        BasisShape::Gaussian => {
            let w = width.abs().max(T::of(MIN_WIDTH));
            (-(d * d) / (T::of(2.0) * w * w)).exp()
        }
        BasisShape::Quartic => {
            let e = d * d / (width * width + T::of(QUARTIC_EPSILON));
            (-(e * e)).exp()
        }
        BasisShape::Spline => {
            let u = (d / width.abs().max(T::of(MIN_WIDTH))).abs();
            let (outer, inner) = (positive(T::of(2.0) - u), positive(T::one() - u));
            (outer * outer * outer - T::of(4.0) * inner * inner * inner) / T::of(6.0)
        }
    }
}

/// Returns the width of the same basis function where time is counted in units of `len`, which is at most 1.
pub(super) fn width_in_unit(shape: BasisShape, width: f32, len: f32) -> f32 {
    match shape {
        BasisShape::Gaussian | BasisShape::Spline => width / len,
        BasisShape::Quartic => {
            let (width, len) = (f64::from(width), f64::from(len));
            let square = (width * width + QUARTIC_EPSILON) / (len * len) - QUARTIC_EPSILON;
            square.max(0.0).sqrt() as f32
        }
    }
}

fn positive<T: Real>(v: T) -> T {
    v.max(T::zero())
}

/// ∂G/∂θ and ∂G/∂σ.
pub fn basis_backward<T: Real>(shape: BasisShape, time: T, centre: T, width: T) -> (T, T) {
    let (d, value) = (time - centre, basis(shape, time, centre, width));
    match shape {
        BasisShape::Gaussian => {
            let w = width.abs().max(T::of(MIN_WIDTH));
            let along_width = if width.abs() > T::of(MIN_WIDTH) {
                value * d * d / (w * w * w) * width.signum()
            } else {
                T::zero()
            };
            (value * d / (w * w), along_width)
        }
        BasisShape::Quartic => {
            let q = width * width + T::of(QUARTIC_EPSILON);
            let e = d * d / q;
            (value * T::of(4.0) * e * d / q, value * T::of(4.0) * e * e * width / q)
        }
        BasisShape::Spline => {
            let w = width.abs().max(T::of(MIN_WIDTH));
            let u = (d / w).abs();
            let (outer, inner) = (positive(T::of(2.0) - u), positive(T::one() - u));
            let along = (T::of(4.0) * inner * inner - outer * outer) / T::of(2.0);
            let along_width = if width.abs() > T::of(MIN_WIDTH) { -along * u / width } else { T::zero() };
            (-along * d.signum() / w, along_width)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_match_finite_differences() {
        for shape in [BasisShape::Gaussian, BasisShape::Quartic, BasisShape::Spline] {
            for (t, c, w) in [(0.31_f64, 0.3, 0.02), (0.5, 0.45, -0.05), (0.2, 0.2, 0.01)] {
                let (dc, dw) = basis_backward(shape, t, c, w);
                let h = 1e-7;
                let numeric_c = (basis(shape, t, c + h, w) - basis(shape, t, c - h, w)) / (2.0 * h);
                let numeric_w = (basis(shape, t, c, w + h) - basis(shape, t, c, w - h)) / (2.0 * h);
                assert!((dc - numeric_c).abs() < 1e-5 * (1.0 + numeric_c.abs()), "{shape:?} centre");
                assert!((dw - numeric_w).abs() < 1e-5 * (1.0 + numeric_w.abs()), "{shape:?} width");
            }
        }
    }

    #[test]
    fn splines_add_up_to_one_and_end() {
        for t in [0.0_f64, 0.13, 0.5, 0.77] {
            let sum: f64 = (-3..8).map(|k| basis(BasisShape::Spline, t, f64::from(k) * 0.25, 0.25)).sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
        assert_eq!(basis(BasisShape::Spline, 0.5_f32, 0.0, 0.25), 0.0);
    }

    #[test]
    fn the_released_shape_has_the_published_half_width() {
        assert!((basis(BasisShape::Quartic, 0.0125_f64, 0.0, 0.01) - 0.543).abs() < 1e-3);
        assert!((basis(BasisShape::Quartic, 0.02_f64, 0.0, 0.01) - 0.018).abs() < 1e-3);
        assert!(basis(BasisShape::Gaussian, 1.0_f32, 0.0, 0.0).is_finite());
    }
}
