//! A scene on the device, uploaded once.

use crate::{
    Gpu,
    buffers::{DeviceVec, max_bytes},
    layout::RestRow,
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
    pub parts: Vec<Part>,
}

/// The basis functions of a range of Gaussians: those of all may exceed what one binding may hold.
#[derive(Debug)]
pub(crate) struct Part {
    pub rows: Range<usize>,
    /// [B][rows][stride].
    pub weights: DeviceVec<f32>,
    /// As `weights` where each Gaussian has its own; else one unread number.
    pub centres: DeviceVec<f32>,
    pub widths: DeviceVec<f32>,
}

impl SceneBuffers {
    pub(crate) fn new(gpu: &Gpu, gaussians: &Gaussians, deformation: &Deformation) -> Result<Self> {
        let rows_at_once = rows_per_part(gpu, deformation);
        Self::in_parts(gpu, gaussians, deformation, rows_at_once)
    }

    /// As [`Self::new`], with at most `rows_at_once` Gaussians in a part.
    pub(crate) fn in_parts(
        gpu: &Gpu,
        gaussians: &Gaussians,
        deformation: &Deformation,
        rows_at_once: usize,
    ) -> Result<Self> {
        check_lengths(gaussians, deformation)?;
        let n = gaussians.len();
        let parts = (0..n)
            .step_by(rows_at_once)
            .map(|first| Part::new(gpu, deformation, n, first..n.min(first + rows_at_once)))
            .collect::<Result<_>>()?;
        Ok(Self {
            rest: DeviceVec::from_slice(gpu, "Gaussians", &RestRow::rows(gaussians))?,
            features: DeviceVec::from_slice(gpu, "features", &gaussians.features)?,
            sh_rest: DeviceVec::from_slice(gpu, "spherical harmonics", &gaussians.sh_rest)?,
            parts,
        })
    }
}

impl Part {
    fn new(gpu: &Gpu, deformation: &Deformation, n: usize, rows: Range<usize>) -> Result<Self> {
        let (stride, bases) = (deformation.stride, deformation.num_bases);
        let plane = n * stride;
        let upload = |name, values: &[f32]| {
            Self::upload(gpu, name, &rows, stride, |b| &values[b * plane..(b + 1) * plane], bases)
        };
        let own = |name, values: &[f32]| {
            if deformation.is_shared() { Ok(DeviceVec::new(gpu, name)) } else { upload(name, values) }
        };
        Ok(Self {
            weights: upload("deformation weights", &deformation.weights)?,
            centres: own("basis centres", &deformation.centres)?,
            widths: own("basis widths", &deformation.widths)?,
            rows,
        })
    }

    /// The part's rows of `bases` planes, [B][rows][stride]; `plane(b)` is that of all Gaussians, [N][stride].
    pub(crate) fn upload<'a>(
        gpu: &Gpu,
        name: &'static str,
        rows: &Range<usize>,
        stride: usize,
        plane: impl Fn(usize) -> &'a [f32],
        bases: usize,
    ) -> Result<DeviceVec<f32>> {
        let mut part = DeviceVec::new(gpu, name);
        part.resize(gpu, bases * rows.len() * stride)?;
        for b in 0..bases {
            part.write_at(gpu, b * rows.len() * stride, &plane(b)[rows.start * stride..rows.end * stride]);
        }
        Ok(part)
    }
}

fn rows_per_part(gpu: &Gpu, deformation: &Deformation) -> usize {
    let bytes_per_row = deformation.num_bases * deformation.stride * size_of::<f32>();
    (max_bytes(gpu) as usize / bytes_per_row.max(1)).max(1)
}

/// Refuses arrays that the passes would read beyond.
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
