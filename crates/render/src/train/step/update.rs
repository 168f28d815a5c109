//! Judgement of the step, and the update of all parameters (`shaders/finish_step.wgsl`,
//! `shaders/update.wgsl`).

use super::{
    backward::BackwardPass,
    chain::ChainPass,
    loss::{LossPass, TERM_QUADS},
};
use crate::{
    buffers::{Array, DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    rows::{RestRow, SplatGradientRow},
    scene_buffers::Planes,
    shader::{GROUP, shader, shader_struct},
    train::{
        current::CurrentStep,
        resident::{Moments, StepResult, to_device},
        status,
    },
};
use surgtpgs_core::{
    Result,
    train::{self, Rates, TermScales},
};

shader! {
    pub(super) FinishStepWgsl = "finish_step.wgsl";
    const STATUS_BAD = status::BAD;
    const STATUS_OK = status::OK;
    const STATUS_OVERFLOWN = status::OVERFLOWN;
    const STATUS_DONE = status::DONE;
    const STATUS_WANTED = status::WANTED;
    const COUNT_REST = status::COUNT_REST;
    const COUNT_SH_REST = status::COUNT_SH_REST;
    const COUNT_FEATURES = status::COUNT_FEATURES;
    const COUNT_NETWORK = status::COUNT_NETWORK;
    const COUNT_BASES = status::COUNT_BASES;
    const TERM_QUADS = TERM_QUADS as u32;
    const REGION_TERM = train::NUM_TERMS as u32 - 1;
    var<uniform> params: FinishStepParams;
    /// [workgroups][TERM_QUADS]
    var<read> partial_sums: [[f32; 4]];
    /// [regions][QUADS][2]
    var<read> spreads: [[f32; 4]];
    /// [workgroups][2]
    var<read> g_cameras: [[f32; 4]];
    var<read> num_pairs_wanted: [u32];
    var<write> status: [u32];
    var<write> history: [StepResult];
}

shader_struct! {
    /// Settings for the judgement of a step.
    struct FinishStepParams {
        /// Number of workgroups of the loss.
        num_sums: u32,
        /// Number of large regions.
        num_regions: u32,
        /// Weight of a region.
        smoothness: f32,
        /// Number of pairs that there is room for.
        capacity: u32,
        /// First live basis.
        first_basis: u32,
        /// End of the live bases.
        last_basis: u32,
        /// 1 if the feature network learns.
        updates_network: u32,
        /// 1 if any parameters are updated.
        updates: u32,
        /// Number of sums of the camera's gradient.
        num_camera_sums: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader! {
    pub(super) UpdateWgsl = "update.wgsl";
    const STATUS_OK = status::OK;
    const REST = train::WIDTH as u32;
    const BETA1 = train::BETA1;
    const BETA2 = train::BETA2;
    const ADAM_EPSILON = train::EPSILON;
    var<uniform> params: UpdateParams;
    var<read> status: [u32];
    /// Bias corrections of the first and second moments, indexed by the number of the update.
    var<read> corrections: [[f32; 2]];
    var<read> rates: [f32];
    var<write> parameters: [f32];
    var<write> first_moments: [f32];
    var<write> second_moments: [f32];
    /// Gradients, in the order of the parameters; for the bases those of the parameters at rest, [N][REST].
    var<read> gradients: [f32];
    /// Gradients of the gate, [N][LATENT_DIM]; for the bases.
    var<read> g_gate: [f32];
    var<read> g_splats: [SplatGradientRow];
    var<write> pull_sums: [f32];
    var<write> times_seen: [u32];
    /// Centres and widths of bases that are not shared, in the order of the weights.
    var<read> centres: [f32];
    var<read> widths: [f32];
    /// dL/d(weight, centre, width) of one basis function, [rows][stride].
    var<write> g_weights: [f32];
    var<write> g_centres: [f32];
    var<write> g_widths: [f32];
}

shader_struct! {
    /// One group of parameters to be updated.
    struct UpdateParams {
        /// Number of values.
        len: u32,
        /// Index of the first of them among the parameters.
        first: u32,
        /// Period of the learning rates: value k has the rate `rate · rates[k mod width]`.
        width: u32,
        /// Index of the group's counter in the status.
        count: u32,
        /// Learning rate.
        rate: f32,
        /// Factor of the gradients.
        gain: f32,
        /// Index of the first of their moments.
        first_moment: u32,
        /// First Gaussian of a part.
        first_row: u32,
        /// First channel of the features' gate.
        gate_channel: u32,
        /// [`surgtpgs_core::deform::BasisShape`] of bases that are not shared, as a number.
        shape: u32,
        /// Time t.
        time: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

/// The kernels, and the learning rates.
#[derive(Debug)]
pub(super) struct UpdatePass {
    latent_dim: usize,
    finish_step: Kernel,
    adam: Kernel,
    adam_basis: Kernel,
    own_basis_gradients: Kernel,
    add_statistics: Kernel,
    /// Gradients of weights, centres and widths of one basis function.
    g_own: [DeviceVec<f32>; 3],
    rest_rates: DeviceVec<f32>,
    channel_rates: DeviceVec<f32>,
    one: DeviceVec<f32>,
}

impl UpdatePass {
    pub(super) fn new(gpu: &Gpu, latent_dim: usize) -> Result<Self> {
        let update = |entry| Kernel::new(gpu, &UpdateWgsl::SHADER, entry, latent_dim);
        Ok(Self {
            latent_dim,
            finish_step: Kernel::new(gpu, &FinishStepWgsl::SHADER, "finish_step", latent_dim)?,
            adam: update("adam")?,
            adam_basis: update("adam_basis")?,
            own_basis_gradients: update("own_basis_gradients")?,
            add_statistics: update("add_statistics")?,
            g_own: [(); 3].map(|()| DeviceVec::new(gpu, "gradients of basis functions")),
            rest_rates: DeviceVec::new(gpu, "learning rates"),
            channel_rates: DeviceVec::new(gpu, "learning rates"),
            one: DeviceVec::from_slice(gpu, "learning rates", &[1.0])?,
        })
    }

    /// Makes room for a step, and uploads its learning rates.
    pub(super) fn prepare(&mut self, step: &CurrentStep<'_>) -> Result<()> {
        if step.resident.own_bases.is_some() {
            let rows = step.resident.scene.parts.iter().map(|rows| rows.len()).max().unwrap_or(0);
            for g in &mut self.g_own {
                g.resize(step.gpu, rows * step.deformation.stride)?;
            }
        }
        let rates = rates(step, self.latent_dim);
        self.rest_rates.write(step.gpu, &to_device(&rates.rest))?;
        self.channel_rates.write(step.gpu, &rates.channels)
    }

    /// Adds the judgement of the step and, if it was good, the update of all parameters.
    pub(super) fn encode(
        &self,
        step: &CurrentStep<'_>,
        pass: &mut Pass<'_>,
        loss: &LossPass,
        backward: &BackwardPass,
        chain: &ChainPass,
    ) {
        self.encode_finish_step(step, pass, loss, chain);
        let (gpu, resident, n) = (step.gpu, step.resident, step.view.num_gaussians);
        let params = uniform(gpu, &UpdateParams { len: n, ..Default::default() });
        let bindings = [
            UpdateWgsl::params(&params),
            UpdateWgsl::status(&resident.status),
            UpdateWgsl::g_splats(&backward.g_splats),
            UpdateWgsl::pull_sums(resident.pull_sums.in_place()),
            UpdateWgsl::times_seen(resident.times_seen.in_place()),
        ];
        self.add_statistics.dispatch(gpu, pass, &bindings, n.div_ceil(GROUP));
        if step.plan.updates {
            self.encode_groups(step, pass, chain);
            self.encode_bases(step, pass, chain);
        }
    }

    fn encode_finish_step(
        &self,
        step: &CurrentStep<'_>,
        pass: &mut Pass<'_>,
        loss: &LossPass,
        chain: &ChainPass,
    ) {
        let (gpu, resident, live) = (step.gpu, step.resident, &step.deform.live);
        let (weights, supervised) = (step.weights(), step.frame.supervised);
        let scales = TermScales::<f32>::new(&weights, supervised, step.num_pixels(), self.latent_dim);
        let params = uniform(
            gpu,
            &FinishStepParams {
                num_sums: loss.num_groups(),
                num_regions: step.num_regions() as u32,
                smoothness: scales.smoothness,
                capacity: step.bin.capacity() as u32,
                first_basis: live.start as u32,
                last_basis: live.end as u32,
                updates_network: u32::from(step.context.settings.feature_motion),
                updates: u32::from(step.plan.updates),
                num_camera_sums: step.view.num_gaussians.div_ceil(GROUP),
                ..Default::default()
            },
        );
        let bindings = [
            FinishStepWgsl::params(&params),
            FinishStepWgsl::partial_sums(&loss.sums),
            FinishStepWgsl::spreads(&loss.spreads),
            FinishStepWgsl::g_cameras(&chain.g_cameras),
            FinishStepWgsl::num_pairs_wanted(step.bin.num_pairs_wanted()),
            FinishStepWgsl::status(&resident.status),
            FinishStepWgsl::history(&resident.history),
        ];
        self.finish_step.dispatch(gpu, pass, &bindings, 1);
    }

    /// Adds the update of the parameters at rest and of the network.
    fn encode_groups(&self, step: &CurrentStep<'_>, pass: &mut Pass<'_>, chain: &ChainPass) {
        let (scene, r, settings) = (&step.resident.scene, step.resident, step.context.settings);
        let sh_rest_rate = rates(step, self.latent_dim).sh_rest;
        let rates = &settings.rates;
        let rest = UpdateParams {
            len: (scene.rest.len() * size_of::<RestRow>() / size_of::<f32>()) as u32,
            width: self.rest_rates.len() as u32,
            count: status::COUNT_REST,
            rate: 1.0,
            gain: 1.0,
            ..Default::default()
        };
        let arrays = [scene.rest.numbers(), chain.g_rest.numbers(), (&self.rest_rates).into()];
        self.encode_group(step, pass, rest, arrays, r.rest.both());
        let plain = |len: usize, count, rate| UpdateParams {
            len: len as u32,
            width: 1,
            count,
            rate,
            gain: 1.0,
            ..Default::default()
        };
        if step.view.sh_degree > 0 {
            let group = plain(scene.sh_rest.len(), status::COUNT_SH_REST, sh_rest_rate);
            let arrays = [&scene.sh_rest, &chain.g_sh_rest, &self.one].map(Array::from);
            self.encode_group(step, pass, group, arrays, r.sh_rest.both());
        }
        if self.latent_dim == 0 {
            return;
        }
        let group = plain(scene.features.len(), status::COUNT_FEATURES, rates.feature);
        let arrays = [&scene.features, &chain.g_features, &self.one].map(Array::from);
        self.encode_group(step, pass, group, arrays, r.features.both());
        if settings.feature_motion {
            let first = step.deformation.num_bases as u32;
            let group = plain(chain.g_network.len(), status::COUNT_NETWORK, rates.feature);
            let arrays = [&step.deform.tables, &chain.g_network, &self.one].map(Array::from);
            self.encode_group(step, pass, UpdateParams { first, ..group }, arrays, r.network.both());
        }
    }

    /// Adds the update of one group; `arrays` are parameters, gradients and learning rates.
    fn encode_group(
        &self,
        step: &CurrentStep<'_>,
        pass: &mut Pass<'_>,
        group: UpdateParams,
        [parameters, gradients, rates]: [Array<'_, f32>; 3],
        [first, second]: [&DeviceVec<f32>; 2],
    ) {
        let params = uniform(step.gpu, &group);
        let bindings = [
            UpdateWgsl::params(&params),
            UpdateWgsl::status(&step.resident.status),
            UpdateWgsl::corrections(Array::from(&step.resident.corrections).moving(0)),
            UpdateWgsl::rates(rates),
            UpdateWgsl::parameters(parameters.moving(2 * num_bytes(&group))),
            UpdateWgsl::first_moments(first.in_place()),
            UpdateWgsl::second_moments(second.in_place()),
            UpdateWgsl::gradients(gradients),
        ];
        self.adam.dispatch(step.gpu, pass, &bindings, group.len.div_ceil(GROUP));
    }

    /// Adds the update of the basis functions: the weights of the live ones, or everything if each
    /// Gaussian has its own.
    fn encode_bases(&self, step: &CurrentStep<'_>, pass: &mut Pass<'_>, chain: &ChainPass) {
        let (scene, deformation, time) = (&step.resident.scene, step.deformation, step.plan.view.time);
        let decay = rates(step, self.latent_dim).decay;
        let values = deformation.is_shared().then(|| deformation.basis_values(time).0);
        for (part, rows) in scene.parts.iter().enumerate() {
            let block = (rows.len() * deformation.stride) as u32;
            for b in step.deform.live.clone() {
                let group = UpdateParams {
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
                if let Some(own) = &step.resident.own_bases {
                    self.encode_own_basis(step, pass, chain, group, part, own);
                } else {
                    self.encode_shared_basis(step, pass, chain, group, part);
                }
            }
        }
    }

    fn encode_shared_basis(
        &self,
        step: &CurrentStep<'_>,
        pass: &mut Pass<'_>,
        chain: &ChainPass,
        group: UpdateParams,
        part: usize,
    ) {
        let resident = step.resident;
        let params = uniform(step.gpu, &group);
        let updated = |array| Array::from(array).moving(2 * num_bytes(&group));
        let bindings = [
            UpdateWgsl::params(&params),
            UpdateWgsl::status(&resident.status),
            UpdateWgsl::corrections(Array::from(&resident.corrections).moving(0)),
            UpdateWgsl::rates(&self.channel_rates),
            UpdateWgsl::parameters(updated(&resident.scene.weights[part])),
            UpdateWgsl::first_moments(updated(&resident.weights.first[part])),
            UpdateWgsl::second_moments(updated(&resident.weights.second[part])),
            UpdateWgsl::gradients(chain.g_rest.numbers()),
            UpdateWgsl::g_gate(&chain.g_gate),
        ];
        self.adam_basis.dispatch(step.gpu, pass, &bindings, group.len.div_ceil(GROUP));
    }

    /// Adds the gradients of one basis function's weights, centres and widths, and their update.
    fn encode_own_basis(
        &self,
        step: &CurrentStep<'_>,
        pass: &mut Pass<'_>,
        chain: &ChainPass,
        group: UpdateParams,
        part: usize,
        [centres, widths]: &[Moments<Planes>; 2],
    ) {
        let resident = step.resident;
        let scene = &resident.scene;
        let params = uniform(step.gpu, &group);
        let [g_weights, g_centres, g_widths] = &self.g_own;
        let read = |array| Array::from(array).moving(num_bytes(&group));
        let bindings = [
            UpdateWgsl::params(&params),
            UpdateWgsl::parameters(read(&scene.weights[part])),
            UpdateWgsl::gradients(chain.g_rest.numbers()),
            UpdateWgsl::g_gate(&chain.g_gate),
            UpdateWgsl::centres(read(&scene.centres[part])),
            UpdateWgsl::widths(read(&scene.widths[part])),
            UpdateWgsl::g_weights(g_weights),
            UpdateWgsl::g_centres(g_centres),
            UpdateWgsl::g_widths(g_widths),
        ];
        self.own_basis_gradients.dispatch(step.gpu, pass, &bindings, group.len.div_ceil(GROUP));
        for (parameters, gradients, moments) in [
            (&scene.weights, g_weights, &resident.weights),
            (&scene.centres, g_centres, centres),
            (&scene.widths, g_widths, widths),
        ] {
            let arrays = [&parameters[part], gradients, &self.channel_rates].map(Array::from);
            self.encode_group(step, pass, group, arrays, [&moments.first[part], &moments.second[part]]);
        }
    }
}

/// Number of bytes of a group's parameters.
fn num_bytes(group: &UpdateParams) -> u64 {
    u64::from(group.len) * size_of::<f32>() as u64
}

fn rates(step: &CurrentStep<'_>, latent_dim: usize) -> Rates {
    let (context, stride) = (step.context, step.deformation.stride);
    Rates::new(context.settings, stride, latent_dim, step.plan.view.progress, context.world_per_px)
}
