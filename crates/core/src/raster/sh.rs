//! Real spherical harmonics up to degree 3, in the order and with the signs of 3D Gaussian splatting.

use crate::{
    gaussian::MAX_SH_BANDS,
    real::{Real, Vector, dot},
};

/// Factor of band 1.
pub const C1: f64 = 0.488_602_511_902_919_9;
/// Factors of band 2, in order.
pub const C2: [f64; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
/// Factors of band 3, in order.
pub const C3: [f64; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];

/// Values of the bands above 0 for a unit direction; the first `(degree + 1)² − 1` are filled.
pub fn bands<T: Real>(degree: usize, [x, y, z]: Vector<T, 3>) -> [T; MAX_SH_BANDS] {
    let mut b = [T::zero(); MAX_SH_BANDS];
    let k = T::of;
    if degree >= 1 {
        b[..3].copy_from_slice(&[k(-C1) * y, k(C1) * z, k(-C1) * x]);
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[3..8].copy_from_slice(&[
            k(C2[0]) * x * y,
            k(C2[1]) * y * z,
            k(C2[2]) * (k(2.0) * zz - xx - yy),
            k(C2[3]) * x * z,
            k(C2[4]) * (xx - yy),
        ]);
    }
    if degree >= 3 {
        b[8..15].copy_from_slice(&[
            k(C3[0]) * y * (k(3.0) * xx - yy),
            k(C3[1]) * x * y * z,
            k(C3[2]) * y * (k(4.0) * zz - xx - yy),
            k(C3[3]) * z * (k(2.0) * zz - k(3.0) * xx - k(3.0) * yy),
            k(C3[4]) * x * (k(4.0) * zz - xx - yy),
            k(C3[5]) * z * (xx - yy),
            k(C3[6]) * x * (xx - k(3.0) * yy),
        ]);
    }
    b
}

/// Gradient with respect to the (unnormalised) direction components, given one per band.
pub fn bands_backward<T: Real>(degree: usize, [x, y, z]: Vector<T, 3>, g: &[T]) -> Vector<T, 3> {
    let k = T::of;
    let mut d = [T::zero(); 3];
    let mut add = |i: usize, coefficient: f64, jacobian: [T; 3]| {
        for a in 0..3 {
            d[a] += g[i] * k(coefficient) * jacobian[a];
        }
    };
    let (o, two) = (T::zero(), k(2.0));
    if degree >= 1 {
        add(0, -C1, [o, T::one(), o]);
        add(1, C1, [o, o, T::one()]);
        add(2, -C1, [T::one(), o, o]);
    }
    if degree >= 2 {
        add(3, C2[0], [y, x, o]);
        add(4, C2[1], [o, z, y]);
        add(5, C2[2], [-two * x, -two * y, k(4.0) * z]);
        add(6, C2[3], [z, o, x]);
        add(7, C2[4], [two * x, -two * y, o]);
    }
    if degree >= 3 {
        let (xx, yy, zz, six, eight) = (x * x, y * y, z * z, k(6.0), k(8.0));
        let three = k(3.0);
        add(8, C3[0], [six * x * y, three * xx - three * yy, o]);
        add(9, C3[1], [y * z, x * z, x * y]);
        add(10, C3[2], [-two * x * y, k(4.0) * zz - xx - three * yy, eight * y * z]);
        add(11, C3[3], [-six * x * z, -six * y * z, six * zz - three * xx - three * yy]);
        add(12, C3[4], [k(4.0) * zz - three * xx - yy, -two * x * y, eight * x * z]);
        add(13, C3[5], [two * x * z, -two * y * z, xx - yy]);
        add(14, C3[6], [three * xx - three * yy, -six * x * y, o]);
    }
    d
}

/// v / ‖v‖ and ‖v‖; (0, 0, 1) if there is no direction.
pub fn unit_direction<T: Real>(v: Vector<T, 3>) -> (Vector<T, 3>, T) {
    let length = dot(v, v).sqrt();
    if length > T::of(1e-12) {
        (v.map(|a| a / length), length)
    } else {
        ([T::zero(), T::zero(), T::one()], T::zero())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_match_finite_differences() {
        let direction = [0.3, -0.7, 0.648_f64];
        for band in 0..MAX_SH_BANDS {
            let mut g = [0.0; MAX_SH_BANDS];
            g[band] = 1.0;
            let analytic = bands_backward(3, direction, &g);
            for axis in 0..3 {
                let step = |h: f64| {
                    let mut d = direction;
                    d[axis] += h;
                    bands(3, d)[band]
                };
                let numeric = (step(1e-5) - step(-1e-5)) / 2e-5;
                assert!((analytic[axis] - numeric).abs() < 1e-8, "band {band} axis {axis}");
            }
        }
    }
}
