//! The scene: one safetensors file with everything the viewer needs, and conversions to formats
//! of other programs.

mod file;
mod gltf;
mod ply;
mod revised;
mod still;

pub use ply::{LANG_DEFORMATION_FILE, ReferencePly, ReferenceWeights};
pub use revised::Revised;

use crate::{
    Error, Result,
    camera::Camera,
    codec::Codec,
    deform::Deformation,
    gaussian::Gaussians,
    grid::Mask,
    prepare::EncoderIdentity,
    reading::{MOST_BYTES, open_regular, read_regular},
    sequence::{Class, Identity, shared_identity},
};
use glam::{Affine3A, Mat3, Vec3};
use std::{
    io::Read,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Extensions of files that [`Scene::load`] reads.
pub const EXTENSIONS: [&str; 2] = ["safetensors", "ply"];

/// Description of a problem with a file, without a full stop.
type Problem = String;

/// A trained reconstruction.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The Gaussians at rest.
    pub gaussians: Revised<Gaussians>,
    /// Motion of the Gaussians.
    pub deformation: Revised<Deformation>,
    /// Camera of each frame; frame i is at time i / N.
    pub cameras: Vec<Camera>,
    /// The area that was supervised: `true` inside the endoscopic picture.
    pub field_of_view: Mask,
    /// Embeddings ⇄ latents; `None` for a scene without features (then prompts find nothing).
    pub codec: Option<Codec>,
    /// Class names with embeddings, if known.
    pub classes: Vec<(Class, Vec<f32>)>,
    /// The text encoder the features belong to.
    pub encoder: Option<EncoderIdentity>,
    /// Origin of the scene.
    pub provenance: Provenance,
}

/// Record of how a scene was made.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Provenance {
    /// Program and version.
    pub made_by: String,
    /// The recording's folder or file name.
    pub sequence_name: String,
    /// Path of the recording, to find the original frames again.
    pub sequence_path: PathBuf,
    /// Identity of the recording; absent in older scenes, which know it by number and size of the frames.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "shared_identity")]
    pub identity: Option<Arc<Identity>>,
    /// `true` if test frames were held out of training.
    pub held_out: bool,
    /// Frame rate of the recording, if known.
    pub frames_per_second: Option<f32>,
    /// Number of optimiser steps done.
    pub steps: usize,
    /// Training wall time, seconds.
    pub seconds: f64,
    /// Largest memory of the training process, if the system tells.
    #[serde(default)]
    pub peak_rss_bytes: Option<u64>,
    /// Training settings.
    pub settings: serde_json::Value,
}

impl Scene {
    /// Returns `true` if a path looks like that of a scene, not of a recording.
    pub fn is_named_like_one(path: &Path) -> bool {
        path.extension().is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known)))
    }
    /// Returns `true` if the file at `path` was written by this program: a scene, or a conversion of one.
    pub fn is_own_file(path: &Path) -> bool {
        let mut start = Vec::new();
        let read = open_regular(path).and_then(|file| file.take(OWN_BYTES).read_to_end(&mut start));
        read.is_ok() && (ply::is_own(&start) || gltf::is_own(&start) || file::is_own(path))
    }
    /// Returns the number of frames.
    pub fn num_frames(&self) -> usize {
        self.cameras.len()
    }
    /// Returns the time of frame `i`.
    pub fn time(&self, i: usize) -> f32 {
        i as f32 / self.num_frames().max(1) as f32
    }
    /// Returns the revision of Gaussians and motion: scenes of equal revision look the same.
    pub fn revision(&self) -> [u64; 2] {
        [self.gaussians.revision(), self.deformation.revision()]
    }
    /// Returns the bytes of the scene file.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        file::to_bytes(self, false)
    }
    /// Returns the bytes of the scene file in its compact form: pictures change by about 0.1 dB or less,
    /// and it is read like any other. If the result is so small that readers would refuse its size, the
    /// exact form is returned.
    pub fn to_quantized_bytes(&self) -> Result<Vec<u8>> {
        let bytes = file::to_bytes(self, true)?;
        if file::from_bytes(&bytes).is_ok() { Ok(bytes) } else { self.to_bytes() }
    }
    /// Writes the complete file.
    pub fn save(&self, path: &Path) -> Result<()> {
        crate::files::write_whole(path, &self.to_bytes()?)
    }
    /// Estimates the memory in bytes that [`Self::load`] takes: small files may hold large scenes. An
    /// unreadable file takes none.
    pub fn memory_bytes(path: &Path) -> u64 {
        let Ok(bytes) = read_regular(path, MOST_BYTES) else { return 0 };
        let read = if bytes.starts_with(ply::MAGIC) { None } else { file::memory_bytes(&bytes) };
        bytes.len() as u64 + read.unwrap_or(4 * bytes.len() as u64)
    }
    /// Reads and validates a file: a scene, or a `.ply` of Gaussians, which is recognised by its content.
    /// The feature network of a deforming `.ply` is taken from [`LANG_DEFORMATION_FILE`] beside it.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = read_regular(path, MOST_BYTES).map_err(|e| Error::io("read the scene file", path, e))?;
        let hint = "Choose another scene file, or train the recording again.";
        let wrong = |what| Error::input_at(path, what, hint);
        if !bytes.starts_with(ply::MAGIC) {
            return file::from_bytes(&bytes).map_err(wrong);
        }
        let mut scene = ply::from_bytes(&bytes, || ReferenceWeights::beside(path)).map_err(wrong)?;
        scene.provenance.made_by = format!("imported by SurgTPGS {}", env!("CARGO_PKG_VERSION"));
        scene.provenance.sequence_name =
            path.file_stem().map_or(String::new(), |name| name.to_string_lossy().into_owned());
        Ok(scene)
    }
    /// Copies from another scene of the same recording the parts that a `.ply` does not hold: cameras,
    /// field of view, class names, text encoder and provenance, and the codec if it fits.
    pub fn complete_from(&mut self, other: &Self) {
        self.cameras.clone_from(&other.cameras);
        self.field_of_view.clone_from(&other.field_of_view);
        self.provenance.clone_from(&other.provenance);
        if other.gaussians.latent_dim == self.gaussians.latent_dim {
            self.codec.clone_from(&other.codec);
            self.classes.clone_from(&other.classes);
            self.encoder.clone_from(&other.encoder);
        }
    }
}

/// Number of bytes at the beginning of a `.ply` or `.glb` within which it names the program that wrote it.
const OWN_BYTES: u64 = 1 << 16;

/// Number of values of a camera in a file.
const CAMERA_WIDTH: usize = 18;

/// Returns width, height, fx, fy, cx, cy and the rows of camera_from_world, 3×4.
fn camera_row(camera: &Camera) -> Vec<f32> {
    let mut row = vec![camera.width as f32, camera.height as f32, camera.fx, camera.fy, camera.cx, camera.cy];
    let (m, t) = (camera.camera_from_world.matrix3, camera.camera_from_world.translation);
    for i in 0..3 {
        row.extend([m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]);
    }
    row
}

/// Returns the camera of a row that [`camera_row`] made.
fn read_camera(row: &[f32]) -> Camera {
    let at = |r: usize, c: usize| row[6 + 4 * r + c];
    let column = |c: usize| Vec3::new(at(0, c), at(1, c), at(2, c));
    Camera {
        width: row[0] as u32,
        height: row[1] as u32,
        fx: row[2],
        fy: row[3],
        cx: row[4],
        cy: row[5],
        camera_from_world: Affine3A::from_mat3_translation(
            Mat3::from_cols(column(0), column(1), column(2)),
            column(3),
        ),
    }
}
