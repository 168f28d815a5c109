//! From Gaussians at rest to Gaussians at time t (`shaders/deform.wgsl`).

use crate::{
    buffers::{Array, DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    rows::{DeformedRow, RestRow},
    scene_buffers::SceneBuffers,
    shader::{GROUP, shader, shader_struct},
};
use std::{collections::BTreeMap, ops::Range};
use surgtpgs_core::{
    Result,
    deform::{Deformation, LIVE_BASIS, MAX_LOG_SCALE},
};

shader! {
    pub(super) Wgsl = "deform.wgsl";
    const LIVE_BASIS = LIVE_BASIS;
    const MAX_LOG_SCALE = MAX_LOG_SCALE as f32;
    var<uniform> params: DeformParams;
    var<read> rest: [RestRow];
    var<read> features_at_rest: [f32];
    var<read> weights: [f32];
    var<read> centres: [f32];
    var<read> widths: [f32];
    /// Basis values [B] (of shared bases), feature weight [D][D + 1], feature bias [D].
    var<read> tables: [f32];
    var<write> deformed: [DeformedRow];
    /// [N][LATENT_DIM], then the opening of each one's gate, [N][LATENT_DIM].
    var<write> features: [f32];
}

shader_struct! {
    /// Deformation of one part of the scene at one time.
    pub(crate) struct DeformParams {
        /// First row of the part, which is the rows `first_row..first_row + num_rows` of the scene.
        first_row: u32,
        /// Number of Gaussians in the part.
        num_rows: u32,
        /// Floats per Gaussian and basis.
        stride: u32,
        /// First live basis.
        first_basis: u32,
        /// End of the live bases.
        last_basis: u32,
        /// Number of bases, B; the basis values come before the feature network in the tables.
        num_bases: u32,
        /// 1 if all Gaussians share centres and widths.
        is_shared: u32,
        /// [`surgtpgs_core::deform::BasisShape`] as a number.
        shape: u32,
        /// Time t.
        time: f32,
        /// Slope δ of the gate.
        gate_slope: f32,
        /// First channel of the gate.
        gate_channel: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

impl DeformParams {
    /// Deformation at `time` of the rows `rows`, with only the bases `live` evaluated.
    pub fn new(
        deformation: &Deformation,
        time: f32,
        rows: &std::ops::Range<usize>,
        live: &std::ops::Range<usize>,
    ) -> Self {
        Self {
            first_row: rows.start as u32,
            num_rows: rows.len() as u32,
            stride: deformation.stride as u32,
            first_basis: live.start as u32,
            last_basis: live.end as u32,
            num_bases: deformation.num_bases as u32,
            is_shared: u32::from(deformation.is_shared()),
            shape: deformation.shape as u32,
            time,
            gate_slope: deformation.gate_slope,
            gate_channel: deformation.gate_channel as u32,
            padding: 0,
        }
    }
}

#[derive(Debug)]
pub(crate) struct DeformPass {
    /// Kernels by latent dimension.
    kernels: BTreeMap<usize, Kernel>,
    /// Basis values [B], then the feature network: its weight [D][D + 1], its bias [D].
    pub tables: DeviceVec<f32>,
    pub live: Range<usize>,
    /// Output, [N].
    pub rows: DeviceVec<DeformedRow>,
    /// Output, [N][D]; then the opening of each one's gate, [N][D].
    pub features: DeviceVec<f32>,
}

impl DeformPass {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self {
            kernels: BTreeMap::new(),
            tables: DeviceVec::new(gpu, "basis values"),
            live: 0..0,
            rows: DeviceVec::new(gpu, "Gaussians"),
            features: DeviceVec::new(gpu, "features"),
        }
    }

    /// Compiles for `latent_dim` and uploads the basis values at `time`.
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        deformation: &Deformation,
        n: usize,
        time: f32,
        latent_dim: usize,
    ) -> Result<()> {
        if let std::collections::btree_map::Entry::Vacant(entry) = self.kernels.entry(latent_dim) {
            entry.insert(Kernel::new(gpu, &Wgsl::SHADER, "deform", latent_dim)?);
        }
        let network = [&*deformation.feature_weight, &deformation.feature_bias].concat();
        self.tables.resize(gpu, deformation.num_bases + network.len())?;
        self.tables.write_at(gpu, deformation.num_bases, &network);
        self.set_time(gpu, deformation, time);
        self.make_room(gpu, n, latent_dim)
    }

    /// Makes room for `n` Gaussians; the feature network is kept.
    pub(crate) fn make_room(&mut self, gpu: &Gpu, n: usize, latent_dim: usize) -> Result<()> {
        self.rows.resize(gpu, n)?;
        self.features.resize(gpu, 2 * n * latent_dim)
    }

    /// Uploads the basis values at `time`; [`Self::prepare`] must have been called.
    pub(crate) fn set_time(&mut self, gpu: &Gpu, deformation: &Deformation, time: f32) {
        let (values, live) = if deformation.is_shared() {
            deformation.basis_values(time)
        } else {
            (vec![0.0; deformation.num_bases], 0..deformation.num_bases)
        };
        self.live = live;
        self.tables.write_at(gpu, 0, &values);
    }

    /// Reads the feature network back: its weight, then its bias.
    pub(crate) fn read_network(&self, gpu: &Gpu, deformation: &Deformation) -> Result<Vec<f32>> {
        Ok(self.tables.read(gpu, usize::MAX)?.split_off(deformation.num_bases))
    }

    /// Adds the pass; [`Self::prepare`] must have been called with the same arguments.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        scene: &SceneBuffers,
        deformation: &Deformation,
        time: f32,
        latent_dim: usize,
    ) {
        let kernel = &self.kernels[&latent_dim];
        for (k, rows) in scene.parts.iter().enumerate() {
            let params = uniform(gpu, &DeformParams::new(deformation, time, rows, &self.live));
            let weights = &scene.weights[k];
            // Bases that are not live are not read.
            let live_bytes =
                weights.num_bytes() / deformation.num_bases.max(1) as u64 * self.live.len() as u64;
            let bindings = [
                Wgsl::params(&params),
                Wgsl::rest(&scene.rest),
                Wgsl::features_at_rest(&scene.features),
                Wgsl::weights(Array::from(weights).moving(live_bytes)),
                Wgsl::centres(&scene.centres[k]),
                Wgsl::widths(&scene.widths[k]),
                Wgsl::tables(&self.tables),
                Wgsl::deformed(&self.rows),
                Wgsl::features(&self.features),
            ];
            kernel.dispatch(gpu, pass, &bindings, (rows.len() as u32).div_ceil(GROUP));
        }
    }
}
