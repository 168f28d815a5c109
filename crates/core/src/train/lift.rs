//! Features in closed form: each Gaussian gets the mean of the features that it shows.
//!
//! fᵢ = Σ w f̂ / Σ w over the supervised pixels of all training frames, with w the Gaussian's weight in
//! the pixel. Both sums are the results of the backward raster pass for gradients f̂ and 1.

use super::{FeatureMode, Model, Trainer};
use crate::{
    Result,
    deform::deform,
    marks::{Carried, CarrySettings, Graph},
    prepare::{BACKGROUND, NO_REGION, Prepared},
    raster::{
        FEATURE_PLANE, Images, Packed, backward::raster_backward, bin::bin, project::project_all,
        render_frame,
    },
    scene::Scene,
    sequence::Sequence,
};
use std::sync::Arc;

/// Smallest weight of a Gaussian, over all pixels together, for which its features are replaced.
const MIN_WEIGHT: f32 = 1e-3;

impl Trainer {
    /// Computes the features of the Gaussians if training leaves them out; called before a scene is saved.
    pub fn complete_features(&mut self) -> Result<()> {
        if self.applied.feature_mode == FeatureMode::Lifted { self.lift_features() } else { Ok(()) }
    }

    /// Replaces the features of all Gaussians by the mean of the features that they show.
    pub(super) fn lift_features(&mut self) -> Result<()> {
        let Some(prepared) = self.prepared.clone() else { return Ok(()) };
        let mut carried = self.carried_marks()?;
        self.finish()?;
        let times: Vec<f32> = (0..self.sequence.num_frames()).map(|i| self.time(i)).collect();
        let Model { gaussians, deformation, .. } = &mut self.state.model;
        let (n, dim) = (gaussians.len(), gaussians.latent_dim);
        let mut sums = vec![0.0f32; n * dim];
        let mut weights = vec![0.0f32; n];
        for i in self.applied.frames(self.sequence.num_frames()) {
            let regions = carried.as_mut().map(|marks| marks.regions(&self.sequence, i)).transpose()?;
            let frame = self.cache.get(Some(&prepared), i, false)?;
            let mut truth = frame.truth(&prepared.latents, self.state.typical_depth);
            if let Some(regions) = &regions {
                truth.regions = regions;
            }
            if truth.regions.is_empty() {
                continue;
            }
            let (width, height) = (truth.width, truth.height);
            let time = times[i];
            let deformed = deform(gaussians, deformation, time, false);
            let splats = project_all(gaussians, &deformed, &self.sequence.camera(i));
            let packed = Packed::new(&splats, &vec![0.0; n * dim], dim);
            let planes = vec![0.0; (FEATURE_PLANE + dim) * width * height];
            let wanted = wanted_planes(&truth, dim);
            let images = Images { width, height, planes };
            let bins = bin(&splats, width, height);
            let (shown, features) = raster_backward(&splats, &packed, &bins, &images, &wanted);
            sums.iter_mut().zip(features).for_each(|(sum, f)| *sum += f);
            // The gradient of the first colour was 1, so this is the weight.
            weights.iter_mut().zip(shown).for_each(|(sum, g)| *sum += g.colour[0]);
        }
        let rows = gaussians.features.chunks_exact_mut(dim.max(1)).zip(sums.chunks_exact(dim.max(1)));
        for ((row, sum), weight) in rows.zip(weights).filter(|(_, w)| *w > MIN_WEIGHT) {
            row.iter_mut().zip(sum).for_each(|(f, s)| *f = s / weight);
        }
        self.backend.invalidate();
        Ok(())
    }

    /// Takes the marks that the recording was prepared from; `None` if features come from elsewhere.
    fn carried_marks(&mut self) -> Result<Option<CarriedMarks>> {
        let marks = self.prepared.as_ref().map(Prepared::marks).transpose()?.flatten();
        let Some(marks) = marks else { return Ok(None) };
        // A chapter knows nothing of other frames.
        let window = self.applied.window(self.sequence.num_frames());
        let marks = marks.within(&window);
        if marks.is_empty() {
            return Ok(None);
        }
        // The features that find the names are yet to be made: nothing is corrected.
        let scene = Scene { codec: None, ..self.scene()? };
        let graph = Arc::new(Graph::of(&scene));
        let marks = marks.with_outsides(&scene, &window);
        let carried = Carried::new(&scene, graph, &marks, CarrySettings::default());
        let rows = carried.names().iter().map(|name| row_of(&scene, name)).collect();
        let unnamed = row_of(&scene, BACKGROUND);
        let frames = self.applied.frames(self.sequence.num_frames());
        Ok(Some(CarriedMarks { scene, carried, rows, unnamed, frames }))
    }
}

/// Marks that a recording was prepared from, as they are carried to its training frames.
struct CarriedMarks {
    scene: Scene,
    carried: Carried,
    /// Row of the feature table for each name, and for places without one.
    rows: Vec<u16>,
    unnamed: u16,
    /// The training frames, ascending.
    frames: Vec<usize>,
}

impl CarriedMarks {
    /// Returns the row of the likeliest name of each pixel of a training frame.
    fn regions(&mut self, sequence: &Sequence, frame: usize) -> Result<Vec<u16>> {
        let (scene, frames) = (&self.scene, &self.frames);
        // Marks go from frame to frame, also through those that may not be seen.
        let mut picture = |i: usize| match frames.binary_search(&i) {
            Ok(_) => sequence.frame(i),
            Err(_) => Ok(render_frame(scene, i).to_rgb()),
        };
        let found = self.carried.on_frame(scene, frame, &mut picture)?;
        let row = |pixel: usize| {
            let likeliest = found.scores.iter().position(|plane| plane.data[pixel] > 0.5);
            likeliest.map_or(self.unnamed, |k| self.rows[k])
        };
        Ok((0..found.doubt.data.len()).map(row).collect())
    }
}

/// Returns the row of the feature table that belongs to a name.
fn row_of(scene: &Scene, name: &str) -> u16 {
    scene.classes.iter().position(|(class, _)| class.name == name).map_or(NO_REGION, |k| k as u16)
}

/// Planes with 1 in the first plane and the wanted features in the feature planes, at pixels that have
/// features; 0 elsewhere.
fn wanted_planes(truth: &super::Truth<'_>, dim: usize) -> Vec<f32> {
    let n = truth.width * truth.height;
    let mut planes = vec![0.0; (FEATURE_PLANE + dim) * n];
    let seen = |i: &usize| truth.mask[*i] && truth.regions[*i] != NO_REGION;
    for i in (0..n).filter(seen) {
        let row = usize::from(truth.regions[i]) * dim;
        planes[i] = 1.0;
        for (d, f) in truth.latents[row..row + dim].iter().enumerate() {
            planes[(FEATURE_PLANE + d) * n + i] = *f;
        }
    }
    planes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        codec::CodecSettings,
        demo::{self, DemoSettings},
        marks::{Mark, Marks, Shape},
        prepare::{MarkedNames, prepare_from_marks},
        progress::unobserved,
        stress::{made_up_encoder, one_hot},
        train::TrainSettings,
    };
    use std::path::Path;

    const DIM: usize = 8;
    const STEPS: usize = 20;

    /// Prepares a recording from marks on its first frame, trains on it, and returns the lifted features.
    fn lifted(recording: &Path, folder: &Path) -> Vec<f32> {
        let sequence = Sequence::open(recording).unwrap();
        let shape = |x: f32| Shape::Box { corners_px: [[x, 10.0], [x + 20.0, 36.0]] };
        let marks = [("liver", 6.0), ("fat", 36.0)].map(|(name, x)| Mark::new(0, name, true, shape(x)));
        let marks = Marks::new(marks.to_vec(), &sequence.canvas()).unwrap();
        let embeddings = one_hot(2, DIM);
        let named = MarkedNames { marks: &marks, encoder: made_up_encoder(DIM), embeddings: &embeddings };
        let codec = CodecSettings { steps: 60, ..CodecSettings::default() };
        let prepared = prepare_from_marks(sequence, named, true, &codec, folder, &mut unobserved).unwrap();
        let settings = TrainSettings { iterations: STEPS, ..TrainSettings::default() };
        let mut trainer = Trainer::new(&prepared.sequence, Some(&prepared), settings).unwrap();
        for _ in 0..STEPS {
            trainer.step().unwrap();
        }
        trainer.state.model.gaussians.features.clone()
    }

    #[test]
    fn marks_are_kept_as_they_were_made() {
        let folder = tempfile::tempdir().unwrap();
        let [recording, prepared] = ["recording", "prepared"].map(|name| folder.path().join(name));
        let small = DemoSettings::of_size(64, 48, 12);
        demo::write(&small, &recording, &mut unobserved).unwrap();
        let sequence = Sequence::open(&recording).unwrap();
        let stroke = |points_px: Vec<[f32; 2]>| Shape::Stroke { points_px, radius_px: 3.0 };
        let marks = vec![
            Mark::new(0, "liver", true, stroke(vec![[10.0, 20.0], [20.0, 20.0]])),
            Mark::new(0, "liver", false, stroke(vec![[50.0, 20.0], [60.0, 20.0]])),
            Mark::new(2, "liver", true, Shape::Box { corners_px: [[4.0, 4.0], [20.0, 20.0]] }),
            Mark::new(1, "liver", true, stroke(vec![[10.0, 20.0]])),
        ];
        let marks = Marks::new(marks, &sequence.canvas()).unwrap();
        let embeddings = [vec![1.0; DIM]];
        let named = MarkedNames { marks: &marks, encoder: made_up_encoder(DIM), embeddings: &embeddings };
        let codec = CodecSettings { steps: 60, ..CodecSettings::default() };
        let prepared = prepare_from_marks(sequence, named, true, &codec, &prepared, &mut unobserved).unwrap();
        let seen = prepared.marks().unwrap().unwrap();
        assert_eq!(seen.all(), &marks.all()[..3], "all but those of a held-out frame");
    }

    #[test]
    fn marks_are_carried_without_a_look_at_held_out_frames() {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("recording");
        let small = DemoSettings::of_size(64, 48, 12);
        demo::write(&small, &recording, &mut unobserved).unwrap();
        let before = lifted(&recording, &folder.path().join("before"));
        assert!(before.iter().any(|f| *f != 0.0));
        for i in [1, 9] {
            let path = recording.join(format!("images/frame_{i:06}.png"));
            image::imageops::flip_vertical(&image::open(&path).unwrap().to_rgb8()).save(&path).unwrap();
        }
        assert!(lifted(&recording, &folder.path().join("after")) == before);
    }
}
