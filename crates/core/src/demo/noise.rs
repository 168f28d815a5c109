//! Smooth pseudo-random fields and curves, made of additions, products and square roots alone. These are
//! exact in IEEE arithmetic, so every machine draws the same picture (`f32::sin` and its kin differ
//! between systems).

use glam::Vec3;

/// Mixes a lattice position and a seed into 32 uniformly distributed bits.
pub(super) fn hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let lattice = (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ (z as u32).wrapping_mul(0xcb1a_b31f);
    let mut h = lattice ^ seed.wrapping_mul(0x9e37_79b9);
    h = (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ h >> 12).wrapping_mul(0x297a_2d39);
    h ^ h >> 15
}

/// A field value with its gradient.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    /// About −0.7 to 0.7, mean 0.
    pub(super) value: f32,
    /// Derivative with respect to the position in the call.
    pub(super) gradient: Vec3,
}

/// The directions from a cube's centre to its edges, of unit length, four of them twice (Perlin 2002).
const DIRECTIONS: [Vec3; 16] = {
    const D: f32 = std::f32::consts::FRAC_1_SQRT_2;
    [
        Vec3::new(D, D, 0.0),
        Vec3::new(-D, D, 0.0),
        Vec3::new(D, -D, 0.0),
        Vec3::new(-D, -D, 0.0),
        Vec3::new(D, 0.0, D),
        Vec3::new(-D, 0.0, D),
        Vec3::new(D, 0.0, -D),
        Vec3::new(-D, 0.0, -D),
        Vec3::new(0.0, D, D),
        Vec3::new(0.0, -D, D),
        Vec3::new(0.0, D, -D),
        Vec3::new(0.0, -D, -D),
        Vec3::new(D, D, 0.0),
        Vec3::new(0.0, -D, D),
        Vec3::new(-D, D, 0.0),
        Vec3::new(0.0, -D, -D),
    ]
};

/// Returns gradient noise of feature size `size` at `p` (Perlin 2002), with its analytic derivative.
pub(super) fn noise(p: Vec3, size: f32, seed: u32) -> Noise {
    let p = p / size;
    let [x, y, z] = p.to_array().map(floor);
    let f = p - Vec3::new(x as f32, y as f32, z as f32);
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let slope = 30.0 * f * f * (f * (f - 2.0) + 1.0);
    // Gradient and height of the plane through each corner.
    let corner = |i: i32, j: i32, k: i32| {
        let direction = DIRECTIONS[(hash(x + i, y + j, z + k, seed) >> 28) as usize];
        direction.extend(direction.dot(f - Vec3::new(i as f32, j as f32, k as f32)))
    };
    let [a, b, c, d] = [corner(0, 0, 0), corner(1, 0, 0), corner(0, 1, 0), corner(1, 1, 0)];
    let [e, g, h, i] = [corner(0, 0, 1), corner(1, 0, 1), corner(0, 1, 1), corner(1, 1, 1)];
    let (front, back) = (a + fade.x * (b - a), e + fade.x * (g - e));
    let (front_rise, back_rise) = (c + fade.x * (d - c) - front, h + fade.x * (i - h) - back);
    let (near, far) = (front + fade.y * front_rise, back + fade.y * back_rise);
    let all = near + fade.z * (far - near);
    // The planes' gradients blend like their heights; the blending itself adds its own slope.
    let along_x = |from: f32, to: f32, from_below: f32, to_below: f32| {
        to - from + fade.y * ((to_below - from_below) - (to - from))
    };
    let (x_near, x_far) = (along_x(a.w, b.w, c.w, d.w), along_x(e.w, g.w, h.w, i.w));
    let blending = Vec3::new(
        x_near + fade.z * (x_far - x_near),
        front_rise.w + fade.z * (back_rise.w - front_rise.w),
        far.w - near.w,
    );
    Noise { value: all.w, gradient: (all.truncate() + slope * blending) / size }
}

/// Returns the whole number at or below `x`.
fn floor(x: f32) -> i32 {
    let towards_zero = x as i32;
    towards_zero - i32::from(x < towards_zero as f32)
}

/// Converts the low ten bits to a number in [0, 1).
fn unit(bits: u32) -> f32 {
    (bits & 1023) as f32 / 1024.0
}

/// Returns the distances to the nearest and second nearest of scattered points about `size` apart (Worley
/// 1996), in units of `size`.
pub(super) fn cells(p: Vec3, size: f32, seed: u32) -> (f32, f32) {
    let p = p / size;
    let cell = p.floor();
    let (mut first, mut second) = (f32::MAX, f32::MAX);
    for n in 0..27 {
        let corner = cell + Vec3::new((n % 3) as f32, (n / 3 % 3) as f32, (n / 9) as f32) - 1.0;
        let bits = hash(corner.x as i32, corner.y as i32, corner.z as i32, seed);
        let point = corner + Vec3::new(unit(bits), unit(bits >> 10), unit(bits >> 20));
        let d = p.distance_squared(point);
        (first, second) = if d < first { (d, first) } else { (first, second.min(d)) };
    }
    (first.sqrt(), second.sqrt())
}

/// Returns sin(2πx), to 4e-6: the Taylor series on a quarter turn.
pub(super) fn sine(turns: f32) -> f32 {
    let x = turns - (turns + 0.5).floor();
    let x = if x.abs() > 0.25 { 0.5_f32.copysign(x) - x } else { x };
    let s = x * x;
    x * (6.283_185_5 + s * (-41.341_7 + s * (81.605_25 + s * (-76.705_86 + s * 42.058_693))))
}

/// Returns cos(2πx).
pub(super) fn cosine(turns: f32) -> f32 {
    sine(turns + 0.25)
}

/// Returns 0 below `from`, 1 above `to`, and smooth values between (cubic; `from` may exceed `to`).
pub(super) fn smoothstep(from: f32, to: f32, x: f32) -> f32 {
    let s = ((x - from) / (to - from)).clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

/// Evaluates a smooth curve through equally spaced `values` (Catmull–Rom); `x` in 0..=1 spans them all.
pub(super) fn curve(values: &[f32], x: f32) -> f32 {
    let last = values.len() - 1;
    let x = x.clamp(0.0, 1.0) * last as f32;
    let i = (x as usize).min(last.saturating_sub(1));
    let f = x - i as f32;
    let (b, c) = (values[i], values[(i + 1).min(last)]);
    let a = if i > 0 { values[i - 1] } else { 2.0 * b - c };
    let d = if i + 2 <= last { values[i + 2] } else { 2.0 * c - b };
    let (p, q) = (0.5 * (c - a), 0.5 * (d - b));
    b + f * (p + f * (3.0 * (c - b) - 2.0 * p - q + f * (2.0 * (b - c) + p + q)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_is_the_sine() {
        for i in -300..300 {
            let x = i as f32 * 0.017;
            let error = f64::from(sine(x)) - (f64::from(x) * std::f64::consts::TAU).sin();
            assert!(error.abs() < 2e-5, "{x}: {error}");
        }
    }

    #[test]
    fn the_gradient_of_noise_is_its_slope() {
        for i in 0..60 {
            let p = Vec3::new(0.37, -1.21, 0.83) * i as f32;
            let there = noise(p, 3.0, 5);
            assert!(there.value.abs() <= 1.0);
            for axis in Vec3::AXES {
                let step = 0.01 * axis;
                let slope = (noise(p + step, 3.0, 5).value - noise(p - step, 3.0, 5).value) / 0.02;
                assert!((slope - there.gradient.dot(axis)).abs() < 2e-3, "{p}: {slope} {}", there.gradient);
            }
        }
    }

    #[test]
    fn a_curve_meets_its_values_and_keeps_straight_lines() {
        let values = [1.0, 4.0, -2.0, 0.5];
        for (i, v) in values.iter().enumerate() {
            assert!((curve(&values, i as f32 / 3.0) - v).abs() < 1e-5);
        }
        assert!((curve(&[0.0, 1.0, 2.0], 0.3) - 0.6).abs() < 1e-6);
    }

    #[test]
    fn cells_are_ordered_and_bounded() {
        for i in 0..100 {
            let (first, second) = cells(Vec3::new(0.31, 0.77, -0.53) * i as f32, 2.0, 1);
            assert!(first <= second && second < 1.8, "{first} {second}");
        }
    }
}
