//! Dense feature maps: an embedding for every place of a picture. Training reads regions, so places that
//! are nearly the same are merged into one region. Each frame gets as many regions as 16 bits can number
//! over the recording.

use super::{FrameFeatures, NO_REGION, RegionMap};
use crate::{codec::normalise_rows, grid::Grid, num::spread, segment::DenseMap, sequence::Sequence};
use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

/// Largest number of rows of the feature table over the whole recording.
pub(super) const MAX_ROWS: usize = NO_REGION as usize - 1;
/// Largest number of regions per frame: more gain nothing once they are finer than the network sees.
const MAX_REGIONS: usize = 600;
/// Number of rounds of clustering; later ones change almost nothing.
const ROUNDS: usize = 6;
/// Number of places that one thread compares at once.
const PLACES_AT_ONCE: usize = 1024;

impl DenseMap {
    /// Merges places with nearly the same direction into regions, at the size of the frames, with the
    /// mean direction of each. Places without a direction (zero, not finite) belong to none.
    pub fn into_features(self, sequence: &Sequence) -> FrameFeatures {
        let regions = MAX_REGIONS.min(MAX_ROWS / sequence.num_frames()).max(1);
        self.clustered(regions, sequence.width(), sequence.height())
    }

    fn clustered(self, num: usize, width: usize, height: usize) -> FrameFeatures {
        let (columns, rows) = (self.width, self.height);
        let table = Array2::from_shape_vec((columns * rows, self.dim), self.values);
        let table = normalise_rows(table.unwrap_or_default());
        let known: Vec<usize> =
            (0..table.nrows()).filter(|&i| table.row(i).iter().any(|v| *v != 0.0)).collect();
        let places = table.select(Axis(0), &known);
        let (numbers, centres) = cluster(places.view(), num);
        let mut map = vec![NO_REGION; columns * rows];
        for (place, number) in known.iter().zip(numbers) {
            map[*place] = number as u16;
        }
        let regions: RegionMap = Grid::from_vec(columns, rows, map);
        let rows = centres.outer_iter().map(|row| row.to_vec()).collect();
        FrameFeatures { regions: regions.sampled(width, height), rows }
    }
}

/// Spherical k-means: returns the cluster of each row and the clusters' unit means. Starts from rows
/// evenly spread over the picture; the same rows give the same clusters.
pub(super) fn cluster(rows: ArrayView2<'_, f32>, num: usize) -> (Vec<usize>, Array2<f32>) {
    let n = rows.nrows();
    if n <= num {
        return ((0..n).collect(), rows.to_owned());
    }
    let starts: Vec<usize> = spread(n, num).collect();
    let mut centres = rows.select(Axis(0), &starts);
    let mut numbers = nearest(rows, centres.view());
    for _ in 0..ROUNDS {
        let mut sums = Array2::<f32>::zeros(centres.raw_dim());
        rows.outer_iter().zip(&numbers).for_each(|(row, &k)| sums.row_mut(k).scaled_add(1.0, &row));
        let sums = normalise_rows(sums);
        // A cluster that lost all its rows keeps its centre.
        for (mut centre, sum) in centres.outer_iter_mut().zip(sums.outer_iter()) {
            if sum.iter().any(|v| *v != 0.0) {
                centre.assign(&sum);
            }
        }
        let moved = nearest(rows, centres.view());
        if moved == numbers {
            break;
        }
        numbers = moved;
    }
    (numbers, centres)
}

/// Returns the centre with the largest cosine for each row; the first of equals.
fn nearest(rows: ArrayView2<'_, f32>, centres: ArrayView2<'_, f32>) -> Vec<usize> {
    let chunks: Vec<_> = rows.axis_chunks_iter(Axis(0), PLACES_AT_ONCE).collect();
    let best = |cosines: ndarray::ArrayView1<'_, f32>| {
        let mut best = (0, f32::NEG_INFINITY);
        for (k, &cosine) in cosines.iter().enumerate() {
            if cosine > best.1 {
                best = (k, cosine);
            }
        }
        best.0
    };
    let of_chunk =
        |chunk: &ArrayView2<'_, f32>| chunk.dot(&centres.t()).outer_iter().map(best).collect::<Vec<usize>>();
    chunks.par_iter().flat_map_iter(of_chunk).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Makes a map whose left places point along x and right ones along y; one has no direction.
    fn halves(width: usize, height: usize) -> DenseMap {
        let place = |i: usize| match i {
            0 => [0.0, 0.0],
            i if i % width * 2 < width => [2.0, 0.01 * i as f32 / (width * height) as f32],
            _ => [0.0, 3.0],
        };
        DenseMap { width, height, dim: 2, values: (0..width * height).flat_map(place).collect() }
    }

    #[test]
    fn few_places_stay_what_they_are() {
        let found = halves(4, 2).clustered(100, 8, 4);
        assert_eq!((found.regions.width, found.regions.height, found.rows.len()), (8, 4, 7));
        assert_eq!(found.regions.at(0, 0), NO_REGION);
        let row = |x, y| &found.rows[usize::from(found.regions.at(x, y))];
        assert!(row(2, 0)[0] > 0.99 && row(7, 3)[1] > 0.99);
        assert!(found.rows.iter().all(|r| (r[0].hypot(r[1]) - 1.0).abs() < 1e-5));
    }

    #[test]
    fn many_places_are_joined_with_those_like_them() {
        let found = halves(30, 20).clustered(8, 30, 20);
        assert_eq!(found.rows.len(), 8);
        for y in 1..20 {
            let row = |x| &found.rows[usize::from(found.regions.at(x, y))];
            assert!(row(3)[0] > 0.999 && row(25)[1] > 0.999);
        }
        assert_eq!(found, halves(30, 20).clustered(8, 30, 20));
    }
}
