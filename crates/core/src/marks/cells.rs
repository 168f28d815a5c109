//! Picture of a marked frame as a grid of small cells, which marks are spread over: cells follow the borders
//! of the picture better than Gaussians do.

use super::{
    Evidence,
    appearance::{Appearance, AppearanceFeatures, Prediction, Unlabelled, opponents},
    carried::scale_beside_denied,
    hints::{GuideShares, Hints},
    links::Links,
    marked_frame::at_half,
    means::window_means,
    seeds::Seeds,
    spread::{Before, PULL, spread},
};
use crate::{camera::Camera, grid::Mask};
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
/// Rounds in which a few marks are spread.
const ROUNDS: usize = 2;
/// Share of a name above which a cell of an example shows it.
const MIN_SHOWN_SHARE: f32 = 0.7;
/// Variance of the label of an example's cell that shows no name.
const UNLABELLED_VARIANCE: f64 = 0.1;
/// Score above which a cell matches an example, and below which it shows something else.
const MIN_POSITIVE: f32 = 0.6;
const MAX_NEGATIVE: f32 = 0.3;
/// Part of a picture that has to look like something in an example for both to show the same place.
const MIN_FAMILIAR_PART: f32 = 0.6;
/// Brightness, as [`opponents`] gives it, above which a cell is not black.
const MIN_BRIGHTNESS: f32 = 0.15;
/// Power of the mean share that a share is multiplied by.
const AREA_POWER: f32 = 0.2;

/// A frame that marks are spread over.
pub(super) struct MarkedPicture<'a> {
    pub(super) picture: &'a RgbImage,
    pub(super) field_of_view: &'a Mask,
    /// Depth at half size, rounded down, in any unit; NaN where there is none. `None` if none was measured.
    pub(super) depth: Option<&'a [f32]>,
}

/// The cells of a picture, with the features of their appearance.
#[derive(Debug)]
pub(super) struct CellFeatures {
    grid: CellGrid,
    appearance: AppearanceFeatures,
}

impl CellFeatures {
    /// Returns the side of the cells of a camera's pictures, px.
    pub(super) fn side_of(camera: &Camera) -> usize {
        CellGrid::of_picture(camera.width as usize, camera.height as usize).side
    }

    /// Divides a picture into cells, and computes their features.
    pub(super) fn of(picture: &RgbImage) -> Self {
        let grid = CellGrid::of_picture(picture.width() as usize, picture.height() as usize);
        let appearance = grid.appearance(&grid.colours(picture), None);
        Self { grid, appearance }
    }

    /// Returns the cells inside the field of view that are not black.
    fn not_black(&self, field_of_view: &Mask) -> Vec<usize> {
        let inside = self.grid.inside(field_of_view);
        let is_bright = |i: usize| self.appearance.brightness(i) > MIN_BRIGHTNESS;
        (0..inside.len()).filter(|i| inside[*i] > 0.5 && is_bright(*i)).collect()
    }

    /// Returns the likeness of the cell of a pixel and that of a pixel of another picture, 0–1. Positions do
    /// not count.
    pub(super) fn likeness(&self, pixel: usize, other: &Self, other_pixel: usize) -> f32 {
        let [cell, other_cell] = [self.grid.of(pixel), other.grid.of(other_pixel)];
        self.appearance.likeness(cell, &other.appearance, other_cell)
    }
}

/// Spreads the marks of a frame over its picture: shares of each name, [names][pixels] at half size, rounded
/// down. `propagated` are pixels of the picture that marks of other frames were propagated to, each with its
/// name; `guides` are the shares of the guides at half size.
pub(super) fn spread_over(
    frame: &MarkedPicture<'_>,
    evidence: &Evidence,
    propagated: &[(usize, usize)],
    num_names: usize,
    guides: Option<GuideShares>,
) -> Vec<Vec<f32>> {
    let (width, height) = (frame.picture.width() as usize, frame.picture.height() as usize);
    let grid = CellGrid::of_picture(width, height);
    let seeds = grid.marked_seeds(evidence, propagated, num_names);
    let colours = grid.colours(frame.picture);
    let log_depths = frame.depth.map(|depth| grid.log_depths(depth));
    let links = grid.links(&colours, log_depths.as_deref(), frame.field_of_view);
    let guides = guides.map(|guides| grid.guide_shares(&guides));
    let shares = if grid.is_mostly_marked(evidence) {
        let hints = guides.as_ref().map(Hints::from_guides);
        walk(&links, &seeds, Before::Nothing, hints.as_ref(), <[_]>::to_vec).1
    } else {
        let appearance = grid.appearance(&colours, log_depths.as_deref());
        spread_in_rounds(&appearance, &links, &seeds, guides.as_ref())
    };
    shares[..num_names].par_iter().map(|share| grid.at_half(share)).collect()
}

/// Seeds of the cells of a picture.
struct CellSeeds {
    /// Of all that marks say.
    all: Seeds,
    /// The same without pixels of which marks deny some names alone, if there are some.
    open: Option<Seeds>,
}

/// A marked picture as an example, with the cells that show each name.
#[derive(Debug)]
pub(super) struct Example {
    cells: CellFeatures,
    /// Cells that clearly show each name, and those that show none.
    shown: Vec<Vec<usize>>,
    unlabelled: Vec<usize>,
    /// Cells that are not black: all of them together, as one class.
    not_black: [Vec<usize>; 1],
}

/// Cells of a picture that look like those of a name in an example, and cells that look like something else
/// in it.
#[derive(Clone, Debug)]
pub(super) struct Match {
    pub(super) positive: Mask,
    pub(super) negative: Mask,
}

impl Example {
    /// Spreads the marks of a frame over its picture.
    pub(super) fn of(
        picture: &RgbImage,
        field_of_view: &Mask,
        evidence: &Evidence,
        num_names: usize,
    ) -> Self {
        let cells = CellFeatures::of(picture);
        let CellFeatures { grid, appearance } = &cells;
        let seeds = grid.marked_seeds(evidence, &[], num_names);
        let links = grid.links(&grid.colours(picture), None, field_of_view);
        let mut shares = spread_in_rounds(appearance, &links, &seeds, None);
        shares.truncate(num_names);
        let inside = || (0..links.len()).filter(|i| links.degrees[*i] > 0.0);
        let shows = |plane: &Vec<f32>| inside().filter(|i| plane[*i] > MIN_SHOWN_SHARE).collect();
        let shown = shares.iter().map(shows).collect();
        let is_unlabelled = |i: &usize| shares.iter().map(|plane| plane[*i]).sum::<f32>() < MIN_SHOWN_SHARE;
        let unlabelled = inside().filter(is_unlabelled).collect();
        let not_black = [cells.not_black(field_of_view)];
        Self { cells, shown, unlabelled, not_black }
    }

    /// Compares a picture of the same size with the example. Returns the match of each name; `None` if the
    /// picture shows another place.
    pub(super) fn match_picture(&self, picture: &CellFeatures, field_of_view: &Mask) -> Option<Vec<Match>> {
        let (own, others) = (&self.cells.appearance, &picture.appearance);
        let none = Unlabelled { nodes: &[], variance: UNLABELLED_VARIANCE };
        let familiar = own.predict_for(others, &self.not_black, &[], none).nearness;
        let not_black = picture.not_black(field_of_view);
        let is_familiar = |i: usize| familiar[i] > MIN_POSITIVE;
        let num_familiar = not_black.iter().filter(|i| is_familiar(**i)).count();
        if num_familiar as f32 <= MIN_FAMILIAR_PART * not_black.len() as f32 {
            return None;
        }
        let unlabelled = Unlabelled { nodes: &self.unlabelled, variance: UNLABELLED_VARIANCE };
        let Prediction { score, nearness } = own.predict_for(others, &self.shown, &[], unlabelled);
        let mask = |is_so: &dyn Fn(usize) -> bool| {
            let mut mask = Mask::filled(picture.grid.columns, picture.grid.rows, false);
            not_black.iter().filter(|i| is_so(**i)).for_each(|i| mask.data[*i] = true);
            mask
        };
        let match_of = |score: &Vec<f32>| Match {
            positive: mask(&|i| score[i].min(nearness[i]) > MIN_POSITIVE),
            negative: mask(&|i| is_familiar(i) && score[i].min(nearness[i]) < MAX_NEGATIVE),
        };
        Some(score.iter().map(match_of).collect())
    }

    /// Compares the example with itself; `None` if it is black.
    pub(super) fn match_itself(&self, field_of_view: &Mask) -> Option<Vec<Match>> {
        self.match_picture(&self.cells, field_of_view)
    }

    /// Returns the area of a name, px.
    pub(super) fn area_px(&self, name: usize) -> usize {
        self.shown[name].len() * self.cells.grid.side.pow(2)
    }
}

/// Spreads marks in rounds: cells that clearly belong to a name are examples of its appearance in the next
/// one. Returns what [`walk`] does.
fn spread_in_rounds(
    appearance: &AppearanceFeatures,
    links: &Links,
    seeds: &CellSeeds,
    guides: Option<&GuideShares>,
) -> Vec<Vec<f32>> {
    let (mut walked, mut shares) = (Vec::new(), Vec::new());
    for round in 0..ROUNDS {
        let hints = Hints::of(appearance, links, &seeds.all, &shares);
        let hints = guides.into_iter().fold(hints, Hints::with_guides);
        let before = if round == 0 { Before::Nothing } else { Before::Nearly(&walked) };
        (walked, shares) = walk(links, seeds, before, Some(&hints), weighed_by_area);
    }
    shares
}

/// Walks from the seeds. A denial changes the shares of the denied name alone: it is walked for by itself.
/// Returns the shares without denials, from which the next walk may start, and the shares with them, which
/// `weigh` weighs. The latter have one more plane if names are denied: see [`take_denied`].
fn walk(
    links: &Links,
    seeds: &CellSeeds,
    before: Before<'_>,
    hints: Option<&Hints>,
    weigh: impl Fn(&[Vec<f32>]) -> Vec<Vec<f32>>,
) -> (Vec<Vec<f32>>, Vec<Vec<f32>>) {
    let open = spread(links, seeds.open.as_ref().unwrap_or(&seeds.all), before, PULL, hints);
    let mut shares = weigh(&open);
    if seeds.open.is_some() {
        let denied = spread(links, &seeds.all, Before::Nearly(&open), PULL, hints);
        let lost = take_denied(&mut shares, &open, &denied);
        shares.push(lost);
    }
    (open, shares)
}

/// Takes from each name what marks deny: the part by which its share is smaller in a walk with denials,
/// `denied`, than in one without, `open`. Returns what was taken from each cell that the other names have
/// more of: such a cell shows one of them, not nothing.
fn take_denied(shares: &mut [Vec<f32>], open: &[Vec<f32>], denied: &[Vec<f32>]) -> Vec<f32> {
    let mut lost = vec![0.0; shares.first().map_or(0, Vec::len)];
    for (i, lost) in lost.iter_mut().enumerate() {
        let before: f32 = shares.iter().map(|plane| plane[i]).sum();
        for (share, (open, denied)) in shares.iter_mut().zip(open.iter().zip(denied)) {
            share[i] *= (denied[i] / open[i].max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        }
        let kept: f32 = shares.iter().map(|plane| plane[i]).sum();
        let scale = scale_beside_denied(kept, before - kept);
        shares.iter_mut().for_each(|plane| plane[i] *= scale);
        *lost = if kept > before - kept { (before - kept) * scale } else { 0.0 };
    }
    lost
}

/// Multiplies shares by a power of their mean, and keeps their sums: a walker leaves a small structure for
/// the large one around it too late.
fn weighed_by_area(shares: &[Vec<f32>]) -> Vec<Vec<f32>> {
    let mean = |plane: &Vec<f32>| plane.iter().sum::<f32>() / plane.len() as f32;
    let factors: Vec<f32> = shares.iter().map(|plane| mean(plane).max(1e-6).powf(AREA_POWER)).collect();
    let mut weighed = shares.to_vec();
    for i in 0..shares.first().map_or(0, Vec::len) {
        let before: f32 = shares.iter().map(|plane| plane[i]).sum();
        let after: f32 = shares.iter().zip(&factors).map(|(plane, f)| f * plane[i]).sum();
        let scale = if after > 0.0 { before / after } else { 0.0 };
        weighed.iter_mut().zip(&factors).for_each(|(plane, f)| plane[i] *= f * scale);
    }
    weighed
}

/// Returns how much deeper a cell is than another, in units of [`LOG_DEPTH`]; 0 where that is not known.
fn depths_apart(log_depths: &[f32], cell: usize, other: usize) -> f32 {
    let farther = (log_depths[cell] - log_depths[other]) / LOG_DEPTH;
    if farther.is_nan() { 0.0 } else { farther }
}

/// Division of a picture into square cells.
#[derive(Debug)]
struct CellGrid {
    /// Side of the cells, px.
    side: usize,
    width: usize,
    height: usize,
    columns: usize,
    rows: usize,
}

impl CellGrid {
    /// Divides a picture of this size.
    fn of_picture(width: usize, height: usize) -> Self {
        let side = ((width * height) as f32 / NUM_CELLS).sqrt().round().max(1.0) as usize;
        Self { side, width, height, columns: width.div_ceil(side), rows: height.div_ceil(side) }
    }

    /// Returns the cell of pixel `i`.
    fn of(&self, i: usize) -> usize {
        i / self.width / self.side * self.columns + i % self.width / self.side
    }

    /// Returns the mean of the pixels of each cell.
    fn means(&self, at: impl Fn(usize) -> f32 + Sync) -> Vec<f32> {
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

    /// Returns the share of each cell that lies in the field of view.
    fn inside(&self, field_of_view: &Mask) -> Vec<f32> {
        self.means(|i| if field_of_view.data.get(i).is_none_or(|v| *v) { 1.0 } else { 0.0 })
    }

    /// Returns `true` if marks decide the label of more than half of the picture.
    fn is_mostly_marked(&self, evidence: &Evidence) -> bool {
        2 * evidence.decided().count() > self.width * self.height
    }

    /// Returns the seeds of evidence and of pixels that marks were propagated to.
    fn marked_seeds(
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
    fn guide_shares(&self, guides: &GuideShares) -> GuideShares {
        let half = |i: usize| at_half(i, self.width, [self.width / 2, self.height / 2]);
        let weights = self.means(|i| guides.weights[half(i)]);
        let share = |plane: &Vec<f32>| -> Vec<f32> {
            let sums = self.means(|i| guides.weights[half(i)] * plane[half(i)]);
            sums.iter().zip(&weights).map(|(sum, weight)| sum / weight.max(f32::MIN_POSITIVE)).collect()
        };
        GuideShares { shares: guides.shares.iter().map(share).collect(), weights }
    }

    /// Returns the mean colours of the cells: red, green, blue, as [`opponents`].
    fn colours(&self, picture: &RgbImage) -> Vec<[f32; 3]> {
        let raw = picture.as_raw();
        let [r, g, b] = [0, 1, 2].map(|c| self.means(|i| f32::from(raw[3 * i + c]) / 255.0));
        (0..r.len()).map(|i| opponents([r[i], g[i], b[i]].map(f32::sqrt))).collect()
    }

    /// Returns the mean logarithms of depth of the cells, less their mean over the picture; NaN where it is
    /// not known.
    fn log_depths(&self, depth: &[f32]) -> Vec<f32> {
        let half = |i: usize| at_half(i, self.width, [self.width / 2, self.height / 2]);
        let mut logarithms = self.means(|i| depth[half(i)].ln());
        let known = logarithms.iter().filter(|v| v.is_finite());
        let (sum, count) = known.fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
        let mean = sum / count.max(1) as f32;
        logarithms.iter_mut().for_each(|v| *v = if v.is_finite() { *v - mean } else { f32::NAN });
        logarithms
    }

    /// Returns the features of the appearance of the cells. Depths count if they are given.
    fn appearance(&self, colours: &[[f32; 3]], log_depths: Option<&[f32]>) -> AppearanceFeatures {
        let around = |value: &dyn Fn(&[f32; 3]) -> f32| {
            let values: Vec<f32> = colours.iter().map(value).collect();
            match log_depths {
                Some(depths) => self.means_about_as_deep(&values, depths),
                None => window_means(&values, [self.columns, self.rows], AROUND),
            }
        };
        let means = [0, 1, 2].map(|c| around(&|colour| colour[c]));
        let means_2 = around(&|colour| colour[0] * colour[0]);
        let of_cell = |i: usize| Appearance {
            colour: colours[i],
            around: [0, 1, 2].map(|c| means[c][i]),
            roughness: (means_2[i] - means[0][i] * means[0][i]).max(0.0).sqrt(),
            position: [i % self.columns, i / self.columns]
                .map(|at| (at * self.side) as f32 / self.width as f32),
            log_depth: log_depths.map(|depths| depths[i]).filter(|depth| depth.is_finite()).unwrap_or(0.0),
        };
        AppearanceFeatures::new((0..colours.len()).map(of_cell))
    }

    /// Returns the mean over the surroundings of each cell, of what is about as deep: beside a tool, what lies
    /// behind it has surroundings of its own.
    fn means_about_as_deep(&self, values: &[f32], log_depths: &[f32]) -> Vec<f32> {
        let mean = |cell: usize| {
            let (x, y) = (cell % self.columns, cell / self.columns);
            let (mut sum, mut weights) = (0.0, 0.0);
            for row in y.saturating_sub(AROUND)..(y + AROUND + 1).min(self.rows) {
                for column in x.saturating_sub(AROUND)..(x + AROUND + 1).min(self.columns) {
                    let other = row * self.columns + column;
                    let weight = (-0.5 * depths_apart(log_depths, cell, other).powi(2)).exp();
                    sum += weight * values[other];
                    weights += weight;
                }
            }
            sum / weights
        };
        (0..values.len()).into_par_iter().with_min_len(1024).map(mean).collect()
    }

    /// Links each cell in the field of view with those of the eight around it that lie there, too, by their
    /// colours and, where they are known, their depths.
    fn links(&self, colours: &[[f32; 3]], log_depths: Option<&[f32]>, field_of_view: &Mask) -> Links {
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
    fn at_half(&self, values: &[f32]) -> Vec<f32> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marks::{Mark, Marks, Shape};

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
        let values: Vec<f32> = (0..800).map(|i| if i % 40 < 20 { 1.0 } else { 0.0 }).collect();
        let beside = |depth_of_tissue: f32| {
            let depths: Vec<f32> =
                (0..800).map(|i| if i % 40 < 20 { 0.0 } else { depth_of_tissue }).collect();
            let means = grid.means_about_as_deep(&values, &depths);
            [means[10 * 40 + 19], means[10 * 40 + 20]]
        };
        assert_eq!(beside(1.0), [1.0, 0.0]);
        for depth in [0.0, f32::NAN] {
            let [tool, tissue] = beside(depth);
            assert!((tool - 0.6).abs() < 1e-3 && (tissue - 0.4).abs() < 1e-3, "{tool} {tissue}");
        }
    }

    /// Strokes on fat, at the bottom, and on liver, at the top, spread over a picture. Returns the shares of
    /// liver and fat in a small piece of dark fat amid the liver. The right half may show something without a
    /// name.
    fn shares_of_dark_fat(unnamed: Option<[u8; 3]>) -> [f32; 2] {
        const SIZE: [usize; 2] = [240, 160];
        let picture = RgbImage::from_fn(240, 160, |x, y| {
            let grain = (x * 7 + y * 13) % 5;
            let colour = match (x, y, unnamed) {
                (30..60, 30..60, _) => [160, 128, 57],
                (120.., _, Some(colour)) => colour,
                (_, ..80, _) => [110, 50, 45],
                _ => [215, 175, 80],
            };
            image::Rgb(colour.map(|level| level + grain as u8))
        });
        let stroke = |name: &str, y: f32| {
            let shape = Shape::Stroke { points_px: vec![[10.0, y], [100.0, y]], radius_px: 3.0 };
            Mark::new(0, name, true, shape)
        };
        let marks = Marks::unchecked(vec![stroke("fat", 120.0), stroke("liver", 15.0)]);
        let evidence = Evidence::of(&marks, 0, &marks.names(), SIZE);
        let field_of_view = Mask::filled(SIZE[0], SIZE[1], true);
        let frame = MarkedPicture { picture: &picture, field_of_view: &field_of_view, depth: None };
        let shares = spread_over(&frame, &evidence, &[], 2, None);
        [1, 0].map(|name| shares[name][22 * 120 + 22])
    }

    #[test]
    fn where_nearly_all_has_a_name_a_darker_piece_has_one_too() {
        let [liver, fat] = shares_of_dark_fat(None);
        assert!(fat > 0.5 && liver < 0.3, "{liver} {fat}");
        let [liver, fat] = shares_of_dark_fat(Some([90, 95, 140]));
        assert!(fat < 0.4 && liver < 0.4, "half of the picture has no name: {liver} {fat}");
    }

    #[test]
    fn a_denial_takes_from_the_denied_name_alone() {
        // Two names compete for the first cell; the second one shows what is denied, the third one neither.
        let open = [vec![0.36, 0.98, 0.0], vec![0.6, 0.01, 0.25]];
        let denied = [vec![0.0, 0.0, 0.0], open[1].clone()];
        let mut shares = open.to_vec();
        let lost = take_denied(&mut shares, &open, &denied);
        assert_eq!(shares[0], [0.0; 3]);
        for (share, expected) in shares[1].iter().zip([0.625, 0.0101, 0.25]) {
            assert!((share - expected).abs() < 1e-3, "{share} instead of {expected}");
        }
        assert!((lost[0] - 0.375).abs() < 1e-3 && lost[1..] == [0.0; 2], "{lost:?}");
    }

    #[test]
    fn what_is_no_fat_may_be_liver_as_before() {
        const SIZE: [usize; 2] = [240, 160];
        // Between liver on the left and fat on the right lies something of a colour between both.
        let picture = RgbImage::from_fn(240, 160, |x, y| {
            let grain = ((x * 7 + y * 13) % 5) as u8;
            let colour = [[110, 50, 45], [150, 95, 58], [215, 175, 80]][x as usize / 80];
            image::Rgb(colour.map(|level| level + grain))
        });
        let stroke = |name: &str, add: bool, x: f32| {
            let shape = Shape::Stroke { points_px: vec![[x, 20.0], [x, 140.0]], radius_px: 3.0 };
            Mark::new(0, name, add, shape)
        };
        let liver_under_mark = |marks: Vec<Mark>| -> f32 {
            let marks = Marks::unchecked(marks);
            let evidence = Evidence::of(&marks, 0, &marks.shown_names(), SIZE);
            let field_of_view = Mask::filled(SIZE[0], SIZE[1], true);
            let frame = MarkedPicture { picture: &picture, field_of_view: &field_of_view, depth: None };
            let shares = spread_over(&frame, &evidence, &[], 2, None);
            assert_eq!(shares.len(), 2);
            shares[1][40 * 120 + 60]
        };
        let shown = vec![stroke("liver", true, 20.0), stroke("fat", true, 220.0)];
        let denied = [shown.clone(), vec![stroke("fat", false, 120.0)]].concat();
        let (before, after) = (liver_under_mark(shown), liver_under_mark(denied));
        assert!(after > before - 0.02, "{before} {after}");
    }

    /// Shares of tool and tissue, of which a stroke each is marked, in tissue between the strokes that is as
    /// grey as the tool beside it. The tissue is 8 deep.
    fn shares_beside_a_tool(depth_of_tool: Option<f32>) -> [f32; 2] {
        const SIZE: [usize; 2] = [240, 160];
        let picture = RgbImage::from_fn(240, 160, |x, y| {
            let grain = ((x * 7 + y * 13) % 5) as u8;
            let colour = if x < 120 { [120, 118, 116] } else { [130, 70, 60] };
            image::Rgb(colour.map(|level| level + grain))
        });
        let stroke = |name: &str, x: f32| {
            let shape = Shape::Stroke { points_px: vec![[x, 10.0], [x, 150.0]], radius_px: 3.0 };
            Mark::new(0, name, true, shape)
        };
        let marks = Marks::unchecked(vec![stroke("tool", 20.0), stroke("tissue", 200.0)]);
        let evidence = Evidence::of(&marks, 0, &marks.names(), SIZE);
        let field_of_view = Mask::filled(SIZE[0], SIZE[1], true);
        let depth = depth_of_tool.map(|depth| -> Vec<f32> {
            (0..120 * 80).map(|i| if i % 120 < 30 { depth } else { 8.0 }).collect()
        });
        let frame =
            MarkedPicture { picture: &picture, field_of_view: &field_of_view, depth: depth.as_deref() };
        let shares = spread_over(&frame, &evidence, &[], 2, None);
        // Names are sorted.
        [1, 0].map(|name| shares[name][40 * 120 + 45])
    }

    #[test]
    fn what_lies_far_behind_a_tool_is_no_tool() {
        for depth in [None, Some(8.0)] {
            let [tool, tissue] = shares_beside_a_tool(depth);
            assert!(tool > 0.5 && tissue < 0.3, "it looks like the tool: {tool} {tissue}");
        }
        let [tool, _] = shares_beside_a_tool(Some(4.0));
        assert!(tool < 0.3, "{tool}");
        assert!(shares_beside_a_tool(Some(f32::NAN)).iter().all(|share| share.is_finite()));
    }
}
