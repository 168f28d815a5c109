//! Points followed through the frames. Optical flow between neighbouring frames, of half size, tells where a
//! point goes; a patch around it, kept from the frame where it was found, then finds its exact position
//! (Lucas and Kanade 1981; Baker and Matthews 2004, "inverse compositional"). So errors do not add up.

use crate::{
    flow::{Vector, around, halved, optical_flow},
    grid::{Grid, Mask},
};
use rayon::prelude::*;

/// Half the side of a patch, px.
const REACH: i32 = 6;
/// Number of pixels of a patch.
const AREA: usize = ((2 * REACH + 1) * (2 * REACH + 1)) as usize;
/// Number of cells of what is in view, each of which has one point.
const CELLS: f32 = 700.0;
/// Mean squared slope, levels²/px², that a patch has in every direction.
const LEAST_SLOPE: f32 = 1.0;
/// Level from which a pixel is glare.
const GLARE: f32 = 245.0;
/// Largest distance to where a point came from after following it forth and back, px.
const LARGEST_RETURN: f32 = 1.5;
/// Largest distance of the patch's position from the flow's, px.
const LARGEST_MENDING: f32 = 2.0;
/// Likeness (correlation) of patches, from which a position is taken; and from which the patch is kept.
const ALIKE: f32 = 0.6;
const VERY_ALIKE: f32 = 0.85;
/// Share of the points that are found again at least, unless almost all are lost; and how many tell that.
const LEAST_FOUND: f32 = 0.1;
const FEWEST: usize = 30;
/// Largest number of steps to find a patch.
const STEPS: usize = 12;

/// A frame to be looked at.
pub(super) struct View {
    /// Luminance in 8-bit levels.
    pub luma: Grid<f32>,
    /// Pixels that points may lie in: `true` = yes.
    pub mask: Mask,
}

impl View {
    /// Returns the frame at half its size: a pixel is in the mask where all four are.
    pub(super) fn halved(&self) -> Self {
        let (width, height) = (self.mask.width / 2, self.mask.height / 2);
        let all = |k: usize| {
            let (x, y) = (2 * (k % width), 2 * (k / width));
            let is_in = |x, y| self.mask.at(x, y);
            is_in(x, y) && is_in(x + 1, y) && is_in(x, y + 1) && is_in(x + 1, y + 1)
        };
        let mask = Grid::from_vec(width, height, (0..width * height).map(all).collect());
        Self { luma: halved(&self.luma), mask }
    }
}

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

/// Returns `true` if a patch at `at` lies in the picture, and its middle in the mask.
fn is_inside(view: &View, at: [f32; 2]) -> bool {
    let [x, y] = at.map(|v| v.round() as i32);
    let (width, height) = (view.luma.width as i32, view.luma.height as i32);
    let fits = x > REACH && y > REACH && x + REACH + 1 < width && y + REACH + 1 < height;
    fits && view.mask.at(x as usize, y as usize)
}

fn level(image: &Grid<f32>, x: f32, y: f32) -> f32 {
    let (offsets, shares) = around(image.width, image.height, [x, y]);
    (0..4).map(|k| shares[k] * image.data[offsets[k]]).sum()
}

/// A square of a picture, ready to be found in another one.
struct Patch {
    /// Levels, mean 0 and length 1.
    levels: [f32; AREA],
    /// Slopes of these along x and y.
    slopes: [[f32; 2]; AREA],
    /// Inverse of the 2×2 matrix of the slopes' products: xx, xy, yy.
    inverse: [f32; 3],
    /// Smaller eigenvalue of that matrix, levels²/px² per pixel.
    strength: f32,
}

/// Offsets of a patch's pixels from its middle.
fn offsets() -> impl Iterator<Item = (f32, f32)> {
    (-REACH..=REACH).flat_map(|y| (-REACH..=REACH).map(move |x| (x as f32, y as f32)))
}

impl Patch {
    /// Cuts a patch; `None` if it leaves the picture or the mask, shows glare, or has no structure.
    fn cut(view: &View, at: [f32; 2]) -> Option<Self> {
        if !is_inside(view, at) {
            return None;
        }
        let corners = [(-REACH, -REACH), (REACH, -REACH), (-REACH, REACH), (REACH, REACH)];
        let kept = |(x, y): &(i32, i32)| {
            let [u, v] = [at[0].round() as i32 + x, at[1].round() as i32 + y];
            view.mask.at(u as usize, v as usize)
        };
        if !corners.iter().all(kept) {
            return None;
        }
        let here = |x: f32, y: f32| level(&view.luma, at[0] + x, at[1] + y);
        let mut levels = [0.0; AREA];
        let mut slopes = [[0.0; 2]; AREA];
        for (k, (x, y)) in offsets().enumerate() {
            levels[k] = here(x, y);
            slopes[k] =
                [0.5 * (here(x + 1.0, y) - here(x - 1.0, y)), 0.5 * (here(x, y + 1.0) - here(x, y - 1.0))];
        }
        if levels.iter().any(|l| *l >= GLARE) {
            return None;
        }
        let product = |a: usize, b: usize| slopes.iter().map(|s| s[a] * s[b]).sum::<f32>();
        let [xx, xy, yy] = [product(0, 0), product(0, 1), product(1, 1)];
        let strength = (0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt()) / AREA as f32;
        let length = normalise(&mut levels)?;
        slopes.iter_mut().flatten().for_each(|s| *s /= length);
        let determinant = (xx * yy - xy * xy) / (length * length);
        (determinant > 0.0).then(|| Self {
            levels,
            slopes,
            inverse: [yy / determinant, -xy / determinant, xx / determinant],
            strength,
        })
    }

    /// Finds the patch near `start`. Returns its position and likeness, at most 1; `None` if it runs away.
    fn found(&self, image: &Grid<f32>, start: [f32; 2]) -> Option<([f32; 2], f32)> {
        let mut at = start;
        let mut likeness = 0.0;
        for _ in 0..STEPS {
            let mut seen = [0.0; AREA];
            offsets().zip(&mut seen).for_each(|((x, y), s)| *s = level(image, at[0] + x, at[1] + y));
            normalise(&mut seen)?;
            likeness = seen.iter().zip(&self.levels).map(|(a, b)| a * b).sum();
            let mut pull = [0.0f32; 2];
            for ((seen, own), slope) in seen.iter().zip(&self.levels).zip(&self.slopes) {
                (0..2).for_each(|k| pull[k] += (seen - own) * slope[k]);
            }
            let [xx, xy, yy] = self.inverse;
            // The matrix is that of slopes divided by the length twice, and `pull` too.
            let step = [xx * pull[0] + xy * pull[1], xy * pull[0] + yy * pull[1]];
            at = [at[0] - step[0], at[1] - step[1]];
            if (at[0] - start[0]).hypot(at[1] - start[1]) > LARGEST_MENDING {
                return None;
            }
            if step[0].hypot(step[1]) < 0.01 {
                break;
            }
        }
        Some((at, likeness))
    }
}

/// Subtracts the mean and divides by the length, which is returned; `None` if there is none.
fn normalise(levels: &mut [f32; AREA]) -> Option<f32> {
    let mean = levels.iter().sum::<f32>() / AREA as f32;
    levels.iter_mut().for_each(|l| *l -= mean);
    let length = levels.iter().map(|l| l * l).sum::<f32>().sqrt();
    levels.iter_mut().for_each(|l| *l /= length);
    (length > 1e-3).then_some(length)
}
