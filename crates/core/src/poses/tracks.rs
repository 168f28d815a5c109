//! Points followed through the frames. Optical flow between neighbouring frames, of half size, tells where a
//! point goes; a [`Patch`] around it, kept from the frame where it was found, then finds its exact position.
//! So errors do not add up.

use super::patch::{Patch, View, is_inside};
use crate::{
    flow::{Vector, around, halved, optical_flow},
    grid::Grid,
};
use rayon::prelude::*;

/// Number of cells of what is in view, each of which has one point.
const CELLS: f32 = 700.0;
/// Mean squared slope, levels²/px², that a patch has in every direction.
pub(super) const LEAST_SLOPE: f32 = 1.0;
/// Largest distance to where a point came from after following it forth and back, px.
const LARGEST_RETURN: f32 = 1.5;
/// Likeness (correlation) of patches, from which a position is taken; and from which the patch is kept.
const ALIKE: f32 = 0.6;
pub(super) const VERY_ALIKE: f32 = 0.85;
/// Share of the points that are found again at least, unless almost all are lost; and how many tell that.
const LEAST_FOUND: f32 = 0.1;
const FEWEST: usize = 30;

/// A followed point: (number of the frame, position in px, whole numbers at pixel centres), in the order of
/// frames.
pub(super) type Track = Vec<(usize, [f32; 2])>;

/// A point that is being followed.
struct Live {
    track: Track,
    patch: Patch,
    at: [f32; 2],
}

/// Points that are followed, as they were found in a view.
pub(super) struct Found {
    view: View,
    half: Grid<f32>,
    /// Position of each point, and its new patch if the old one has become unlike; `None` if it is lost.
    moved: Vec<Option<([f32; 2], Option<Patch>)>>,
}

impl Found {
    /// Returns the view at half its size.
    pub(super) fn halved_view(&self) -> View {
        self.view.halved()
    }

    /// Returns `true` if almost all points are lost.
    pub(super) fn is_lost(&self) -> bool {
        let num_found = self.moved.iter().flatten().count();
        self.moved.len() >= FEWEST && (num_found as f32) < LEAST_FOUND * self.moved.len() as f32
    }
}

/// Follows points from view to view.
#[derive(Default)]
pub(super) struct Follower {
    live: Vec<Live>,
    ended: Vec<Track>,
    last: Option<(View, Grid<f32>)>,
}

impl Follower {
    /// Looks for the points that are followed in a view; all views have one size. A cut ends all tracks by
    /// itself, as nothing is found again.
    pub(super) fn found_in(&self, view: View) -> Found {
        let half = halved(&view.luma);
        let last =
            self.last.as_ref().filter(|(_, last)| (last.width, last.height) == (half.width, half.height));
        let moved = match last {
            Some((last, last_half)) => {
                let (forth, back) =
                    rayon::join(|| optical_flow(last_half, &half), || optical_flow(&half, last_half));
                self.live.par_iter().map(|live| follow(live, last, &view, &forth, &back)).collect()
            }
            None => self.live.iter().map(|_| None).collect(),
        };
        Found { view, half, moved }
    }

    /// Goes on from a view, frame `index`, with what was found in it.
    pub(super) fn take(&mut self, index: usize, Found { view, half, moved }: Found) {
        for (mut live, moved) in std::mem::take(&mut self.live).into_iter().zip(moved) {
            match moved {
                Some((at, patch)) => {
                    live.track.push((index, at));
                    live.at = at;
                    live.patch = patch.unwrap_or(live.patch);
                    self.live.push(live);
                }
                None => self.ended.push(live.track),
            }
        }
        self.seed(index, &view);
        self.last = Some((view, half));
    }

    /// Returns all tracks of at least `shortest` frames.
    pub(super) fn finish(mut self, shortest: usize) -> Vec<Track> {
        self.ended.extend(self.live.into_iter().map(|live| live.track));
        self.ended.retain(|track| track.len() >= shortest);
        // The order of points does not depend on when they ended.
        self.ended.sort_by(|a, b| {
            (a[0].0, a[0].1[1], a[0].1[0])
                .partial_cmp(&(b[0].0, b[0].1[1], b[0].1[0]))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        self.ended
    }

    /// Starts a point in every cell without one, where the patch can be found best.
    fn seed(&mut self, index: usize, view: &View) {
        let (width, height) = (view.luma.width, view.luma.height);
        let side = (view.mask.count() as f32 / CELLS).sqrt().max(8.0);
        let columns = (width as f32 / side).ceil() as usize;
        let rows = (height as f32 / side).ceil() as usize;
        let mut taken = vec![false; columns * rows];
        for live in &self.live {
            let [x, y] = live.at.map(|v| (v.max(0.0) / side) as usize);
            taken[y.min(rows - 1) * columns + x.min(columns - 1)] = true;
        }
        let best = |cell: usize| {
            let [left, top] = [cell % columns, cell / columns].map(|k| k as f32 * side);
            let positions = (0..16).map(|k| {
                [left + side * ((k % 4) as f32 + 0.5) / 4.0, top + side * ((k / 4) as f32 + 0.5) / 4.0]
            });
            let candidates =
                positions.map(|at| at.map(|v| v.floor())).filter_map(|at| Some((Patch::cut(view, at)?, at)));
            candidates.max_by(|a, b| a.0.strength.total_cmp(&b.0.strength))
        };
        let found: Vec<Option<(Patch, [f32; 2])>> = (0..columns * rows)
            .into_par_iter()
            .map(|cell| if taken[cell] { None } else { best(cell) })
            .collect();
        self.live.extend(
            found.into_iter().flatten().filter(|(p, _)| p.strength >= LEAST_SLOPE).map(|(patch, at)| Live {
                track: vec![(index, at)],
                patch,
                at,
            }),
        );
    }
}

/// Returns where a point went, and its new patch if the old one has become unlike; `None` if it is lost.
fn follow(
    live: &Live,
    last: &View,
    view: &View,
    forth: &Grid<Vector>,
    back: &Grid<Vector>,
) -> Option<([f32; 2], Option<Patch>)> {
    let there = carried(forth, live.at);
    let home = carried(back, there);
    let returns = (home[0] - live.at[0]).hypot(home[1] - live.at[1]) <= LARGEST_RETURN;
    if let Some((at, likeness)) = live.patch.found(&view.luma, there)
        && likeness >= ALIKE
        && is_inside(view, at)
    {
        let renewed = if likeness >= VERY_ALIKE { None } else { Some(Patch::cut(view, at)?) };
        return Some((at, renewed));
    }
    // The patch has changed too much: the one of the frame before is tried.
    let (at, likeness) = Patch::cut(last, live.at)?.found(&view.luma, there)?;
    (returns && likeness >= VERY_ALIKE && is_inside(view, at))
        .then(|| Some((at, Some(Patch::cut(view, at)?))))?
}

/// Returns a position after a flow between pictures of half the size.
fn carried(flow: &Grid<Vector>, at: [f32; 2]) -> [f32; 2] {
    let (offsets, shares) = around(flow.width, flow.height, at.map(|v| v / 2.0 - 0.25));
    std::array::from_fn(|k| at[k] + 2.0 * (0..4).map(|i| shares[i] * flow.data[offsets[i]][k]).sum::<f32>())
}
