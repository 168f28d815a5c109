//! Squares of pictures that are found in other pictures (Lucas and Kanade 1981; Baker and Matthews 2004,
//! "inverse compositional").

use crate::{
    flow::{around, halved},
    grid::{Grid, Mask},
};
use glam::{Mat2, Vec2};

/// Half the side of a patch, px.
const REACH: i32 = 6;
/// Number of pixels of a patch.
const AREA: usize = ((2 * REACH + 1) * (2 * REACH + 1)) as usize;
/// Level from which a pixel is glare.
const GLARE: f32 = 245.0;
/// Largest distance of a patch's position from where it is first looked for, px.
const LARGEST_MENDING: f32 = 2.0;
/// Distance from where a lost patch is expected up to which it is looked for, px along each axis.
const LARGEST_DISTANCE: i32 = 4;
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

/// Returns `true` if a patch at `at` lies in the picture, and its middle in the mask.
pub(super) fn is_inside(view: &View, at: [f32; 2]) -> bool {
    let [x, y] = at.map(|v| v.round() as i32);
    let (width, height) = (view.luma.width as i32, view.luma.height as i32);
    let fits = x > REACH && y > REACH && x + REACH + 1 < width && y + REACH + 1 < height;
    fits && view.mask.at(x as usize, y as usize)
}

fn level(image: &Grid<f32>, at: Vec2) -> f32 {
    let (offsets, shares) = around(image.width, image.height, at.to_array());
    (0..4).map(|k| shares[k] * image.data[offsets[k]]).sum()
}

/// A square of a picture, ready to be found in another one.
pub(super) struct Patch {
    /// Levels, mean 0 and length 1.
    levels: [f32; AREA],
    /// Slopes of these along x and y.
    slopes: [[f32; 2]; AREA],
    /// Inverse of the 2×2 matrix of the slopes' products: xx, xy, yy.
    inverse: [f32; 3],
    /// Smaller eigenvalue of that matrix, levels²/px² per pixel.
    pub strength: f32,
}

/// Offsets of a patch's pixels from its middle.
fn offsets() -> impl Iterator<Item = (f32, f32)> {
    (-REACH..=REACH).flat_map(|y| (-REACH..=REACH).map(move |x| (x as f32, y as f32)))
}

impl Patch {
    /// Cuts a patch; `None` if it leaves the picture or the mask, shows glare, or has no structure.
    pub(super) fn cut(view: &View, at: [f32; 2]) -> Option<Self> {
        if is_inside(view, at) { Self::warped(view, at, Mat2::IDENTITY) } else { None }
    }

    /// Cuts a patch as another camera sees it: `warp` leads from offsets in its picture to those in `view`.
    pub(super) fn warped(view: &View, at: [f32; 2], warp: Mat2) -> Option<Self> {
        let place = |x: f32, y: f32| Vec2::from(at) + warp * Vec2::new(x, y);
        let is_seen = |(x, y): (i32, i32)| {
            let [u, v] = place(x as f32, y as f32).round().to_array();
            let is_in_picture = u >= 0.0 && v >= 0.0;
            let (u, v) = (u as usize, v as usize);
            is_in_picture && u < view.mask.width && v < view.mask.height && view.mask.at(u, v)
        };
        if ![(-REACH, -REACH), (REACH, -REACH), (-REACH, REACH), (REACH, REACH)].into_iter().all(is_seen) {
            return None;
        }
        let here = |x: f32, y: f32| level(&view.luma, place(x, y));
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
    pub(super) fn found(&self, image: &Grid<f32>, start: [f32; 2]) -> Option<([f32; 2], f32)> {
        let mut at = start;
        let mut likeness = 0.0;
        for _ in 0..STEPS {
            let mut seen = [0.0; AREA];
            offsets()
                .zip(&mut seen)
                .for_each(|((x, y), s)| *s = level(image, Vec2::new(at[0] + x, at[1] + y)));
            normalise(&mut seen)?;
            likeness = self.likeness(&seen);
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

    /// Finds the patch up to [`LARGEST_DISTANCE`] from `start`. Returns its position and likeness, at most 1;
    /// `None` if it runs away.
    pub(super) fn found_around(&self, image: &Grid<f32>, start: [f32; 2]) -> Option<([f32; 2], f32)> {
        let middle = start.map(|v| v.round() as i32);
        let clamped = |v: i32, length: usize| v.clamp(0, length as i32 - 1) as usize;
        let mut best = (f32::MIN, start);
        // Every second pixel is enough: `found` goes on from the best one.
        let steps = || (-LARGEST_DISTANCE..=LARGEST_DISTANCE).step_by(2);
        for (x, y) in steps().flat_map(|dy| steps().map(move |dx| (middle[0] + dx, middle[1] + dy))) {
            let mut seen = [0.0; AREA];
            offsets().zip(&mut seen).for_each(|((dx, dy), s)| {
                let [u, v] = [clamped(x + dx as i32, image.width), clamped(y + dy as i32, image.height)];
                *s = image.at(u, v);
            });
            let likeness = normalise(&mut seen).map_or(f32::MIN, |_| self.likeness(&seen));
            if likeness > best.0 {
                best = (likeness, [x as f32, y as f32]);
            }
        }
        self.found(image, best.1)
    }

    /// Correlation with a normalised square.
    fn likeness(&self, seen: &[f32; AREA]) -> f32 {
        seen.iter().zip(&self.levels).map(|(a, b)| a * b).sum()
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
