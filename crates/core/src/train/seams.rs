//! Seams between chapters: how the world of a chapter lies in that of the chapter before it.
//!
//! Where a path was estimated, each chapter has axes, an origin and a unit of its own. Both chapters know the
//! cameras on the frames that they share, and how deep is what is seen there, and that tells all three.

use crate::{
    num::median,
    scene::{Scene, Similarity},
};
use glam::{Quat, Vec3};
use std::ops::{Range, RangeInclusive};

/// Depths at which a world goes on, scene units. Errors of the unit multiply from chapter to chapter, and
/// what is nearer than the near plane is not seen.
const DEPTHS: RangeInclusive<f32> = 1.0..=1e4;

/// Returns how the world of `after` lies in that of `before`, of which both are scenes of one chapter. `None`
/// if they share no frames, or if the unit of `before` has become much too large or small. The same if a
/// scene cannot be moved: see [`Scene::moved`]. If neither path was estimated, both have one world already,
/// and `after` goes where `before` was moved to.
pub fn seam(before: &Scene, after: &Scene) -> Option<Similarity> {
    let both = [before, after];
    let is_movable = |scene: &&Scene| scene.gaussians.sh_degree <= 1 && scene.deformation.is_shared();
    let is_estimated = |scene: &&Scene| !scene.provenance.path_depths.is_empty();
    let shared = shared_frames(before, after).filter(|_| both.iter().all(is_movable))?;
    if !both.iter().any(is_estimated) {
        return Some(before.chapters.placement());
    }
    let is_measured = |scene: &&Scene| scene.provenance.depth.is_some_and(|depth| depth.is_measured());
    // Without a path, the unit is that of a typical depth, as it is with one.
    let mut scale = before.chapters.placement().scale;
    if !both.iter().all(is_measured)
        && let Some((depth, ratio)) = depth_and_ratio(before, after, shared.clone())
    {
        scale = DEPTHS.contains(&depth).then_some(ratio)?;
    }
    let turns = shared.clone().map(|i| {
        let [before, after] = both.map(|scene| scene.cameras[i].camera_from_world);
        Quat::from_mat3a(&(before.matrix3.transpose() * after.matrix3)).normalize()
    });
    let rotation = middle(&turns.collect::<Vec<_>>())?;
    let shifts = shared.map(|i| {
        let [before, after] = both.map(|scene| scene.cameras[i].position_in_world());
        before - scale * (rotation * after)
    });
    let shifts: Vec<Vec3> = shifts.collect();
    let along = |k: usize| median(&mut shifts.iter().map(|s| f64::from(s[k])).collect::<Vec<_>>());
    let shift = Vec3::new(along(0)? as f32, along(1)? as f32, along(2)? as f32);
    Some(Similarity { scale, rotation, shift })
}

/// Frames that both scenes were learned from; `None` if there are none.
fn shared_frames(before: &Scene, after: &Scene) -> Option<Range<usize>> {
    let [before, after] = [before, after].map(|scene| Some(scene.chapters.current()?.learned.clone()));
    let (before, after) = (before?, after?);
    let shared = before.start.max(after.start)..before.end.min(after.end);
    (!shared.is_empty()).then_some(shared)
}

/// Median depth in `before`, and median ratio to that in `after`; `None` if no frame has both.
fn depth_and_ratio(before: &Scene, after: &Scene, shared: Range<usize>) -> Option<(f32, f32)> {
    let both = |i: usize| Some((f64::from(depth_on(before, i)?), f64::from(depth_on(after, i)?)));
    let is_known = |(a, b): &(f64, f64)| *a > 0.0 && *b > 0.0 && (a / b).is_finite();
    let (mut depths, mut ratios): (Vec<f64>, Vec<f64>) =
        shared.filter_map(both).filter(is_known).map(|(a, b)| (a, a / b)).unzip();
    Some((median(&mut depths)? as f32, median(&mut ratios)? as f32))
}

/// Median depth of what is seen on a frame, scene units.
fn depth_on(scene: &Scene, frame: usize) -> Option<f32> {
    let at = frame.checked_sub(scene.chapters.current()?.learned.start)?;
    scene.provenance.path_depths.get(at).copied()
}

/// The rotation with the smallest sum of angles to all.
fn middle(rotations: &[Quat]) -> Option<Quat> {
    let sum = |a: &Quat| rotations.iter().map(|b| f64::from(a.angle_between(*b))).sum::<f64>();
    rotations.iter().copied().min_by(|a, b| sum(a).total_cmp(&sum(b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        scene::{Chapter, Provenance},
        sequence::DepthOrigin,
        stress::ordinary,
    };
    use glam::Affine3A;

    /// Returns a chapter of a scene that a camera passes by in twenty frames.
    fn part(index: usize, learned: Range<usize>) -> Scene {
        let mut scene = ordinary(150);
        let pose = |i: usize| {
            let turn = Quat::from_rotation_y(0.02 * i as f32);
            Affine3A::from_rotation_translation(turn, Vec3::new(-0.03 * i as f32, 0.01, 0.1))
        };
        let camera = scene.cameras[0];
        scene.cameras =
            (0..20).map(|i| crate::camera::Camera { camera_from_world: pose(i), ..camera }).collect();
        let shown = 10 * index..10 * (index + 1);
        let chapter = Chapter { index, count: 2, shown, learned: learned.clone() };
        let settings = serde_json::json!({ "chapter": chapter });
        let path_depths = learned.map(|i| 4.0 + 0.1 * i as f32).collect();
        scene.provenance = Provenance { path_depths, settings, ..Provenance::default() };
        scene.as_chapter()
    }

    fn elsewhere() -> Similarity {
        let rotation = Quat::from_scaled_axis(Vec3::new(0.4, -1.1, 0.7));
        Similarity { scale: 1.7, rotation, shift: Vec3::new(2.0, -5.0, 1.0) }
    }

    #[test]
    fn a_chapter_comes_to_lie_where_the_one_before_it_tells() {
        let (before, after) = (part(0, 0..14), part(1, 6..20));
        let there = after.clone().moved(&elsewhere());
        let seam = seam(&before, &there).unwrap();
        assert!((1.7 * seam.scale - 1.0).abs() < 1e-3, "{seam:?}");
        let back = there.moved(&seam);
        for (wanted, found) in after.cameras.iter().zip(&back.cameras) {
            let (wanted, found) = (wanted.camera_from_world, found.camera_from_world);
            assert!(wanted.abs_diff_eq(found, 5e-3), "{wanted} {found}");
        }
        // Whichever frame is shown, its Gaussians lie there, too.
        let joined = Scene::joined(Some(Scene::joined(None, before.clone())), back);
        for (i, wanted) in [(3, &before), (15, &after)] {
            let shown = joined.at(joined.time(i)).unwrap();
            let pairs =
                shown.gaussians.means.as_flattened().iter().zip(wanted.gaussians.means.as_flattened());
            assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 2e-2), "frame {i}");
        }
    }

    #[test]
    fn a_unit_that_was_measured_stays() {
        let measured = |mut scene: Scene| {
            scene.provenance.depth = Some(DepthOrigin::Recorded);
            scene
        };
        let there = measured(part(1, 6..20)).moved(&elsewhere());
        assert_eq!(seam(&measured(part(0, 0..14)), &there).map(|seam| seam.scale), Some(1.0));
    }

    #[test]
    fn what_tells_nothing_is_no_seam() {
        let (before, after) = (part(0, 0..14), part(1, 6..20));
        assert!(seam(&before, &after).is_some());
        assert_eq!(seam(&before, &part(1, 14..20)), None, "no frames in common");
        let still = |mut scene: Scene| {
            scene.provenance.path_depths.clear();
            scene
        };
        let standing = still(before.clone());
        assert_eq!(seam(&standing, &still(after.clone())), Some(Similarity::IDENTITY), "one world already");
        let elsewhere = elsewhere();
        let there = seam(&standing.moved(&elsewhere), &still(after.clone()));
        assert_eq!(there, Some(elsewhere), "with the one before it");
        assert_eq!(seam(&before, &still(after.clone())).map(|seam| seam.scale), Some(1.0));
        let small = before.clone().moved(&Similarity { scale: 0.5, ..Similarity::IDENTITY });
        assert_eq!(seam(&small, &still(after.clone())).map(|seam| seam.scale), Some(0.5));
        let tiny = before.clone().moved(&Similarity { scale: 1e-3, ..Similarity::IDENTITY });
        assert_eq!(seam(&tiny, &after), None, "near the near plane");
        let mut own = after;
        own.deformation = crate::deform::Deformation::clone(&own.deformation).with_own_bases().into();
        assert_eq!(seam(&before, &own), None, "cannot be turned");
    }
}
