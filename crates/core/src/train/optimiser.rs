//! Adam for every parameter group, at the learning rates of the settings.

use super::{adam::Adam, chain::Gradients, settings::TrainSettings};
use crate::{
    deform::{COLOUR_CHANNEL, Deformation, GATE_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL},
    gaussian::Gaussians,
};

/// Moments of all groups.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimiser {
    means: Adam,
    rotations: Adam,
    log_scales: Adam,
    opacity_logits: Adam,
    colours: Adam,
    sh_rest: Adam,
    features: Adam,
    net_weight: Adam,
    net_bias: Adam,
    /// One per basis: each counts only the steps at which it was live.
    bases: Vec<Adam>,
}

impl Optimiser {
    /// Zero moments.
    pub fn new(gaussians: &Gaussians, deformation: &Deformation) -> Self {
        let n = gaussians.len();
        Self {
            means: Adam::new(3 * n),
            rotations: Adam::new(4 * n),
            log_scales: Adam::new(3 * n),
            opacity_logits: Adam::new(n),
            colours: Adam::new(3 * n),
            sh_rest: Adam::new(gaussians.sh_rest.len()),
            features: Adam::new(gaussians.features.len()),
            net_weight: Adam::new(deformation.feature_weight.len()),
            net_bias: Adam::new(deformation.feature_bias.len()),
            bases: (0..deformation.num_bases).map(|_| Adam::new(n * deformation.stride)).collect(),
        }
    }

    /// One update of everything; `progress` is the share of training done, `world_per_px` the length of a pixel
    /// at the typical depth.
    pub fn step(
        &mut self,
        gaussians: &mut Gaussians,
        deformation: &mut Deformation,
        g: &Gradients,
        settings: &TrainSettings,
        (time, progress, world_per_px): (f32, f32, f32),
    ) {
        let r = &settings.rates;
        let decay = r.final_share.powf(progress);
        let mean_rate = r.mean_px * world_per_px * decay;
        self.means.step(gaussians.means.as_flattened_mut(), g.means.as_flattened(), mean_rate);
        self.rotations.step(gaussians.rotations.as_flattened_mut(), g.rotations.as_flattened(), r.rotation);
        self.log_scales.step(
            gaussians.log_scales.as_flattened_mut(),
            g.log_scales.as_flattened(),
            r.log_scale,
        );
        self.opacity_logits.step(&mut gaussians.opacity_logits, &g.opacity_logits, r.opacity);
        self.colours.step(gaussians.colours.as_flattened_mut(), g.colours.as_flattened(), r.colour);
        self.sh_rest.step(&mut gaussians.sh_rest, &g.sh_rest, r.sh_rest);
        self.features.step(&mut gaussians.features, &g.features, r.feature);
        let (g_weight, g_bias) = g.net.split_at(deformation.feature_weight.len());
        self.net_weight.step(&mut deformation.feature_weight, g_weight, r.feature);
        self.net_bias.step(&mut deformation.feature_bias, g_bias, r.feature);
        let scales = channel_rates(settings, deformation.stride, gaussians.latent_dim, world_per_px);
        let (values, live) = deformation.basis_values(time);
        let plane = gaussians.len() * deformation.stride;
        for b in live {
            let weights = &mut deformation.weights[b * plane..(b + 1) * plane];
            self.bases[b].step_rows(weights, &g.psi, decay, values[b], &scales);
        }
    }

    /// Follows a change of the set of Gaussians: row i of the new set keeps the moments of `rows[i]`, or starts afresh.
    pub fn rearrange(&mut self, rows: &[Option<u32>], sh_width: usize, latent_dim: usize, stride: usize) {
        self.means.rearrange(rows, 3);
        self.rotations.rearrange(rows, 4);
        self.log_scales.rearrange(rows, 3);
        self.opacity_logits.rearrange(rows, 1);
        self.colours.rearrange(rows, 3);
        self.sh_rest.rearrange(rows, sh_width);
        self.features.rearrange(rows, latent_dim);
        self.bases.iter_mut().for_each(|b| b.rearrange(rows, stride));
    }
}

/// Learning rate of each deformation channel before decay; 0 for channels that the settings keep still.
fn channel_rates(settings: &TrainSettings, stride: usize, latent_dim: usize, world_per_px: f32) -> Vec<f32> {
    let r = &settings.rates;
    let mut rates = vec![0.0; stride];
    rates[..ROTATION_CHANNEL].fill(r.motion_px * world_per_px);
    rates[ROTATION_CHANNEL..SCALE_CHANNEL].fill(r.rotation * r.motion_relative);
    rates[SCALE_CHANNEL..COLOUR_CHANNEL].fill(r.log_scale * r.motion_relative);
    let colour = if settings.colour_over_time { r.colour * r.motion_relative } else { 0.0 };
    rates[COLOUR_CHANNEL..GATE_CHANNEL].fill(colour);
    rates[GATE_CHANNEL..GATE_CHANNEL + latent_dim].fill(r.feature * r.motion_relative);
    rates
}
