//! Marks spread over the cells of a picture, which follow its borders better than Gaussians do, and pictures
//! compared cell by cell.

use super::{
    Evidence,
    appearance::{AppearanceFeatures, Prediction, Regression, Unlabelled},
    carried::scale_beside_denied,
    cell_grid::{CellGrid, CellSeeds},
    hints::{GuideShares, Hints},
    links::Links,
    spread::{Before, PULL, spread},
};
use crate::{camera::Camera, grid::Mask};
use image::RgbImage;
use rayon::prelude::*;

/// Rounds in which a few marks are spread.
const ROUNDS: usize = 2;
/// Share of a name above which a cell of an example shows it.
pub(super) const MIN_SHOWN_SHARE: f32 = 0.7;
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
    /// Logarithm of depth at half size, rounded down, in any unit; NaN where there is none. `None` if none was
    /// measured.
    pub(super) log_depths: Option<&'a [f32]>,
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

    /// Divides a picture into cells, and computes their features. Depth counts if logarithms of it at half size
    /// are given.
    pub(super) fn of(picture: &RgbImage, log_depths: Option<&[f32]>) -> Self {
        let grid = CellGrid::of_picture(picture.width() as usize, picture.height() as usize);
        let log_depths = log_depths.map(|pixels| grid.log_depths(pixels));
        let appearance = grid.appearance(&grid.colours(picture), log_depths.as_deref());
        Self { grid, appearance }
    }

    /// Returns the features of the cells.
    pub(super) fn features(&self) -> &AppearanceFeatures {
        &self.appearance
    }

    /// Returns the share of each cell that lies in the field of view.
    pub(super) fn inside(&self, field_of_view: &Mask) -> Vec<f32> {
        self.grid.inside(field_of_view)
    }

    /// Returns the means of values at half size in each cell.
    pub(super) fn means_of_half(&self, values: &[f32]) -> Vec<f32> {
        self.grid.means_of_half(|i| values[i])
    }

    /// Interpolates values of cells at every pixel of half size.
    pub(super) fn at_half(&self, values: &[f32]) -> Vec<f32> {
        self.grid.at_half(values)
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
    let log_depths = frame.log_depths.map(|pixels| grid.log_depths(pixels));
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

/// A marked picture as an example.
#[derive(Debug)]
pub(super) struct Example {
    cells: CellFeatures,
    /// Number of cells that clearly show each name.
    num_shown: Vec<usize>,
    /// Appearance of each name, told from cells that show none.
    names: Regression,
    /// Appearance of everything that is not black, as one class.
    place: Regression,
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
        let cells = CellFeatures::of(picture, None);
        let CellFeatures { grid, appearance } = &cells;
        let seeds = grid.marked_seeds(evidence, &[], num_names);
        let links = grid.links(&grid.colours(picture), None, field_of_view);
        let mut shares = spread_in_rounds(appearance, &links, &seeds, None);
        shares.truncate(num_names);
        let inside = || (0..links.len()).filter(|i| links.degrees[*i] > 0.0);
        let shows = |plane: &Vec<f32>| inside().filter(|i| plane[*i] > MIN_SHOWN_SHARE).collect();
        let shown: Vec<Vec<usize>> = shares.iter().map(shows).collect();
        let is_unlabelled = |i: &usize| shares.iter().map(|plane| plane[*i]).sum::<f32>() < MIN_SHOWN_SHARE;
        let unlabelled: Vec<usize> = inside().filter(is_unlabelled).collect();
        let unlabelled = Unlabelled { nodes: &unlabelled, variance: UNLABELLED_VARIANCE };
        let names = appearance.fit(&shown, &[], unlabelled);
        let place = appearance.fit(&[cells.not_black(field_of_view)], &[], Unlabelled::NONE);
        Self { num_shown: shown.iter().map(Vec::len).collect(), names, place, cells }
    }

    /// Compares a picture of the same size with the example. Returns the match of each name; `None` if the
    /// picture shows another place.
    pub(super) fn match_picture(&self, picture: &CellFeatures, field_of_view: &Mask) -> Option<Vec<Match>> {
        let familiar = self.place.predict(&picture.appearance).nearness;
        let not_black = picture.not_black(field_of_view);
        let is_familiar = |i: usize| familiar[i] > MIN_POSITIVE;
        let num_familiar = not_black.iter().filter(|i| is_familiar(**i)).count();
        if num_familiar as f32 <= MIN_FAMILIAR_PART * not_black.len() as f32 {
            return None;
        }
        let Prediction { score, nearness } = self.names.predict(&picture.appearance);
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
        self.num_shown[name] * self.cells.grid.side.pow(2)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marks::{Mark, Marks, Shape};

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
        let frame = MarkedPicture { picture: &picture, field_of_view: &field_of_view, log_depths: None };
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
            let frame = MarkedPicture { picture: &picture, field_of_view: &field_of_view, log_depths: None };
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
        let log_depths = depth_of_tool.map(|depth| -> Vec<f32> {
            (0..120 * 80).map(|i| if i % 120 < 30 { depth.ln() } else { 8.0_f32.ln() }).collect()
        });
        let log_depths = log_depths.as_deref();
        let frame = MarkedPicture { picture: &picture, field_of_view: &field_of_view, log_depths };
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
