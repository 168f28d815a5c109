//! A frame as it is shown, from Gaussians to the overlay on the picture, in one submission. Only the
//! shown results are read back.
//!
//! ```text
//! deform ─▶ project ─▶ bin ─▶ raster ─▶ compose ──▶ picture, depth
//!                               │          └─(or a recorded frame)─▶ overlay ─▶ marked picture
//!                               └────▶ lattice ─▶ scores ─────────────┘ └─▶ summary
//! ```

use crate::{
    Gpu, GpuRenderer,
    buffers::DeviceVec,
    layout::{Overlay, PromptRow},
    passes::{from_pixels, to_pixels},
    renderer::Frame,
};
use image::RgbImage;
use surgtpgs_core::{
    Result,
    grid::{Grid, Mask},
    overlay::OverlayLook,
    raster::{FrameClock, FramePass, MIN_DEPTH_ALPHA},
    relevancy::{Lattice, Query, RelevancySettings},
    summary::Summary,
};

/// Prompts to search for.
pub struct Asked<'a> {
    /// Lattice of the scene's codec.
    pub lattice: &'a mut Lattice,
    /// Queries, all of which fit the lattice's codec.
    pub queries: &'a [Query],
    /// Settings of the scores.
    pub settings: &'a RelevancySettings,
    /// Style of the overlay; `None` if only the scores are wanted.
    pub marking: Option<Marking<'a>>,
}

/// Style of the overlay of found regions.
#[derive(Clone, Copy, Debug)]
pub struct Marking<'a> {
    /// Marks, one per prompt.
    pub marks: &'a [Mark],
    /// Look of each mark; found regions are drawn over instruments here.
    pub look: OverlayLook,
    /// Picture to draw on instead of the rendered one; of the frame's size.
    pub base: Option<&'a RgbImage>,
}

/// Style of one prompt's region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Score above which a pixel is found.
    pub threshold: f32,
    /// Colour of the prompt.
    pub colour: [u8; 3],
}

/// Results to be read back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// `true` for the rendered picture and the one with the overlay.
    pub pictures: bool,
    /// `true` for depth and scores of every pixel.
    pub values: bool,
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

/// Buffers of [`GpuRenderer::show`] on the device, besides those of the passes.
#[derive(Debug)]
pub(crate) struct ShownBuffers {
    /// Pixels inside the field of view, one bit per pixel.
    inside: DeviceVec<u32>,
    /// Size and field of view that `inside` was made for.
    inside_of: Option<([u32; 2], Option<Mask>)>,
    marks: DeviceVec<PromptRow>,
    marked: DeviceVec<u32>,
}

impl ShownBuffers {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self {
            inside: DeviceVec::new(gpu, "field of view"),
            inside_of: None,
            marks: DeviceVec::new(gpu, "prompts"),
            marked: DeviceVec::new(gpu, "pixels"),
        }
    }

    /// Uploads the pixels that are inside, unless the last call was the same.
    fn set_inside(&mut self, gpu: &Gpu, size: [u32; 2], field_of_view: Option<&Mask>) -> Result<()> {
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
        self.inside.write(gpu, &words)?;
        self.inside_of = Some((size, field_of_view.cloned()));
        Ok(())
    }
}

impl GpuRenderer {
    /// Renders, scores the prompts, and draws the overlay. Pixels outside `field_of_view` are black and
    /// never found. It is sampled at the frame's size; `None` means that everything is inside.
    pub fn show(
        &mut self,
        frame: &Frame<'_>,
        field_of_view: Option<&Mask>,
        mut asked: Option<Asked<'_>>,
        wanted: Wanted,
        clock: &mut FrameClock,
    ) -> Result<Shown> {
        let size = [frame.camera.width, frame.camera.height];
        if size.contains(&0) {
            return Ok(Shown::default());
        }
        clock.start();
        // Prompts that cannot be answered are left out.
        asked = asked
            .filter(|a| !a.queries.is_empty() && a.marking.is_none_or(|m| m.marks.len() == a.queries.len()));
        let is_asked = asked.is_some();
        let gpu = self.gpu().clone();
        let shown =
            gpu.guarded(|| self.show_until_right(frame, field_of_view, asked.as_mut(), wanted, clock));
        if shown.is_err() {
            // The contents of the device are unknown after an error.
            self.forget_scene();
        }
        clock.waited(if is_asked { FramePass::Relevancy } else { FramePass::Raster });
        shown
    }

    /// Repeats the frame until all pairs fit, and the overlay if the tables left pixels open.
    fn show_until_right(
        &mut self,
        frame: &Frame<'_>,
        field_of_view: Option<&Mask>,
        mut asked: Option<&mut Asked<'_>>,
        wanted: Wanted,
        clock: &mut FrameClock,
    ) -> Result<Shown> {
        let gpu = self.gpu().clone();
        let size = [frame.camera.width, frame.camera.height];
        let num_pixels = (size[0] * size[1]) as usize;
        self.shown.set_inside(&gpu, size, field_of_view)?;
        loop {
            let mut encoder = self.encode_frame(frame, clock)?;
            if let Some(Asked { lattice, queries, settings, .. }) = asked.as_deref_mut() {
                let Self { passes, timer, shown, .. } = self;
                let temperature = settings.temperature;
                passes.lattice.prepare(&gpu, lattice, queries, temperature, num_pixels)?;
                let pass = &mut timer.begin(&mut encoder, "lattice");
                let planes = &passes.raster.planes;
                passes.lattice.encode(&gpu, pass, planes, &shown.inside, settings);
                clock.lap(FramePass::Relevancy);
            }
            self.encode_shown(&mut encoder, asked.as_deref(), size)?;
            let Read { num_pairs, num_open, mut shown } =
                self.read_shown(encoder, asked.as_deref(), size, wanted)?;
            if self.passes.bin.grow_if_full(&gpu, num_pairs)? {
                continue;
            }
            if let Some(asked) = asked.filter(|_| num_open > 0) {
                let Asked { lattice, queries, settings, .. } = asked;
                self.passes.lattice.repair(&gpu, lattice, queries, settings, num_open as usize)?;
                let mut encoder = gpu.device().create_command_encoder(&Default::default());
                self.passes.lattice.encode_patch(&gpu, &mut encoder.begin_compute_pass(&Default::default()));
                self.encode_shown(&mut encoder, Some(asked), size)?;
                shown = self.read_shown(encoder, Some(asked), size, wanted)?.shown;
            }
            return Ok(shown);
        }
    }

    /// Adds the passes after the scores.
    fn encode_shown(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        asked: Option<&Asked<'_>>,
        size: [u32; 2],
    ) -> Result<()> {
        let Self { gpu, passes, timer, shown, .. } = self;
        passes.compose.prepare(gpu, (size[0] * size[1]) as usize)?;
        {
            let pass = &mut timer.begin(encoder, "compose");
            passes.compose.encode(gpu, pass, &passes.raster.planes, &shown.inside, MIN_DEPTH_ALPHA);
        }
        let Some(marking) = asked.and_then(|a| a.marking) else { return Ok(()) };
        shown.marks.write(gpu, &marking.marks.iter().map(PromptRow::from).collect::<Vec<_>>())?;
        shown.marked.resize(gpu, passes.compose.pixels.len())?;
        match marking.base {
            Some(base) => shown.marked.write(gpu, &to_pixels(base))?,
            None => {
                let (pixels, num_bytes) = passes.compose.pixels.part();
                encoder.copy_buffer_to_buffer(&pixels, 0, shown.marked.buffer(), 0, num_bytes);
            }
        }
        let scores = &passes.lattice.scores;
        {
            let params = Overlay::new(size, marking.marks.len(), marking.look);
            let bindings = [shown.marks.binding(), scores.binding(), shown.marked.binding()];
            passes.overlay.encode(gpu, &mut timer.begin(encoder, "overlay"), &params, bindings);
        }
        passes.summary.prepare(gpu, size, marking.marks.len())?;
        encoder.clear_buffer(passes.summary.summaries.buffer(), 0, None);
        passes.summary.encode(gpu, &mut timer.begin(encoder, "summary"), &shown.marks, scores);
        Ok(())
    }

    /// Submits, waits for the wanted results, and splits them up.
    fn read_shown(
        &mut self,
        encoder: wgpu::CommandEncoder,
        asked: Option<&Asked<'_>>,
        size: [u32; 2],
        wanted: Wanted,
    ) -> Result<Read> {
        let Self { passes, shown, .. } = &*self;
        let (is_asked, is_marked) = (asked.is_some(), asked.is_some_and(|a| a.marking.is_some()));
        let parts = [
            (true, self.num_wanted()),
            (is_asked, passes.lattice.num_open.part()),
            (is_marked, passes.summary.summaries.part()),
            (wanted.pictures, passes.compose.pixels.part()),
            (wanted.pictures && is_marked, shown.marked.part()),
            (wanted.values, passes.compose.depths.part()),
            (wanted.values && is_asked, passes.lattice.scores.part()),
        ];
        let chosen = parts.map(|(is_wanted, part)| if is_wanted { part } else { (part.0, 0) });
        let bytes = self.submit(encoder, &chosen)?;
        let mut rest = &bytes[..];
        let mut next = chosen.iter().map(|(_, size)| {
            let (part, others) = rest.split_at(*size as usize);
            rest = others;
            part
        });
        let mut numbers = || bytemuck::pod_collect_to_vec::<u8, u32>(next.next().unwrap_or_default());
        let first = |numbers: Vec<u32>| numbers.first().copied().unwrap_or(0);
        let (num_pairs, num_open) = (first(numbers()), first(numbers()));
        let summaries = self.passes.summary.parse(&numbers());
        let mut picture = || {
            let pixels = numbers();
            (!pixels.is_empty()).then(|| from_pixels(size, &pixels))
        };
        let (picture, marked) = (picture(), picture());
        let [width, height] = size.map(|n| n as usize);
        let mut grids = || {
            let values: Vec<f32> = numbers().into_iter().map(f32::from_bits).collect();
            let grid = |v: &[f32]| Grid::from_vec(width, height, v.to_vec());
            values.chunks_exact(width * height).map(grid).collect::<Vec<_>>()
        };
        let (depth, scores) = (grids().pop(), grids());
        Ok(Read { num_pairs, num_open, shown: Shown { picture, marked, depth, scores, summaries } })
    }
}

/// Results that were read back, with the counts that show if they are right.
struct Read {
    num_pairs: u32,
    num_open: u32,
    shown: Shown,
}
