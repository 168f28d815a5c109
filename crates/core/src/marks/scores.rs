//! Scores of one frame, and where they are in doubt.

use crate::grid::{Grid, Mask};
use rayon::prelude::*;

/// Side of the blocks whose mean doubt is compared, px.
const LOOKED_AT_PX: usize = 32;

/// Scores of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameScores {
    /// One image per name, 0–1: above one half where the name is likelier than any other and than none.
    pub scores: Vec<Grid<f32>>,
    /// Closeness of the two likeliest answers, 0 (sure) to 1.
    pub doubt: Grid<f32>,
}

/// The place where one more mark would help most.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LookHere {
    /// The frame.
    pub frame: usize,
    /// The middle of the most doubtful area on it, px.
    pub point_px: [f32; 2],
    /// Mean doubt inside the field of view, 0–1.
    pub doubt: f32,
}

/// Frames on either side that a mark helps less and less.
const HELPED: usize = 8;

impl LookHere {
    /// Returns the place, of one on each of some frames, where a mark would help most: on the frame whose
    /// surroundings are in most doubt. `places` are in the order of their frames.
    pub fn best(places: &[Self]) -> Option<&Self> {
        let helped = |here: &Self| -> f32 {
            let first = places.partition_point(|other| other.frame + HELPED <= here.frame);
            let near = places[first..].iter().take_while(|other| other.frame < here.frame + HELPED);
            near.map(|other| other.doubt * (HELPED - other.frame.abs_diff(here.frame)) as f32).sum()
        };
        let sums: Vec<f32> = places.iter().map(helped).collect();
        // The first of equal ones.
        let best = (0..sums.len()).rev().max_by(|a, b| sums[*a].total_cmp(&sums[*b]))?;
        places.get(best)
    }
}

impl FrameScores {
    /// Returns the place on a frame with these scores where one more mark would help most. Pixels outside
    /// the field of view, which `keep` is, do not count.
    pub fn look_here(&self, frame: usize, keep: &Mask) -> LookHere {
        let doubt = &self.doubt;
        let (width, height) = (doubt.width, doubt.height);
        let columns = width.div_ceil(LOOKED_AT_PX);
        let mut sums = vec![0.0_f32; columns * height.div_ceil(LOOKED_AT_PX)];
        for (i, doubt) in doubt.data.iter().enumerate().filter(|(i, _)| keep.data.get(*i).is_none_or(|v| *v))
        {
            sums[i / width / LOOKED_AT_PX * columns + i % width / LOOKED_AT_PX] += doubt;
        }
        let total: f32 = sums.iter().sum();
        let best = (0..sums.len()).max_by(|a, b| sums[*a].total_cmp(&sums[*b])).unwrap_or(0);
        let middle =
            |cell: usize, size: usize| ((cell * LOOKED_AT_PX + LOOKED_AT_PX / 2).min(size - 1)) as f32 + 0.5;
        LookHere {
            frame,
            point_px: [middle(best % columns, width), middle(best / columns, height)],
            doubt: total / keep.count().max(1) as f32,
        }
    }
}

/// Turns shares into scores: p / (p + the largest of the others), nothing being one of them.
pub(super) fn scores(shares: &[Vec<f32>], width: usize, height: usize) -> FrameScores {
    // The two largest of each pixel, and the place of the largest.
    let likeliest = |i: usize| {
        let none = (1.0 - shares.iter().map(|plane| plane[i]).sum::<f32>()).max(0.0);
        let (mut first, mut second, mut place) = (none, 0.0, usize::MAX);
        for (k, plane) in shares.iter().enumerate() {
            if plane[i] > first {
                (second, first, place) = (first, plane[i], k);
            } else if plane[i] > second {
                second = plane[i];
            }
        }
        (first, second, place)
    };
    let likeliest: Vec<(f32, f32, usize)> =
        (0..width * height).into_par_iter().with_min_len(4096).map(likeliest).collect();
    let plane = |(k, shares): (usize, &Vec<f32>)| {
        let score = |(own, (first, second, place)): (&f32, &(f32, f32, usize))| {
            let other = if k == *place { second } else { first };
            if *own > 0.0 { own / (own + other) } else { 0.0 }
        };
        Grid::from_vec(width, height, shares.iter().zip(&likeliest).map(score).collect())
    };
    let doubt = likeliest.iter().map(|(first, second, _)| 1.0 - (first - second)).collect();
    FrameScores {
        scores: shares.par_iter().enumerate().map(plane).collect(),
        doubt: Grid::from_vec(width, height, doubt),
    }
}
