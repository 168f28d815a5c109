//! From image planes to what is shown: the picture, the scores of prompts, the overlay on the picture. Only
//! the wanted results are read back.
//!
//! ```text
//! image planes ─▶ compose ──▶ picture, depth
//!   │                └─(or a recorded frame)─▶ overlay ─▶ marked picture
//!   └─▶ lattice ─▶ scores ──────────────────────┘ └─▶ summary
//! ```

mod compose;
mod lattice;
mod overlay;
mod summary;

use crate::{
    buffers::{DeviceVec, Part},
    device::Gpu,
    kernel::Pass,
    shader::Shader,
    timer::Timer,
};
use compose::ComposePass;
use image::RgbImage;
use lattice::LatticePass;
use overlay::{OverlayParams, OverlayPass, PromptRow, from_pixels, to_pixels};
use rayon::prelude::*;
use std::borrow::Cow;
use summary::SummaryPass;
use surgtpgs_core::{
    Result,
    grid::{Grid, Mask},
    overlay::{OverlayLook, OverlayPrompt},
    raster::MIN_DEPTH_ALPHA,
    relevancy::{Lattice, Query, RelevancySettings},
    summary::Summary,
};

/// Shaders of these passes.
pub(crate) const SHADERS: &[Shader] =
    &[compose::Wgsl::SHADER, lattice::Wgsl::SHADER, overlay::Wgsl::SHADER, summary::Wgsl::SHADER];

/// Prompts to search for.
pub struct Asked<'a> {
    /// Lattice of the scene's codec.
    pub lattice: &'a mut Lattice,
    /// Queries, all of which fit the lattice's codec.
    pub queries: &'a [Query],
    /// Settings of the scores.
    pub settings: &'a RelevancySettings,
    /// Overlay to draw; `None` if only the scores are wanted.
    pub overlay: Option<OverlayRequest<'a>>,
}

/// Overlay of found regions.
#[derive(Clone, Copy, Debug)]
pub struct OverlayRequest<'a> {
    /// Styles of the regions, one per prompt.
    pub regions: &'a [RegionStyle],
    /// Look of all regions; they are drawn over instruments here.
    pub look: OverlayLook,
    /// Picture to draw on instead of the rendered one; of the frame's size.
    pub base: Option<&'a RgbImage>,
}

/// Style of one prompt's region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionStyle {
    /// Score above which a pixel is found.
    pub threshold: f32,
    /// Colour of the prompt.
    pub colour: [u8; 3],
    /// `true` for a dashed contour, see [`surgtpgs_core::overlay::OverlayPrompt`].
    pub is_dashed: bool,
}

/// Results to be read back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// `true` for the rendered picture and the one with the overlay.
    pub pictures: bool,
    /// `true` for the depth of every pixel.
    pub depth: bool,
    /// `true` for the scores of every pixel.
    pub scores: bool,
}

impl Wanted {
    /// Everything there is.
    pub const ALL: Self = Self { pictures: true, depth: true, scores: true };
}

/// Results that were read back.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    /// Rendered picture; black outside the field of view.
    pub picture: Option<RgbImage>,
    /// Picture with the found regions drawn over it, if prompts were given.
    pub marked: Option<RgbImage>,
    /// Depth in scene units; 0 at pixels without depth.
    pub depth: Option<Grid<f32>>,
    /// Score images, one per prompt.
    pub scores: Vec<Grid<f32>>,
    /// Summaries, one per prompt.
    pub summaries: Vec<Summary>,
}

/// The passes from image planes to what is shown.
#[derive(Debug)]
pub struct ShownPasses {
    gpu: Gpu,
    compose: ComposePass,
    lattice: LatticePass,
    overlay: OverlayPass,
    summary: SummaryPass,
    /// Pixels inside the field of view, one bit per pixel.
    inside: DeviceVec<u32>,
    /// Size and field of view that `inside` was made for.
    inside_of: Option<([u32; 2], Option<Mask>)>,
    prompts: DeviceVec<PromptRow>,
    marked: DeviceVec<u32>,
}

impl ShownPasses {
    /// Compiles the passes.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        gpu.guarded(|| {
            Ok(Self {
                gpu: gpu.clone(),
                compose: ComposePass::new(gpu)?,
                lattice: LatticePass::new(gpu)?,
                overlay: OverlayPass::new(gpu)?,
                summary: SummaryPass::new(gpu)?,
                inside: DeviceVec::new(gpu, "field of view"),
                inside_of: None,
                prompts: DeviceVec::new(gpu, "prompts"),
                marked: DeviceVec::new(gpu, "pixels"),
            })
        })
    }

    /// Twin of [`surgtpgs_core::overlay::overlay`].
    pub fn overlay(
        &self,
        frame: &RgbImage,
        prompts: &[OverlayPrompt<'_>],
        look: OverlayLook,
    ) -> Result<RgbImage> {
        self.gpu.guarded(|| self.overlay.draw(&self.gpu, frame, prompts, look))
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
        let Asked { lattice, queries, settings, .. } = asked;
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
        let Asked { lattice, queries, settings, .. } = asked;
        self.lattice.repair(&self.gpu, lattice, queries, settings, num_open)?;
        self.lattice.encode_patch(&self.gpu, &mut Pass::begin(encoder));
        Ok(())
    }

    /// Adds the passes after the scores.
    pub(crate) fn encode_pictures(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        planes: &DeviceVec<f32>,
        asked: Option<&Asked<'_>>,
        size: [u32; 2],
    ) -> Result<()> {
        let Self { gpu, compose, lattice, overlay, summary, inside, prompts, marked, .. } = self;
        compose.prepare(gpu, (size[0] * size[1]) as usize)?;
        compose.encode(gpu, &mut timer.begin(encoder, "compose"), planes, inside, MIN_DEPTH_ALPHA);
        let Some(request) = asked.and_then(|a| a.overlay) else { return Ok(()) };
        let rows: Vec<PromptRow> =
            request.regions.iter().map(|r| PromptRow::new(r.colour, r.threshold, r.is_dashed)).collect();
        prompts.write(gpu, &rows)?;
        marked.resize(gpu, compose.pixels.len())?;
        match request.base {
            Some(base) => marked.write(gpu, &to_pixels(base))?,
            None => {
                let (pixels, num_bytes) = compose.pixels.part();
                encoder.copy_buffer_to_buffer(&pixels, 0, marked.buffer(), 0, num_bytes);
            }
        }
        let params = OverlayParams::new(size, request.regions.len(), request.look);
        let scores = &lattice.scores;
        overlay.encode(gpu, &mut timer.begin(encoder, "overlay"), &params, prompts, scores, marked);
        summary.prepare(gpu, size, request.regions.len())?;
        encoder.clear_buffer(summary.summaries.buffer(), 0, None);
        summary.encode(gpu, &mut timer.begin(encoder, "summary"), prompts, scores);
        Ok(())
    }

    /// Parts to read back; those that are not wanted are empty.
    pub(crate) fn parts(&self, asked: Option<&Asked<'_>>, wanted: Wanted) -> [Part; 6] {
        let (is_asked, is_marked) = (asked.is_some(), asked.is_some_and(|a| a.overlay.is_some()));
        [
            (is_asked, self.lattice.num_open.part()),
            (is_marked, self.summary.summaries.part()),
            (wanted.pictures, self.compose.pixels.part()),
            (wanted.pictures && is_marked, self.marked.part()),
            (wanted.depth, self.compose.depths.part()),
            (wanted.scores && is_asked, self.lattice.scores.part()),
        ]
        .map(|(is_wanted, part)| if is_wanted { part } else { (part.0, 0) })
    }

    /// Converts the bytes of [`Self::parts`] to results, and the number of pixels that were left open.
    pub(crate) fn parse(&self, parts: [&[u8]; 6], size: [u32; 2]) -> (Shown, usize) {
        let parts = parts.map(words);
        let [num_open, summaries, picture, marked, depth, scores] = parts.each_ref().map(|words| &**words);
        let picture_of = |pixels: &[u32]| (!pixels.is_empty()).then(|| from_pixels(size, pixels));
        let [width, height] = size.map(|n| n as usize);
        let grids = |numbers: &[u32]| -> Vec<Grid<f32>> {
            let grid = |bits: &[u32]| Grid::from_vec(width, height, bytemuck::cast_slice(bits).to_vec());
            numbers.par_chunks_exact((width * height).max(1)).map(grid).collect()
        };
        let shown = Shown {
            picture: picture_of(picture),
            marked: picture_of(marked),
            depth: grids(depth).pop(),
            scores: grids(scores),
            summaries: self.summary.parse(summaries),
        };
        (shown, num_open.first().map_or(0, |n| *n as usize))
    }
}

/// Returns bytes as numbers, where they lie if a number may begin there.
fn words(bytes: &[u8]) -> Cow<'_, [u32]> {
    let unaligned = |_| Cow::Owned(bytemuck::pod_collect_to_vec(bytes));
    bytemuck::try_cast_slice(bytes).map_or_else(unaligned, Cow::Borrowed)
}
