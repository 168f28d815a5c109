//! Deformation of one Gaussian: ψ(t) added to raw parameters, then activated; and the gradients (method
//! §3.2–3.3).

use super::{MEAN_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL};
use crate::real::{Real, Vector, unit_quaternion, unit_quaternion_backward};

/// Log-scales are kept within ± this, so that neither a scale nor its square leaves the range of f32.
pub const MAX_LOG_SCALE: f64 = 15.0;

/// e to the power of [`MAX_LOG_SCALE`].
pub const MAX_SCALE: f64 = 3_269_017.372_472_11;

/// Position, orientation and size of one Gaussian, activated.
#[derive(Clone, Copy, Debug)]
pub struct Geometry<T> {
    /// Centre in the world.
    pub mean: Vector<T, 3>,
    /// Unit quaternion (w, x, y, z).
    pub rotation: Vector<T, 4>,
    /// Standard deviations.
    pub scale: Vector<T, 3>,
}

/// A deformed, activated geometry with the values that its backward pass needs.
#[derive(Clone, Copy, Debug)]
pub struct Moved<T> {
    /// The geometry at time t.
    pub geometry: Geometry<T>,
    /// ‖q + Δq‖; 0 where the quaternion had no direction.
    pub quaternion_length: T,
}

/// Eq. 2: μ + ψ, normalise(q + ψ), exp(log s + ψ).
pub fn move_geometry<T: Real>(
    mean: Vector<T, 3>,
    rotation: Vector<T, 4>,
    log_scale: Vector<T, 3>,
    psi: &[T],
) -> Moved<T> {
    let limit = T::of(MAX_LOG_SCALE);
    let (unit, quaternion_length) =
        unit_quaternion(std::array::from_fn(|i| rotation[i] + psi[ROTATION_CHANNEL + i]));
    Moved {
        geometry: Geometry {
            mean: std::array::from_fn(|i| mean[i] + psi[MEAN_CHANNEL + i]),
            rotation: unit,
            scale: std::array::from_fn(|i| {
                (log_scale[i] + psi[SCALE_CHANNEL + i]).max(-limit).min(limit).exp()
            }),
        },
        quaternion_length,
    }
}

/// Gradients with respect to mean, raw quaternion and log-scale; those of ψ's channels are the same numbers.
pub fn move_geometry_backward<T: Real>(moved: &Moved<T>, g: &Geometry<T>) -> Geometry<T> {
    let inside = |s: T| s < T::of(MAX_SCALE) && s > T::of(1.0 / MAX_SCALE);
    Geometry {
        mean: g.mean,
        rotation: unit_quaternion_backward(moved.geometry.rotation, moved.quaternion_length, g.rotation),
        scale: std::array::from_fn(|i| {
            let s = moved.geometry.scale[i];
            if inside(s) { g.scale[i] * s } else { T::zero() }
        }),
    }
}

/// Feature network g([f, t]) = W [f; t] + b and the slope δ of its gate.
#[derive(Clone, Copy, Debug)]
pub struct FeatureNet<'a, T> {
    /// W, [D][D + 1] flat.
    pub weight: &'a [T],
    /// b, [D].
    pub bias: &'a [T],
    /// δ.
    pub slope: T,
}

impl<T: Real> FeatureNet<'_, T> {
    /// Row `i` of W [f; t] + b.
    fn output(&self, i: usize, feature: &[T], time: T) -> T {
        let row = &self.weight[i * (feature.len() + 1)..(i + 1) * (feature.len() + 1)];
        feature.iter().zip(row).map(|(f, w)| *f * *w).sum::<T>() + row[feature.len()] * time + self.bias[i]
    }
}

/// Eq. 3: f' = f + g([f, t]) ⊙ σ(δ ψ^f); `gate` is ψ^f. Results that are not finite become 0, so that one
/// bad number does not blot out every pixel that it touches.
pub fn gate_feature<T: Real>(net: &FeatureNet<'_, T>, feature: &[T], gate: &[T], time: T, out: &mut [T]) {
    for (i, o) in out.iter_mut().enumerate() {
        let value = feature[i] + net.output(i, feature, time) * (net.slope * gate[i]).sigmoid();
        *o = if value.is_finite() { value } else { T::zero() };
    }
}

/// Gradients of [`gate_feature`]: writes those of `feature` and `gate`, and adds to those of the network
/// (`g_net`: W flat, then b).
pub fn gate_feature_backward<T: Real>(
    net: &FeatureNet<'_, T>,
    feature: &[T],
    gate: &[T],
    time: T,
    g_out: &[T],
    (g_feature, g_gate): (&mut [T], &mut [T]),
    g_net: &mut [T],
) {
    let dim = feature.len();
    g_feature.copy_from_slice(g_out);
    for i in 0..dim {
        let open = (net.slope * gate[i]).sigmoid();
        g_gate[i] = g_out[i] * net.output(i, feature, time) * open * (T::one() - open) * net.slope;
        let g = g_out[i] * open;
        for j in 0..dim {
            g_feature[j] += g * net.weight[i * (dim + 1) + j];
            g_net[i * (dim + 1) + j] += g * feature[j];
        }
        g_net[i * (dim + 1) + dim] += g * time;
        g_net[dim * (dim + 1) + i] += g;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn geometry_gradients_match_finite_differences() {
        let psi: Vec<f64> = (0..16).map(|i| 0.1 * (i as f64 * 1.7).sin()).collect();
        let parameters = [0.3, -0.2, 1.5, 0.9, 0.2, -0.4, 0.1, -1.0, 0.3, 0.1];
        let evaluate = |p: &[f64; 10]| {
            let m = move_geometry([p[0], p[1], p[2]], [p[3], p[4], p[5], p[6]], [p[7], p[8], p[9]], &psi);
            let g = m.geometry;
            (
                g.mean[0] - 2.0 * g.mean[2] + g.rotation[0] - 0.7 * g.rotation[1]
                    + 1.3 * g.rotation[3]
                    + g.scale[0] * g.scale[2],
                m,
            )
        };
        let (_, moved) = evaluate(&parameters);
        let s = moved.geometry.scale;
        let upstream =
            Geometry { mean: [1.0, 0.0, -2.0], rotation: [1.0, -0.7, 0.0, 1.3], scale: [s[2], 0.0, s[0]] };
        let g = move_geometry_backward(&moved, &upstream);
        let analytic: Vec<f64> = g.mean.iter().chain(&g.rotation).chain(&g.scale).copied().collect();
        for i in 0..10 {
            let step = |h: f64| {
                let mut p = parameters;
                p[i] += h;
                evaluate(&p).0
            };
            let numeric = (step(1e-6) - step(-1e-6)) / 2e-6;
            assert!((analytic[i] - numeric).abs() < 1e-7, "parameter {i}");
        }
    }

    #[test]
    fn feature_gradients_match_finite_differences() {
        const D: usize = 3;
        let initial: Vec<f64> = (0..2 * D + D * (D + 1) + D).map(|i| (i as f64 * 2.3 + 0.4).cos()).collect();
        let (time, upstream) = (0.4, [0.7, -1.1, 0.2]);
        let split = |p: &[f64]| -> [Vec<f64>; 4] {
            let (f, rest) = p.split_at(D);
            let (gate, rest) = rest.split_at(D);
            let (weight, bias) = rest.split_at(D * (D + 1));
            [f.to_vec(), gate.to_vec(), weight.to_vec(), bias.to_vec()]
        };
        let evaluate = |p: &[f64]| {
            let [f, gate, weight, bias] = split(p);
            let mut out = [0.0; D];
            gate_feature(&FeatureNet { weight: &weight, bias: &bias, slope: 2.5 }, &f, &gate, time, &mut out);
            out.iter().zip(upstream).map(|(o, u)| o * u).sum::<f64>()
        };
        let [f, gate, weight, bias] = split(&initial);
        let (mut g_f, mut g_gate, mut g_net) = ([0.0; D], [0.0; D], [0.0; D * (D + 1) + D]);
        let net = FeatureNet { weight: &weight, bias: &bias, slope: 2.5 };
        gate_feature_backward(&net, &f, &gate, time, &upstream, (&mut g_f, &mut g_gate), &mut g_net);
        let analytic: Vec<f64> = g_f.iter().chain(&g_gate).chain(&g_net).copied().collect();
        for i in 0..initial.len() {
            let step = |h: f64| {
                let mut p = initial.clone();
                p[i] += h;
                evaluate(&p)
            };
            let numeric = (step(1e-6) - step(-1e-6)) / 2e-6;
            assert!((analytic[i] - numeric).abs() < 1e-7, "parameter {i}");
        }
    }

    #[test]
    fn extreme_parameters_stay_finite() {
        assert!((MAX_SCALE.ln() - MAX_LOG_SCALE).abs() < 1e-12);
        let psi = [0.0_f32; 16];
        let m = move_geometry([0.0; 3], [0.0; 4], [1e30, -1e30, 0.0], &psi);
        assert_eq!(m.geometry.rotation, [1.0, 0.0, 0.0, 0.0]);
        assert!(m.geometry.scale.iter().all(|s| s.is_finite() && *s > 0.0));
    }
}
