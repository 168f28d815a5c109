//! Rows that passes hand to each other, and the view that all of them know.

use crate::shader::shader_struct;
use surgtpgs_core::{
    camera::Camera,
    deform::Deformed,
    gaussian::Gaussians,
    raster::{
        TILE, jacobian_guard,
        project::{Sampling, Splat, SplatGradient},
    },
};

shader_struct! {
    /// The camera and the sizes of the frame.
    pub(crate) struct ViewParams {
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
    /// A Gaussian at rest: raw parameters.
    pub(crate) struct RestRow {
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
    /// A Gaussian at one time: activated parameters.
    pub(crate) struct DeformedRow {
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
    /// A Gaussian on the image plane.
    pub(crate) struct SplatRow {
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

shader_struct! {
    /// Gradients with respect to the values of a splat that the raster pass reads.
    pub(crate) struct SplatGradientRow {
        /// ∂L/∂centre, per px.
        centre: [f32; 2],
        /// ∂L/∂depth.
        depth: f32,
        /// ∂L/∂opacity.
        opacity: f32,
        /// ∂L/∂conic for (xx, xy, yy), xy counted once.
        conic: [f32; 3],
        /// Length of the centre's gradient in the unit of the statistics; -1 if the splat is culled.
        pull: f32,
        /// ∂L/∂colour.
        colour: [f32; 3],
        /// Padding to a multiple of 16 bytes.
        padding: f32,
    }
}

impl ViewParams {
    /// Makes a view of a camera, for `gaussians` and pair buffers of `pair_capacity`.
    pub fn new(camera: &Camera, gaussians: &Gaussians, pair_capacity: usize) -> Self {
        let (m, t) = (camera.camera_from_world.matrix3, camera.camera_from_world.translation);
        let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
        let guard = |size: u32, focal: f32, centre: f32| {
            let (low, high) = jacobian_guard(size, focal, centre);
            (low as f32, high as f32)
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

impl From<&SplatGradientRow> for SplatGradient<f32> {
    fn from(row: &SplatGradientRow) -> Self {
        Self {
            centre: row.centre,
            conic: row.conic,
            depth: row.depth,
            opacity: row.opacity,
            colour: row.colour,
        }
    }
}
