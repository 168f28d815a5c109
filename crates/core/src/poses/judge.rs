//! Judgement on a path: does it explain what is seen, better than a camera that stands still?

use super::{
    INLIER_PX, MIN_INLIER_RATIO, MIN_PARALLAX_FOR_DEPTH, ScopePath, ScopeVerdict,
    adjust::{Landmark, Observation, RobustResidual},
    build::Builder,
    lens::Lens,
    tracks::Track,
};
use crate::num::median;

/// Smallest difference between the shares of inliers of a path and of a camera that stands still.
pub(super) const MIN_INLIER_GAIN: f64 = 0.2;
/// Largest ratio of a far to a near depth of a surface. A tool close to a moving scope makes larger ones.
const MAX_DEPTH_RATIO: f64 = 12.0;
/// Smallest share of the frames in which a track tells of a point that it stands still, and of its
/// observations that lie near the median one then; and share of these tracks that stand still at most while a
/// scope moves.
const LONG: f64 = 1.0 / 3.0;
const STANDS: f64 = 0.9;
const MOST_STANDING: f64 = 0.01;

/// Share of all observations that lie near the median position of their point in the picture.
pub(super) fn still_share(tracks: &[Track]) -> f64 {
    let near: usize = tracks.iter().map(num_near_median).sum();
    let all: usize = tracks.iter().map(Vec::len).sum();
    if all == 0 { 1.0 } else { near as f64 / all as f64 }
}

/// Number of observations of a track that lie near their median.
fn num_near_median(track: &Track) -> usize {
    let middle: [f64; 2] = std::array::from_fn(|k| {
        median(&mut track.iter().map(|(_, at)| f64::from(at[k])).collect::<Vec<_>>()).unwrap_or(0.0)
    });
    let is_near =
        |at: &[f32; 2]| (f64::from(at[0]) - middle[0]).hypot(f64::from(at[1]) - middle[1]) <= INLIER_PX;
    track.iter().filter(|(_, at)| is_near(at)).count()
}

/// Share of the long tracks of `num_frames` frames whose points stand still in the picture all the time.
fn standing_share(tracks: &[Track], num_frames: usize) -> f64 {
    let is_long = |track: &&Track| track.len() as f64 >= LONG * num_frames as f64;
    let stands = |track: &&Track| num_near_median(track) as f64 >= STANDS * track.len() as f64;
    let long: Vec<&Track> = tracks.iter().filter(is_long).collect();
    long.iter().copied().filter(stands).count() as f64 / long.len().max(1) as f64
}

/// Share of all observations that the path explains.
pub(super) fn moving_share(builder: &Builder, lens: &Lens) -> f64 {
    let residual = RobustResidual { focal_px: lens.focal_px(), cauchy_px: 1.0 };
    let (mut near, mut all) = (0, 0);
    for mark in &builder.landmarks {
        near += mark.position.map_or(0, |position| {
            let seen = mark.observations.iter();
            seen.filter(|s| {
                let there = builder.poses[s.frame].transform_point3(position);
                residual.in_picture(s, there).length() <= INLIER_PX
            })
            .count()
        });
        all += mark.observations.len();
    }
    near as f64 / all.max(1) as f64
}

/// Judges a finished path. One that explains much, but by depths that hardly any surface inside of a body
/// has, and while some points stand still, follows tissue that moves by itself. A scope whose path explains
/// no more stands still if that explains much, or some points stand still.
pub(super) fn verdict(path: &ScopePath, tracks: &[Track], builder: &Builder, lens: &Lens) -> ScopeVerdict {
    let gain = path.moving_share - path.still_share;
    let some_stand = standing_share(tracks, builder.poses.len()) >= MOST_STANDING;
    let is_surface = depth_range(builder, lens) <= MAX_DEPTH_RATIO || !some_stand;
    let is_still = path.still_share >= MIN_INLIER_RATIO || some_stand;
    match (gain >= MIN_INLIER_GAIN, path.moving_share >= MIN_INLIER_RATIO && is_surface) {
        (true, true) => ScopeVerdict::Moves { fov_x_degrees: None, period_frames: None, known: None },
        (false, _) if is_still => ScopeVerdict::Still,
        _ => ScopeVerdict::Unclear,
    }
}

/// Ratio of a far to a near depth, of points where they were seen first: the 98th percentile to the 2nd. Only
/// points whose depth is told count: bland tissue has tracks that lead anywhere.
pub(super) fn depth_range(builder: &Builder, lens: &Lens) -> f64 {
    let depth = |mark: &Landmark| {
        let position = mark.position.filter(|_| is_explained(mark, builder, lens))?;
        let towards =
            |observation: &Observation| builder.poses[observation.frame].inverse().translation - position;
        let first = mark.observations.first()?;
        let is_told = mark
            .observations
            .iter()
            .any(|s| towards(s).angle_between(towards(first)) > MIN_PARALLAX_FOR_DEPTH);
        is_told.then(|| builder.poses[first.frame].transform_point3(position).z)
    };
    let mut depths: Vec<f64> = builder.landmarks.iter().filter_map(depth).collect();
    depths.sort_by(f64::total_cmp);
    let at = |share: f64| depths.get((share * depths.len() as f64) as usize).copied().unwrap_or(1.0);
    at(0.98) / at(0.02).max(1e-6)
}

/// Returns `true` if the path explains a point in most of its frames.
pub(super) fn is_explained(mark: &Landmark, builder: &Builder, lens: &Lens) -> bool {
    let Some(position) = mark.position else { return false };
    let residual = RobustResidual { focal_px: lens.focal_px(), cauchy_px: 1.0 };
    let difference =
        |s: &Observation| residual.in_picture(s, builder.poses[s.frame].transform_point3(position)).length();
    median(&mut mark.observations.iter().map(difference).collect::<Vec<_>>()).is_some_and(|d| d <= INLIER_PX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scope_does_not_move_while_points_stand_still() {
        let standing: Track = (0..40).map(|i| (i, [50.0, 60.0 + 0.5 * (i as f32).sin()])).collect();
        let moving: Track = (0..40).map(|i| (i, [i as f32, 60.0])).collect();
        // Short tracks tell nothing: hardly anything moves at once.
        let short: Track = standing[..9].to_vec();
        let tracks = |standing_ones: usize, moving_ones: usize| -> Vec<Track> {
            let both = [(&standing, standing_ones), (&moving, moving_ones), (&short, 500)];
            both.into_iter().flat_map(|(track, n)| std::iter::repeat_n(track.clone(), n)).collect()
        };
        assert_eq!(standing_share(&tracks(0, 300), 100), 0.0);
        assert!(standing_share(&tracks(2, 298), 100) < MOST_STANDING);
        assert!(standing_share(&tracks(6, 294), 100) > MOST_STANDING);
        assert_eq!(standing_share(&[], 100), 0.0);
    }
}
