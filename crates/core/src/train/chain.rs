//! From gradients of splats back to the parameters at rest, per Gaussian.

use crate::{
    camera::Camera,
    deform::{
        COLOUR_CHANNEL, Deformation, Deformed, GATE_CHANNEL, MEAN_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL,
        gate_feature_backward, move_geometry, move_geometry_backward,
    },
    gaussian::Gaussians,
    raster::project::{Geometry, Splat, SplatGradient, View, project_backward, view_colour_backward},
};
use rayon::prelude::*;

/// ∂L/∂ every parameter at rest, and ∂L/∂ψ from which those of the basis weights follow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// As [`Gaussians::means`].
    pub means: Vec<[f32; 3]>,
    /// As [`Gaussians::rotations`].
    pub rotations: Vec<[f32; 4]>,
    /// As [`Gaussians::log_scales`].
    pub log_scales: Vec<[f32; 3]>,
    /// As [`Gaussians::opacity_logits`].
    pub opacity_logits: Vec<f32>,
    /// As [`Gaussians::colours`].
    pub colours: Vec<[f32; 3]>,
    /// As [`Gaussians::sh_rest`].
    pub sh_rest: Vec<f32>,
    /// As [`Gaussians::features`].
    pub features: Vec<f32>,
    /// ∂L/∂ψ, [N][stride].
    pub psi: Vec<f32>,
    /// Feature network: W flat, then b.
    pub net: Vec<f32>,
}

/// One Gaussian's share of [`Gradients`]; what has a width of its own is written in place.
struct Row {
    mean: [f32; 3],
    rotation: [f32; 4],
    log_scale: [f32; 3],
    opacity_logit: f32,
    colour: [f32; 3],
}

/// Gaussians per chunk: partial sums of the network's gradient are added chunk by chunk, in order.
const CHUNK: usize = 1024;

/// Everything the chain rule needs of one rendered frame.
pub struct FrameState<'a> {
    /// At rest.
    pub gaussians: &'a Gaussians,
    /// How they move.
    pub deformation: &'a Deformation,
    /// ψ(t), [N][stride].
    pub psi: &'a [f32],
    /// At time t.
    pub deformed: &'a Deformed,
    /// On the image.
    pub splats: &'a [Splat<f32>],
    /// The frame's camera.
    pub camera: &'a Camera,
    /// t.
    pub time: f32,
}

/// Applies the chain rule to all Gaussians.
pub fn backward(state: &FrameState<'_>, g_splats: &[SplatGradient<f32>], g_features: &[f32]) -> Gradients {
    let (n, stride) = (state.gaussians.len(), state.deformation.stride);
    let (bands, dim) = (state.gaussians.sh_bands() * 3, state.gaussians.latent_dim);
    let mut out = Gradients {
        sh_rest: vec![0.0; n * bands],
        features: vec![0.0; n * dim],
        psi: vec![0.0; n * stride],
        net: vec![0.0; state.deformation.feature_weight.len() + state.deformation.feature_bias.len()],
        ..Gradients::default()
    };
    let net_len = out.net.len();
    let view = View::new(state.camera);
    let mut rest_chunks = chunks_or_empty(&mut out.sh_rest, CHUNK * bands, n);
    let mut feature_chunks = chunks_or_empty(&mut out.features, CHUNK * dim, n);
    let results: Vec<(Vec<Row>, Vec<f32>)> = out
        .psi
        .par_chunks_mut(CHUNK * stride)
        .zip(rest_chunks.par_iter_mut())
        .zip(feature_chunks.par_iter_mut())
        .enumerate()
        .map(|(k, ((g_psi, g_rest), g_feature))| {
            let mut net = vec![0.0; net_len];
            let rows = g_psi.chunks_mut(stride).enumerate().map(|(j, g_psi)| {
                let i = k * CHUNK + j;
                let g_rest = &mut g_rest[j * bands..(j + 1) * bands];
                let row = geometry_and_colour(state, &view, i, &g_splats[i], g_rest, g_psi);
                if dim > 0 && !g_features.is_empty() {
                    let g_out = &g_features[i * dim..(i + 1) * dim];
                    feature(state, i, g_out, &mut g_feature[j * dim..(j + 1) * dim], g_psi, &mut net);
                }
                row
            });
            (rows.collect(), net)
        })
        .collect();
    for (rows, net) in results {
        for row in rows {
            out.means.push(row.mean);
            out.rotations.push(row.rotation);
            out.log_scales.push(row.log_scale);
            out.opacity_logits.push(row.opacity_logit);
            out.colours.push(row.colour);
        }
        out.net.iter_mut().zip(net).for_each(|(a, b)| *a += b);
    }
    out
}

/// Chunks of `size`; as many empty ones as there are chunks of Gaussians where the array is empty.
fn chunks_or_empty(values: &mut [f32], size: usize, n: usize) -> Vec<&mut [f32]> {
    if values.is_empty() {
        (0..n.div_ceil(CHUNK)).map(|_| [].as_mut_slice()).collect()
    } else {
        values.chunks_mut(size).collect()
    }
}

fn geometry_and_colour(
    state: &FrameState<'_>,
    view: &View<f32>,
    i: usize,
    g: &SplatGradient<f32>,
    g_rest: &mut [f32],
    g_psi: &mut [f32],
) -> Row {
    let (gaussians, deformed, splat) = (state.gaussians, state.deformed, &state.splats[i]);
    if !splat.is_visible() {
        return Row {
            mean: [0.0; 3],
            rotation: [0.0; 4],
            log_scale: [0.0; 3],
            opacity_logit: 0.0,
            colour: [0.0; 3],
        };
    }
    let psi = &state.psi[i * state.deformation.stride..(i + 1) * state.deformation.stride];
    let mean = deformed.means[i];
    let moved = move_geometry(gaussians.means[i], gaussians.rotations[i], gaussians.log_scales[i], psi);
    let mut g_geometry: Geometry<f32> = project_backward(view, &moved.geometry, g);
    let rest = &gaussians.sh_rest[i * g_rest.len()..(i + 1) * g_rest.len()];
    let (g_mean, g_colour) =
        view_colour_backward(view, mean, gaussians.sh_degree, rest, splat.colour, g.colour, g_rest);
    for (total, part) in g_geometry.mean.iter_mut().zip(g_mean) {
        *total += part;
    }
    let raw = move_geometry_backward(&moved, &g_geometry);
    g_psi[MEAN_CHANNEL..MEAN_CHANNEL + 3].copy_from_slice(&raw.mean);
    g_psi[ROTATION_CHANNEL..ROTATION_CHANNEL + 4].copy_from_slice(&raw.rotation);
    g_psi[SCALE_CHANNEL..SCALE_CHANNEL + 3].copy_from_slice(&raw.scale);
    g_psi[COLOUR_CHANNEL..COLOUR_CHANNEL + 3].copy_from_slice(&g_colour);
    let opacity = splat.opacity;
    Row {
        mean: raw.mean,
        rotation: raw.rotation,
        log_scale: raw.scale,
        opacity_logit: g.opacity * opacity * (1.0 - opacity),
        colour: g_colour,
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
    let at = i * state.deformation.stride + GATE_CHANNEL;
    gate_feature_backward(
        &state.deformation.feature_net(),
        &state.gaussians.features[i * dim..(i + 1) * dim],
        &state.psi[at..at + dim],
        state.time,
        g_out,
        (g_feature, &mut g_psi[GATE_CHANNEL..GATE_CHANNEL + dim]),
        g_net,
    );
}

impl Gradients {
    /// Whether every gradient is a finite number.
    pub fn are_finite(&self) -> bool {
        let flat = [
            self.means.as_flattened(),
            self.rotations.as_flattened(),
            self.log_scales.as_flattened(),
            &self.opacity_logits,
            self.colours.as_flattened(),
            &self.sh_rest,
            &self.features,
            &self.psi,
            &self.net,
        ];
        flat.iter().all(|values| values.par_chunks(16384).all(|c| c.iter().all(|v| v.is_finite())))
    }
}
