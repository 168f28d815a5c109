//! What training changes, on the device.

use crate::{
    Gpu,
    buffers::DeviceVec,
    layout::{RestRow, Settled},
    scene_buffers::{Part, SceneBuffers},
    shader_source::status,
};
use surgtpgs_core::{
    Result,
    deform::{COLOUR_CHANNEL, MEAN_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL},
    train::{Adam, Model, OPACITY_CHANNEL, Statistics, WIDTH, bias_corrections},
};

/// Steps between two looks at the history.
pub(super) const READ_EVERY: usize = 16;

/// Moments of one group of parameters, in the order of the parameters on the device.
#[derive(Debug)]
pub(super) struct Moments {
    pub first: DeviceVec<f32>,
    pub second: DeviceVec<f32>,
}

impl Moments {
    fn new(gpu: &Gpu, [first, second]: [&[f32]; 2]) -> Result<Self> {
        Ok(Self {
            first: DeviceVec::from_slice(gpu, "moments", first)?,
            second: DeviceVec::from_slice(gpu, "moments", second)?,
        })
    }

    fn read_into(&self, gpu: &Gpu, adam: &mut Adam) -> Result<()> {
        adam.first = self.first.read(gpu, adam.first.len())?;
        adam.second = self.second.read(gpu, adam.second.len())?;
        Ok(())
    }
}

/// Parameters, moments and statistics of a model.
#[derive(Debug)]
pub(super) struct Resident {
    pub scene: SceneBuffers,
    pub rest: Moments,
    pub sh_rest: Moments,
    pub features: Moments,
    pub network: Moments,
    /// Those of the basis weights of each part.
    pub bases: Vec<Moments>,
    pub pull_sums: DeviceVec<f32>,
    pub times_seen: DeviceVec<u32>,
    /// See [`status`].
    pub status: DeviceVec<u32>,
    pub history: DeviceVec<Settled>,
    /// Bias corrections of the first and second moments, by number of the update.
    pub corrections: DeviceVec<[f32; 2]>,
    /// Whether the model on the host is the same.
    pub is_known: bool,
}

/// Where the numbers of a row at rest, in the order of ψ's channels, lie in a [`RestRow`].
fn place(channel: usize) -> usize {
    match channel {
        OPACITY_CHANNEL => 3,
        MEAN_CHANNEL..ROTATION_CHANNEL => channel,
        // After the mean comes the opacity, after the scale a padding.
        ROTATION_CHANNEL..COLOUR_CHANNEL => channel + 1,
        _ => channel + 2,
    }
}

/// Numbers of every Gaussian at rest.
const AT_REST: usize = OPACITY_CHANNEL + 1;
const _: () = assert!(SCALE_CHANNEL < COLOUR_CHANNEL && size_of::<RestRow>() == WIDTH * size_of::<f32>());

/// Rows in the order of ψ's channels → rows like [`RestRow`].
pub(super) fn to_device(rows: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; rows.len()];
    for (to, from) in out.chunks_exact_mut(WIDTH).zip(rows.chunks_exact(WIDTH)) {
        (0..AT_REST).for_each(|c| to[place(c)] = from[c]);
    }
    out
}

/// The other way round.
pub(super) fn from_device(rows: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; rows.len()];
    for (to, from) in out.chunks_exact_mut(WIDTH).zip(rows.chunks_exact(WIDTH)) {
        (0..AT_REST).for_each(|c| to[c] = from[place(c)]);
    }
    out
}

impl Resident {
    /// Uploads a model; there will be at most `iterations` updates.
    pub(super) fn new(gpu: &Gpu, model: &Model, iterations: usize) -> Result<Self> {
        let Model { gaussians, deformation, optimiser, statistics } = model;
        let scene = SceneBuffers::new(gpu, gaussians, deformation)?;
        let bases = scene.parts.iter().map(|part| {
            let upload = |which: fn(&Adam) -> &[f32]| {
                Part::upload(
                    gpu,
                    "moments",
                    &part.rows,
                    deformation.stride,
                    |b| which(&optimiser.bases[b]),
                    optimiser.bases.len(),
                )
            };
            Ok(Moments { first: upload(|a| &a.first)?, second: upload(|a| &a.second)? })
        });
        let network = [&optimiser.net_weight, &optimiser.net_bias];
        let network = [network.map(|a| &*a.first).concat(), network.map(|a| &*a.second).concat()];
        let of = |adam: &Adam| Moments::new(gpu, [&adam.first, &adam.second]);
        let rest = [to_device(&optimiser.rest.first), to_device(&optimiser.rest.second)];
        let corrections: Vec<[f32; 2]> = (1..=iterations.max(1) as i32).map(bias_corrections).collect();
        Ok(Self {
            bases: bases.collect::<Result<_>>()?,
            scene,
            rest: Moments::new(gpu, [&rest[0], &rest[1]])?,
            sh_rest: of(&optimiser.sh_rest)?,
            features: of(&optimiser.features)?,
            network: Moments::new(gpu, [&network[0], &network[1]])?,
            pull_sums: DeviceVec::from_slice(gpu, "statistics", &statistics.pull)?,
            times_seen: DeviceVec::from_slice(gpu, "statistics", &statistics.seen)?,
            status: DeviceVec::from_slice(gpu, "status", &first_status(model))?,
            history: DeviceVec::from_slice(gpu, "history", &[Settled::default(); READ_EVERY])?,
            corrections: DeviceVec::from_slice(gpu, "bias corrections", &corrections)?,
            is_known: true,
        })
    }

    /// Brings the model up to date; `network` holds the feature network's weight and bias.
    pub(super) fn read_into(&self, gpu: &Gpu, model: &mut Model, network: &[f32]) -> Result<()> {
        let Model { gaussians, deformation, optimiser, statistics } = model;
        let n = gaussians.len();
        let rows = self.scene.rest.read(gpu, n)?;
        RestRow::write_into(&rows, gaussians);
        gaussians.sh_rest = self.scene.sh_rest.read(gpu, gaussians.sh_rest.len())?;
        gaussians.features = self.scene.features.read(gpu, gaussians.features.len())?;
        let (weight, bias) = network.split_at(deformation.feature_weight.len());
        deformation.feature_weight.copy_from_slice(weight);
        deformation.feature_bias.copy_from_slice(bias);
        let stride = deformation.stride;
        for (part, moments) in self.scene.parts.iter().zip(&self.bases) {
            let block = part.rows.len() * stride;
            let at = part.rows.start * stride..part.rows.end * stride;
            let weights = part.weights.read(gpu, usize::MAX)?;
            let first = moments.first.read(gpu, usize::MAX)?;
            let second = moments.second.read(gpu, usize::MAX)?;
            for (b, adam) in optimiser.bases.iter_mut().enumerate() {
                let here = b * block..(b + 1) * block;
                deformation.weights[b * n * stride..(b + 1) * n * stride][at.clone()]
                    .copy_from_slice(&weights[here.clone()]);
                adam.first[at.clone()].copy_from_slice(&first[here.clone()]);
                adam.second[at.clone()].copy_from_slice(&second[here]);
            }
        }
        self.rest.read_into(gpu, &mut optimiser.rest)?;
        optimiser.rest.first = from_device(&optimiser.rest.first);
        optimiser.rest.second = from_device(&optimiser.rest.second);
        self.sh_rest.read_into(gpu, &mut optimiser.sh_rest)?;
        self.features.read_into(gpu, &mut optimiser.features)?;
        let split = deformation.feature_weight.len();
        let moments = [&self.network.first, &self.network.second].map(|m| m.read(gpu, network.len()));
        let [first, second] = moments;
        let (first, second) = (first?, second?);
        (optimiser.net_weight.first, optimiser.net_bias.first) =
            (first[..split].into(), first[split..].into());
        (optimiser.net_weight.second, optimiser.net_bias.second) =
            (second[..split].into(), second[split..].into());
        *statistics = Statistics { pull: self.pull_sums.read(gpu, n)?, seen: self.times_seen.read(gpu, n)? };
        set_counts(model, &self.status.read(gpu, usize::MAX)?);
        Ok(())
    }
}

/// No step done yet, the updates counted as far as they are.
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

fn set_counts(model: &mut Model, status: &[u32]) {
    let o = &mut model.optimiser;
    let count = |at: u32| status[at as usize] as i32;
    o.rest.steps = count(status::COUNT_REST);
    o.sh_rest.steps = count(status::COUNT_SH_REST);
    o.features.steps = count(status::COUNT_FEATURES);
    o.net_weight.steps = count(status::COUNT_NETWORK);
    o.net_bias.steps = count(status::COUNT_NETWORK);
    for (b, adam) in o.bases.iter_mut().enumerate() {
        adam.steps = count(status::COUNT_BASES + b as u32);
    }
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
