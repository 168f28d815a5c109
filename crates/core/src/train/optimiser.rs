//! Adam for every parameter group, at the learning rates of the settings.

use super::{
    adam::{Adam, Update, WIDTH},
    chain::Gradients,
    settings::{LengthUnit, TrainSettings},
};
use crate::{
    deform::{
        COLOUR_CHANNEL, Deformation, GATE_CHANNEL, MEAN_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL, basis,
        basis_backward,
    },
    gaussian::Gaussians,
};
use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use rayon::prelude::*;

/// Index of the opacity logit in a row of the parameters at rest; the channels of ψ come before it.
pub const OPACITY_CHANNEL: usize = GATE_CHANNEL;

/// Moments of all parameter groups.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Optimiser {
    /// Moments of centre, rotation, log-scale, colour and opacity: [N][[`WIDTH`]], in the order of ψ's
    /// channels.
    pub rest: Adam,
    /// Moments of [`Gaussians::sh_rest`].
    pub sh_rest: Adam,
    /// Moments of [`Gaussians::features`].
    pub features: Adam,
    /// Moments of [`Deformation::feature_weight`].
    pub net_weight: Adam,
    /// Moments of [`Deformation::feature_bias`].
    pub net_bias: Adam,
    /// Moments of the weights of each basis, which count only the steps at which it was live.
    pub bases: Vec<Adam>,
    /// Moments of the centres and widths of every basis function; empty if they are shared, and thus fixed.
    pub own_bases: Vec<[Adam; 2]>,
}

impl Optimiser {
    /// Makes zero moments.
    pub fn new(gaussians: &Gaussians, deformation: &Deformation) -> Self {
        let n = gaussians.len();
        Self {
            rest: Adam::new(n * WIDTH),
            sh_rest: Adam::new(gaussians.sh_rest.len()),
            features: Adam::new(gaussians.features.len()),
            net_weight: Adam::new(deformation.feature_weight.len()),
            net_bias: Adam::new(deformation.feature_bias.len()),
            bases: (0..deformation.num_bases).map(|_| Adam::new(n * deformation.stride)).collect(),
            own_bases: if deformation.is_shared() {
                Vec::new()
            } else {
                let adam = || Adam::new(n * deformation.stride);
                (0..deformation.num_bases).map(|_| [adam(), adam()]).collect()
            },
        }
    }

    /// Returns `true` if there are as many moments as parameters.
    pub fn fits(&self, gaussians: &Gaussians, deformation: &Deformation) -> bool {
        let fresh = Self::new(gaussians, deformation);
        let sizes = |o: &Self| -> Vec<[usize; 2]> {
            let single = [&o.rest, &o.sh_rest, &o.features, &o.net_weight, &o.net_bias];
            single
                .into_iter()
                .chain(&o.bases)
                .chain(o.own_bases.iter().flatten())
                .map(|a| [a.first.len(), a.second.len()])
                .collect()
        };
        sizes(self) == sizes(&fresh)
    }

    /// Updates all parameters once. `progress` is the share of training done, `world_per_px` the length
    /// of a pixel at the typical depth.
    pub fn step(
        &mut self,
        gaussians: &mut Gaussians,
        deformation: &mut Deformation,
        g: &mut Gradients,
        settings: &TrainSettings,
        (time, progress, world_per_px): (f32, f32, f32),
    ) {
        let r = &settings.rates;
        let rates = Rates::new(settings, deformation.stride, gaussians.latent_dim, progress, world_per_px);
        let update = self.rest.next_update(1.0, 1.0);
        step_rest(update, &mut self.rest, gaussians, g, deformation.stride, &rates.rest);
        g.fold_gate(deformation, gaussians.latent_dim);
        self.sh_rest.step(&mut gaussians.sh_rest, &g.sh_rest, rates.sh_rest);
        self.features.step(&mut gaussians.features, &g.features, r.feature);
        let (g_weight, g_bias) = g.net.split_at(deformation.feature_weight.len());
        if settings.feature_motion {
            self.net_weight.step(&mut deformation.feature_weight, g_weight, r.feature);
            self.net_bias.step(&mut deformation.feature_bias, g_bias, r.feature);
        }
        let Rates { decay, channels: scales, .. } = rates;
        if !deformation.is_shared() {
            self.step_own_bases(deformation, g, time, decay, &scales);
            return;
        }
        let (values, live) = deformation.basis_values(time);
        let plane = gaussians.len() * deformation.stride;
        for b in live {
            let weights = &mut deformation.weights[b * plane..(b + 1) * plane];
            self.bases[b].step_rows(weights, &g.psi, decay, values[b], &scales);
        }
    }

    /// Updates once all basis functions, live or not, of Gaussians that have their own, as the released
    /// code does.
    fn step_own_bases(
        &mut self,
        deformation: &mut Deformation,
        g: &Gradients,
        time: f32,
        rate: f32,
        scales: &[f32],
    ) {
        let plane = g.psi.len();
        for b in 0..deformation.num_bases {
            let gradients = own_basis_gradients(deformation, b, &g.psi, time);
            let at = b * plane..(b + 1) * plane;
            let column = |k: usize| gradients.par_iter().map(|g| g[k]).collect::<Vec<f32>>();
            let [centre_adam, width_adam] = &mut self.own_bases[b];
            self.bases[b].step_rows(&mut deformation.weights[at.clone()], &column(0), rate, 1.0, scales);
            centre_adam.step_rows(&mut deformation.centres[at.clone()], &column(1), rate, 1.0, scales);
            width_adam.step_rows(&mut deformation.widths[at], &column(2), rate, 1.0, scales);
        }
    }

    /// Adapts to a change of the set of Gaussians: row i of the new set keeps the moments of `rows[i]`,
    /// or starts afresh.
    pub fn rearrange(&mut self, rows: &[Option<u32>], sh_width: usize, latent_dim: usize, stride: usize) {
        self.rest.rearrange(rows, WIDTH);
        self.sh_rest.rearrange(rows, sh_width);
        self.features.rearrange(rows, latent_dim);
        let own = self.own_bases.iter_mut().flatten();
        self.bases.iter_mut().chain(own).for_each(|b| b.rearrange(rows, stride));
    }
}

/// ∂L/∂(weight, centre, width) of basis `b` for every Gaussian and channel, given ∂L/∂ψ.
pub(super) fn own_basis_gradients(
    deformation: &Deformation,
    b: usize,
    g_psi: &[f32],
    time: f32,
) -> Vec<[f32; 3]> {
    let at = b * g_psi.len()..(b + 1) * g_psi.len();
    let own = deformation.centres[at.clone()].par_iter().zip(&deformation.widths[at.clone()]);
    let parameters = deformation.weights[at].par_iter().zip(own);
    g_psi
        .par_iter()
        .zip(parameters)
        .with_min_len(1 << 14)
        .map(|(g_psi, (weight, (centre, width)))| {
            // Most channels of most Gaussians are padding or at rest.
            if *g_psi == 0.0 {
                return [0.0; 3];
            }
            let value = basis(deformation.shape, time, *centre, *width);
            let (by_centre, by_width) = basis_backward(deformation.shape, time, *centre, *width);
            [value, weight * by_centre, weight * by_width].map(|v| v * g_psi)
        })
        .collect()
}

/// Number of Gaussians per parallel piece.
const CHUNK: usize = 1024;

/// Updates the parameters at rest of every Gaussian, one row of [`WIDTH`] numbers each.
fn step_rest(
    update: Update,
    adam: &mut Adam,
    gaussians: &mut Gaussians,
    g: &Gradients,
    stride: usize,
    rates: &[f32; WIDTH],
) {
    let level = Level::new();
    let parameters = (
        gaussians.means.par_chunks_mut(CHUNK),
        gaussians.rotations.par_chunks_mut(CHUNK),
        gaussians.log_scales.par_chunks_mut(CHUNK),
        gaussians.colours.par_chunks_mut(CHUNK),
        gaussians.opacity_logits.par_chunks_mut(CHUNK),
    );
    let moments = (adam.first.par_chunks_mut(CHUNK * WIDTH), adam.second.par_chunks_mut(CHUNK * WIDTH));
    let gradients = (g.psi.par_chunks(CHUNK * stride), g.opacity_logits.par_chunks(CHUNK));
    (parameters, moments, gradients).into_par_iter().for_each(
        |((means, rotations, log_scales, colours, opacities), (first, second), (psi, g_opacity))| {
            let (first, second) = (first.as_chunks_mut().0, second.as_chunks_mut().0);
            for i in 0..means.len() {
                let mut g_row = [0.0; WIDTH];
                g_row[..OPACITY_CHANNEL].copy_from_slice(&psi[i * stride..i * stride + OPACITY_CHANNEL]);
                g_row[OPACITY_CHANNEL] = g_opacity[i];
                let mut row = [0.0; WIDTH];
                row[MEAN_CHANNEL..ROTATION_CHANNEL].copy_from_slice(&means[i]);
                row[ROTATION_CHANNEL..SCALE_CHANNEL].copy_from_slice(&rotations[i]);
                row[SCALE_CHANNEL..COLOUR_CHANNEL].copy_from_slice(&log_scales[i]);
                row[COLOUR_CHANNEL..OPACITY_CHANNEL].copy_from_slice(&colours[i]);
                row[OPACITY_CHANNEL] = opacities[i];
                dispatch!(level, simd =>
                    update_row(simd, update, &mut row, (&mut first[i], &mut second[i]), &g_row, rates));
                means[i].copy_from_slice(&row[MEAN_CHANNEL..ROTATION_CHANNEL]);
                rotations[i].copy_from_slice(&row[ROTATION_CHANNEL..SCALE_CHANNEL]);
                log_scales[i].copy_from_slice(&row[SCALE_CHANNEL..COLOUR_CHANNEL]);
                colours[i].copy_from_slice(&row[COLOUR_CHANNEL..OPACITY_CHANNEL]);
                opacities[i] = row[OPACITY_CHANNEL];
            }
        },
    );
}

#[simd]
fn update_row<S: Simd>(
    _: S,
    update: Update,
    row: &mut [f32; WIDTH],
    moments: (&mut [f32; WIDTH], &mut [f32; WIDTH]),
    g: &[f32; WIDTH],
    rates: &[f32; WIDTH],
) {
    update.apply(row, moments, g, rates);
}

/// Learning rates of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct Rates {
    /// Decay of the rates of centres and basis weights so far, as a share.
    pub decay: f32,
    /// Rates of the parameters at rest, in the order of ψ's channels, then opacity.
    pub rest: [f32; WIDTH],
    /// Rate of the higher colour bands.
    pub sh_rest: f32,
    /// Rates of the deformation channels before decay, [stride]; 0 for those that the settings keep still.
    pub channels: Vec<f32>,
}

impl Rates {
    /// Rates at the share `progress` of training.
    pub fn new(
        settings: &TrainSettings,
        stride: usize,
        latent_dim: usize,
        progress: f32,
        world_per_px: f32,
    ) -> Self {
        let cooldown = settings.rates.cooldown_at(progress);
        let decay = cooldown * settings.rates.final_share.powf(progress);
        let length = match settings.rates.unit {
            LengthUnit::Pixel => world_per_px,
            LengthUnit::Scene => 1.0,
        };
        Self {
            decay,
            rest: rest_rates(settings, length * decay, cooldown),
            sh_rest: settings.rates.sh_rest * cooldown,
            channels: channel_rates(settings, stride, latent_dim, length),
        }
    }
}

/// Learning rates of the parameters at rest; `length` is the unit of lengths, after decay, `cooldown` the
/// share of the other rates.
fn rest_rates(settings: &TrainSettings, length: f32, cooldown: f32) -> [f32; WIDTH] {
    let r = &settings.rates;
    let mut rates = [0.0; WIDTH];
    rates[MEAN_CHANNEL..ROTATION_CHANNEL].fill(r.mean * length);
    rates[ROTATION_CHANNEL..SCALE_CHANNEL].fill(r.rotation * cooldown);
    rates[SCALE_CHANNEL..COLOUR_CHANNEL].fill(r.log_scale * cooldown);
    rates[COLOUR_CHANNEL..OPACITY_CHANNEL].fill(r.colour * cooldown);
    rates[OPACITY_CHANNEL] = r.opacity * cooldown;
    rates
}

/// Learning rate of each deformation channel before decay; 0 for channels that the settings keep still.
fn channel_rates(settings: &TrainSettings, stride: usize, latent_dim: usize, length: f32) -> Vec<f32> {
    let r = &settings.rates;
    let motion = r.motion * length;
    let relative = |rate: f32| if r.uniform_motion { motion } else { rate * r.motion_relative };
    let mut rates = vec![0.0; stride];
    rates[..ROTATION_CHANNEL].fill(motion);
    if !settings.depth_over_time {
        rates[MEAN_CHANNEL + 2] = 0.0;
    }
    rates[ROTATION_CHANNEL..SCALE_CHANNEL].fill(relative(r.rotation));
    rates[SCALE_CHANNEL..COLOUR_CHANNEL].fill(relative(r.log_scale));
    if settings.colour_over_time {
        rates[COLOUR_CHANNEL..GATE_CHANNEL].fill(relative(r.colour));
    }
    if settings.feature_motion {
        rates[GATE_CHANNEL..GATE_CHANNEL + latent_dim].fill(relative(r.feature));
    }
    rates
}
