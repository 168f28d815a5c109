//! From the gradients of splats and features to those of everything learned (`shaders/chain.wgsl`,
//! `shaders/features_backward.wgsl`, `shaders/network.wgsl`).

use super::backward::BackwardPass;
use crate::{
    buffers::{DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    planes::DeformParams,
    rows::{DeformedRow, RestRow, SplatGradientRow, SplatRow, ViewParams},
    shader::{GROUP, shader, shader_struct},
    train::{current::CurrentStep, status},
};
use surgtpgs_core::{Result, deform::MAX_SCALE};

/// Number of Gaussians whose part of the network's gradient one workgroup sums up.
const NETWORK_BLOCK: u32 = 1024;

shader! {
    pub(super) ChainWgsl = "chain.wgsl";
    const STATUS_BAD = status::BAD;
    const MAX_SCALE = MAX_SCALE as f32;
    var<uniform> view: ViewParams;
    var<uniform> params: ChainParams;
    var<read> deformed: [DeformedRow];
    var<read> splats: [SplatRow];
    var<read> g_splats: [SplatGradientRow];
    /// [N][bands][3]
    var<read> sh_rest: [f32];
    var<write> g_rest: [RestRow];
    var<write> g_sh_rest: [f32];
    /// [workgroups][2]: dL/d(turn of the camera), dL/d(its shift).
    var<write> g_cameras: [[f32; 4]];
    var<atomic> status: [u32];
}

shader_struct! {
    /// Settings for the learning of colours.
    struct ChainParams {
        /// Number of bands above 0 that are already learned.
        learned_bands: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader! {
    pub(super) FeaturesWgsl = "features_backward.wgsl";
    const STATUS_BAD = status::BAD;
    var<uniform> params: DeformParams;
    var<read> features_at_rest: [f32];
    /// Features at time t, [N][LATENT_DIM], then the opening of each one's gate, [N][LATENT_DIM].
    var<read> features: [f32];
    /// Basis values [B], feature weight [D][D + 1], feature bias [D].
    var<read> tables: [f32];
    var<read> g_out: [f32];
    var<write> g_features: [f32];
    var<write> g_gate: [f32];
    /// dL/df' * open: the gradient that reaches the network.
    var<write> g_opened: [f32];
    var<atomic> status: [u32];
}

shader! {
    pub(super) NetworkWgsl = "network.wgsl";
    const STATUS_BAD = status::BAD;
    const NETWORK_BLOCK = NETWORK_BLOCK;
    var<uniform> params: NetworkParams;
    var<read> features_at_rest: [f32];
    var<read> g_opened: [f32];
    /// [blocks][NUMBERS]
    var<write> block_sums: [f32];
    var<write> g_network: [f32];
    var<atomic> status: [u32];
}

shader_struct! {
    /// Sum of the network's gradient over all Gaussians.
    struct NetworkParams {
        /// Number of Gaussians, N.
        num_gaussians: u32,
        /// Number of blocks of Gaussians.
        num_blocks: u32,
        /// Time t.
        time: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

/// The kernels, and the buffers that they write.
#[derive(Debug)]
pub(in crate::train) struct ChainPass {
    latent_dim: usize,
    chain: Kernel,
    features_backward: Kernel,
    sum_network: Kernel,
    fold_network: Kernel,
    /// Output: sums of each workgroup of ∂L/∂(turn, shift) of the camera.
    pub g_cameras: DeviceVec<[f32; 4]>,
    g_opened: DeviceVec<f32>,
    network_sums: DeviceVec<f32>,
    /// Output: ∂L/∂parameters at rest, [N].
    pub g_rest: DeviceVec<RestRow>,
    /// Output: ∂L/∂colour bands above 0, [N][bands][3].
    pub g_sh_rest: DeviceVec<f32>,
    /// Output: ∂L/∂features at rest, [N][D].
    pub g_features: DeviceVec<f32>,
    /// Output: ∂L/∂gate, [N][D].
    pub g_gate: DeviceVec<f32>,
    /// Output: ∂L/∂(feature network): its weight [D][D + 1], its bias [D].
    pub g_network: DeviceVec<f32>,
}

impl ChainPass {
    pub(super) fn new(gpu: &Gpu, latent_dim: usize) -> Result<Self> {
        let kernel = |shader, entry| Kernel::new(gpu, shader, entry, latent_dim);
        let features = || DeviceVec::new(gpu, "gradients of features");
        let network = || DeviceVec::new(gpu, "gradients of the feature network");
        Ok(Self {
            latent_dim,
            chain: kernel(&ChainWgsl::SHADER, "chain")?,
            features_backward: kernel(&FeaturesWgsl::SHADER, "features_backward")?,
            sum_network: kernel(&NetworkWgsl::SHADER, "sum_blocks")?,
            fold_network: kernel(&NetworkWgsl::SHADER, "fold_blocks")?,
            g_cameras: DeviceVec::new(gpu, "gradients of the camera"),
            g_opened: features(),
            network_sums: network(),
            g_rest: DeviceVec::new(gpu, "gradients of Gaussians"),
            g_sh_rest: DeviceVec::new(gpu, "gradients of spherical harmonics"),
            g_features: features(),
            g_gate: features(),
            g_network: network(),
        })
    }

    /// Makes room for a step.
    pub(super) fn prepare(&mut self, step: &CurrentStep<'_>) -> Result<()> {
        let (gpu, dim, n) = (step.gpu, self.latent_dim, step.num_gaussians());
        let numbers = dim * (dim + 1) + dim;
        self.g_rest.resize(gpu, n)?;
        self.g_cameras.resize(gpu, 2 * n.div_ceil(GROUP as usize))?;
        self.g_sh_rest.resize(gpu, step.resident.scene.sh_rest.len())?;
        self.g_features.resize(gpu, n * dim)?;
        self.g_gate.resize(gpu, n * dim)?;
        self.g_opened.resize(gpu, n * dim)?;
        self.network_sums.resize(gpu, n.div_ceil(NETWORK_BLOCK as usize) * numbers)?;
        self.g_network.resize(gpu, numbers)
    }

    /// Adds the way from the splats' gradient to that of everything learned.
    pub(super) fn encode(&self, step: &CurrentStep<'_>, pass: &mut Pass<'_>, backward: &BackwardPass) {
        let (gpu, resident) = (step.gpu, step.resident);
        let bands = (step.view.sh_degree as usize + 1).pow(2) - 1;
        let learned_bands = step.context.settings.learned_bands(bands, step.plan.step) as u32;
        let params = uniform(gpu, &ChainParams { learned_bands, ..Default::default() });
        let bindings = [
            ChainWgsl::view(step.view_buffer),
            ChainWgsl::params(&params),
            ChainWgsl::deformed(&step.deform.rows),
            ChainWgsl::splats(step.splats),
            ChainWgsl::g_splats(&backward.g_splats),
            ChainWgsl::sh_rest(&resident.scene.sh_rest),
            ChainWgsl::g_rest(&self.g_rest),
            ChainWgsl::g_sh_rest(&self.g_sh_rest),
            ChainWgsl::g_cameras(&self.g_cameras),
            ChainWgsl::status(&resident.status),
        ];
        self.chain.dispatch(gpu, pass, &bindings, step.view.num_gaussians.div_ceil(GROUP));
        if self.latent_dim > 0 {
            self.encode_features(step, pass, &backward.g_features);
        }
    }

    fn encode_features(&self, step: &CurrentStep<'_>, pass: &mut Pass<'_>, g_features: &DeviceVec<f32>) {
        let (gpu, resident, time) = (step.gpu, step.resident, step.plan.view.time);
        let all = 0..step.num_gaussians();
        let params = uniform(gpu, &DeformParams::new(step.deformation, time, &all, &step.deform.live));
        let bindings = [
            FeaturesWgsl::params(&params),
            FeaturesWgsl::features_at_rest(&resident.scene.features),
            FeaturesWgsl::features(&step.deform.features),
            FeaturesWgsl::tables(&step.deform.tables),
            FeaturesWgsl::g_out(g_features),
            FeaturesWgsl::g_features(&self.g_features),
            FeaturesWgsl::g_gate(&self.g_gate),
            FeaturesWgsl::g_opened(&self.g_opened),
            FeaturesWgsl::status(&resident.status),
        ];
        self.features_backward.dispatch(gpu, pass, &bindings, step.view.num_gaussians.div_ceil(GROUP));
        let num_blocks = step.view.num_gaussians.div_ceil(NETWORK_BLOCK);
        let num_gaussians = step.view.num_gaussians;
        let params = uniform(gpu, &NetworkParams { num_gaussians, num_blocks, time, padding: 0 });
        let bindings = [
            NetworkWgsl::params(&params),
            NetworkWgsl::features_at_rest(&resident.scene.features),
            NetworkWgsl::g_opened(&self.g_opened),
            NetworkWgsl::block_sums(&self.network_sums),
        ];
        self.sum_network.dispatch(gpu, pass, &bindings, num_blocks);
        let bindings = [
            NetworkWgsl::params(&params),
            NetworkWgsl::block_sums(&self.network_sums),
            NetworkWgsl::g_network(&self.g_network),
            NetworkWgsl::status(&resident.status),
        ];
        self.fold_network.dispatch(gpu, pass, &bindings, 1);
    }
}
