//! The scale of depth over time. A network that sees single pictures gives each of them a scale of its
//! own. Before a still camera most of the surface stays in place, so scales can be separated from motion. A
//! camera that moves comes nearer, which its path tells from a change of scale.

use crate::{
    Result,
    camera::Camera,
    num::{finite_percentile, spread},
    poses::{self, ANY_DEPTH, ScopePath, ScopeVerdict, Timeline},
    progress::Observer,
    sequence::{Sequence, pace, shots},
};
use rayon::prelude::*;
use std::ops::Range;

/// Number of places along each side that are compared over time.
pub(super) const SAMPLES: usize = 48;
/// Number of frames that all others are compared with: enough that no single one matters.
const REFERENCES: usize = 48;
/// Number of neighbouring frames by which the motion of a scope is judged at once.
const STRETCH: usize = 96;
/// Fewest points that tell the scale of a frame.
const FEWEST_POINTS: usize = 12;

/// Scales of the depth of frames.
#[derive(Debug, PartialEq)]
pub(super) struct Scales {
    /// Logarithm of each frame's scale. The median of frames that were compared with each other is 0.
    pub(super) logs: Vec<f32>,
    /// Number of frames whose scale was told by the path of the scope.
    pub(super) along_path: usize,
    /// Number of frames with scale 0, because neither a still scope nor a path explains them.
    pub(super) left: usize,
}

impl Scales {
    /// Returns sentences for users on frames that the scope does not stand still before.
    pub(super) fn notes(&self) -> impl Iterator<Item = String> {
        let n = self.logs.len();
        let along_path = (self.along_path > 0).then(|| {
            let some = self.along_path;
            format!("The scope moves in {some} of {n} frames: its path tells the scale of their depth")
        });
        let left = (self.left > 0).then(|| {
            let what = "neither a still scope nor a path explains them";
            format!("The scale of depth was left as it is in {} of {n} frames: {what}", self.left)
        });
        along_path.into_iter().chain(left)
    }
}

/// Neighbouring frames of one shot.
struct Stretch {
    shot: usize,
    /// Places of the frames in the list of all.
    slots: Range<usize>,
    scope: Scope,
}

enum Scope {
    Still,
    /// It moves along a path, which tells the logarithms of the scales.
    Moves(Vec<f32>),
    Unknown,
}

/// Returns the scales of `frames`, whose cameras are not known to move, from logarithms of depth at
/// [`SAMPLES`]² places of each, NaN where unknown. Frames are compared within a shot, where the scope stands
/// still; where it moves, with points of its path.
///
/// # Errors
/// A frame that cannot be read, or the observer's wish to stop.
pub(super) fn log_scales(
    sequence: &Sequence,
    frames: &[usize],
    log_depth: &[Vec<f32>],
    observer: &mut Observer<'_>,
) -> Result<Scales> {
    let mut scales = Scales { logs: vec![0.0; frames.len()], along_path: 0, left: 0 };
    let stretches = stretches(sequence, frames, log_depth, observer)?;
    let are_alike = |a: &Stretch, b: &Stretch| {
        a.shot == b.shot && matches!((&a.scope, &b.scope), (Scope::Still, Scope::Still))
    };
    for part in stretches.chunk_by(are_alike) {
        let slots = part[0].slots.start..part[part.len() - 1].slots.end;
        match &part[0].scope {
            Scope::Still => scales.logs[slots.clone()].copy_from_slice(&still_scales(&log_depth[slots])),
            Scope::Moves(logs) => {
                scales.along_path += slots.len();
                scales.logs[slots].copy_from_slice(logs);
            }
            Scope::Unknown => scales.left += slots.len(),
        }
    }
    Ok(scales)
}

/// Splits `frames` at changes of the shot, shots into parts of about the same length, and judges each.
fn stretches(
    sequence: &Sequence,
    frames: &[usize],
    log_depth: &[Vec<f32>],
    observer: &mut Observer<'_>,
) -> Result<Vec<Stretch>> {
    let cuts = shots::cuts_of(&pace::differences(sequence, frames, observer)?);
    let mut borders = vec![0];
    borders.extend(cuts.iter().map(|cut| frames.partition_point(|frame| frame < cut)));
    borders.push(frames.len());
    let mut stretches = Vec::new();
    for (shot, ends) in borders.windows(2).enumerate() {
        let (first, len) = (ends[0], ends[1] - ends[0]);
        let count = len.div_ceil(STRETCH);
        for k in 0..count {
            let slots = first + k * len / count..first + (k + 1) * len / count;
            let scope = scope(sequence, &frames[slots.clone()], &log_depth[slots.clone()], observer)?;
            stretches.push(Stretch { shot, slots, scope });
        }
    }
    Ok(stretches)
}

fn scope(
    sequence: &Sequence,
    frames: &[usize],
    log_depth: &[Vec<f32>],
    observer: &mut Observer<'_>,
) -> Result<Scope> {
    if !poses::are_wanted(sequence) {
        return Ok(Scope::Still);
    }
    let times = sequence.times();
    let path = poses::estimate(sequence, Timeline { frames, times: &times }, ANY_DEPTH, observer)?;
    Ok(match path.verdict {
        ScopeVerdict::Still => Scope::Still,
        ScopeVerdict::Moves { .. } => Scope::Moves(path_scales(sequence, &path, frames, log_depth)),
        _ => Scope::Unknown,
    })
}

/// Returns the logarithm of each frame's scale, their median 0: the median over points of the path of how
/// much farther they are than the path says. A frame that sees too few points has scale 0.
fn path_scales(sequence: &Sequence, path: &ScopePath, frames: &[usize], log_depth: &[Vec<f32>]) -> Vec<f32> {
    let sequence = sequence.clone().with_zoom(path.zoom.unwrap_or(1.0));
    let scale = |(&i, log_depth): (&usize, &Vec<f32>)| {
        let recorded = sequence.camera(i);
        let pose = path.pose_to_tissue(i, recorded.camera_from_world);
        let camera = Camera { camera_from_world: pose, ..recorded };
        let farther = path.seen(&camera, i).filter_map(|[x, y, z]| {
            let shares = [x / camera.width as f32, y / camera.height as f32];
            let is_inside = shares.iter().all(|share| (0.0..1.0).contains(share));
            let [column, row] = shares.map(|share| (share * SAMPLES as f32) as usize);
            is_inside.then(|| log_depth[row * SAMPLES + column] - z.ln()).filter(|v| v.is_finite())
        });
        let farther: Vec<f32> = farther.collect();
        if farther.len() < FEWEST_POINTS { f32::NAN } else { median(farther.into_iter()).unwrap_or(f32::NAN) }
    };
    centred(frames.iter().zip(log_depth).map(scale).collect())
}

/// Returns the logarithm of each frame's scale, their median 0, from logarithms of depth at the same
/// places of every frame, [frames][places], NaN where unknown. The difference of two frames is the median
/// over their places, so that moving or hidden places do not count. A frame's scale is the median of its
/// differences from frames spread over all. A frame without a value has scale 0.
fn still_scales(log_depth: &[Vec<f32>]) -> Vec<f32> {
    let references: Vec<&Vec<f32>> = spread(log_depth.len(), REFERENCES).map(|k| &log_depth[k]).collect();
    let apart = |a: &[f32], b: &[f32]| median(a.iter().zip(b).map(|(a, b)| a - b));
    let scale = |row: &Vec<f32>| median(references.iter().filter_map(|reference| apart(row, reference)));
    centred(log_depth.par_iter().map(|row| scale(row).unwrap_or(f32::NAN)).collect())
}

/// Subtracts the median from those that are finite; others become 0.
fn centred(scales: Vec<f32>) -> Vec<f32> {
    let middle = median(scales.iter().copied()).unwrap_or(0.0);
    scales.iter().map(|s| if s.is_finite() { s - middle } else { 0.0 }).collect()
}

/// Returns the median of the finite values.
fn median(values: impl Iterator<Item = f32>) -> Option<f32> {
    finite_percentile(values, 50.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns logarithms of depth of a slope under drifting scales, a third of the places covered by
    /// something that moves.
    fn drifting(scales: &[f32]) -> Vec<Vec<f32>> {
        let value = |i: usize, p: usize| match (p + 7 * i) % 3 {
            0 => -2.0 + 0.05 * i as f32,
            _ => 0.01 * p as f32 + scales[i],
        };
        (0..scales.len()).map(|i| (0..90).map(|p| value(i, p)).collect()).collect()
    }

    #[test]
    fn scales_are_found_beside_motion() {
        let truth = [0.3, -0.2, 0.0, 0.1, -0.4, 0.0, 0.25];
        let found = still_scales(&drifting(&truth));
        for (found, truth) in found.iter().zip(truth) {
            assert!((found - truth).abs() < 0.02, "{found} {truth}");
        }
    }

    #[test]
    fn unknown_places_and_frames_are_passed_over() {
        let mut values = drifting(&[0.2, 0.0, -0.2]);
        values[1] = vec![f32::NAN; 90];
        values[0][..20].fill(f32::NAN);
        let found = still_scales(&values);
        assert!((found[0] - found[2] - 0.4).abs() < 0.03 && found[1] == 0.0, "{found:?}");
        assert!(still_scales(&[]).is_empty());
    }
}
