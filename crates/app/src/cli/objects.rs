//! Objects that prompts find, in space: the Gaussians as a `.ply`, and their places over time as tables.

use super::answers::{Answers, FoundGaussians, FrameAnswer, PromptAnswers};
use crate::{engine::Engine, tables::csv};
use std::path::Path;
use surgtpgs_core::{
    Result, deform::deform, export::slugs, files::write_whole, object::Body, scene::Scene,
    sequence::DepthOrigin,
};

/// A row of `objects.csv` and `objects.json`; lengths in scene units, `None` where there is nothing, or where
/// the depth was not measured.
#[derive(serde::Serialize)]
struct Row<'a> {
    prompt: &'a str,
    frame: usize,
    time_s: Option<f64>,
    area_px: Option<usize>,
    /// Area of the found pixels at their depth, facing the camera.
    seen_area: Option<f64>,
    /// Volume of the ellipsoid that spreads as the object's Gaussians do.
    volume_proxy: Option<f64>,
    spread: Option<f64>,
    x: Option<f64>,
    y: Option<f64>,
    z: Option<f64>,
    /// Distance that the centroid moved since the frame before.
    moved: Option<f64>,
    /// Distance of the centroid from its place on the first frame.
    away: Option<f64>,
    /// File name of the recorded frame.
    source: Option<&'a str>,
}

impl Row<'_> {
    /// Leaves out everything that would be a length.
    fn without_lengths(self) -> Self {
        let (volume_proxy, spread, moved, away) = (None, None, None, None);
        Self { seen_area: None, volume_proxy, spread, x: None, y: None, z: None, moved, away, ..self }
    }
}

/// Writes the Gaussians that each prompt finds on the frame where it covers most, and follows them over all
/// frames. Writes nothing for a prompt that found nothing. Files are written into `folder`, and reported as
/// files of `shown`, where they will be.
pub(super) fn write(engine: &mut Engine, answers: &mut Answers, folder: &Path, shown: &Path) -> Result<()> {
    let names = slugs(answers.prompts.iter().map(|p| p.text.as_str()));
    let mut found = Vec::new();
    for (k, name) in names.iter().enumerate() {
        let Some(frame) = answers.prompts[k].largest().map(|f| f.frame) else { continue };
        let time = engine.scene().time(frame);
        let gaussians = engine.gaussians_found(time)?.swap_remove(k);
        let scene = engine.scene().clone();
        let file = format!("{name}.ply");
        write_whole(&folder.join(&file), &scene.still(time, &gaussians).to_ply(scene.cameras.get(frame)))?;
        answers.prompts[k].gaussians =
            Some(FoundGaussians { frame, count: gaussians.len(), file: shown.join(file) });
        found.push((k, gaussians, scene));
    }
    let origin = engine.depth_origin();
    let rows = found.iter().flat_map(|(k, gaussians, scene)| follow(scene, &answers.prompts[*k], gaussians));
    let rows: Vec<Row<'_>> =
        rows.map(|row| if origin.is_measured() { row } else { row.without_lengths() }).collect();
    write_tables(folder, &rows, origin)
}

/// Follows the object over every frame that was asked for. In a scene in chapters it has no place outside of
/// its own.
fn follow<'a>(scene: &Scene, prompt: &'a PromptAnswers, gaussians: &[usize]) -> Vec<Row<'a>> {
    let (mut first, mut last) = (None, None);
    let distance = |a: Option<[f64; 3]>, b: Option<[f64; 3]>| {
        a.zip(b).map(|(a, b)| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt())
    };
    let row = |f: &'a FrameAnswer| {
        // The frames of other chapters of a long scene are shown by other Gaussians.
        let is_here = scene.frames_here().contains(&f.frame);
        let now = is_here.then(|| deform(&scene.gaussians, &scene.deformation, scene.time(f.frame), false));
        let body = now.and_then(|now| Body::of(&now, gaussians));
        let here = body.map(|b| b.centroid);
        let (moved, away) = (distance(last, here), distance(first, here));
        (first, last) = (first.or(here), here);
        Row {
            prompt: &prompt.text,
            frame: f.frame,
            time_s: scene.provenance.seconds(f.frame),
            area_px: f.area_px,
            seen_area: f.seen_area,
            volume_proxy: body.map(|b| b.volume),
            spread: body.map(|b| b.spread),
            x: here.map(|p| p[0]),
            y: here.map(|p| p[1]),
            z: here.map(|p| p[2]),
            moved,
            away,
            source: f.source.as_deref(),
        }
    };
    prompt.frames.iter().map(row).collect()
}

fn write_tables(folder: &Path, rows: &[Row<'_>], origin: DepthOrigin) -> Result<()> {
    write_whole(&folder.join("objects.csv"), &csv(rows)?)?;
    let unit = origin.is_measured().then_some("scene units");
    let json = serde_json::json!({ "length_unit": unit, "depth_origin": origin, "objects": rows });
    let text = serde_json::to_string_pretty(&json).unwrap_or_default() + "\n";
    write_whole(&folder.join("objects.json"), text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Verdict;
    use surgtpgs_core::stress;

    #[test]
    fn an_object_is_followed_from_frame_to_frame() {
        let mut scene = stress::ordinary(40);
        scene.cameras = vec![scene.cameras[0]; 4];
        scene.provenance.frames_per_second = Some(25.0);
        let frame = |frame| FrameAnswer {
            frame,
            answer: Verdict::Found,
            nearest: None,
            found: true,
            area_px: Some(7),
            area_fraction: Some(0.1),
            max_score: Some(0.9),
            seen_area: Some(2.0),
            source: None,
        };
        let prompt = PromptAnswers {
            needs_mark: false,
            not_understood: false,
            text: "liver".into(),
            answer: Verdict::Found,
            nearest: None,
            certainty: 1.0,
            why: String::new(),
            frames: (0..4).map(frame).collect(),
            gaussians: None,
        };
        let rows = follow(&scene, &prompt, &[1, 5, 9, 12, 20]);
        assert_eq!((rows.len(), rows[3].time_s), (4, Some(0.12)));
        assert_eq!((rows[0].moved, rows[0].away), (None, None));
        assert_eq!(rows[1].moved, rows[1].away);
        let centroid = |row: &Row<'_>| [row.x, row.y, row.z].map(Option::unwrap);
        let [a, b] = [centroid(&rows[2]), centroid(&rows[3])];
        let moved = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        assert!((rows[3].moved.unwrap() - moved).abs() < 1e-12 && moved > 0.0);
        assert!(rows[2].volume_proxy.unwrap() > 0.0);
        let row = follow(&scene, &prompt, &[1, 5, 9]).swap_remove(3).without_lengths();
        assert_eq!((row.area_px, row.time_s), (Some(7), Some(0.12)));
        let lengths = [row.seen_area, row.volume_proxy, row.spread, row.x, row.y, row.z, row.moved, row.away];
        assert_eq!(lengths, [None; 8], "the shape is guessed");
        assert!(follow(&scene, &prompt, &[]).iter().all(|row| row.x.is_none() && row.moved.is_none()));
    }
}
