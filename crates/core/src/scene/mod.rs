//! The scene: one safetensors file with everything the viewer needs, and conversions to formats
//! of other programs.

mod camera_row;
mod chapters;
mod file;
mod fit;
mod gltf;
mod io;
mod part;
mod ply;
mod released;
mod revised;
mod similarity;
mod spz;
mod still;
mod web;

pub use chapters::{Chapter, Chapters};
pub use ply::{LANG_DEFORMATION_FILE, ReferenceWeights};
pub use released::{RELEASED_BASES, Released};
pub use revised::Revised;
pub use similarity::Similarity;
pub use web::PagePrompt;

use crate::{
    camera::Camera,
    codec::Codec,
    deform::Deformation,
    gaussian::Gaussians,
    grid::Mask,
    meaning::{EncoderIdentity, WordFacts},
    sequence::{Class, DepthOrigin, Identity, seconds_of, shared_identity},
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// Extensions of files that [`Scene::load`] reads.
pub const EXTENSIONS: [&str; 3] = ["safetensors", "ply", "spz"];

/// Program that files of other formats name as their generator, without its version.
const GENERATOR: &str = "SurgTPGS";
/// Comment in files of formats that only have comments.
const MADE_BY: &str = "written by surgtpgs";

/// Description of a problem with a file, without a full stop.
type Problem = String;

/// A trained reconstruction.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The Gaussians at rest.
    pub gaussians: Revised<Gaussians>,
    /// Motion of the Gaussians.
    pub deformation: Revised<Deformation>,
    /// Chapters of a long scene, one of which the Gaussians and their motion belong to.
    pub chapters: Chapters,
    /// Camera of each frame.
    pub cameras: Vec<Camera>,
    /// Time of each frame, 0 to 1; none in older scenes, where frame i is at i / N.
    pub times: Vec<f32>,
    /// The area that was supervised: `true` inside the endoscopic picture.
    pub field_of_view: Mask,
    /// Embeddings ⇄ latents; `None` for a scene without features (then prompts find nothing).
    pub codec: Option<Codec>,
    /// Class names with embeddings, if known.
    pub classes: Vec<(Class, Vec<f32>)>,
    /// The text encoder the features belong to.
    pub encoder: Option<EncoderIdentity>,
    /// Facts about words, found when the recording was prepared; nothing in older scenes.
    pub words: WordFacts,
    /// Origin of the scene.
    pub provenance: Provenance,
}

/// Record of how a scene was made. Nothing in it depends on the clock or the machine, so that equal trainings
/// give equal files.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Provenance {
    /// Program and version.
    pub made_by: String,
    /// The recording's folder or file name.
    pub sequence_name: String,
    /// Path of the recording, to find the original frames again. A link is not followed: settings may lie
    /// beside it.
    pub sequence_path: PathBuf,
    /// Identity of the recording; absent in older scenes, which know it by number and size of the frames.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "shared_identity")]
    pub identity: Option<Arc<Identity>>,
    /// Hash of everything that the scene learned from besides the pictures, see
    /// [`crate::train::supervision_digest`]; absent in older scenes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub supervision: Option<String>,
    /// Origin of the depth that the scene learned from; absent in older scenes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<DepthOrigin>,
    /// Median depth of what was seen on each frame that a chapter was learned from, scene units, where the
    /// scope's path was estimated from the pictures; 0 where nothing tells. Empty without such a path.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub path_depths: Vec<f32>,
    /// `true` if test frames were held out of training.
    pub held_out: bool,
    /// Frame rate of the recording, if known.
    pub frames_per_second: Option<f32>,
    /// Time of every frame after the first, seconds; empty if the frame rate tells it, or nothing does.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub frame_seconds: Vec<f64>,
    /// Number of optimiser steps done; of chapters, their mean.
    pub steps: usize,
    /// Training settings.
    pub settings: serde_json::Value,
}

impl Provenance {
    /// Returns the frame rate of the recording, finite and above 0, if known.
    pub fn speed(&self) -> Option<f32> {
        self.frames_per_second.filter(|speed| speed.is_finite() && *speed > 0.0)
    }

    /// Returns the number of optimiser steps of the whole training; `None` if it is not known.
    pub fn planned_steps(&self) -> Option<usize> {
        let steps = self.settings.get("iterations")?.as_u64()?;
        usize::try_from(steps).ok().filter(|steps| *steps > 0)
    }

    /// Returns the seconds from the first frame to `frame`; `None` if nothing tells them.
    pub fn seconds(&self, frame: usize) -> Option<f64> {
        seconds_of(frame, &self.frame_seconds, self.speed())
    }
}

impl Scene {
    /// Returns `true` if a path looks like that of a scene, not of a recording.
    pub fn is_named_like_one(path: &Path) -> bool {
        path.extension().is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known)))
    }
    /// Returns the number of frames.
    pub fn num_frames(&self) -> usize {
        self.cameras.len()
    }
    /// Returns the time of frame `i`.
    pub fn time(&self, i: usize) -> f32 {
        self.times.get(i).copied().unwrap_or(i as f32 / self.num_frames().max(1) as f32)
    }
    /// Returns `true` if the scene finds a name by its features: it is one of its classes.
    pub fn finds(&self, name: &str) -> bool {
        self.codec.is_some() && self.classes.iter().any(|(class, _)| class.name == name)
    }
    /// Returns `true` if the scene finds any words by its features: it has no list of classes to find.
    pub fn finds_any_words(&self) -> bool {
        self.codec.is_some() && self.classes.is_empty()
    }
    /// Returns `true` if marks of a name correct what the scene finds by its features.
    pub fn corrects(&self, name: &str) -> bool {
        self.finds(name) || self.finds_any_words()
    }
    /// Returns the revision of Gaussians and motion: scenes of equal revision look the same.
    pub fn revision(&self) -> [u64; 2] {
        [self.gaussians.revision(), self.deformation.revision()]
    }
    /// Copies from another scene of the same recording the parts that a `.ply` does not hold: cameras,
    /// field of view, class names, text encoder and the record of the recording, and the codec if it fits. The
    /// record of how the scene was made stays its own. Where none tells how it was trained, the same frames count
    /// as held out.
    pub fn complete_from(&mut self, other: &Self) {
        self.cameras.clone_from(&other.cameras);
        self.times.clone_from(&other.times);
        self.field_of_view.clone_from(&other.field_of_view);
        let Provenance { made_by, held_out, steps, settings, .. } = std::mem::take(&mut self.provenance);
        let held_out = if steps == 0 { other.provenance.held_out } else { held_out };
        self.provenance = Provenance { made_by, held_out, steps, settings, ..other.provenance.clone() };
        if other.gaussians.latent_dim == self.gaussians.latent_dim {
            self.codec.clone_from(&other.codec);
            self.classes.clone_from(&other.classes);
            self.encoder.clone_from(&other.encoder);
            self.words.clone_from(&other.words);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress::ordinary;

    #[test]
    fn a_completed_scene_keeps_the_record_of_how_it_was_made() {
        let [mut imported, mut other] = [ordinary(5), ordinary(6)];
        imported.provenance.made_by = "imported".into();
        imported.provenance.settings = serde_json::json!({ "gaussians_left_out": 3 });
        let own = imported.provenance.clone();
        other.provenance = Provenance {
            made_by: "trained".into(),
            sequence_name: "pulling".into(),
            depth: Some(DepthOrigin::Recorded),
            held_out: true,
            frames_per_second: Some(25.0),
            frame_seconds: vec![0.0, 0.5],
            steps: 4000,
            settings: serde_json::json!({ "iterations": 4000 }),
            ..Provenance::default()
        };
        for (steps, held_out) in [(0, true), (100, false)] {
            imported.provenance = Provenance { steps, ..own.clone() };
            imported.complete_from(&other);
            let Provenance { made_by, settings, .. } = own.clone();
            let wanted = Provenance { made_by, settings, steps, held_out, ..other.provenance.clone() };
            assert_eq!(imported.provenance, wanted);
        }
    }
}
