//! Mirrors of the structs in `shaders/`; a test compares them field by field with the shader compiler's
//! layout.

use crate::Mark;
use bytemuck::{Pod, Zeroable};
use surgtpgs_core::{
    camera::Camera,
    deform::{Deformation, Deformed},
    gaussian::Gaussians,
    overlay::OverlayLook,
    raster::{
        FRUSTUM_GUARD, TILE,
        project::{Sampling, Splat},
    },
};

/// A struct that exists in Rust and in WGSL under the same name.
pub trait ShaderStruct {
    /// Name in Rust and in WGSL.
    const NAME: &'static str;
    /// Name and byte offset of each field, in order.
    const FIELDS: &'static [(&'static str, usize)];
    /// Size in bytes.
    const SIZE: usize;
}

macro_rules! shader_struct {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$field_meta:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub struct $name { $($(#[$field_meta])* pub $field: $type,)* }

        impl ShaderStruct for $name {
            const NAME: &'static str = stringify!($name);
            const FIELDS: &'static [(&'static str, usize)] =
                &[$((stringify!($field), std::mem::offset_of!($name, $field)),)*];
            const SIZE: usize = size_of::<$name>();
        }
    };
}

mod train;

pub(crate) use train::TERM_QUADS;
pub use train::{
    Chain, CopyRows, Densify, Gather, Loss, Network, Region, RegionBlock, Regions, Settle, Settled,
    SplatGradientRow, Update,
};

shader_struct! {
    /// The camera and the sizes of the frame (`shared/view.wgsl`).
    pub struct View {
        /// Rows of [R | t].
        camera_from_world: [[f32; 4]; 3],
        /// Position of the camera in the world.
        position: [f32; 3],
        /// Degree of the spherical harmonics.
        sh_degree: u32,
        /// Focal lengths, px.
        focal: [f32; 2],
        /// Principal point, px.
        centre: [f32; 2],
        /// Lowest x/z and y/z at which the Jacobian is evaluated.
        guard_low: [f32; 2],
        /// Highest x/z and y/z.
        guard_high: [f32; 2],
        /// Image columns and rows.
        size: [u32; 2],
        /// Tile columns and rows.
        tiles: [u32; 2],
        /// Number of Gaussians, N.
        num_gaussians: u32,
        /// Number of pairs that the pair buffers can hold.
        pair_capacity: u32,
        /// Distance between rendered pixels; `size` counts the rendered ones.
        sampling_step: u32,
        /// Padding to a multiple of 8 bytes.
        padding: u32,
        /// Column and row of the first rendered pixel.
        sampling_first: [u32; 2],
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// Deformation of one part of the scene at one time (`shared/deform.wgsl`).
    pub struct Deform {
        /// First row of the part, which is the rows `first_row..first_row + num_rows` of the scene.
        first_row: u32,
        /// Number of Gaussians in the part.
        num_rows: u32,
        /// Floats per Gaussian and basis.
        stride: u32,
        /// First live basis.
        first_basis: u32,
        /// End of the live bases.
        last_basis: u32,
        /// Number of bases, B; the basis values come before the feature network in the tables.
        num_bases: u32,
        /// 1 if all Gaussians share centres and widths.
        is_shared: u32,
        /// [`surgtpgs_core::deform::BasisShape`] as a number.
        shape: u32,
        /// Time t.
        time: f32,
        /// Slope δ of the gate.
        gate_slope: f32,
        /// First channel of the gate.
        gate_channel: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// One pass of the radix sort (`sort.wgsl`).
    pub struct Digit {
        /// Lowest bit of the digit.
        shift: u32,
        /// Number of blocks of the whole capacity.
        num_blocks: u32,
        /// Number of pairs that fit.
        capacity: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// One layer of the decoder (`dense.wgsl`).
    pub struct Dense {
        /// Number of points.
        num_rows: u32,
        /// Number of inputs.
        num_in: u32,
        /// Number of outputs.
        num_out: u32,
        /// Row of the input that is row 0 of the output.
        first_row: u32,
        /// 1 if a ReLU follows.
        has_relu: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// Scoring of one query (`relevancy.wgsl`).
    pub struct Scoring {
        /// Number of points.
        num_rows: u32,
        /// Number of values of an embedding.
        embedding_dim: u32,
        /// Number of texts of all queries.
        num_texts: u32,
        /// Index of the prompt among them; its negatives follow.
        first_text: u32,
        /// Number of negatives.
        num_negatives: u32,
        /// Index of the first score.
        first_score: u32,
        /// Sharpness.
        temperature: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// Settings for drawing over a frame (`overlay.wgsl`).
    pub struct Overlay {
        /// Columns and rows.
        size: [u32; 2],
        /// Number of prompts to draw.
        num_prompts: u32,
        /// [`surgtpgs_core::overlay::OverlayStyle`] as a number.
        style: u32,
        /// Opacity of fills and heatmaps, 0–1.
        opacity: f32,
        /// Opacity of contours and their halos, 0–1.
        outline_opacity: f32,
        /// Padding to a multiple of 16 bytes.
        padding: [u32; 2],
    }
}

shader_struct! {
    /// Conversion of planes to the shown picture (`compose.wgsl`).
    pub struct Compose {
        /// Columns times rows.
        num_pixels: u32,
        /// Smallest accumulated opacity of a pixel that has depth.
        min_alpha: f32,
        /// Padding to a multiple of 16 bytes.
        padding: [u32; 2],
    }
}

shader_struct! {
    /// One look-up of all prompts (`lattice.wgsl`).
    pub struct LookUp {
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
    /// A pixel that no table can decide (`lattice.wgsl`).
    pub struct OpenPixel {
        /// Feature of the pixel.
        latent: [f32; 3],
        /// Row-major index of the pixel.
        number: u32,
    }
}

shader_struct! {
    /// Summary of scores (`summary.wgsl`).
    pub struct Summarise {
        /// Columns and rows.
        size: [u32; 2],
        /// Number of prompts.
        num_prompts: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// Gaussian at a pixel (`pick.wgsl`).
    pub struct Picked {
        /// Column and row that were asked for.
        pixel: [u32; 2],
        /// Index of the Gaussian that contributes most.
        gaussian: u32,
        /// Its share; 0 if nothing contributes.
        weight: f32,
        /// Depth of its centre.
        depth: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// One prompt to draw (`overlay.wgsl`).
    pub struct PromptRow {
        /// Colour, 0–255.
        colour: [f32; 3],
        /// Score above which a pixel is found.
        threshold: f32,
    }
}

shader_struct! {
    /// A Gaussian at rest: raw parameters (`shared/gaussian.wgsl`).
    pub struct RestRow {
        /// Centre in the world.
        mean: [f32; 3],
        /// Logit of opacity.
        opacity_logit: f32,
        /// Quaternion (w, x, y, z), not normalised.
        rotation: [f32; 4],
        /// Logarithms of the standard deviations.
        log_scale: [f32; 3],
        /// Padding to a multiple of 16 bytes.
        padding: f32,
        /// Band-0 colour coefficients.
        colour: [f32; 3],
        /// Padding to a multiple of 16 bytes.
        padding_2: f32,
    }
}

shader_struct! {
    /// A Gaussian at one time: activated parameters (`shared/gaussian.wgsl`).
    pub struct DeformedRow {
        /// Centre in the world.
        mean: [f32; 3],
        /// Opacity, 0–1.
        opacity: f32,
        /// Unit quaternion (w, x, y, z).
        rotation: [f32; 4],
        /// Standard deviations.
        scale: [f32; 3],
        /// Length of the quaternion before it was normalised; 0 if it had no direction.
        quaternion_length: f32,
        /// Band-0 colour coefficients.
        colour: [f32; 3],
        /// Padding to a multiple of 16 bytes.
        padding_2: f32,
    }
}

shader_struct! {
    /// A Gaussian on the image plane (`shared/gaussian.wgsl`).
    pub struct SplatRow {
        /// Centre in continuous pixel coordinates.
        centre: [f32; 2],
        /// Depth: z in the camera.
        depth: f32,
        /// Opacity, 0–1.
        opacity: f32,
        /// Inverse covariance (xx, xy, yy).
        conic: [f32; 3],
        /// Half width of the ellipse where alpha falls to 1/255; 0 if culled.
        extent_x: f32,
        /// Colour, ≥ 0.
        colour: [f32; 3],
        /// Half height of the ellipse.
        extent_y: f32,
    }
}

impl View {
    /// Makes a view of a camera, for `gaussians` and pair buffers of `pair_capacity`.
    pub fn new(camera: &Camera, gaussians: &Gaussians, pair_capacity: usize) -> Self {
        let (m, t) = (camera.camera_from_world.matrix3, camera.camera_from_world.translation);
        let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
        let guard = |size: u32, focal: f32, centre: f32| {
            let (size, focal, centre) = (f64::from(size), f64::from(focal), f64::from(centre));
            let slack = (f64::from(FRUSTUM_GUARD) - 1.0) * 0.5 * size;
            (((-centre - slack) / focal) as f32, ((size - centre + slack) / focal) as f32)
        };
        let (x, y) = (guard(camera.width, camera.fx, camera.cx), guard(camera.height, camera.fy, camera.cy));
        Self {
            camera_from_world: [row(0), row(1), row(2)],
            position: camera.position_in_world().to_array(),
            sh_degree: gaussians.sh_degree as u32,
            focal: [camera.fx, camera.fy],
            centre: [camera.cx, camera.cy],
            guard_low: [x.0, y.0],
            guard_high: [x.1, y.1],
            size: [camera.width, camera.height],
            tiles: tiles([camera.width, camera.height]),
            num_gaussians: gaussians.len() as u32,
            pair_capacity: pair_capacity as u32,
            sampling_step: 1,
            padding: 0,
            sampling_first: [0; 2],
            padding_2: [0; 2],
        }
    }

    /// Restricts the view to some of the pixels.
    pub fn sampled(self, sampling: Sampling) -> Self {
        let (width, height) = sampling.size(self.size[0] as usize, self.size[1] as usize);
        let size = [width as u32, height as u32];
        let sampling_first = sampling.first.map(|v| v as u32);
        Self { size, tiles: tiles(size), sampling_step: sampling.step as u32, sampling_first, ..self }
    }
}

fn tiles(size: [u32; 2]) -> [u32; 2] {
    size.map(|pixels| pixels.div_ceil(TILE as u32))
}

impl Deform {
    /// Deformation at `time` of the rows `rows`, with only the bases `live` evaluated.
    pub fn new(
        deformation: &Deformation,
        time: f32,
        rows: &std::ops::Range<usize>,
        live: &std::ops::Range<usize>,
    ) -> Self {
        Self {
            first_row: rows.start as u32,
            num_rows: rows.len() as u32,
            stride: deformation.stride as u32,
            first_basis: live.start as u32,
            last_basis: live.end as u32,
            num_bases: deformation.num_bases as u32,
            is_shared: u32::from(deformation.is_shared()),
            shape: deformation.shape as u32,
            time,
            gate_slope: deformation.gate_slope,
            gate_channel: deformation.gate_channel as u32,
            padding: 0,
        }
    }
}

impl Overlay {
    /// Settings for a frame of `size` with `num_prompts` prompts.
    pub fn new(size: [u32; 2], num_prompts: usize, look: OverlayLook) -> Self {
        let OverlayLook { style, opacity, outline_opacity, .. } = look;
        let num_prompts = num_prompts as u32;
        Self { size, num_prompts, style: style as u32, opacity, outline_opacity, ..Default::default() }
    }
}

impl From<&Mark> for PromptRow {
    fn from(mark: &Mark) -> Self {
        Self { colour: mark.colour.map(f32::from), threshold: mark.threshold }
    }
}

impl RestRow {
    /// All Gaussians of a scene, row by row.
    pub fn rows(gaussians: &Gaussians) -> Vec<Self> {
        (0..gaussians.len())
            .map(|i| Self {
                mean: gaussians.means[i],
                opacity_logit: gaussians.opacity_logits[i],
                rotation: gaussians.rotations[i],
                log_scale: gaussians.log_scales[i],
                colour: gaussians.colours[i],
                ..Default::default()
            })
            .collect()
    }
}

impl RestRow {
    /// Replaces the parameters of all Gaussians.
    pub fn write_into(rows: &[Self], gaussians: &mut Gaussians) {
        gaussians.means = rows.iter().map(|r| r.mean).collect();
        gaussians.opacity_logits = rows.iter().map(|r| r.opacity_logit).collect();
        gaussians.rotations = rows.iter().map(|r| r.rotation).collect();
        gaussians.log_scales = rows.iter().map(|r| r.log_scale).collect();
        gaussians.colours = rows.iter().map(|r| r.colour).collect();
    }
}

impl DeformedRow {
    /// Converts from the arrays of core.
    pub fn rows(deformed: &Deformed) -> Vec<Self> {
        (0..deformed.means.len())
            .map(|i| Self {
                mean: deformed.means[i],
                opacity: deformed.opacities[i],
                rotation: deformed.rotations[i],
                scale: deformed.scales[i],
                colour: deformed.colours[i],
                ..Default::default()
            })
            .collect()
    }

    /// Converts to the arrays of core.
    pub fn to_deformed(rows: &[Self], features: Vec<f32>) -> Deformed {
        Deformed {
            means: rows.iter().map(|r| r.mean).collect(),
            rotations: rows.iter().map(|r| r.rotation).collect(),
            scales: rows.iter().map(|r| r.scale).collect(),
            opacities: rows.iter().map(|r| r.opacity).collect(),
            colours: rows.iter().map(|r| r.colour).collect(),
            features,
        }
    }
}

impl From<SplatRow> for Splat<f32> {
    fn from(row: SplatRow) -> Self {
        Self {
            centre: row.centre,
            conic: row.conic,
            depth: row.depth,
            opacity: row.opacity,
            colour: row.colour,
            extent: [row.extent_x, row.extent_y],
        }
    }
}

impl From<&Splat<f32>> for SplatRow {
    fn from(splat: &Splat<f32>) -> Self {
        Self {
            centre: splat.centre,
            depth: splat.depth,
            opacity: splat.opacity,
            conic: splat.conic,
            extent_x: splat.extent[0],
            colour: splat.colour,
            extent_y: splat.extent[1],
        }
    }
}
