//! A marked frame as a grid of small squares, which marks are spread over: it knows the borders of its
//! picture better than Gaussians do.

use super::{
    Evidence,
    hints::{Hints, Told},
    links::Links,
    looks::{Answers, Appearance, Looks, opponents},
    means::window_means,
    seeds::Seeds,
    spread::{Before, PULL, spread},
};
use crate::{camera::Camera, grid::Mask};
use image::RgbImage;
use rayon::prelude::*;

/// Number of squares of a picture, about: how far marks spread does not depend on its resolution.
const SQUARES: f32 = 25_600.0;
/// Difference of brightness at which neighbours weigh e^(−½), and of hue, as [`opponents`] gives them.
const BRIGHTNESS: f32 = 0.041;
const HUE: f32 = 0.033;
/// Half the side of the surroundings of a square, in squares.
const AROUND: usize = 2;
/// Rounds in which a few marks are spread.
const ROUNDS: usize = 2;
/// Share of a name from which on a square of an example shows it.
const SHOWN: f32 = 0.7;
/// Variance of the answer of an example's square that shows no name.
const OPEN_VARIANCE: f64 = 0.1;
/// Certainty from which on a square looks as an example's, and up to which it surely does not.
const SURE: f32 = 0.6;
const NOT: f32 = 0.3;
/// Part of a picture that looks as something in an example, from which on both show the same place.
const FAMILIAR: f32 = 0.6;
/// Brightness, as [`opponents`] gives it, from which on there is something to be seen.
const LIT: f32 = 0.15;
/// Power of the mean share that a share is multiplied by.
const AREA: f32 = 0.2;

/// The squares of a picture, with their looks.
#[derive(Debug)]
pub(super) struct Squares {
    cells: Cells,
    looks: Looks,
}

impl Squares {
    /// Side of the squares of a camera's pictures, px.
    pub(super) fn side_of(camera: &Camera) -> usize {
        Cells::of_picture(camera.width as usize, camera.height as usize).side
    }

    pub(super) fn of(picture: &RgbImage) -> Self {
        let cells = Cells::of_picture(picture.width() as usize, picture.height() as usize);
        let looks = cells.looks(&cells.colours(picture));
        Self { cells, looks }
    }

    /// Returns the squares inside the field of view that are not black.
    fn lit(&self, field_of_view: &Mask) -> Vec<usize> {
        let inside = self.cells.inside(field_of_view);
        (0..inside.len()).filter(|i| inside[*i] > 0.5 && self.looks.brightness(*i) > LIT).collect()
    }

    /// Returns the likeness of the looks around a pixel and around one of another picture, wherever they are,
    /// 0–1.
    pub(super) fn likeness(&self, pixel: usize, other: &Self, other_pixel: usize) -> f32 {
        self.looks.likeness(self.cells.of(pixel), &other.looks, other.cells.of(other_pixel))
    }
}

/// Spreads the marks of a frame over its picture: shares of each name, [names][pixels] at half size, rounded
/// down. `told` is what other frames tell, of pixels of the same size; `lent` are pixels of the picture that
/// marks of other frames were carried to, each with its name.
pub(super) fn spread_over(
    picture: &RgbImage,
    field_of_view: &Mask,
    (evidence, lent): (&Evidence, &[(usize, usize)]),
    num_names: usize,
    told: Option<Told>,
) -> Vec<Vec<f32>> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let cells = Cells::of_picture(width, height);
    let mut seeds = cells.seeds(evidence, num_names);
    cells.lend(&mut seeds, lent);
    let colours = cells.colours(picture);
    let links = cells.links(&colours, field_of_view);
    let told = told.map(|told| cells.told(&told));
    let shares = if cells.is_mostly_marked(evidence) {
        spread(&links, &seeds, Before::Nothing, PULL, told.as_ref().map(Hints::of_told).as_ref())
    } else {
        grown(&cells.looks(&colours), &links, &seeds, told.as_ref())
    };
    shares.par_iter().map(|share| cells.at_half(share)).collect()
}

/// A marked picture as an example: what its squares show, and how that looks.
#[derive(Debug)]
pub(super) struct Example {
    squares: Squares,
    /// Squares that clearly show each name, and those that show none.
    shown: Vec<Vec<usize>>,
    open: Vec<usize>,
    /// Squares that are not black: all of them together, as one answer.
    lit: [Vec<usize>; 1],
}

/// Squares of a picture that surely look as those of an example that show a name, and that surely look as
/// others.
#[derive(Clone, Debug)]
pub(super) struct Alike {
    pub(super) shows: Mask,
    pub(super) denies: Mask,
}

impl Example {
    /// Spreads the marks of a frame over its picture.
    pub(super) fn of(
        picture: &RgbImage,
        field_of_view: &Mask,
        evidence: &Evidence,
        num_names: usize,
    ) -> Self {
        let squares = Squares::of(picture);
        let Squares { cells, looks } = &squares;
        let seeds = cells.seeds(evidence, num_names);
        let links = cells.links(&cells.colours(picture), field_of_view);
        let shares = grown(looks, &links, &seeds, None);
        let inside = || (0..links.len()).filter(|i| links.degrees[*i] > 0.0);
        let shown = shares.iter().map(|plane| inside().filter(|i| plane[*i] > SHOWN).collect()).collect();
        let is_open = |i: &usize| shares.iter().map(|plane| plane[*i]).sum::<f32>() < SHOWN;
        let open = inside().filter(is_open).collect();
        let lit = [squares.lit(field_of_view)];
        Self { squares, shown, open, lit }
    }

    /// Returns the squares of a picture of the same size that are like those of each name, and unlike them.
    /// `None` if the picture shows another place.
    pub(super) fn likes(&self, picture: &Squares, field_of_view: &Mask) -> Option<Vec<Alike>> {
        let (own, others) = (&self.squares.looks, &picture.looks);
        let familiar = own.answers_of(others, &self.lit, &[], (&[], OPEN_VARIANCE)).known;
        let lit = picture.lit(field_of_view);
        let is_familiar = |i: usize| familiar[i] > SURE;
        if lit.iter().filter(|i| is_familiar(**i)).count() as f32 <= FAMILIAR * lit.len() as f32 {
            return None;
        }
        let Answers { sure, known } = own.answers_of(others, &self.shown, &[], (&self.open, OPEN_VARIANCE));
        let mask = |is_so: &dyn Fn(usize) -> bool| {
            let mut mask = Mask::filled(picture.cells.columns, picture.cells.rows, false);
            lit.iter().filter(|i| is_so(**i)).for_each(|i| mask.data[*i] = true);
            mask
        };
        let alike = |sure: &Vec<f32>| Alike {
            shows: mask(&|i| sure[i].min(known[i]) > SURE),
            denies: mask(&|i| is_familiar(i) && sure[i].min(known[i]) < NOT),
        };
        Some(sure.iter().map(alike).collect())
    }

    /// Returns the same of the example itself; `None` if it is black.
    pub(super) fn own(&self, field_of_view: &Mask) -> Option<Vec<Alike>> {
        self.likes(&self.squares, field_of_view)
    }

    /// Area that a name has, px.
    pub(super) fn area_px(&self, name: usize) -> usize {
        self.shown[name].len() * self.squares.cells.side.pow(2)
    }
}

/// Spreads marks in rounds: what clearly belongs to a name is an example of its looks in the next one.
fn grown(looks: &Looks, links: &Links, seeds: &Seeds, told: Option<&Told>) -> Vec<Vec<f32>> {
    let (mut walked, mut shares) = (Vec::new(), Vec::new());
    for round in 0..ROUNDS {
        let hints = Hints::of(looks, links, seeds, &shares);
        let hints = told.into_iter().fold(hints, Hints::with_told);
        let before = if round == 0 { Before::Nothing } else { Before::Nearly(&walked) };
        walked = spread(links, seeds, before, PULL, Some(&hints));
        shares = weighed_by_area(&walked);
    }
    shares
}

/// Multiplies shares by a power of their mean, and keeps their sums: a walker leaves a small structure for
/// the large one around it too late.
fn weighed_by_area(shares: &[Vec<f32>]) -> Vec<Vec<f32>> {
    let mean = |plane: &Vec<f32>| plane.iter().sum::<f32>() / plane.len() as f32;
    let factors: Vec<f32> = shares.iter().map(|plane| mean(plane).max(1e-6).powf(AREA)).collect();
    let mut weighed = shares.to_vec();
    for i in 0..shares.first().map_or(0, Vec::len) {
        let before: f32 = shares.iter().map(|plane| plane[i]).sum();
        let after: f32 = shares.iter().zip(&factors).map(|(plane, f)| f * plane[i]).sum();
        let scale = if after > 0.0 { before / after } else { 0.0 };
        weighed.iter_mut().zip(&factors).for_each(|(plane, f)| plane[i] *= f * scale);
    }
    weighed
}

/// The squares of a picture.
#[derive(Debug)]
struct Cells {
    /// Side of the squares, px.
    side: usize,
    width: usize,
    height: usize,
    columns: usize,
    rows: usize,
}

impl Cells {
    /// Divides a picture of this size.
    fn of_picture(width: usize, height: usize) -> Self {
        let side = ((width * height) as f32 / SQUARES).sqrt().round().max(1.0) as usize;
        Self { side, width, height, columns: width.div_ceil(side), rows: height.div_ceil(side) }
    }

    fn of(&self, i: usize) -> usize {
        i / self.width / self.side * self.columns + i % self.width / self.side
    }

    /// Means of the pixels of each square.
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

    /// Share of each square that is in the field of view.
    fn inside(&self, field_of_view: &Mask) -> Vec<f32> {
        self.means(|i| if field_of_view.data.get(i).is_none_or(|v| *v) { 1.0 } else { 0.0 })
    }

    /// Returns `true` if marks leave less than half of the picture open.
    fn is_mostly_marked(&self, evidence: &Evidence) -> bool {
        2 * evidence.settled().count() > self.width * self.height
    }

    fn seeds(&self, evidence: &Evidence, num_names: usize) -> Seeds {
        let zeros = vec![vec![0.0; self.columns * self.rows]; num_names];
        let mut seeds = Seeds { weights: zeros.clone(), shares: zeros };
        for i in evidence.pixels() {
            let cell = self.of(i);
            for k in 0..num_names {
                let (weight, share) = evidence.at(i, k);
                seeds.weights[k][cell] += weight;
                seeds.shares[k][cell] += weight * share;
            }
        }
        seeds
    }

    /// Adds pixels, each with the name that it shows, where no mark shows a name or speaks of this one.
    fn lend(&self, seeds: &mut Seeds, lent: &[(usize, usize)]) {
        let is_shown: Vec<bool> =
            (0..self.columns * self.rows).map(|cell| seeds.shares.iter().any(|s| s[cell] > 0.0)).collect();
        let is_spoken_of: Vec<Vec<bool>> =
            seeds.weights.iter().map(|weights| weights.iter().map(|w| *w > 0.0).collect()).collect();
        for &(i, name) in lent {
            let cell = self.of(i);
            if !is_shown[cell] && !is_spoken_of[name][cell] {
                seeds.weights.iter_mut().for_each(|weights| weights[cell] += 1.0);
                seeds.shares[name][cell] += 1.0;
            }
        }
    }

    /// Returns the means of what is told of the pixels of half size in each square.
    fn told(&self, told: &Told) -> Told {
        let width = self.width / 2;
        let half = |i: usize| {
            let (x, y) = (i % self.width / 2, i / self.width / 2);
            y.min(self.height / 2 - 1) * width + x.min(width - 1)
        };
        let weights = self.means(|i| told.weights[half(i)]);
        let share = |plane: &Vec<f32>| -> Vec<f32> {
            let sums = self.means(|i| told.weights[half(i)] * plane[half(i)]);
            sums.iter().zip(&weights).map(|(sum, weight)| sum / weight.max(f32::MIN_POSITIVE)).collect()
        };
        Told { shares: told.shares.iter().map(share).collect(), weights }
    }

    /// Returns the mean colours of the squares: red, green, blue, as [`opponents`].
    fn colours(&self, picture: &RgbImage) -> Vec<[f32; 3]> {
        let raw = picture.as_raw();
        let [r, g, b] = [0, 1, 2].map(|c| self.means(|i| f32::from(raw[3 * i + c]) / 255.0));
        (0..r.len()).map(|i| opponents([r[i], g[i], b[i]].map(f32::sqrt))).collect()
    }

    /// Returns the looks of the squares.
    fn looks(&self, colours: &[[f32; 3]]) -> Looks {
        let around = |value: &dyn Fn(&[f32; 3]) -> f32| {
            let values: Vec<f32> = colours.iter().map(value).collect();
            window_means(&values, [self.columns, self.rows], AROUND)
        };
        let means = [0, 1, 2].map(|c| around(&|colour| colour[c]));
        let squares = around(&|colour| colour[0] * colour[0]);
        let appearance = |i: usize| Appearance {
            colour: colours[i],
            around: [0, 1, 2].map(|c| means[c][i]),
            roughness: (squares[i] - means[0][i] * means[0][i]).max(0.0).sqrt(),
            place: [i % self.columns, i / self.columns].map(|at| (at * self.side) as f32 / self.width as f32),
        };
        Looks::new((0..colours.len()).map(appearance))
    }

    /// Links each square with the eight around it that are in the field of view, too.
    fn links(&self, colours: &[[f32; 3]], field_of_view: &Mask) -> Links {
        let inside = self.inside(field_of_view);
        let link = |cell: usize, (dx, dy): (isize, usize)| {
            let x = (cell % self.columns).checked_add_signed(dx).filter(|x| *x < self.columns)?;
            let y = Some(cell / self.columns + dy).filter(|y| *y < self.rows)?;
            let other = y * self.columns + x;
            let [light, red, yellow]: [f32; 3] =
                std::array::from_fn(|c| colours[cell][c] - colours[other][c]);
            let difference_2 = (light / BRIGHTNESS).powi(2) + (red / HUE).powi(2) + (yellow / HUE).powi(2);
            let length = ((dx * dx) as f32 + (dy * dy) as f32).sqrt();
            let weight = (-0.5 * difference_2).exp() / length;
            (inside[cell] > 0.5 && inside[other] > 0.5).then_some((cell as u32, other as u32, weight))
        };
        let steps = [(1, 0), (0, 1), (1, 1), (-1, 1)];
        let each =
            (0..inside.len()).flat_map(|cell| steps.into_iter().filter_map(move |step| link(cell, step)));
        Links::new(inside.len(), each.collect::<Vec<_>>().into_iter())
    }

    /// Interpolates values of squares at every pixel of half size.
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

    #[test]
    fn squares_grow_with_the_picture() {
        let side = |size: [usize; 2]| Cells::of_picture(size[0], size[1]).side;
        let sizes = [[40, 20], [320, 256], [427, 240], [640, 512], [854, 480], [1280, 720], [1920, 1080]];
        assert_eq!(sizes.map(side), [1, 2, 2, 4, 4, 6, 9]);
    }
}
