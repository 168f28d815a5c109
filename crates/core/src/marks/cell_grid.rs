//! Division of a picture into small square cells, with their colours and links.

use super::{
    Evidence,
    appearance::{Appearance, AppearanceFeatures, opponents},
    hints::GuideShares,
    links::Links,
    marked_frame::at_half,
    means::window_means,
    seeds::Seeds,
};
use crate::grid::Mask;
use image::RgbImage;
use rayon::prelude::*;

/// Approximate number of cells of a picture: the distance over which marks spread does not depend on its
/// resolution.
const NUM_CELLS: f32 = 25_600.0;
/// Difference of brightness at which a link weighs e^(−½), and of hue, as [`opponents`] gives them.
const BRIGHTNESS: f32 = 0.041;
const HUE: f32 = 0.033;
/// Difference of the logarithm of depth at which a link, or a cell of the surroundings, weighs e^(−½).
const LOG_DEPTH: f32 = 0.03;
/// Half the side of the surroundings of a cell, in cells.
const AROUND: usize = 2;

/// Seeds of the cells of a picture.
pub(super) struct CellSeeds {
    /// Of all that marks say.
    pub(super) all: Seeds,
    /// The same without pixels of which marks deny some names alone, if there are some.
    pub(super) open: Option<Seeds>,
}

/// Division of a picture into square cells.
#[derive(Debug)]
pub(super) struct CellGrid {
    /// Side of the cells, px.
    pub(super) side: usize,
    width: usize,
    height: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

impl CellGrid {
    /// Divides a picture of this size.
    pub(super) fn of_picture(width: usize, height: usize) -> Self {
        let side = ((width * height) as f32 / NUM_CELLS).sqrt().round().max(1.0) as usize;
        Self { side, width, height, columns: width.div_ceil(side), rows: height.div_ceil(side) }
    }

    /// Returns the cell of pixel `i`.
    pub(super) fn of(&self, i: usize) -> usize {
        i / self.width / self.side * self.columns + i % self.width / self.side
    }

    /// Returns the mean of the pixels of each cell.
    pub(super) fn means(&self, at: impl Fn(usize) -> f32 + Sync) -> Vec<f32> {
        let mut means = vec![0.0; self.columns * self.rows];
        means.par_chunks_mut(self.columns.max(1)).enumerate().for_each(|(row, means)| {
            let ys = row * self.side..((row + 1) * self.side).min(self.height);
            for (column, mean) in means.iter_mut().enumerate() {
                let xs = column * self.side..((column + 1) * self.side).min(self.width);
                let pixels = ys.clone().flat_map(|y| xs.clone().map(move |x| y * self.width + x));
                *mean = pixels.map(&at).sum::<f32>() / (ys.len() * xs.len()) as f32;
            }
        });
        means
    }

    /// Returns the mean of the pixels of each cell in a picture at half size.
    pub(super) fn means_of_half(&self, at: impl Fn(usize) -> f32 + Sync) -> Vec<f32> {
        self.means(|i| at(at_half(i, self.width, [self.width / 2, self.height / 2])))
    }

    /// Returns the share of each cell that lies in the field of view.
    pub(super) fn inside(&self, field_of_view: &Mask) -> Vec<f32> {
        self.means(|i| if field_of_view.data.get(i).is_none_or(|v| *v) { 1.0 } else { 0.0 })
    }

    /// Returns `true` if marks decide the label of more than half of the picture.
    pub(super) fn is_mostly_marked(&self, evidence: &Evidence) -> bool {
        2 * evidence.decided().count() > self.width * self.height
    }

    /// Returns the seeds of evidence and of pixels that marks were propagated to.
    pub(super) fn marked_seeds(
        &self,
        evidence: &Evidence,
        propagated: &[(usize, usize)],
        num_names: usize,
    ) -> CellSeeds {
        let of = |evidence: &Evidence| {
            let mut seeds = self.seeds(evidence, num_names);
            self.add_propagated(&mut seeds, propagated);
            seeds
        };
        CellSeeds { all: of(evidence), open: evidence.without_denials().as_ref().map(of) }
    }

    /// Sums up the evidence of the pixels of each cell.
    fn seeds(&self, evidence: &Evidence, num_names: usize) -> Seeds {
        let zeros = vec![vec![0.0; self.columns * self.rows]; num_names];
        let mut seeds = Seeds { weights: zeros.clone(), shares: zeros };
        for (pixels, verdicts) in evidence.said() {
            for k in 0..num_names {
                let (weight, share) = verdicts.of(k);
                for cell in pixels.clone().map(|i| self.of(i)) {
                    seeds.weights[k][cell] += weight;
                    seeds.shares[k][cell] += weight * share;
                }
            }
        }
        seeds
    }

    /// Adds propagated pixels, each with the name that it shows, to cells where no mark shows any name or
    /// says something of this one.
    fn add_propagated(&self, seeds: &mut Seeds, propagated: &[(usize, usize)]) {
        let is_shown: Vec<bool> =
            (0..self.columns * self.rows).map(|cell| seeds.shares.iter().any(|s| s[cell] > 0.0)).collect();
        let has_evidence: Vec<Vec<bool>> =
            seeds.weights.iter().map(|weights| weights.iter().map(|w| *w > 0.0).collect()).collect();
        for &(i, name) in propagated {
            let cell = self.of(i);
            if !is_shown[cell] && !has_evidence[name][cell] {
                seeds.weights.iter_mut().for_each(|weights| weights[cell] += 1.0);
                seeds.shares[name][cell] += 1.0;
            }
        }
    }

    /// Returns the means of the guides' shares at half size in each cell.
    pub(super) fn guide_shares(&self, guides: &GuideShares) -> GuideShares {
        let means = |(plane, weights): (&Vec<f32>, &Vec<f32>)| -> (Vec<f32>, Vec<f32>) {
            let sums = self.means_of_half(|i| weights[i] * plane[i]);
            let weights = self.means_of_half(|i| weights[i]);
            let share = |(sum, weight): (f32, &f32)| sum / weight.max(f32::MIN_POSITIVE);
            (sums.into_iter().zip(&weights).map(share).collect(), weights)
        };
        let (shares, weights) = guides.shares.par_iter().zip(&guides.weights).map(means).unzip();
        GuideShares { shares, weights }
    }

    /// Returns the mean colours of the cells: red, green, blue, as [`opponents`].
    pub(super) fn colours(&self, picture: &RgbImage) -> Vec<[f32; 3]> {
        let raw = picture.as_raw();
        let [r, g, b] = [0, 1, 2].map(|c| self.means(|i| f32::from(raw[3 * i + c]) / 255.0));
        (0..r.len()).map(|i| opponents([r[i], g[i], b[i]].map(f32::sqrt))).collect()
    }

    /// Returns the mean logarithms of depth of the cells, from those of the pixels at half size, less their mean
    /// over the picture; NaN where it is not known.
    pub(super) fn log_depths(&self, pixels: &[f32]) -> Vec<f32> {
        let mut logarithms = self.means_of_half(|i| pixels[i]);
        let known = logarithms.iter().filter(|v| v.is_finite());
        let (sum, count) = known.fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
        let mean = sum / count.max(1) as f32;
        logarithms.iter_mut().for_each(|v| *v = if v.is_finite() { *v - mean } else { f32::NAN });
        logarithms
    }

    /// Returns the features of the appearance of the cells. Depths count if they are given.
    pub(super) fn appearance(&self, colours: &[[f32; 3]], log_depths: Option<&[f32]>) -> AppearanceFeatures {
        // Colour, and the square of the brightness.
        let values = |[light, red, yellow]: &[f32; 3]| [*light, *red, *yellow, light * light];
        let values: Vec<[f32; 4]> = colours.iter().map(values).collect();
        let around = match log_depths {
            Some(depths) => self.means_about_as_deep(&values, depths),
            None => self.means_around(&values),
        };
        let of_cell = |i: usize| Appearance {
            colour: colours[i],
            around: [0, 1, 2].map(|c| around[i][c]),
            roughness: (around[i][3] - around[i][0] * around[i][0]).max(0.0).sqrt(),
            position: [i % self.columns, i / self.columns]
                .map(|at| (at * self.side) as f32 / self.width as f32),
            log_depth: log_depths.map(|depths| depths[i]).filter(|depth| depth.is_finite()).unwrap_or(0.0),
        };
        AppearanceFeatures::new((0..colours.len()).map(of_cell))
    }

    /// Returns the means over the surroundings of each cell.
    fn means_around<const N: usize>(&self, values: &[[f32; N]]) -> Vec<[f32; N]> {
        let plane = |c: usize| values.iter().map(|value| value[c]).collect::<Vec<f32>>();
        let means: [Vec<f32>; N] =
            std::array::from_fn(|c| window_means(&plane(c), [self.columns, self.rows], AROUND));
        (0..values.len()).map(|i| std::array::from_fn(|c| means[c][i])).collect()
    }

    /// Returns the means over the surroundings of each cell, of what is about as deep: beside a tool, what lies
    /// behind it has surroundings of its own.
    fn means_about_as_deep<const N: usize>(&self, values: &[[f32; N]], log_depths: &[f32]) -> Vec<[f32; N]> {
        let mean = |cell: usize| {
            let (x, y) = (cell % self.columns, cell / self.columns);
            let (mut sums, mut weights) = ([0.0; N], 0.0);
            for row in y.saturating_sub(AROUND)..(y + AROUND + 1).min(self.rows) {
                for column in x.saturating_sub(AROUND)..(x + AROUND + 1).min(self.columns) {
                    let other = row * self.columns + column;
                    let weight = (-0.5 * depths_apart(log_depths, cell, other).powi(2)).exp();
                    (0..N).for_each(|c| sums[c] += weight * values[other][c]);
                    weights += weight;
                }
            }
            sums.map(|sum| sum / weights)
        };
        (0..values.len()).into_par_iter().with_min_len(1024).map(mean).collect()
    }

    /// Links each cell in the field of view with those of the eight around it that lie there, too, by their
    /// colours and, where they are known, their depths.
    pub(super) fn links(
        &self,
        colours: &[[f32; 3]],
        log_depths: Option<&[f32]>,
        field_of_view: &Mask,
    ) -> Links {
        let inside = self.inside(field_of_view);
        let link = |cell: usize, (dx, dy): (isize, usize)| {
            let x = (cell % self.columns).checked_add_signed(dx).filter(|x| *x < self.columns)?;
            let y = Some(cell / self.columns + dy).filter(|y| *y < self.rows)?;
            let other = y * self.columns + x;
            let [light, red, yellow]: [f32; 3] =
                std::array::from_fn(|c| colours[cell][c] - colours[other][c]);
            let farther = log_depths.map_or(0.0, |depths| depths_apart(depths, cell, other));
            let difference_2 =
                (light / BRIGHTNESS).powi(2) + (red / HUE).powi(2) + (yellow / HUE).powi(2) + farther.powi(2);
            let length = ((dx * dx) as f32 + (dy * dy) as f32).sqrt();
            let weight = (-0.5 * difference_2).exp() / length;
            (inside[cell] > 0.5 && inside[other] > 0.5).then_some((cell as u32, other as u32, weight))
        };
        let steps = [(1, 0), (0, 1), (1, 1), (-1, 1)];
        let each =
            (0..inside.len()).flat_map(|cell| steps.into_iter().filter_map(move |step| link(cell, step)));
        Links::new(inside.len(), each.collect::<Vec<_>>().into_iter())
    }

    /// Interpolates values of cells at every pixel of half size.
    pub(super) fn at_half(&self, values: &[f32]) -> Vec<f32> {
        let [width, height] = [self.width / 2, self.height / 2];
        let place = |at: usize, cells: usize| {
            let at = ((at as f32 + 0.5) * 2.0 / self.side as f32 - 0.5).clamp(0.0, (cells - 1) as f32);
            let low = at as usize;
            (low, (low + 1).min(cells - 1), at - low as f32)
        };
        let places: Vec<_> = (0..width).map(|x| place(x, self.columns)).collect();
        let mut out = Vec::with_capacity(width * height);
        for y in 0..height {
            let (top, bottom, down) = place(y, self.rows);
            let [top, bottom] = [top, bottom].map(|y| &values[y * self.columns..(y + 1) * self.columns]);
            let value = |&(left, right, across): &(usize, usize, f32)| {
                let [top, bottom] = [top, bottom].map(|row| row[left] + across * (row[right] - row[left]));
                (top + down * (bottom - top)).clamp(0.0, 1.0)
            };
            out.extend(places.iter().map(value));
        }
        out
    }
}

/// Returns how much deeper a cell is than another, in units of [`LOG_DEPTH`]; 0 where that is not known.
fn depths_apart(log_depths: &[f32], cell: usize, other: usize) -> f32 {
    let farther = (log_depths[cell] - log_depths[other]) / LOG_DEPTH;
    if farther.is_nan() { 0.0 } else { farther }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_grow_with_the_picture() {
        let side = |size: [usize; 2]| CellGrid::of_picture(size[0], size[1]).side;
        let sizes = [[40, 20], [320, 256], [427, 240], [640, 512], [854, 480], [1280, 720], [1920, 1080]];
        assert_eq!(sizes.map(side), [1, 2, 2, 4, 4, 6, 9]);
    }

    #[test]
    fn surroundings_are_about_as_deep() {
        let grid = CellGrid::of_picture(40, 20);
        // A bright tool on the left lies before dark tissue.
        let values: Vec<[f32; 1]> = (0..800).map(|i| if i % 40 < 20 { [1.0] } else { [0.0] }).collect();
        let beside = |depth_of_tissue: f32| {
            let depths: Vec<f32> =
                (0..800).map(|i| if i % 40 < 20 { 0.0 } else { depth_of_tissue }).collect();
            let means = grid.means_about_as_deep(&values, &depths);
            [means[10 * 40 + 19][0], means[10 * 40 + 20][0]]
        };
        assert_eq!(beside(1.0), [1.0, 0.0]);
        for depth in [0.0, f32::NAN] {
            let [tool, tissue] = beside(depth);
            assert!((tool - 0.6).abs() < 1e-3 && (tissue - 0.4).abs() < 1e-3, "{tool} {tissue}");
        }
    }
}
