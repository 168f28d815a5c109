//! From image planes to what is shown: the picture, the depth, the scores of prompts. Only the wanted results
//! are read back.
//!
//! ```text
//! image planes ─┬▶ compose ─▶ picture, depth
//!               └▶ lattice ─▶ scores
//! ```

mod compose;
mod lattice;

use crate::{
    buffers::{DeviceVec, Part},
    device::Gpu,
    kernel::Pass,
    shader::Shader,
    timer::Timer,
};
use compose::{ComposePass, to_picture};
use image::RgbImage;
use lattice::LatticePass;
use rayon::prelude::*;
use std::borrow::Cow;
use surgtpgs_core::{
    Result,
    grid::{Grid, Mask},
    raster::MIN_DEPTH_ALPHA,
    relevancy::{Lattice, Query, RelevancySettings},
};

/// Shaders of these passes.
pub(crate) const SHADERS: &[Shader] = &[compose::Wgsl::SHADER, lattice::Wgsl::SHADER];

/// Prompts to search for.
pub struct Asked<'a> {
    /// Lattice of the scene's codec.
    pub lattice: &'a mut Lattice,
    /// Queries, all of which fit the lattice's codec.
    pub queries: &'a [Query],
    /// Settings of the scores.
    pub settings: &'a RelevancySettings,
}

/// Results to be read back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// `true` for the rendered picture.
    pub picture: bool,
    /// `true` for the depth of every pixel.
    pub depth: bool,
    /// `true` for the scores of every pixel.
    pub scores: bool,
}

impl Wanted {
    /// Everything there is.
    pub const ALL: Self = Self { picture: true, depth: true, scores: true };
}

/// Results that were read back.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    /// Rendered picture; black outside the field of view.
    pub picture: Option<RgbImage>,
    /// Depth in scene units; 0 at pixels without depth.
    pub depth: Option<Grid<f32>>,
    /// Score images, one per prompt.
    pub scores: Vec<Grid<f32>>,
}

/// The passes from image planes to what is shown.
#[derive(Debug)]
pub(crate) struct ShownPasses {
    gpu: Gpu,
    compose: ComposePass,
    lattice: LatticePass,
    /// Pixels inside the field of view, one bit per pixel.
    inside: DeviceVec<u32>,
    /// Size and field of view that `inside` was made for.
    inside_of: Option<([u32; 2], Option<Mask>)>,
}

impl ShownPasses {
    /// Compiles the passes.
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        gpu.guarded(|| {
            Ok(Self {
                gpu: gpu.clone(),
                compose: ComposePass::new(gpu)?,
                lattice: LatticePass::new(gpu)?,
                inside: DeviceVec::new(gpu, "field of view"),
                inside_of: None,
            })
        })
    }

    /// Uploads the pixels that are inside, unless the last call was the same.
    pub(crate) fn set_inside(&mut self, size: [u32; 2], field_of_view: Option<&Mask>) -> Result<()> {
        if self.inside_of.as_ref().is_some_and(|(s, f)| *s == size && f.as_ref() == field_of_view) {
            return Ok(());
        }
        let [width, height] = size.map(|n| n as usize);
        let mut words = vec![u32::MAX; (width * height).div_ceil(32)];
        if let Some(mask) = field_of_view {
            for (i, is_inside) in mask.sampled(width, height).data.into_iter().enumerate() {
                words[i / 32] &= !(u32::from(!is_inside) << (i % 32));
            }
        }
        self.inside.write(&self.gpu, &words)?;
        self.inside_of = Some((size, field_of_view.cloned()));
        Ok(())
    }

    /// Adds the look-up of the scores.
    pub(crate) fn encode_scores(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        planes: &DeviceVec<f32>,
        asked: &mut Asked<'_>,
        size: [u32; 2],
    ) -> Result<()> {
        let Asked { lattice, queries, settings } = asked;
        let num_pixels = (size[0] * size[1]) as usize;
        self.lattice.prepare(&self.gpu, lattice, queries, settings.temperature, num_pixels)?;
        let pass = &mut timer.begin(encoder, "lattice");
        self.lattice.encode(&self.gpu, pass, planes, &self.inside, settings);
        Ok(())
    }

    /// Scores the pixels on the CPU that the look-up left open, and adds the writing of their scores.
    pub(crate) fn encode_repair(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        asked: &mut Asked<'_>,
        num_open: usize,
    ) -> Result<()> {
        let Asked { lattice, queries, settings } = asked;
        self.lattice.repair(&self.gpu, lattice, queries, settings, num_open)?;
        self.lattice.encode_patch(&self.gpu, &mut Pass::begin(encoder));
        Ok(())
    }

    /// Adds the pass that makes picture and depth.
    pub(crate) fn encode_picture(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        planes: &DeviceVec<f32>,
        size: [u32; 2],
    ) -> Result<()> {
        let Self { gpu, compose, inside, .. } = self;
        compose.prepare(gpu, (size[0] * size[1]) as usize)?;
        compose.encode(gpu, &mut timer.begin(encoder, "compose"), planes, inside, MIN_DEPTH_ALPHA);
        Ok(())
    }

    /// Parts to read back; those that are not wanted are empty.
    pub(crate) fn parts(&self, is_asked: bool, wanted: Wanted) -> [Part; 4] {
        [
            (is_asked, self.lattice.num_open.part()),
            (wanted.picture, self.compose.pixels.part()),
            (wanted.depth, self.compose.depths.part()),
            (wanted.scores && is_asked, self.lattice.scores.part()),
        ]
        .map(|(is_wanted, part)| if is_wanted { part } else { (part.0, 0) })
    }
}

/// Converts the bytes of [`ShownPasses::parts`] to results, and the number of pixels that were left open.
pub(crate) fn parse(parts: [&[u8]; 4], size: [u32; 2]) -> (Shown, usize) {
    let parts = parts.map(words);
    let [num_open, picture, depth, scores] = parts.each_ref().map(|words| &**words);
    let [width, height] = size.map(|n| n as usize);
    let grids = |numbers: &[u32]| -> Vec<Grid<f32>> {
        let grid = |bits: &[u32]| Grid::from_vec(width, height, bytemuck::cast_slice(bits).to_vec());
        numbers.par_chunks_exact((width * height).max(1)).map(grid).collect()
    };
    let shown = Shown {
        picture: (!picture.is_empty()).then(|| to_picture(size, picture)),
        depth: grids(depth).pop(),
        scores: grids(scores),
    };
    (shown, num_open.first().map_or(0, |n| *n as usize))
}

/// Returns bytes as numbers, where they lie if a number may begin there.
fn words(bytes: &[u8]) -> Cow<'_, [u32]> {
    let unaligned = |_| Cow::Owned(bytemuck::pod_collect_to_vec(bytes));
    bytemuck::try_cast_slice(bytes).map_or_else(unaligned, Cow::Borrowed)
}
