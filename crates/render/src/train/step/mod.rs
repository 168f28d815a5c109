//! The passes of a step after the picture: loss, gradients, update.

mod backward;
mod chain;
mod loss;
mod update;

use crate::{device::Gpu, shader::Shader, timer::Timer, train::current::CurrentStep};
use backward::BackwardPass;
use chain::ChainPass;
use loss::LossPass;
use surgtpgs_core::Result;
use update::UpdatePass;

/// Shaders of these passes.
pub(super) const SHADERS: &[Shader] = &[
    loss::LossWgsl::SHADER,
    loss::RegionsWgsl::SHADER,
    backward::BackwardWgsl::SHADER,
    backward::GatherWgsl::SHADER,
    chain::ChainWgsl::SHADER,
    chain::FeaturesWgsl::SHADER,
    chain::NetworkWgsl::SHADER,
    update::FinishStepWgsl::SHADER,
    update::UpdateWgsl::SHADER,
];

/// The passes for one latent dimension.
#[derive(Debug)]
pub(super) struct StepPasses {
    pub latent_dim: usize,
    pub loss: LossPass,
    pub backward: BackwardPass,
    pub chain: ChainPass,
    update: UpdatePass,
}

impl StepPasses {
    pub(super) fn new(gpu: &Gpu, latent_dim: usize, latents: &[f32]) -> Result<Self> {
        Ok(Self {
            latent_dim,
            loss: LossPass::new(gpu, latent_dim, latents)?,
            backward: BackwardPass::new(gpu, latent_dim)?,
            chain: ChainPass::new(gpu, latent_dim)?,
            update: UpdatePass::new(gpu, latent_dim)?,
        })
    }

    /// Makes room and adds the passes of a step, after those of its picture.
    pub(super) fn encode(
        &mut self,
        step: &CurrentStep<'_>,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
    ) -> Result<()> {
        let Self { loss, backward, chain, update, .. } = self;
        loss.prepare(step)?;
        backward.prepare(step, encoder)?;
        chain.prepare(step)?;
        update.prepare(step)?;
        loss.encode(step, &mut timer.begin(encoder, "loss"));
        backward.encode(step, &mut timer.begin(encoder, "backward"), &loss.g_planes);
        chain.encode(step, &mut timer.begin(encoder, "chain"), backward);
        update.encode(step, &mut timer.begin(encoder, "adam"), loss, backward, chain);
        Ok(())
    }
}
