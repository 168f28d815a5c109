//! A scene on the device, uploaded once.

use crate::{
    buffers::{DeviceVec, max_bytes},
    device::Gpu,
    rows::RestRow,
};
use std::ops::Range;
use surgtpgs_core::{
    Error, Result,
    deform::{Deformation, num_channels},
    gaussian::Gaussians,
};

/// The Gaussians at rest and their deformation.
#[derive(Debug)]
pub(crate) struct SceneBuffers {
    pub rest: DeviceVec<RestRow>,
    pub features: DeviceVec<f32>,
    pub sh_rest: DeviceVec<f32>,
    /// Parts of the scene: ranges of Gaussians whose basis functions fit one binding, since those of all
    /// may not.
    pub parts: Vec<Range<usize>>,
    pub weights: Planes,
    /// Centres, cut as `weights`, if each Gaussian has its own; else one unread number for each part.
    pub centres: Planes,
    pub widths: Planes,
}

/// An array [B][N][stride], cut into the parts of a scene: [B][rows][stride] each.
pub(crate) type Planes = Vec<DeviceVec<f32>>;

impl SceneBuffers {
    pub(crate) fn new(gpu: &Gpu, gaussians: &Gaussians, deformation: &Deformation) -> Result<Self> {
        Self::in_parts(gpu, gaussians, deformation, parts(gpu, gaussians.len(), deformation))
    }

    /// Uploads a scene as [`Self::new`] does, cut into the given parts.
    pub(crate) fn in_parts(
        gpu: &Gpu,
        gaussians: &Gaussians,
        deformation: &Deformation,
        parts: Vec<Range<usize>>,
    ) -> Result<Self> {
        check_lengths(gaussians, deformation)?;
        let plane = gaussians.len() * deformation.stride;
        let upload = |name, values: &[f32]| {
            upload_planes(gpu, name, &parts, deformation.stride, values.chunks(plane.max(1)))
        };
        let own = |name, values: &[f32]| {
            if deformation.is_shared() { Ok(unread(gpu, name, parts.len())) } else { upload(name, values) }
        };
        Ok(Self {
            rest: DeviceVec::from_slice(gpu, "Gaussians", &RestRow::rows(gaussians))?,
            features: DeviceVec::from_slice(gpu, "features", &gaussians.features)?,
            sh_rest: DeviceVec::from_slice(gpu, "spherical harmonics", &gaussians.sh_rest)?,
            weights: upload("deformation weights", &deformation.weights)?,
            centres: own("basis centres", &deformation.centres)?,
            widths: own("basis widths", &deformation.widths)?,
            parts,
        })
    }
}

/// Uploads an array plane by plane, [N][stride] each.
pub(crate) fn upload_planes<'a>(
    gpu: &Gpu,
    name: &'static str,
    parts: &[Range<usize>],
    stride: usize,
    planes: impl Iterator<Item = &'a [f32]> + Clone,
) -> Result<Planes> {
    let upload = |rows: &Range<usize>| {
        let (block, at) = (rows.len() * stride, rows.start * stride..rows.end * stride);
        let mut part = DeviceVec::new(gpu, name);
        part.resize(gpu, planes.clone().count() * block)?;
        for (b, plane) in planes.clone().enumerate() {
            part.write_at(gpu, b * block, &plane[at.clone()]);
        }
        Ok(part)
    };
    parts.iter().map(upload).collect()
}

/// Reads an array back, plane by plane.
pub(crate) fn read_planes<'a>(
    gpu: &Gpu,
    array: &Planes,
    parts: &[Range<usize>],
    stride: usize,
    planes: impl Iterator<Item = &'a mut [f32]>,
) -> Result<()> {
    let values: Vec<Vec<f32>> = array.iter().map(|part| part.read(gpu, usize::MAX)).collect::<Result<_>>()?;
    for (b, plane) in planes.enumerate() {
        for (rows, values) in parts.iter().zip(&values) {
            let block = rows.len() * stride;
            plane[rows.start * stride..rows.end * stride]
                .copy_from_slice(&values[b * block..(b + 1) * block]);
        }
    }
    Ok(())
}

/// Stand-in for an array that does not exist, because a binding cannot be empty.
pub(crate) fn unread(gpu: &Gpu, name: &'static str, num_parts: usize) -> Planes {
    (0..num_parts).map(|_| DeviceVec::new(gpu, name)).collect()
}

/// Ranges of `n` Gaussians whose basis functions can be bound at once.
pub(crate) fn parts(gpu: &Gpu, n: usize, deformation: &Deformation) -> Vec<Range<usize>> {
    let bytes_per_row = deformation.num_bases * deformation.stride * size_of::<f32>();
    cut(n, max_bytes(gpu) as usize / bytes_per_row.max(1))
}

/// Ranges of `n` rows, each of `at_once` rows except the last.
pub(crate) fn cut(n: usize, at_once: usize) -> Vec<Range<usize>> {
    let at_once = at_once.max(1);
    (0..n).step_by(at_once).map(|first| first..n.min(first + at_once)).collect()
}

/// Refuses arrays that are too short, because the passes would read beyond their ends.
fn check_lengths(gaussians: &Gaussians, deformation: &Deformation) -> Result<()> {
    let n = gaussians.len();
    let rows = deformation.num_bases * n * deformation.stride;
    let per_basis = if deformation.is_shared() { deformation.num_bases } else { rows };
    let dim = gaussians.latent_dim;
    let stride_needed = if deformation.num_bases == 0 { 0 } else { num_channels(dim) };
    let lengths = [
        ("rotations", gaussians.rotations.len(), n),
        ("scales", gaussians.log_scales.len(), n),
        ("opacities", gaussians.opacity_logits.len(), n),
        ("colours", gaussians.colours.len(), n),
        ("spherical harmonics", gaussians.sh_rest.len(), n * gaussians.sh_bands() * 3),
        ("features", gaussians.features.len(), n * dim),
        ("deformation weights", deformation.weights.len(), rows),
        ("basis centres", deformation.centres.len(), per_basis),
        ("basis widths", deformation.widths.len(), per_basis),
        ("feature network weights", deformation.feature_weight.len(), dim * (dim + 1)),
        ("feature network biases", deformation.feature_bias.len(), dim),
        ("channels a basis", deformation.stride.min(stride_needed), stride_needed),
    ];
    for (name, found, expected) in lengths {
        if found != expected {
            return Err(Error::input(
                format!("the scene has {found} {name}, {expected} were expected for its {n} Gaussians"),
                "The scene is damaged: train or convert it again",
            ));
        }
    }
    Ok(())
}
