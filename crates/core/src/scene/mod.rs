//! The scene: one safetensors file with everything the viewer needs, and the forms that other programs read.

mod file;
mod gltf;
mod ply;
mod still;

pub use ply::{LANG_DEFORMATION_FILE, ReferencePly, ReferenceWeights};

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
    hash::{DefaultHasher, Hash, Hasher},
    io::Read,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Extensions of files that [`Scene::load`] reads.
pub const EXTENSIONS: [&str; 2] = ["safetensors", "ply"];

/// What is wrong with a file, without a full stop.
type Problem = String;

/// A trained reconstruction.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The Gaussians at rest.
    pub gaussians: Gaussians,
    /// How they move.
    pub deformation: Deformation,
    /// Camera of each frame; frame i is at time i / N.
    pub cameras: Vec<Camera>,
    /// The area that was supervised: `true` inside the endoscopic picture.
    pub field_of_view: Mask,
    /// Embeddings ⇄ latents; `None` for a scene without features (then prompts find nothing).
    pub codec: Option<Codec>,
    /// Class names with embeddings, where known.
    pub classes: Vec<(Class, Vec<f32>)>,
    /// The text encoder the features belong to.
    pub encoder: Option<EncoderIdentity>,
    /// Where it comes from and how it was made.
    pub provenance: Provenance,
}

/// How a scene was made.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Provenance {
    /// Program and version.
    pub made_by: String,
    /// The recording's folder or file name.
    pub sequence_name: String,
    /// Where the recording was, to find the original frames again.
    pub sequence_path: PathBuf,
    /// What the recording was; absent in older scenes, which know it by number and size of the frames.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "shared_identity")]
    pub identity: Option<Arc<Identity>>,
    /// Whether test frames were held out of training.
    pub held_out: bool,
    /// Recording speed, where known.
    pub frames_per_second: Option<f32>,
    /// Optimiser steps done.
    pub steps: usize,
    /// Training wall time, seconds.
    pub seconds: f64,
    /// The most memory the training process had, where the system tells.
    #[serde(default)]
    pub peak_rss_bytes: Option<u64>,
    /// Training settings.
    pub settings: serde_json::Value,
}

impl Scene {
    /// Whether a path looks like one of a scene, and not of a recording.
    pub fn is_named_like_one(path: &Path) -> bool {
        path.extension().is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known)))
    }
    /// Whether the file at `path` was written by this program: a scene, or what a scene is converted to.
    pub fn is_own_file(path: &Path) -> bool {
        let mut start = Vec::new();
        let read = open_regular(path).and_then(|file| file.take(OWN_BYTES).read_to_end(&mut start));
        read.is_ok() && (ply::is_own(&start) || gltf::is_own(&start) || file::is_own(path))
    }
    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        self.cameras.len()
    }
    /// Time of frame `i`.
    pub fn time(&self, i: usize) -> f32 {
        i as f32 / self.num_frames().max(1) as f32
    }
    /// Tells scenes in memory apart without reading them whole: where the Gaussians' arrays lie, how long they are, and
    /// samples of their values. Call it again after editing; a few values edited in place may go unnoticed.
    pub fn fingerprint(&self) -> u64 {
        let (gaussians, deformation) = (&self.gaussians, &self.deformation);
        let mut hasher = DefaultHasher::new();
        (gaussians.sh_degree, gaussians.latent_dim, deformation.num_bases, deformation.stride)
            .hash(&mut hasher);
        (deformation.shape as u8, deformation.gate_slope.to_bits(), deformation.gate_channel)
            .hash(&mut hasher);
        let arrays: [&[f32]; 12] = [
            gaussians.means.as_flattened(),
            gaussians.rotations.as_flattened(),
            gaussians.log_scales.as_flattened(),
            &gaussians.opacity_logits,
            gaussians.colours.as_flattened(),
            &gaussians.sh_rest,
            &gaussians.features,
            &deformation.weights,
            &deformation.centres,
            &deformation.widths,
            &deformation.feature_weight,
            &deformation.feature_bias,
        ];
        const SAMPLES: usize = 128;
        for array in arrays {
            (array.as_ptr() as usize, array.len()).hash(&mut hasher);
            for value in array.iter().step_by((array.len() / SAMPLES).max(1)) {
                value.to_bits().hash(&mut hasher);
            }
        }
        hasher.finish()
    }
    /// The scene file.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        file::to_bytes(self, false)
    }
    /// The scene file in few bits: pictures change by about 0.1 dB or less, and it reads back like any other.
    /// A scene that takes so few of them that no reader would believe its size is kept as it is.
    pub fn to_quantized_bytes(&self) -> Result<Vec<u8>> {
        let bytes = file::to_bytes(self, true)?;
        if file::from_bytes(&bytes).is_ok() { Ok(bytes) } else { self.to_bytes() }
    }
    /// Writes the file whole.
    pub fn save(&self, path: &Path) -> Result<()> {
        crate::files::write_whole(path, &self.to_bytes()?)
    }
    /// Memory that [`Self::load`] takes, bytes, about: small files may hold large scenes. What cannot be read takes none.
    pub fn memory_bytes(path: &Path) -> u64 {
        let Ok(bytes) = read_regular(path, MOST_BYTES) else { return 0 };
        let read = if bytes.starts_with(ply::MAGIC) { None } else { file::memory_bytes(&bytes) };
        bytes.len() as u64 + read.unwrap_or(4 * bytes.len() as u64)
    }
    /// Reads and validates a file: a scene, or a `.ply` of Gaussians, which is recognised by its content. The feature
    /// network of a deforming `.ply` is taken from [`LANG_DEFORMATION_FILE`] beside it.
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
    /// Takes from another scene of the same recording what a `.ply` does not hold: cameras, field of view, class names,
    /// text encoder and provenance, and the codec if it fits.
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

/// Bytes from the beginning of a `.ply` or `.glb` in which it names the program that wrote it.
const OWN_BYTES: u64 = 1 << 16;

/// Numbers of a camera in a file.
const CAMERA_WIDTH: usize = 18;

/// Width, height, fx, fy, cx, cy and the rows of camera_from_world, 3×4.
fn camera_row(camera: &Camera) -> Vec<f32> {
    let mut row = vec![camera.width as f32, camera.height as f32, camera.fx, camera.fy, camera.cx, camera.cy];
    let (m, t) = (camera.camera_from_world.matrix3, camera.camera_from_world.translation);
    for i in 0..3 {
        row.extend([m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]);
    }
    row
}

/// The camera that [`camera_row`] gave.
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
