//! Random numbers by counter: the same counter gives the same numbers, in any order and on any number of
//! threads. Twin of `shaders/shared/random.wgsl`.

/// PCG in four dimensions (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020).
fn pcg4d(counter: [u32; 4]) -> [u32; 4] {
    let mix = |[x, y, z, w]: [u32; 4]| {
        let x = x.wrapping_add(y.wrapping_mul(w));
        let y = y.wrapping_add(z.wrapping_mul(x));
        let z = z.wrapping_add(x.wrapping_mul(y));
        [x, y, z, w.wrapping_add(y.wrapping_mul(z))]
    };
    let seeded = counter.map(|v| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    mix(mix(seeded).map(|v| v ^ (v >> 16)))
}

/// Four numbers, evenly distributed over [0, 1).
fn uniform4(counter: [u32; 4]) -> [f32; 4] {
    pcg4d(counter).map(|v| (v >> 8) as f32 / (1 << 24) as f32)
}

/// Four normally distributed numbers (Box and Muller).
pub(super) fn normal4(counter: [u32; 4]) -> [f32; 4] {
    let [a, b, c, d] = uniform4(counter);
    let pair = |u: f32, turn: f32| {
        // 1 - u is in (0, 1], so that the logarithm is finite.
        let (radius, angle) = ((-2.0 * (1.0 - u).ln()).sqrt(), std::f32::consts::TAU * turn);
        (radius * angle.cos(), radius * angle.sin())
    };
    let ((x, z), (y, w)) = (pair(a, c), pair(b, d));
    [x, y, z, w]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_are_those_of_the_published_hash() {
        // The expected numbers are those of the listing in the paper's supplement, in 32-bit integers.
        assert_eq!(pcg4d([0; 4]), [0x0f02f829, 0x2d568769, 0x32b0c43b, 0xd32548ea]);
        assert_eq!(pcg4d([1, 2, 3, 4]), [0x3622cd16, 0xf11471d8, 0xe1109b3f, 0x02b94c2f]);
    }

    #[test]
    fn numbers_are_spread_as_they_should_be() {
        let all = |f: fn([u32; 4]) -> [f32; 4]| -> Vec<f64> {
            (0..5000).flat_map(|i| f([7, 300, i, 0])).map(f64::from).collect()
        };
        let moments = |v: &[f64]| {
            let mean = v.iter().sum::<f64>() / v.len() as f64;
            (mean, v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / v.len() as f64)
        };
        let (uniform, normal) = (all(uniform4), all(normal4));
        assert!(uniform.iter().all(|u| (0.0..1.0).contains(u)) && normal.iter().all(|v| v.is_finite()));
        // The limits are five standard errors of 20,000 numbers.
        let (mean, variance) = moments(&uniform);
        assert!((mean - 0.5).abs() < 0.011 && (variance - 1.0 / 12.0).abs() < 0.003, "{mean} {variance}");
        let (mean, variance) = moments(&normal);
        assert!(mean.abs() < 0.036 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
    }
}
