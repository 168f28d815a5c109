//! The parameters, moments and statistics of training, on the device.

use super::status;
use crate::{
    buffers::DeviceVec,
    device::Gpu,
    rows::RestRow,
    scene_buffers::{Planes, SceneBuffers, read_planes, upload_planes},
    shader::shader_struct,
};
use std::ops::Range;
use surgtpgs_core::{
    Result,
    camera::Twist,
    deform::{COLOUR_CHANNEL, Deformation, MEAN_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL},
    gaussian::Gaussians,
    train::{
        Adam, LossTerms, Model, NUM_TERMS, OPACITY_CHANNEL, Optimiser, Statistics, WIDTH, bias_corrections,
    },
};

/// Number of steps after which the history is read.
pub(super) const READ_EVERY: usize = 16;

/// Moments of one group of parameters, in the order of the parameters on the device.
#[derive(Debug)]
pub(super) struct Moments<T = DeviceVec<f32>> {
    pub first: T,
    pub second: T,
}

impl Moments {
    fn new(gpu: &Gpu, [first, second]: [&[f32]; 2]) -> Result<Self> {
        Ok(Self {
            first: DeviceVec::from_slice(gpu, "moments", first)?,
            second: DeviceVec::from_slice(gpu, "moments", second)?,
        })
    }

    /// First and second moments.
    pub(super) fn both(&self) -> [&DeviceVec<f32>; 2] {
        [&self.first, &self.second]
    }

    fn read_into(&self, gpu: &Gpu, adam: &mut Adam, len: usize) -> Result<()> {
        adam.first = self.first.read(gpu, len)?;
        adam.second = self.second.read(gpu, len)?;
        Ok(())
    }
}

impl Moments<Planes> {
    /// Moments of one group for each basis.
    fn of_bases<'a>(
        gpu: &Gpu,
        parts: &[Range<usize>],
        stride: usize,
        adams: impl Iterator<Item = &'a Adam> + Clone,
    ) -> Result<Self> {
        let first = adams.clone().map(|a| &*a.first);
        let second = adams.map(|a| &*a.second);
        Ok(Self {
            first: upload_planes(gpu, "moments", parts, stride, first)?,
            second: upload_planes(gpu, "moments", parts, stride, second)?,
        })
    }

    fn read_bases<'a>(
        &self,
        gpu: &Gpu,
        parts: &[Range<usize>],
        stride: usize,
        adams: impl Iterator<Item = &'a mut Adam>,
    ) -> Result<()> {
        let len = parts.last().map_or(0, |rows| rows.end) * stride;
        let (mut first, mut second) = (Vec::new(), Vec::new());
        for adam in adams {
            adam.first.resize(len, 0.0);
            adam.second.resize(len, 0.0);
            first.push(&mut *adam.first);
            second.push(&mut *adam.second);
        }
        read_planes(gpu, &self.first, parts, stride, first.into_iter())?;
        read_planes(gpu, &self.second, parts, stride, second.into_iter())
    }
}

shader_struct! {
    /// Result of a step.
    pub(super) struct StepResult {
        /// Terms of the loss, weighted, in the order of [`LossTerms`]; then zeros.
        terms: [[f32; 4]; 2],
        /// Gradient of the camera's turn, then of its shift; then zeros.
        camera: [[f32; 4]; 2],
        /// 1 if the step was dropped.
        is_dropped: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

impl From<&StepResult> for LossTerms<f32> {
    fn from(s: &StepResult) -> Self {
        const { assert!(NUM_TERMS <= 8) };
        Self::of(std::array::from_fn(|k| s.terms.as_flattened()[k]))
    }
}

impl StepResult {
    /// Gradient with respect to a motion of the camera; `None` if the step was dropped.
    pub(super) fn camera(&self) -> Option<Twist<f32>> {
        let [[a, b, c, _], [x, y, z, _]] = self.camera;
        (self.is_dropped == 0).then_some(Twist { turn: [a, b, c], shift: [x, y, z] })
    }
}

/// Parameters, moments and statistics of a model.
#[derive(Debug)]
pub(super) struct Resident {
    pub num_gaussians: usize,
    pub scene: SceneBuffers,
    pub rest: Moments,
    pub sh_rest: Moments,
    pub features: Moments,
    pub network: Moments,
    /// Moments of the basis weights.
    pub weights: Moments<Planes>,
    /// Moments of centres and widths, if each Gaussian has its own.
    pub own_bases: Option<[Moments<Planes>; 2]>,
    pub pull_sums: DeviceVec<f32>,
    pub times_seen: DeviceVec<u32>,
    /// Status of the trainer, see [`status`].
    pub status: DeviceVec<u32>,
    pub history: DeviceVec<StepResult>,
    /// Bias corrections of the first and second moments, indexed by the number of the update.
    pub corrections: DeviceVec<[f32; 2]>,
    /// `true` if the model on the host is the same.
    pub is_known: bool,
}

/// Index in a [`RestRow`] of a channel at rest, in the order of ψ's channels.
fn place(channel: usize) -> usize {
    match channel {
        OPACITY_CHANNEL => 3,
        MEAN_CHANNEL..ROTATION_CHANNEL => channel,
        // The opacity follows the mean, padding follows the scale.
        ROTATION_CHANNEL..COLOUR_CHANNEL => channel + 1,
        _ => channel + 2,
    }
}

/// Number of values of each Gaussian at rest.
const AT_REST: usize = OPACITY_CHANNEL + 1;
const _: () = assert!(SCALE_CHANNEL < COLOUR_CHANNEL && size_of::<RestRow>() == WIDTH * size_of::<f32>());

/// Converts rows in the order of ψ's channels to rows like [`RestRow`].
pub(super) fn to_device(rows: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; rows.len()];
    for (to, from) in out.chunks_exact_mut(WIDTH).zip(rows.chunks_exact(WIDTH)) {
        (0..AT_REST).for_each(|c| to[place(c)] = from[c]);
    }
    out
}

/// Converts rows like [`RestRow`] to rows in the order of ψ's channels.
pub(super) fn from_device(rows: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; rows.len()];
    for (to, from) in out.chunks_exact_mut(WIDTH).zip(rows.chunks_exact(WIDTH)) {
        (0..AT_REST).for_each(|c| to[c] = from[place(c)]);
    }
    out
}

impl Resident {
    /// Uploads a model; `iterations` is the largest number of updates.
    pub(super) fn new(gpu: &Gpu, model: &Model, iterations: usize) -> Result<Self> {
        let Model { gaussians, deformation, optimiser, statistics } = model;
        let scene = SceneBuffers::new(gpu, gaussians, deformation)?;
        let of_own = |which: usize| {
            let adams = optimiser.own_bases.iter().map(move |own| &own[which]);
            Moments::of_bases(gpu, &scene.parts, deformation.stride, adams)
        };
        let own_bases = if deformation.is_shared() { None } else { Some([of_own(0)?, of_own(1)?]) };
        let network = [&optimiser.net_weight, &optimiser.net_bias];
        let network = [network.map(|a| &*a.first).concat(), network.map(|a| &*a.second).concat()];
        let of = |adam: &Adam| Moments::new(gpu, [&adam.first, &adam.second]);
        let rest = [to_device(&optimiser.rest.first), to_device(&optimiser.rest.second)];
        let corrections: Vec<[f32; 2]> = (1..=iterations.max(1) as i32).map(bias_corrections).collect();
        Ok(Self {
            num_gaussians: gaussians.len(),
            weights: Moments::of_bases(gpu, &scene.parts, deformation.stride, optimiser.bases.iter())?,
            own_bases,
            scene,
            rest: Moments::new(gpu, [&rest[0], &rest[1]])?,
            sh_rest: of(&optimiser.sh_rest)?,
            features: of(&optimiser.features)?,
            network: Moments::new(gpu, [&network[0], &network[1]])?,
            pull_sums: DeviceVec::from_slice(gpu, "statistics", &statistics.pull)?,
            times_seen: DeviceVec::from_slice(gpu, "statistics", &statistics.seen)?,
            status: DeviceVec::from_slice(gpu, "status", &first_status(model))?,
            history: DeviceVec::from_slice(gpu, "history", &[StepResult::default(); READ_EVERY])?,
            corrections: DeviceVec::from_slice(gpu, "bias corrections", &corrections)?,
            is_known: true,
        })
    }

    /// Brings Gaussians and their motion up to date; `network` holds the feature network's weight and bias.
    pub(super) fn read_shown(
        &self,
        gpu: &Gpu,
        gaussians: &mut Gaussians,
        deformation: &mut Deformation,
        network: &[f32],
    ) -> Result<()> {
        let n = self.num_gaussians;
        RestRow::write_into(&self.scene.rest.read(gpu, n)?, gaussians);
        gaussians.sh_rest = self.scene.sh_rest.read(gpu, n * gaussians.sh_bands() * 3)?;
        gaussians.features = self.scene.features.read(gpu, n * gaussians.latent_dim)?;
        let (weight, bias) = network.split_at(deformation.feature_weight.len());
        deformation.feature_weight.copy_from_slice(weight);
        deformation.feature_bias.copy_from_slice(bias);
        let (parts, stride) = (&self.scene.parts, deformation.stride);
        let plane = n * stride;
        let len = deformation.num_bases * plane;
        let read = |from: &Planes, to: &mut Vec<f32>| {
            to.resize(len, 0.0);
            read_planes(gpu, from, parts, stride, to.chunks_mut(plane.max(1)))
        };
        read(&self.scene.weights, &mut deformation.weights)?;
        if self.own_bases.is_some() {
            read(&self.scene.centres, &mut deformation.centres)?;
            read(&self.scene.widths, &mut deformation.widths)?;
        }
        Ok(())
    }

    /// Brings the model up to date; `network` as for [`Resident::read_shown`].
    pub(super) fn read_into(&self, gpu: &Gpu, model: &mut Model, network: &[f32]) -> Result<()> {
        let Model { gaussians, deformation, optimiser, statistics } = model;
        self.read_shown(gpu, gaussians, deformation, network)?;
        let n = self.num_gaussians;
        let (bands, dim) = (gaussians.sh_bands() * 3, gaussians.latent_dim);
        self.rest.read_into(gpu, &mut optimiser.rest, n * WIDTH)?;
        optimiser.rest.first = from_device(&optimiser.rest.first);
        optimiser.rest.second = from_device(&optimiser.rest.second);
        self.sh_rest.read_into(gpu, &mut optimiser.sh_rest, n * bands)?;
        self.features.read_into(gpu, &mut optimiser.features, n * dim)?;
        self.read_bases(gpu, deformation.stride, optimiser)?;
        self.read_network(gpu, network.len(), deformation.feature_weight.len(), optimiser)?;
        *statistics = Statistics { pull: self.pull_sums.read(gpu, n)?, seen: self.times_seen.read(gpu, n)? };
        set_counts(optimiser, &self.status.read(gpu, usize::MAX)?);
        Ok(())
    }

    /// Reads the moments of the bases, whose rows have `stride` values.
    fn read_bases(&self, gpu: &Gpu, stride: usize, optimiser: &mut Optimiser) -> Result<()> {
        let parts = &self.scene.parts;
        self.weights.read_bases(gpu, parts, stride, optimiser.bases.iter_mut())?;
        for (which, moments) in self.own_bases.iter().flatten().enumerate() {
            let adams = optimiser.own_bases.iter_mut().map(|own| &mut own[which]);
            moments.read_bases(gpu, parts, stride, adams)?;
        }
        Ok(())
    }

    /// Reads the moments of the feature network's `len` numbers, of which the first `num_weights` are the weight.
    fn read_network(
        &self,
        gpu: &Gpu,
        len: usize,
        num_weights: usize,
        optimiser: &mut Optimiser,
    ) -> Result<()> {
        let first = self.network.first.read(gpu, len)?;
        let second = self.network.second.read(gpu, len)?;
        let (weight, bias) = (&mut optimiser.net_weight, &mut optimiser.net_bias);
        (weight.first, bias.first) = (first[..num_weights].into(), first[num_weights..].into());
        (weight.second, bias.second) = (second[..num_weights].into(), second[num_weights..].into());
        Ok(())
    }
}

/// Status without steps, with the updates counted so far.
fn first_status(model: &Model) -> Vec<u32> {
    let o = &model.optimiser;
    let mut status = vec![0; status::COUNT_BASES as usize];
    status[status::OK as usize] = 1;
    status[status::COUNT_REST as usize] = o.rest.steps as u32;
    status[status::COUNT_SH_REST as usize] = o.sh_rest.steps as u32;
    status[status::COUNT_FEATURES as usize] = o.features.steps as u32;
    status[status::COUNT_NETWORK as usize] = o.net_weight.steps as u32;
    status.extend(o.bases.iter().map(|b| b.steps as u32));
    status
}

fn set_counts(o: &mut Optimiser, status: &[u32]) {
    let count = |at: u32| status[at as usize] as i32;
    o.rest.steps = count(status::COUNT_REST);
    o.sh_rest.steps = count(status::COUNT_SH_REST);
    o.features.steps = count(status::COUNT_FEATURES);
    o.net_weight.steps = count(status::COUNT_NETWORK);
    o.net_bias.steps = count(status::COUNT_NETWORK);
    let bases = |b: usize| count(status::COUNT_BASES + b as u32);
    o.bases.iter_mut().enumerate().for_each(|(b, adam)| adam.steps = bases(b));
    o.own_bases.iter_mut().enumerate().for_each(|(b, own)| own.iter_mut().for_each(|a| a.steps = bases(b)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_as_they_went_and_lie_like_gaussians_at_rest() {
        let rows: Vec<f32> = (0..WIDTH).map(|i| if i < AT_REST { i as f32 + 1.0 } else { 0.0 }).collect();
        let on_device = to_device(&rows);
        let row: RestRow = bytemuck::pod_read_unaligned(bytemuck::cast_slice(&on_device));
        assert_eq!(row.mean, [1.0, 2.0, 3.0]);
        assert_eq!(row.rotation, [4.0, 5.0, 6.0, 7.0]);
        assert_eq!((row.log_scale, row.colour), ([8.0, 9.0, 10.0], [11.0, 12.0, 13.0]));
        assert_eq!(row.opacity_logit, 14.0);
        assert_eq!(from_device(&on_device), rows);
    }
}
