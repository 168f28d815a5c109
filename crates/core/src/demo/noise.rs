//! Smooth pseudo-random fields and curves, from additions, products and square roots alone: those are exact
//! in IEEE arithmetic, so every machine draws the same picture (`f32::sin` and its kin differ between systems).

use glam::Vec3;

/// Mixes a lattice position and a seed into 32 even bits.
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
    /// Derivative with respect to the position that was asked for.
    pub(super) gradient: Vec3,
}

/// Gradient noise of feature size `size` at `p` (Perlin 2002, with its analytic derivative).
pub(super) fn noise(p: Vec3, size: f32, seed: u32) -> Noise {
    let p = p / size;
    let cell = p.floor();
    let f = p - cell;
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let slope = 30.0 * f * f * (f * (f - 2.0) + 1.0);
    let (x, y, z) = (cell.x as i32, cell.y as i32, cell.z as i32);
    let (mut value, mut gradient) = (0.0, Vec3::ZERO);
    for corner in 0..8 {
        let (i, j, k) = (corner & 1, corner >> 1 & 1, corner >> 2);
        let bits = hash(x + i, y + j, z + k, seed);
        let direction = Vec3::new(unit(bits), unit(bits >> 10), unit(bits >> 20)) * 2.0 - 1.0;
        let offset = Vec3::new(i as f32, j as f32, k as f32);
        let height = direction.dot(f - offset);
        // Weight of this corner along each axis and its derivative.
        let weight = Vec3::ONE - offset + (2.0 * offset - 1.0) * fade;
        let change = (2.0 * offset - 1.0) * slope;
        let product = weight.x * weight.y * weight.z;
        value += product * height;
        gradient += product * direction
            + height
                * Vec3::new(
                    change.x * weight.y * weight.z,
                    weight.x * change.y * weight.z,
                    weight.x * weight.y * change.z,
                );
    }
    Noise { value, gradient: gradient / size }
}

/// The low ten bits as a number in [0, 1).
fn unit(bits: u32) -> f32 {
    (bits & 1023) as f32 / 1024.0
}

/// Distances to the nearest and second nearest of scattered points about `size` apart (Worley 1996), in `size`.
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

/// sin(2πx), to 4e-6: the Taylor series on a quarter turn.
pub(super) fn sine(turns: f32) -> f32 {
    let x = turns - (turns + 0.5).floor();
    let x = if x.abs() > 0.25 { 0.5_f32.copysign(x) - x } else { x };
    let s = x * x;
    x * (6.283_185_5 + s * (-41.341_7 + s * (81.605_25 + s * (-76.705_86 + s * 42.058_693))))
}

/// cos(2πx).
pub(super) fn cosine(turns: f32) -> f32 {
    sine(turns + 0.25)
}

/// 0 below `from`, 1 above `to`, smooth between (cubic; `from` may exceed `to`).
pub(super) fn smoothstep(from: f32, to: f32, x: f32) -> f32 {
    let s = ((x - from) / (to - from)).clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

/// A smooth curve through equally spaced `values` (Catmull–Rom); `x` in 0..=1 spans them all.
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
