//! From rendered features to scores, looked up in the tables of a lattice (`shaders/lattice.wgsl`).

use crate::{
    buffers::{Array, DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    shader::{GROUP, shader, shader_struct},
};
use surgtpgs_core::{
    Result,
    relevancy::{Lattice, Points, Query, Relevancy, RelevancySettings},
};

shader! {
    pub(super) Wgsl = "lattice.wgsl";
    const LATTICE_COARSE_BITS = Lattice::COARSE_BITS;
    const LATTICE_BRICK_LEVELS = Lattice::BRICK_LEVELS;
    const LATTICE_BRICK = Lattice::BRICK;
    const LATTICE_EMPTY = Lattice::EMPTY;
    const LATTICE_EXTENT = Lattice::EXTENT;
    const LATTICE_FINE = Lattice::FINE as f32;
    const LATTICE_FINE_PER_UNIT = Lattice::FINE_PER_UNIT;
    const MIN_LATENT_LENGTH = Points::MIN_LENGTH;
    var<uniform> params: LatticeParams;
    /// Planes in the layout of the raster pass, with three features.
    var<read> planes: [f32];
    /// Pixels inside the field of view: one bit per pixel, starting with the lowest bit of each word.
    var<read> inside: [u32];
    /// Values of the coarsest cells, then brick by brick those of the cells within a cut cell.
    var<read> cells: [u32];
    /// [prompts][leaves][2]: factors of 1, z, y, yz and of x, xz, xy, xyz; NaN where points must be decoded.
    var<read> polynomials: [[f32; 4]];
    /// [prompts][pixels]
    var<write> scores: [f32];
    var<atomic> num_open: [u32];
    var<write> open: [OpenPixel];
    /// [pixels][1 + prompts]: a pixel's number, then the bits of its scores.
    var<read> patches: [u32];
}

shader_struct! {
    /// One look-up of all prompts.
    pub(crate) struct LatticeParams {
        /// Columns times rows.
        num_pixels: u32,
        /// Number of prompts to score.
        num_prompts: u32,
        /// Number of cells tabulated for each prompt.
        num_leaves: u32,
        /// Smallest accumulated opacity of a pixel that is not a hole.
        min_alpha: f32,
        /// Sharpness.
        temperature: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// A pixel that no table can decide.
    pub(crate) struct OpenPixel {
        /// Feature of the pixel.
        latent: [f32; 3],
        /// Row-major index of the pixel.
        number: u32,
    }
}

/// Number of latent dimensions of a lattice.
const DIM: usize = 3;

#[derive(Debug)]
pub(crate) struct LatticePass {
    look_up: Kernel,
    patch: Kernel,
    cells: DeviceVec<u32>,
    polynomials: DeviceVec<[f32; 4]>,
    /// Identity of the tables on the device: the lattice with its version of the cells, the number of
    /// leaves, and the prompts.
    known: Option<([u64; 2], usize, Prompts)>,
    shape: [u32; 3],
    /// Output, [prompts][pixels].
    pub scores: DeviceVec<f32>,
    /// Output: number of pixels that no table can decide.
    pub num_open: DeviceVec<u32>,
    open: DeviceVec<OpenPixel>,
    patches: DeviceVec<u32>,
}

/// Prompts, and the sharpness of their scores.
type Prompts = (Vec<Query>, f32);

impl LatticePass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            look_up: Kernel::new(gpu, &Wgsl::SHADER, "look_up", DIM)?,
            patch: Kernel::new(gpu, &Wgsl::SHADER, "write_open", DIM)?,
            cells: DeviceVec::new(gpu, "lattice cells"),
            polynomials: DeviceVec::new(gpu, "lattice tables"),
            known: None,
            shape: [0; 3],
            scores: DeviceVec::new(gpu, "scores"),
            num_open: DeviceVec::new(gpu, "open pixels"),
            open: DeviceVec::new(gpu, "open pixels"),
            patches: DeviceVec::new(gpu, "scores"),
        })
    }

    /// Makes room, and uploads the tables if they have changed. `queries` fit the lattice's codec.
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        lattice: &mut Lattice,
        queries: &[Query],
        temperature: f32,
        num_pixels: usize,
    ) -> Result<()> {
        let asked: Vec<&Query> = queries.iter().collect();
        let tables = lattice.tables(&asked, temperature);
        let num_leaves = tables.polynomials.first().map_or(0, |p| p.len());
        let known = (tables.version, num_leaves, (queries.to_vec(), temperature));
        if self.known.as_ref().is_none_or(|k| k.0 != known.0) {
            self.cells.write(gpu, tables.cells)?;
        }
        if self.known.as_ref() != Some(&known) {
            self.polynomials.write(gpu, bytemuck::cast_slice(&tables.polynomials.concat()))?;
        }
        self.known = Some(known);
        self.shape = [num_pixels, queries.len(), num_leaves].map(|n| n as u32);
        self.scores.resize(gpu, num_pixels * queries.len())?;
        self.open.resize(gpu, num_pixels)?;
        self.num_open.write(gpu, &[0])
    }

    /// Adds the look-up; `inside` has one bit per pixel.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        planes: &DeviceVec<f32>,
        inside: &DeviceVec<u32>,
        settings: &RelevancySettings,
    ) {
        let [num_pixels, num_prompts, num_leaves] = self.shape;
        let params = LatticeParams {
            num_pixels,
            num_prompts,
            num_leaves,
            min_alpha: settings.min_alpha.max(Points::MIN_ALPHA),
            temperature: settings.temperature,
            ..Default::default()
        };
        let params = uniform(gpu, &params);
        let per_pixel = |numbers: usize| u64::from(num_pixels) * (numbers * size_of::<f32>()) as u64;
        // A pixel looks at its opacity and features, at a cell of each size, and at one leaf for each prompt.
        // Hardly any is left open.
        let cells = per_pixel(3).min(self.cells.num_bytes());
        let leaves = per_pixel(8 * num_prompts as usize).min(self.polynomials.num_bytes());
        let bindings = [
            Wgsl::params(&params),
            Wgsl::planes(Array::from(planes).moving(per_pixel(1 + DIM))),
            Wgsl::inside(inside),
            Wgsl::cells(Array::from(&self.cells).moving(cells)),
            Wgsl::polynomials(Array::from(&self.polynomials).moving(leaves)),
            Wgsl::scores(&self.scores),
            Wgsl::num_open(&self.num_open),
            Wgsl::open(Array::from(&self.open).moving(0)),
        ];
        self.look_up.dispatch(gpu, pass, &bindings, num_pixels.div_ceil(GROUP));
    }

    /// Scores the open pixels on the CPU, makes the cells that were missing, and uploads the scores.
    /// [`Self::encode_patch`] then writes them.
    pub(crate) fn repair(
        &mut self,
        gpu: &Gpu,
        lattice: &mut Lattice,
        queries: &[Query],
        settings: &RelevancySettings,
        num_open: usize,
    ) -> Result<()> {
        let open = self.open.read(gpu, num_open)?;
        let latents: Vec<f32> = open.iter().flat_map(|p| p.latent).collect();
        let scores = lattice.score_points(&Points::of_latents(&latents, DIM), queries, settings);
        let mut patches = Vec::with_capacity(open.len() * (1 + queries.len()));
        for (i, pixel) in open.iter().enumerate() {
            patches.push(pixel.number);
            patches.extend(scores.iter().map(|s| s[i].to_bits()));
        }
        self.patches.write(gpu, &patches)
    }

    /// Adds the writing of repaired scores.
    pub(crate) fn encode_patch(&self, gpu: &Gpu, pass: &mut Pass<'_>) {
        let [num_pixels, num_prompts, _] = self.shape;
        let params = uniform(gpu, &LatticeParams { num_pixels, num_prompts, ..Default::default() });
        let bindings = [Wgsl::params(&params), Wgsl::scores(&self.scores), Wgsl::patches(&self.patches)];
        let num_patches = self.patches.len() as u32 / (1 + num_prompts);
        self.patch.dispatch(gpu, pass, &bindings, num_patches.div_ceil(GROUP));
    }
}
