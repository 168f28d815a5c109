//! From gradients of splats back to the parameters at rest, for each Gaussian.

use crate::{
    camera::{Camera, Twist},
    deform::{
        COLOUR_CHANNEL, Deformation, Deformed, GATE_CHANNEL, Geometry, MEAN_CHANNEL, Moved, ROTATION_CHANNEL,
        SCALE_CHANNEL, gate_feature_backward, move_geometry_backward,
    },
    gaussian::{Gaussians, MAX_SH_BANDS},
    raster::project::{CameraView, Splat, SplatGradient, project_backward, view_colour_backward},
    real::unit_quaternion,
};
use rayon::prelude::*;

/// Gradients with respect to the parameters at rest. Those of centres, rotations, log-scales and colours
/// are the first channels of `psi`, because ψ is added to them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// ∂L/∂ψ, [N][stride]. The gate's gradient is in the gate's own channels until [`Gradients::fold_gate`].
    pub psi: Vec<f32>,
    /// ∂L/∂ [`Gaussians::opacity_logits`].
    pub opacity_logits: Vec<f32>,
    /// ∂L/∂ [`Gaussians::sh_rest`].
    pub sh_rest: Vec<f32>,
    /// ∂L/∂ [`Gaussians::features`].
    pub features: Vec<f32>,
    /// ∂L/∂ the feature network: W flat, then b.
    pub net: Vec<f32>,
    /// ∂L/∂ a motion of the camera.
    pub camera: Twist<f32>,
}

/// Number of Gaussians per chunk. Partial sums of the network's gradient are added chunk by chunk, in order.
const CHUNK: usize = 1024;

/// Values of one rendered frame that the chain rule needs.
pub struct FrameState<'a> {
    /// Gaussians at rest.
    pub gaussians: &'a Gaussians,
    /// Their motion.
    pub deformation: &'a Deformation,
    /// ψ(t), [N][stride].
    pub psi: &'a [f32],
    /// Gaussians at time t.
    pub deformed: &'a Deformed,
    /// Gaussians on the image plane.
    pub splats: &'a [Splat<f32>],
    /// Camera of the frame.
    pub camera: &'a Camera,
    /// Time t.
    pub time: f32,
}

/// Applies the chain rule to all Gaussians; returns `false` if a gradient is not finite.
pub fn backward(
    state: &FrameState<'_>,
    g_splats: &[SplatGradient<f32>],
    g_features: &[f32],
    out: &mut Gradients,
) -> bool {
    let (n, stride) = (state.gaussians.len(), state.deformation.stride);
    let (bands, dim) = (state.gaussians.sh_bands() * 3, state.gaussians.latent_dim);
    let net_len = state.deformation.feature_weight.len() + state.deformation.feature_bias.len();
    out.psi.resize(n * stride, 0.0);
    out.opacity_logits.resize(n, 0.0);
    out.sh_rest.resize(n * bands, 0.0);
    out.features.resize(n * dim, 0.0);
    let view = CameraView::new(state.camera);
    let learns_features = dim > 0 && !g_features.is_empty();
    if !learns_features {
        out.features.fill(0.0);
    }
    let chunks = (
        out.psi.par_chunks_mut(CHUNK * stride),
        out.opacity_logits.par_chunks_mut(CHUNK),
        chunks_or_empty(&mut out.sh_rest, CHUNK * bands, n),
        chunks_or_empty(&mut out.features, CHUNK * dim, n),
    );
    let results: Vec<(Vec<f32>, [f32; 6], bool)> = chunks
        .into_par_iter()
        .enumerate()
        .map(|(k, (psi, opacity, rest, features))| {
            psi.fill(0.0);
            rest.fill(0.0);
            let mut net = vec![0.0; net_len];
            let mut camera = [0.0; 6];
            for (j, (g_psi, g_opacity)) in psi.chunks_exact_mut(stride).zip(opacity.iter_mut()).enumerate() {
                let i = k * CHUNK + j;
                let g_rest = &mut rest[j * bands..(j + 1) * bands];
                let (g_logit, g_camera) = geometry_and_colour(state, &view, i, &g_splats[i], g_rest, g_psi);
                *g_opacity = g_logit;
                camera.iter_mut().zip(g_camera.to_array()).for_each(|(total, part)| *total += part);
                if learns_features {
                    let g_out = &g_features[i * dim..(i + 1) * dim];
                    feature(state, i, g_out, &mut features[j * dim..(j + 1) * dim], g_psi, &mut net);
                }
            }
            let finite = [&*psi, opacity, rest, features, &net].into_iter().all(are_finite);
            (net, camera, finite)
        })
        .collect();
    out.net.clear();
    out.net.resize(net_len, 0.0);
    let mut camera = [0.0; 6];
    for (net, part, _) in &results {
        out.net.iter_mut().zip(net).for_each(|(a, b)| *a += b);
        camera.iter_mut().zip(part).for_each(|(a, b)| *a += b);
    }
    out.camera = Twist::of(camera);
    results.iter().all(|(_, _, finite)| *finite)
}

/// Splits into chunks of `size`. An empty array gives as many empty chunks as there are chunks of Gaussians.
fn chunks_or_empty(values: &mut [f32], size: usize, n: usize) -> Vec<&mut [f32]> {
    if values.is_empty() {
        (0..n.div_ceil(CHUNK)).map(|_| [].as_mut_slice()).collect()
    } else {
        values.chunks_mut(size).collect()
    }
}

/// Returns `true` if all values are finite: 0 · v is 0 for finite values and NaN for others.
fn are_finite(values: &[f32]) -> bool {
    let (chunks, rest) = values.as_chunks::<16>();
    let mut lanes = [0.0f32; 16];
    for chunk in chunks {
        lanes.iter_mut().zip(chunk).for_each(|(lane, v)| *lane += v * 0.0);
    }
    lanes.iter().chain(rest).all(|v| v.is_finite())
}

/// Writes one Gaussian's gradients except those of its features; returns that of its opacity logit and its
/// part of the camera's.
fn geometry_and_colour(
    state: &FrameState<'_>,
    view: &CameraView<f32>,
    i: usize,
    g: &SplatGradient<f32>,
    g_rest: &mut [f32],
    g_psi: &mut [f32],
) -> (f32, Twist<f32>) {
    let (gaussians, deformed, splat) = (state.gaussians, state.deformed, &state.splats[i]);
    if !splat.is_visible() {
        return Default::default();
    }
    let psi = &state.psi[i * state.deformation.stride..(i + 1) * state.deformation.stride];
    let turned = std::array::from_fn(|k| gaussians.rotations[i][k] + psi[ROTATION_CHANNEL + k]);
    let moved = Moved { geometry: deformed.geometry(i), quaternion_length: unit_quaternion(turned).1 };
    let rest = &gaussians.sh_rest[i * g_rest.len()..(i + 1) * g_rest.len()];
    let inputs = SplatInputs { view, degree: gaussians.sh_degree, rest, splat };
    let (g_geometry, g_camera, g_colour) = inputs.backward(&moved.geometry, g, g_rest);
    let raw = move_geometry_backward(&moved, &g_geometry);
    g_psi[MEAN_CHANNEL..MEAN_CHANNEL + 3].copy_from_slice(&raw.mean);
    g_psi[ROTATION_CHANNEL..ROTATION_CHANNEL + 4].copy_from_slice(&raw.rotation);
    g_psi[SCALE_CHANNEL..SCALE_CHANNEL + 3].copy_from_slice(&raw.scale);
    g_psi[COLOUR_CHANNEL..COLOUR_CHANNEL + 3].copy_from_slice(&g_colour);
    let opacity = splat.opacity;
    (g.opacity * opacity * (1.0 - opacity), g_camera)
}

/// Gradient of the camera's motion alone, for Gaussians at one time that stay as they are.
pub(super) fn camera_backward(
    gaussians: &Gaussians,
    deformed: &Deformed,
    splats: &[Splat<f32>],
    camera: &Camera,
    g_splats: &[SplatGradient<f32>],
) -> Twist<f32> {
    let view = CameraView::new(camera);
    let bands = gaussians.sh_bands() * 3;
    let of_chunk = |k: usize| {
        let mut sum = [0.0; 6];
        let mut g_rest = [0.0; MAX_SH_BANDS * 3];
        for i in (k * CHUNK..splats.len().min((k + 1) * CHUNK)).filter(|&i| splats[i].is_visible()) {
            let rest = &gaussians.sh_rest[i * bands..(i + 1) * bands];
            let inputs = SplatInputs { view: &view, degree: gaussians.sh_degree, rest, splat: &splats[i] };
            let (_, camera, _) = inputs.backward(&deformed.geometry(i), &g_splats[i], &mut g_rest[..bands]);
            sum.iter_mut().zip(camera.to_array()).for_each(|(total, part)| *total += part);
        }
        sum
    };
    let sums: Vec<[f32; 6]> = (0..splats.len().div_ceil(CHUNK)).into_par_iter().map(of_chunk).collect();
    Twist::of(sums.iter().fold([0.0; 6], |total, part| std::array::from_fn(|k| total[k] + part[k])))
}

/// Inputs of one Gaussian's splat.
struct SplatInputs<'a> {
    view: &'a CameraView<f32>,
    degree: usize,
    /// Its colour bands above 0.
    rest: &'a [f32],
    splat: &'a Splat<f32>,
}

impl SplatInputs<'_> {
    /// Gradients with respect to geometry, a motion of the camera, and band 0 of the colour; adds those of the
    /// other bands to `g_rest`.
    fn backward(
        &self,
        geometry: &Geometry<f32>,
        g: &SplatGradient<f32>,
        g_rest: &mut [f32],
    ) -> (Geometry<f32>, Twist<f32>, [f32; 3]) {
        let Self { view, degree, rest, splat } = *self;
        let (mut g_geometry, mut g_camera) = project_backward(view, geometry, g);
        let (g_mean, g_colour) =
            view_colour_backward(view, geometry.mean, degree, rest, splat.colour, g.colour, g_rest);
        // A turn about the camera changes no viewing direction, a shift does.
        for (total, part) in g_geometry.mean.iter_mut().zip(g_mean) {
            *total += part;
        }
        for (total, part) in g_camera.shift.iter_mut().zip(view.to_camera(g_mean)) {
            *total += part;
        }
        (g_geometry, g_camera, g_colour)
    }
}

fn feature(
    state: &FrameState<'_>,
    i: usize,
    g_out: &[f32],
    g_feature: &mut [f32],
    g_psi: &mut [f32],
    g_net: &mut [f32],
) {
    let dim = g_out.len();
    let stride = state.deformation.stride;
    let gate = i * stride + state.deformation.gate_channel;
    gate_feature_backward(
        &state.deformation.feature_net(),
        &state.gaussians.features[i * dim..(i + 1) * dim],
        &state.psi[gate..gate + dim],
        state.time,
        g_out,
        (g_feature, &mut g_psi[GATE_CHANNEL..GATE_CHANNEL + dim]),
        g_net,
    );
}

impl Gradients {
    /// Adds the gate's gradient to the channels that it reads. It does not belong to the parameters at
    /// rest, so this is called after their update.
    pub fn fold_gate(&mut self, deformation: &Deformation, latent_dim: usize) {
        if deformation.gate_channel == GATE_CHANNEL {
            return;
        }
        for row in self.psi.chunks_exact_mut(deformation.stride) {
            for d in 0..latent_dim {
                row[deformation.gate_channel + d] += std::mem::take(&mut row[GATE_CHANNEL + d]);
            }
        }
    }
}
