//! From Gaussians at rest to Gaussians at time t (`shaders/deform.wgsl`).

use crate::{
    Gpu,
    buffers::{DeviceVec, uniform},
    kernel::Kernel,
    layout::{Deform, DeformedRow},
    scene_buffers::SceneBuffers,
    shader_source::GROUP,
};
use std::{collections::BTreeMap, ops::Range};
use surgtpgs_core::{Result, deform::Deformation};

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
            entry.insert(Kernel::new(gpu, "deform.wgsl", "deform", latent_dim)?);
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

    /// Adds the pass; [`Self::prepare`] must have been called with the same arguments.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        scene: &SceneBuffers,
        deformation: &Deformation,
        time: f32,
        latent_dim: usize,
    ) {
        let kernel = &self.kernels[&latent_dim];
        for (k, rows) in scene.parts.iter().enumerate() {
            let params = uniform(gpu, &Deform::new(deformation, time, rows, &self.live));
            let bindings = [
                (0, params.as_entire_binding()),
                (1, scene.rest.binding()),
                (2, scene.features.binding()),
                (3, scene.weights[k].binding()),
                (4, scene.centres[k].binding()),
                (5, scene.widths[k].binding()),
                (6, self.tables.binding()),
                (7, self.rows.binding()),
                (8, self.features.binding()),
            ];
            kernel.dispatch(gpu, pass, &bindings, (rows.len() as u32).div_ceil(GROUP));
        }
    }
}
