//! Changes of the shot, and runs of frames that show no tissue, from a glance at every frame.

use super::pace::{self, Glance};
use crate::grid::Mask;
use image::{Rgb, RgbImage};
use std::ops::Range;

/// Difference of neighbouring frames, in 8-bit levels, from which on it may be a cut.
const CUT_LEVELS: f32 = 12.0;
/// The same as a multiple of the usual difference around it.
const CUT_TIMES: f32 = 3.0;
/// The same as a multiple of the largest difference around it, where it is compared with one side alone.
const LARGEST_TIMES: f32 = 1.5;
/// Share of a difference from which on that of the next frame belongs to it: one frame alone is bright or
/// dark.
const FLASH_SHARE: f32 = 0.5;
/// Factor by which frames that are two steps apart differ more than neighbours: between one and two, because
/// differences grow less and less.
const TWO_STEPS: f32 = std::f32::consts::SQRT_2;
/// Number of frames on either side that tell what is usual.
const AROUND: usize = 12;
/// Brightness of a pixel's brightest channel from which on its colour counts, 8-bit levels.
const DARK: u8 = 40;
/// Share of pixels whose colour counts, below which nothing is seen.
const FEWEST: f32 = 0.02;
/// Share of red in all light below which a frame shows no tissue. Tissue has 0.41 to 0.49, grey 0.33.
const LEAST_RED: f32 = 0.36;
/// Shortest run of frames without tissue that is told.
const SHORTEST: usize = 5;

/// A look at one frame beside the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Shot {
    /// Mean difference from the frame before, 8-bit levels; `None` for the first one, and where one of the two
    /// could not be read.
    pub(super) difference: Option<f32>,
    /// `true` if the frame shows tissue, as far as its colours tell.
    pub(super) is_tissue: bool,
}

impl Shot {
    /// A frame that could not be read: nothing is known of it.
    pub(super) const UNREAD: Self = Self { difference: None, is_tissue: true };
}

/// A frame as it was read: enough of it to compare the next one with.
pub(super) struct Seen {
    pub(super) glance: Glance,
    is_tissue: bool,
}

impl Seen {
    pub(super) fn of(picture: &RgbImage) -> Self {
        Self { glance: Glance::of(picture), is_tissue: shows_tissue(picture) }
    }

    /// Compares the frame with the one before.
    pub(super) fn after(&self, before: Option<&Self>) -> Shot {
        let difference = before.and_then(|before| before.glance.difference(&self.glance));
        Shot { difference, is_tissue: self.is_tissue }
    }
}

/// Returns `true` if the light of a picture is as red as that of tissue.
fn shows_tissue(picture: &RgbImage) -> bool {
    let (mut sums, mut count, mut all) = ([0_u64; 3], 0_usize, 0_usize);
    // Every seventh pixel is enough, and is in every column.
    for pixel in picture.pixels().step_by(7) {
        all += 1;
        if is_lit(pixel) {
            count += 1;
            sums.iter_mut().zip(pixel.0).for_each(|(sum, v)| *sum += u64::from(v));
        }
    }
    is_seen(count, all) && sums[0] as f32 >= LEAST_RED * sums.iter().sum::<u64>() as f32
}

/// Returns `true` if a picture shows something where `kept`, which is of its size, is `true`.
pub(crate) fn shows_something(picture: &RgbImage, kept: &Mask) -> bool {
    let lit = picture.pixels().zip(&kept.data).filter(|(pixel, is_kept)| **is_kept && is_lit(pixel));
    is_seen(lit.count(), kept.count())
}

/// Returns `true` if the colour of a pixel counts.
fn is_lit(pixel: &Rgb<u8>) -> bool {
    pixel.0.iter().any(|v| *v > DARK)
}

/// Returns `true` if `lit` of `all` pixels are enough to see something.
fn is_seen(lit: usize, all: usize) -> bool {
    lit as f32 >= FEWEST * all.max(1) as f32
}

/// Returns the first frames of new shots: they differ far more from the frame before than frames around them
/// do, or than those on one side, where a steady shot meets one that moves fast. A single bright or dark
/// frame is none. Frames that repeat the one before do not count.
pub(super) fn cuts(shots: &[Shot]) -> Vec<usize> {
    let repeats = pace::repeats(&shots.iter().map(|shot| shot.difference).collect::<Vec<_>>());
    let new: Vec<usize> = (0..shots.len()).filter(|i| !repeats[*i]).collect();
    let shots: Vec<Shot> = new.iter().map(|i| shots[*i]).collect();
    cuts_of_new(&shots).into_iter().map(|k| new[k]).collect()
}

/// Returns the same for frames none of which repeats the one before.
fn cuts_of_new(shots: &[Shot]) -> Vec<usize> {
    let differences = |frames: Range<usize>| -> Vec<f32> {
        let mut differences: Vec<f32> = shots[frames].iter().filter_map(|shot| shot.difference).collect();
        differences.sort_by(f32::total_cmp);
        differences
    };
    let usual = |sorted: &[f32]| sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    // A few frames tell nothing by themselves.
    let is_enough = |side: &&[f32]| 2 * side.len() >= AROUND;
    let sudden = |i: usize| {
        let own = shots[i].difference.filter(|own| *own > CUT_LEVELS)?;
        let before = differences(i.saturating_sub(AROUND)..i);
        let after = differences(i + 1..(i + AROUND + 1).min(shots.len()));
        let mut both = [&before[..], &after].concat();
        both.sort_by(f32::total_cmp);
        let stands_out = own > LARGEST_TIMES * both.last().copied().unwrap_or(0.0);
        let sides = [&before[..], &after].into_iter().filter(|side| stands_out && is_enough(side));
        (own > CUT_TIMES * sides.map(usual).fold(usual(&both), f32::min)).then_some(own)
    };
    let sudden: Vec<Option<f32>> = (0..shots.len()).map(sudden).collect();
    let is_flash = |i: usize, own: f32| {
        let beside = [i.checked_sub(1), Some(i + 1)].into_iter().flatten();
        beside.filter_map(|k| *sudden.get(k)?).any(|other| other > FLASH_SHARE * own)
    };
    (0..shots.len()).filter(|i| sudden[*i].is_some_and(|own| !is_flash(*i, own))).collect()
}

/// Returns the first frames of new shots from the mean differences of frames from the ones that were read
/// before, in 8-bit levels; `None` for frames that were not read.
pub(crate) fn cuts_of(differences: &[Option<f32>]) -> Vec<usize> {
    let read: Vec<usize> = (0..differences.len()).filter(|i| differences[*i].is_some()).collect();
    let shot = |k: usize| {
        // A frame between them was not read.
        let is_apart = k > 0 && read[k] == read[k - 1] + 2;
        let steps = if is_apart { TWO_STEPS } else { 1.0 };
        Shot { difference: differences[read[k]].map(|difference| difference / steps), is_tissue: true }
    };
    cuts(&(0..read.len()).map(shot).collect::<Vec<_>>()).into_iter().map(|k| read[k]).collect()
}

/// Returns the runs of frames that show no tissue, both ends included; none if no frame does: then the light
/// or the camera may be another one.
pub(super) fn without_tissue(shots: &[Shot]) -> Vec<(usize, usize)> {
    if shots.iter().all(|shot| !shot.is_tissue) {
        return Vec::new();
    }
    let mut at = 0;
    let runs = shots.chunk_by(|a, b| a.is_tissue == b.is_tissue).filter_map(move |run| {
        let first = at;
        at += run.len();
        (!run[0].is_tissue && run.len() >= SHORTEST).then(|| (first, at - 1))
    });
    runs.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;

    fn shots(differences: &[f32]) -> Vec<Shot> {
        let shot = |d: &f32| Shot { difference: Some(*d), is_tissue: true };
        let mut shots: Vec<Shot> = differences.iter().map(shot).collect();
        shots[0].difference = None;
        shots
    }

    #[test]
    fn cuts_stand_out_and_fast_motion_and_flashes_do_not() {
        let mut differences = vec![5.0; 60];
        differences[20] = 40.0;
        (40..50).for_each(|i| differences[i] = 25.0);
        assert_eq!(cuts(&shots(&differences)), [20]);
        differences[21] = 40.0;
        assert_eq!(cuts(&shots(&differences)), [0; 0], "one frame that is bright by itself");
        differences[21] = 18.0;
        assert_eq!(cuts(&shots(&differences)), [20], "a jump in the new shot");
        (21..40).for_each(|i| differences[i] = 18.0);
        assert_eq!(cuts(&shots(&differences)), [20], "a steady shot before one that moves fast");
        differences[20] = 25.0;
        assert_eq!(cuts(&shots(&differences)), [0; 0], "a shot that begins to move fast");
        let mut first = vec![12.0; 30];
        first[1] = 30.0;
        assert_eq!(cuts(&shots(&first)), [0; 0], "one frame does not tell that the shot was steady");
        assert_eq!(cuts(&shots(&[0.0; 30])), [0; 0]);
        let mut tripled: Vec<f32> = (0..90).map(|i| if i % 3 == 0 { 15.0 } else { 0.0 }).collect();
        assert_eq!(cuts(&shots(&tripled)), [0; 0], "a changed frame rate");
        tripled[45] = 60.0;
        assert_eq!(cuts(&shots(&tripled)), [45]);
        assert_eq!(cuts(&[]), [0; 0]);
        let mut known: Vec<Option<f32>> = vec![Some(5.0); 40];
        (1..40).step_by(8).for_each(|i| known[i] = None);
        known[24] = Some(40.0);
        assert_eq!(cuts_of(&known), [24]);
        known[26] = Some(40.0);
        assert_eq!(cuts_of(&known), [0; 0], "frame 25 was not read");
        let quick = [9.6, 12.5, 14.8, 16.0, 0.0, 24.2, 13.2, 11.1, 8.8, 7.1];
        known[20..40].fill(Some(8.0));
        known[21..31].copy_from_slice(&quick.map(|d| Some(d).filter(|d| *d > 0.0)));
        assert_eq!(cuts_of(&known), [0; 0], "a quick move past a frame that was not read");
        known[26] = Some(45.0);
        assert_eq!(cuts_of(&known), [26], "a cut there");
    }

    #[test]
    fn frames_without_red_light_show_no_tissue() {
        let of = |colour| Seen::of(&RgbImage::from_pixel(40, 30, Rgb(colour))).after(None).is_tissue;
        assert!(of([180, 90, 80]) && !of([120, 130, 140]) && !of([3, 2, 2]));
        let run = |is_tissue, n| vec![Shot { difference: None, is_tissue }; n];
        let all = [run(true, 3), run(false, 6), run(true, 9), run(false, 2)].concat();
        assert_eq!(without_tissue(&all), [(3, 8)], "two frames are no part");
        assert_eq!(without_tissue(&run(false, 9)), [], "a recording in grey");
    }

    #[test]
    fn what_is_dark_or_not_kept_shows_nothing() {
        // One column of 40 is lit.
        let picture = |lit| RgbImage::from_fn(40, 30, |x, _| Rgb([if x == 7 { lit } else { 3 }; 3]));
        let all = Grid::filled(40, 30, true);
        assert!(shows_something(&picture(90), &all) && !shows_something(&picture(30), &all));
        let others = Grid::from_vec(40, 30, (0..1200).map(|i| i % 40 != 7).collect());
        assert!(!shows_something(&picture(90), &others));
        assert!(!shows_something(&picture(90), &Grid::filled(40, 30, false)));
    }
}
