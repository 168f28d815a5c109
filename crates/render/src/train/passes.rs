//! The passes of a step after the picture: loss, gradients, update.

use super::{
    frame::FrameBuffers,
    resident::{Moments, Resident},
};
use crate::{
    Gpu,
    buffers::{DeviceVec, uniform},
    kernel::Kernel,
    layout::{self, RestRow, Settle, SplatGradientRow, SplatRow, TERM_QUADS, Update, View},
    passes::{BinPass, DeformPass, RasterPass},
    scene_buffers::Planes,
    shader_source::{GROUP, NETWORK_BLOCK, status},
};
use surgtpgs_core::{
    Result,
    deform::Deformation,
    raster::FEATURE_PLANE,
    train::{Context, LossWeights, Rates, StepPlan, TermScales},
};

/// Number of values of a slot, see `shared/slot.wgsl`.
fn slot_len(latent_dim: usize) -> usize {
    10 + latent_dim
}

/// The kernels for one latent dimension, and the buffers between them.
#[derive(Debug)]
pub(super) struct StepPasses {
    pub latent_dim: usize,
    loss: Kernel,
    sum_values: Kernel,
    fold_means: Kernel,
    sum_deviations: Kernel,
    fold_spreads: Kernel,
    add_gradients: Kernel,
    backward: Kernel,
    gather: Kernel,
    chain: Kernel,
    features_backward: Kernel,
    sum_network: Kernel,
    fold_network: Kernel,
    settle: Kernel,
    adam: Kernel,
    adam_basis: Kernel,
    own_basis_gradients: Kernel,
    add_statistics: Kernel,
    pub g_planes: DeviceVec<f32>,
    loss_sums: DeviceVec<[f32; 4]>,
    region_sums: DeviceVec<[f32; 4]>,
    means: DeviceVec<[f32; 4]>,
    spreads: DeviceVec<[f32; 4]>,
    pub slots: DeviceVec<f32>,
    pub g_splats: DeviceVec<SplatGradientRow>,
    pub g_features_now: DeviceVec<f32>,
    pub g_rest: DeviceVec<RestRow>,
    pub g_sh_rest: DeviceVec<f32>,
    pub g_features: DeviceVec<f32>,
    pub g_gate: DeviceVec<f32>,
    g_opened: DeviceVec<f32>,
    /// Gradients of weights, centres and widths of one basis function.
    g_own: [DeviceVec<f32>; 3],
    network_sums: DeviceVec<f32>,
    pub g_network: DeviceVec<f32>,
    latents: DeviceVec<f32>,
    rest_rates: DeviceVec<f32>,
    channel_rates: DeviceVec<f32>,
    one: DeviceVec<f32>,
}

/// The current step.
pub(super) struct Job<'a> {
    pub gpu: &'a Gpu,
    pub view: &'a View,
    pub view_buffer: &'a wgpu::Buffer,
    pub plan: &'a StepPlan,
    pub context: &'a Context<'a>,
    pub deformation: &'a Deformation,
    pub deform: &'a DeformPass,
    pub splats: &'a DeviceVec<SplatRow>,
    pub bin: &'a BinPass,
    pub raster: &'a RasterPass,
    pub frame: &'a FrameBuffers,
    pub resident: &'a Resident,
}

impl Job<'_> {
    fn num_gaussians(&self) -> usize {
        self.view.num_gaussians as usize
    }

    fn num_pixels(&self) -> usize {
        self.view.size[0] as usize * self.view.size[1] as usize
    }

    fn weights(&self) -> LossWeights {
        self.context.settings.loss.sampled(self.plan.look.sampling.step)
    }

    /// Number of regions to be smoothed.
    fn num_regions(&self) -> usize {
        if self.frame.has_regions { self.frame.num_regions } else { 0 }
    }
}

impl StepPasses {
    pub(super) fn new(gpu: &Gpu, latent_dim: usize, latents: &[f32]) -> Result<Self> {
        let kernel = |file, entry| Kernel::new(gpu, file, entry, latent_dim);
        let floats = |name| DeviceVec::new(gpu, name);
        let quads = |name| DeviceVec::new(gpu, name);
        Ok(Self {
            latent_dim,
            loss: kernel("loss.wgsl", "loss")?,
            sum_values: kernel("regions.wgsl", "sum_values")?,
            fold_means: kernel("regions.wgsl", "fold_means")?,
            sum_deviations: kernel("regions.wgsl", "sum_deviations")?,
            fold_spreads: kernel("regions.wgsl", "fold_spreads")?,
            add_gradients: kernel("regions.wgsl", "add_gradients")?,
            backward: kernel("backward.wgsl", "backward")?,
            gather: kernel("gather.wgsl", "gather")?,
            chain: kernel("chain.wgsl", "chain")?,
            features_backward: kernel("features_backward.wgsl", "features_backward")?,
            sum_network: kernel("network.wgsl", "sum_blocks")?,
            fold_network: kernel("network.wgsl", "fold_blocks")?,
            settle: kernel("settle.wgsl", "settle")?,
            adam: kernel("update.wgsl", "adam")?,
            adam_basis: kernel("update.wgsl", "adam_basis")?,
            own_basis_gradients: kernel("update.wgsl", "own_basis_gradients")?,
            add_statistics: kernel("update.wgsl", "add_statistics")?,
            g_planes: floats("gradients of the picture"),
            loss_sums: quads("loss terms"),
            region_sums: quads("regions"),
            means: quads("regions"),
            spreads: quads("regions"),
            slots: floats("slots of splat-tile pairs"),
            g_splats: DeviceVec::new(gpu, "gradients of splats"),
            g_features_now: floats("gradients of features"),
            g_rest: DeviceVec::new(gpu, "gradients of Gaussians"),
            g_sh_rest: floats("gradients of spherical harmonics"),
            g_features: floats("gradients of features"),
            g_gate: floats("gradients of features"),
            g_opened: floats("gradients of features"),
            g_own: [(); 3].map(|()| floats("gradients of basis functions")),
            network_sums: floats("gradients of the feature network"),
            g_network: floats("gradients of the feature network"),
            latents: DeviceVec::from_slice(gpu, "latent features", latents)?,
            rest_rates: floats("learning rates"),
            channel_rates: floats("learning rates"),
            one: DeviceVec::from_slice(gpu, "learning rates", &[1.0])?,
        })
    }

    /// Makes room for a step.
    pub(super) fn prepare(&mut self, job: &Job<'_>) -> Result<()> {
        let (gpu, dim, n, pixels) = (job.gpu, self.latent_dim, job.num_gaussians(), job.num_pixels());
        let quads = dim.div_ceil(4).max(1);
        let (blocks, regions) = (job.frame.blocks.len(), job.frame.large_regions.len());
        self.g_planes.resize(gpu, pixels * (FEATURE_PLANE + dim))?;
        self.loss_sums.resize(gpu, pixels.div_ceil(GROUP as usize) * TERM_QUADS)?;
        self.region_sums.resize(gpu, blocks * quads * 2)?;
        self.means.resize(gpu, regions * quads)?;
        self.spreads.resize(gpu, regions * quads * 2)?;
        self.slots.resize(gpu, job.bin.capacity() * slot_len(dim))?;
        self.g_splats.resize(gpu, n)?;
        self.g_features_now.resize(gpu, n * dim)?;
        self.g_rest.resize(gpu, n)?;
        self.g_sh_rest.resize(gpu, job.resident.scene.sh_rest.len())?;
        self.g_features.resize(gpu, n * dim)?;
        self.g_gate.resize(gpu, n * dim)?;
        self.g_opened.resize(gpu, n * dim)?;
        if job.resident.own_bases.is_some() {
            let rows = job.resident.scene.parts.iter().map(|rows| rows.len()).max().unwrap_or(0);
            for g in &mut self.g_own {
                g.resize(gpu, rows * job.deformation.stride)?;
            }
        }
        let numbers = dim * (dim + 1) + dim;
        self.network_sums.resize(gpu, n.div_ceil(NETWORK_BLOCK as usize) * numbers)?;
        self.g_network.resize(gpu, numbers)?;
        let rates = rates(job, dim);
        self.rest_rates.write(gpu, &super::resident::to_device(&rates.rest))?;
        self.channel_rates.write(gpu, &rates.channels)
    }

    /// Number of workgroups of the loss; each writes its sums.
    fn num_loss_groups(&self) -> u32 {
        (self.loss_sums.len() / TERM_QUADS) as u32
    }

    /// Adds the loss and its gradient with respect to the planes.
    pub(super) fn encode_loss(&self, job: &Job<'_>, pass: &mut wgpu::ComputePass<'_>) {
        let (gpu, frame, weights) = (job.gpu, job.frame, job.weights());
        let scales = TermScales::<f32>::new(&weights, frame.supervised, job.num_pixels(), self.latent_dim);
        let params = uniform(
            gpu,
            &layout::Loss {
                size: job.view.size,
                has_depth: u32::from(frame.has_depth && weights.depth != 0.0),
                has_regions: u32::from(frame.has_regions),
                raw_depth: u32::from(weights.raw_depth),
                unmasked_variation: u32::from(weights.unmasked_variation),
                num_rows: (job.context.latents.len() / self.latent_dim.max(1)) as u32,
                typical_depth: job.context.typical_depth,
                ..layout::Loss::weighted(&scales, frame.supervised > 0)
            },
        );
        let bindings = [
            (0, params.as_entire_binding()),
            (1, job.raster.planes.binding()),
            (2, frame.pixels.binding()),
            (3, frame.depths.binding()),
            (4, frame.regions.binding()),
            (5, self.latents.binding()),
            (6, self.g_planes.binding()),
            (7, self.loss_sums.binding()),
        ];
        self.loss.dispatch(gpu, pass, &bindings, self.num_loss_groups());
        if job.num_regions() > 0 {
            self.encode_regions(job, pass, &weights, scales.smoothness);
        }
    }

    fn encode_regions(
        &self,
        job: &Job<'_>,
        pass: &mut wgpu::ComputePass<'_>,
        weights: &LossWeights,
        smoothness: f32,
    ) {
        let (gpu, frame) = (job.gpu, job.frame);
        let num_blocks = frame.blocks.len() as u32;
        let params = uniform(
            gpu,
            &layout::Regions {
                num_pixels: job.num_pixels() as u32,
                num_blocks,
                num_regions: frame.num_regions as u32,
                is_pooled: u32::from(weights.pooled_regions),
                smoothness,
                ..Default::default()
            },
        );
        let bind = |number: u32| {
            let resource = match number {
                0 => params.as_entire_binding(),
                1 => job.raster.planes.binding(),
                2 => frame.listed.binding(),
                3 => frame.blocks.binding(),
                4 => frame.large_regions.binding(),
                5 => self.region_sums.binding(),
                6 => self.means.binding(),
                7 => self.spreads.binding(),
                _ => self.g_planes.binding(),
            };
            (number, resource)
        };
        let per_region = (frame.num_regions as u32).div_ceil(GROUP);
        let mut run = |kernel: &Kernel, numbers: &[u32], groups| {
            let bindings: Vec<_> = numbers.iter().map(|number| bind(*number)).collect();
            kernel.dispatch(gpu, pass, &bindings, groups);
        };
        run(&self.sum_values, &[0, 1, 2, 3, 5], num_blocks);
        run(&self.fold_means, &[0, 4, 5, 6], per_region);
        run(&self.sum_deviations, &[0, 1, 2, 3, 5, 6], num_blocks);
        run(&self.fold_spreads, &[0, 4, 5, 7], per_region);
        run(&self.add_gradients, &[0, 1, 2, 3, 4, 6, 7, 8], num_blocks);
    }

    /// Adds the way from the planes' gradient to that of the splats; the slots must have been cleared.
    pub(super) fn encode_backward(&self, job: &Job<'_>, pass: &mut wgpu::ComputePass<'_>) {
        let (gpu, view) = (job.gpu, job.view_buffer.as_entire_binding());
        let bindings = [
            (0, view.clone()),
            (1, job.splats.binding()),
            (2, job.deform.features.binding()),
            (3, job.bin.pair_owners.binding()),
            (4, job.bin.pairs().binding()),
            (5, job.bin.ranges.binding()),
            (6, job.raster.planes.binding()),
            (7, self.g_planes.binding()),
            (8, self.slots.binding()),
        ];
        self.backward.dispatch_2d(gpu, pass, &bindings, job.view.tiles);
        let settings = job.context.settings;
        let params = uniform(
            gpu,
            &layout::Gather {
                pull_scale: job.context.pull_scale(&job.plan.look),
                depth_moves_centres: u32::from(settings.depth_moves_centres),
                padding: 0,
            },
        );
        let [depth_order, first_slot] = job.bin.slots();
        let bindings = [
            (0, view),
            (1, params.as_entire_binding()),
            (2, job.splats.binding()),
            (3, depth_order.binding()),
            (4, first_slot.binding()),
            (5, job.bin.num_wanted().binding()),
            (6, self.slots.binding()),
            (7, self.g_splats.binding()),
            (8, self.g_features_now.binding()),
        ];
        self.gather.dispatch(gpu, pass, &bindings, job.view.num_gaussians.div_ceil(GROUP));
    }

    /// Adds the way from the splats' gradient to that of everything learned.
    pub(super) fn encode_chain(&self, job: &Job<'_>, pass: &mut wgpu::ComputePass<'_>) {
        let (gpu, resident) = (job.gpu, job.resident);
        let bands = (job.view.sh_degree as usize + 1).pow(2) - 1;
        let learned_bands = job.context.settings.learned_bands(bands, job.plan.step) as u32;
        let params = uniform(gpu, &layout::Chain { learned_bands, ..Default::default() });
        let bindings = [
            (0, job.view_buffer.as_entire_binding()),
            (1, params.as_entire_binding()),
            (2, job.deform.rows.binding()),
            (3, job.splats.binding()),
            (4, self.g_splats.binding()),
            (5, resident.scene.sh_rest.binding()),
            (6, self.g_rest.binding()),
            (7, self.g_sh_rest.binding()),
            (8, resident.status.binding()),
        ];
        self.chain.dispatch(gpu, pass, &bindings, job.view.num_gaussians.div_ceil(GROUP));
        if self.latent_dim > 0 {
            self.encode_features(job, pass);
        }
    }

    fn encode_features(&self, job: &Job<'_>, pass: &mut wgpu::ComputePass<'_>) {
        let (gpu, resident, time) = (job.gpu, job.resident, job.plan.look.time);
        let all = 0..job.num_gaussians();
        let params = uniform(gpu, &layout::Deform::new(job.deformation, time, &all, &job.deform.live));
        let bindings = [
            (0, params.as_entire_binding()),
            (1, resident.scene.features.binding()),
            (2, job.deform.features.binding()),
            (3, job.deform.tables.binding()),
            (4, self.g_features_now.binding()),
            (5, self.g_features.binding()),
            (6, self.g_gate.binding()),
            (7, self.g_opened.binding()),
            (8, resident.status.binding()),
        ];
        self.features_backward.dispatch(gpu, pass, &bindings, job.view.num_gaussians.div_ceil(GROUP));
        let num_blocks = job.view.num_gaussians.div_ceil(NETWORK_BLOCK);
        let num_gaussians = job.view.num_gaussians;
        let params = uniform(gpu, &layout::Network { num_gaussians, num_blocks, time, padding: 0 });
        let bindings = [
            (0, params.as_entire_binding()),
            (1, resident.scene.features.binding()),
            (2, self.g_opened.binding()),
            (3, self.network_sums.binding()),
        ];
        self.sum_network.dispatch(gpu, pass, &bindings, num_blocks);
        let bindings = [
            (0, params.as_entire_binding()),
            (3, self.network_sums.binding()),
            (4, self.g_network.binding()),
            (5, resident.status.binding()),
        ];
        self.fold_network.dispatch(gpu, pass, &bindings, 1);
    }

    /// Adds the judgement of the step and, if it was good, the update of all parameters.
    pub(super) fn encode_update(&self, job: &Job<'_>, pass: &mut wgpu::ComputePass<'_>) {
        let (gpu, resident, live) = (job.gpu, job.resident, &job.deform.live);
        let settings = job.context.settings;
        let scales =
            TermScales::<f32>::new(&job.weights(), job.frame.supervised, job.num_pixels(), self.latent_dim);
        let params = uniform(
            gpu,
            &Settle {
                num_sums: self.num_loss_groups(),
                num_regions: job.num_regions() as u32,
                smoothness: scales.smoothness,
                capacity: job.bin.capacity() as u32,
                first_basis: live.start as u32,
                last_basis: live.end as u32,
                updates_network: u32::from(settings.feature_motion),
                updates: u32::from(job.plan.updates),
            },
        );
        let bindings = [
            (0, params.as_entire_binding()),
            (1, self.loss_sums.binding()),
            (2, self.spreads.binding()),
            (3, job.bin.num_wanted().binding()),
            (4, resident.status.binding()),
            (5, resident.history.binding()),
        ];
        self.settle.dispatch(gpu, pass, &bindings, 1);
        let params = uniform(gpu, &Update { len: job.view.num_gaussians, ..Default::default() });
        let bindings = [
            (0, params.as_entire_binding()),
            (1, resident.status.binding()),
            (9, self.g_splats.binding()),
            (10, resident.pull_sums.binding()),
            (11, resident.times_seen.binding()),
        ];
        self.add_statistics.dispatch(gpu, pass, &bindings, job.view.num_gaussians.div_ceil(GROUP));
        if job.plan.updates {
            self.encode_groups(job, pass);
            self.encode_bases(job, pass);
        }
    }

    /// Adds the update of the parameters at rest and of the network.
    fn encode_groups(&self, job: &Job<'_>, pass: &mut wgpu::ComputePass<'_>) {
        let (scene, r, settings) = (&job.resident.scene, job.resident, job.context.settings);
        let rates = &settings.rates;
        let rest = Update {
            len: (scene.rest.len() * size_of::<RestRow>() / size_of::<f32>()) as u32,
            width: self.rest_rates.len() as u32,
            count: status::COUNT_REST,
            rate: 1.0,
            gain: 1.0,
            ..Default::default()
        };
        let arrays = [scene.rest.binding(), self.g_rest.binding(), self.rest_rates.binding()];
        self.encode_group(job, pass, rest, arrays, r.rest.both());
        let plain = |len: usize, count, rate| Update {
            len: len as u32,
            width: 1,
            count,
            rate,
            gain: 1.0,
            ..Default::default()
        };
        if job.view.sh_degree > 0 {
            let group = plain(scene.sh_rest.len(), status::COUNT_SH_REST, rates.sh_rest);
            let arrays = [scene.sh_rest.binding(), self.g_sh_rest.binding(), self.one.binding()];
            self.encode_group(job, pass, group, arrays, r.sh_rest.both());
        }
        if self.latent_dim == 0 {
            return;
        }
        let group = plain(scene.features.len(), status::COUNT_FEATURES, rates.feature);
        let arrays = [scene.features.binding(), self.g_features.binding(), self.one.binding()];
        self.encode_group(job, pass, group, arrays, r.features.both());
        if settings.feature_motion {
            let first = job.deformation.num_bases as u32;
            let group = plain(self.g_network.len(), status::COUNT_NETWORK, rates.feature);
            let arrays = [job.deform.tables.binding(), self.g_network.binding(), self.one.binding()];
            self.encode_group(job, pass, Update { first, ..group }, arrays, r.network.both());
        }
    }

    /// Adds the update of one group; `arrays` are parameters, gradients and learning rates.
    fn encode_group(
        &self,
        job: &Job<'_>,
        pass: &mut wgpu::ComputePass<'_>,
        group: Update,
        [parameters, gradients, rates]: [wgpu::BindingResource<'_>; 3],
        [first, second]: [&DeviceVec<f32>; 2],
    ) {
        let params = uniform(job.gpu, &group);
        let bindings = [
            (0, params.as_entire_binding()),
            (1, job.resident.status.binding()),
            (2, job.resident.corrections.binding()),
            (3, rates),
            (4, parameters),
            (5, first.binding()),
            (6, second.binding()),
            (7, gradients),
        ];
        self.adam.dispatch(job.gpu, pass, &bindings, group.len.div_ceil(GROUP));
    }

    /// Adds the update of the basis functions: the weights of the live ones, or everything if each
    /// Gaussian has its own.
    fn encode_bases(&self, job: &Job<'_>, pass: &mut wgpu::ComputePass<'_>) {
        let (scene, deformation, time) = (&job.resident.scene, job.deformation, job.plan.look.time);
        let decay = rates(job, self.latent_dim).decay;
        let values = deformation.is_shared().then(|| deformation.basis_values(time).0);
        for (part, rows) in scene.parts.iter().enumerate() {
            let block = (rows.len() * deformation.stride) as u32;
            for b in job.deform.live.clone() {
                let group = Update {
                    len: block,
                    first: b as u32 * block,
                    width: deformation.stride as u32,
                    count: status::COUNT_BASES + b as u32,
                    rate: decay,
                    gain: values.as_ref().map_or(1.0, |values| values[b]),
                    first_moment: b as u32 * block,
                    first_row: rows.start as u32,
                    gate_channel: deformation.gate_channel as u32,
                    shape: deformation.shape as u32,
                    time,
                    padding: 0,
                };
                if let Some(own) = &job.resident.own_bases {
                    self.encode_own_basis(job, pass, group, part, own);
                } else {
                    self.encode_shared_basis(job, pass, group, part);
                }
            }
        }
    }

    fn encode_shared_basis(
        &self,
        job: &Job<'_>,
        pass: &mut wgpu::ComputePass<'_>,
        group: Update,
        part: usize,
    ) {
        let resident = job.resident;
        let params = uniform(job.gpu, &group);
        let bindings = [
            (0, params.as_entire_binding()),
            (1, resident.status.binding()),
            (2, resident.corrections.binding()),
            (3, self.channel_rates.binding()),
            (4, resident.scene.weights[part].binding()),
            (5, resident.weights.first[part].binding()),
            (6, resident.weights.second[part].binding()),
            (7, self.g_rest.binding()),
            (8, self.g_gate.binding()),
        ];
        self.adam_basis.dispatch(job.gpu, pass, &bindings, group.len.div_ceil(GROUP));
    }

    /// Adds the gradients of one basis function's weights, centres and widths, and their update.
    fn encode_own_basis(
        &self,
        job: &Job<'_>,
        pass: &mut wgpu::ComputePass<'_>,
        group: Update,
        part: usize,
        [centres, widths]: &[Moments<Planes>; 2],
    ) {
        let resident = job.resident;
        let scene = &resident.scene;
        let params = uniform(job.gpu, &group);
        let [g_weights, g_centres, g_widths] = &self.g_own;
        let bindings = [
            (0, params.as_entire_binding()),
            (4, scene.weights[part].binding()),
            (7, self.g_rest.binding()),
            (8, self.g_gate.binding()),
            (12, scene.centres[part].binding()),
            (13, scene.widths[part].binding()),
            (14, g_weights.binding()),
            (15, g_centres.binding()),
            (16, g_widths.binding()),
        ];
        self.own_basis_gradients.dispatch(job.gpu, pass, &bindings, group.len.div_ceil(GROUP));
        for (parameters, gradients, moments) in [
            (&scene.weights, g_weights, &resident.weights),
            (&scene.centres, g_centres, centres),
            (&scene.widths, g_widths, widths),
        ] {
            let arrays = [parameters[part].binding(), gradients.binding(), self.channel_rates.binding()];
            self.encode_group(job, pass, group, arrays, [&moments.first[part], &moments.second[part]]);
        }
    }
}

fn rates(job: &Job<'_>, latent_dim: usize) -> Rates {
    let (context, stride) = (job.context, job.deformation.stride);
    Rates::new(context.settings, stride, latent_dim, job.plan.look.progress, context.world_per_px)
}
