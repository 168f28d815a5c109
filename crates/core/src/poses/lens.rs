//! The lens: from positions in pictures to directions, and its focal length where it is not known.

use super::{
    SHORTEST_TRACK,
    adjust::{Landmark, Observation},
    build::Builder,
    tracks::Track,
};
use crate::{
    Result,
    camera::Camera,
    progress::{Observer, Progress},
    sequence::Sequence,
};
use glam::DVec2;
use rayon::prelude::*;

/// Angle across the round picture of an endoscope, degrees, that is likely: rigid ones have 70 to 80.
const DISC_DEGREES: f64 = 75.0;
/// Factors of the focal length that are tried, in ascending order.
const ZOOMS: [f64; 11] = [0.33, 0.41, 0.5, 0.62, 0.75, 0.88, 1.0, 1.15, 1.35, 1.6, 1.9];
/// Number of frames that they are tried with at most; and about how many points, or observations of points
/// where these leave the view so soon that fewer would hold no path together.
pub(super) const FRAMES: usize = 64;
const POINTS: usize = 500;
const OBSERVATIONS: usize = 16_000;
/// Fewest points that tell something.
const FEWEST_POINTS: usize = 60;
/// Ratio of the cost at both ends to the lowest, from which on the lowest is believed: tissue that breathes
/// makes a shallow valley at a wrong zoom.
const LEAST_RISE: f64 = 1.05;

/// Maps positions in the pictures that are looked at to the plane at depth 1.
#[derive(Clone, Copy)]
pub(super) struct Lens {
    pub camera: Camera,
    /// Number of pixels of the recording, along a side, for each pixel of the pictures.
    pub shrink: f64,
}

impl Lens {
    /// Returns the lens with a focal length that is `zoom` times as large.
    pub(super) fn zoomed(self, zoom: f64) -> Self {
        Self { camera: self.camera.zoomed(zoom as f32), ..self }
    }

    pub(super) fn focal_px(&self) -> f64 {
        f64::from(self.camera.fx) / self.shrink
    }

    /// Returns the lens for pictures of half the size.
    pub(super) fn halved(self) -> Self {
        Self { shrink: 2.0 * self.shrink, ..self }
    }

    /// Returns the position in the pictures that are looked at of a point of the plane at depth 1, px.
    pub(super) fn position(&self, at: DVec2) -> [f32; 2] {
        let Camera { fx, fy, cx, cy, .. } = self.camera;
        let pixel = at * DVec2::new(fx.into(), fy.into()) + DVec2::new(cx.into(), cy.into());
        (pixel / self.shrink - 0.5).as_vec2().to_array()
    }

    /// Returns the position in the recording of a position in the pictures that are looked at, px.
    pub(super) fn pixel(&self, at: [f32; 2]) -> [f64; 2] {
        at.map(|p| (f64::from(p) + 0.5) * self.shrink)
    }

    pub(super) fn observation(&self, frame: usize, at: [f32; 2]) -> Observation {
        let [u, v] = self.pixel(at);
        let Camera { fx, fy, cx, cy, .. } = self.camera;
        let at = DVec2::new((u - f64::from(cx)) / f64::from(fx), (v - f64::from(cy)) / f64::from(fy));
        Observation { frame, at, depth: None }
    }

    pub(super) fn landmarks(&self, tracks: &[Track]) -> Vec<Landmark> {
        landmarks(tracks, |_| *self)
    }
}

/// Returns the points of tracks, seen through the lens that each frame has.
pub(super) fn landmarks(tracks: &[Track], lens_of: impl Fn(usize) -> Lens) -> Vec<Landmark> {
    let landmark = |track: &Track| Landmark {
        position: None,
        expected_depth: 1.0,
        observations: track.iter().map(|(frame, at)| lens_of(*frame).observation(*frame, *at)).collect(),
    };
    tracks.iter().map(landmark).collect()
}

/// Returns the factor from the focal length that is assumed of a recording to the likely one: the one that
/// best explains the tracks of all `parts`, else that of a usual endoscope if the picture is round. `None` if
/// nothing tells.
///
/// # Errors
/// The observer's wish to stop.
pub(super) fn likely_zoom(
    sequence: &Sequence,
    parts: &[&[Track]],
    assumed: &Lens,
    observer: &mut Observer<'_>,
) -> Result<Option<f64>> {
    let usual =
        |radius_px: f64| radius_px / (0.5 * DISC_DEGREES.to_radians()).tan() / f64::from(assumed.camera.fx);
    let found = find_zoom(parts, assumed, observer)?;
    Ok(found.or_else(|| sequence.disc_radius_px().map(usual)))
}

/// Returns the factor from the focal length of `lens` to the one that explains the tracks of all parts best.
/// `None` unless what is left unexplained rises clearly on both sides of it, and stays so: then the tracks do
/// not tell.
///
/// # Errors
/// The observer's wish to stop.
fn find_zoom(parts: &[&[Track]], lens: &Lens, observer: &mut Observer<'_>) -> Result<Option<f64>> {
    let parts: Vec<Vec<Track>> = parts.iter().filter_map(|tracks| telling(tracks)).collect();
    let mut sum = [0.0; ZOOMS.len()];
    for (part, tracks) in parts.iter().enumerate() {
        let mut costs: Vec<f64> = Vec::with_capacity(ZOOMS.len());
        // As many at once as there are threads, so that a wish to stop is heard between them.
        for zooms in ZOOMS.chunks(rayon::current_num_threads()) {
            let (done, total) = (part * ZOOMS.len() + costs.len(), parts.len() * ZOOMS.len());
            Progress::new("looking for the lens", done, total).tell(observer)?;
            costs.par_extend(zooms.par_iter().map(|zoom| cost(tracks, &lens.zoomed(*zoom))));
        }
        // A path that no lens holds together tells nothing.
        if costs.iter().any(|cost| cost.is_finite()) {
            sum.iter_mut().zip(without_peaks(&costs)).for_each(|(sum, cost)| *sum += cost);
        }
    }
    Ok(lowest(&sum))
}

/// Returns about as many tracks as are needed, of the first frames; `None` if there are too few.
fn telling(tracks: &[Track]) -> Option<Vec<Track>> {
    let begun: Vec<Track> = tracks.iter().map(first_frames).filter(|t| t.len() >= SHORTEST_TRACK).collect();
    let observations: usize = begun.iter().map(Vec::len).sum();
    let every = begun.len().div_ceil(POINTS).min(observations.div_ceil(OBSERVATIONS)).max(1);
    let chosen: Vec<Track> = begun.into_iter().step_by(every).collect();
    (chosen.len() >= FEWEST_POINTS).then_some(chosen)
}

/// Returns the observations of a track in the first frames.
fn first_frames(track: &Track) -> Track {
    track.iter().copied().filter(|(frame, _)| *frame < FRAMES).collect()
}

/// Returns the cost of the best path with a lens, px²; infinite if there is none.
fn cost(tracks: &[Track], lens: &Lens) -> f64 {
    let frames = tracks.iter().filter_map(|track| track.last()).map(|(frame, _)| frame + 1).max();
    let mut builder = Builder::new(frames.unwrap_or(0), lens.landmarks(tracks), lens.focal_px());
    if builder.build().is_some() { f64::INFINITY } else { builder.cost() }
}

/// Returns the zoom at the bottom of a valley of costs, on a parabola through the lowest and those beside it;
/// `None` if the costs form no valley, or one more that is about as deep.
fn lowest(costs: &[f64]) -> Option<f64> {
    let costs = &without_peaks(costs)[..];
    let k = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
    let is_deep = costs[0].min(costs[costs.len() - 1]) > LEAST_RISE * costs[k];
    let is_lone = stays_above(costs[..=k].iter().rev()) && stays_above(costs[k..].iter());
    if k == 0 || k + 1 == costs.len() || !is_deep || !is_lone {
        return None;
    }
    let [a, b, c] = [k - 1, k, k + 1].map(|k| ZOOMS[k].ln());
    let (left, right) = ((costs[k - 1] - costs[k]) / (b - a), (costs[k + 1] - costs[k]) / (c - b));
    // Slopes are those in the middle between two zooms.
    let bottom = 0.5 * (a + b) + 0.5 * (c - a) * left / (left + right);
    bottom.is_finite().then(|| bottom.exp())
}

/// Returns `true` if costs rise from the lowest on, which comes first, or are clearly above it wherever they
/// have fallen again.
fn stays_above<'a>(outwards: impl Iterator<Item = &'a f64> + Clone) -> bool {
    let Some(lowest) = outwards.clone().next() else { return true };
    let mut has_fallen = false;
    outwards.clone().zip(outwards.skip(1)).all(|(last, cost)| {
        has_fallen |= cost < last;
        !has_fallen || *cost > LEAST_RISE * lowest
    })
}

/// Lowers costs that are above both beside them: there the search for the path ended at a worse one.
fn without_peaks(costs: &[f64]) -> Vec<f64> {
    let lowered = |k: usize| match costs.get(k.wrapping_sub(1)..k + 2) {
        Some([before, own, after]) => own.min(before.max(*after)),
        _ => costs[k],
    };
    (0..costs.len()).map(lowered).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_valley_has_a_bottom_between_the_lowest_and_one_bad_search_hides_nothing() {
        let valley = |at: f64| ZOOMS.map(|zoom| 1000.0 + 500.0 * (zoom / at).ln().powi(2)).to_vec();
        let mut costs = valley(0.8);
        assert!((lowest(&costs).unwrap() - 0.8).abs() < 0.02);
        costs[8] *= 1.5;
        assert!((lowest(&costs).unwrap() - 0.8).abs() < 0.02);
        costs[7] *= 1.3;
        assert!((lowest(&costs).unwrap() - 0.8).abs() < 0.02, "two beside each other");
        costs[9] *= 0.84;
        assert_eq!(lowest(&costs), None, "two valleys");
        assert_eq!(lowest(&valley(0.1)), None, "it only rises");
        assert_eq!(lowest(&ZOOMS.map(|zoom| 1000.0 + 50.0 * zoom.ln().powi(2))), None, "shallow");
        assert_eq!(lowest(&[f64::INFINITY; ZOOMS.len()]), None);
    }
}
