//! Questions of several points that look alike. A network may be unsure of a dim, even surface at a
//! single point, or see only a part of it. It usually finds such a surface from points all over it.
//!
//! Similarity is measured by the encoder's own features and by colour, at every fineness. Cells of the
//! picture are joined one by one (Ward's hierarchical clustering), and every group that arises is a question.

use super::DenseMap;
use crate::{
    codec::normalise_rows,
    grid::{Grid, Mask},
    mask::depths,
};
use image::{RgbImage, imageops::FilterType};
use kodama::{Method, linkage};
use ndarray::Array2;
use rayon::prelude::*;

/// Number of points per prompt.
const POINTS: usize = 3;
/// Number of cells along the longer side of the picture: finer ones do not help, and time grows
/// with their square.
const CELLS: usize = 32;
/// Allowed size of a group, as a share of the pixels that matter.
const SHARES: std::ops::RangeInclusive<f64> = 0.015..=0.7;
/// Weights of brightness, red against green and yellow against blue (0–1 and ±1), beside
/// features of length 1.
const COLOUR_WEIGHTS: [f32; 3] = [1.2, 0.4, 0.4];

/// Returns at most `num` prompts about the pixels of `keep`, the largest groups first. `features`
/// cover the picture.
pub(super) fn prompts(
    image: &RgbImage,
    features: Option<&DenseMap>,
    keep: &Mask,
    num: usize,
) -> Vec<Vec<[f32; 2]>> {
    let longer = keep.width.max(keep.height);
    let cells_along = |length: usize| (CELLS * length).div_ceil(longer);
    let (columns, rows) = (cells_along(keep.width), cells_along(keep.height));
    let kept = kept_cells(keep, columns, rows);
    if num == 0 || kept.len() < POINTS {
        return Vec::new();
    }
    let looks = looks(image, features, columns, rows);
    let rows_of: Vec<&[f32]> = kept.iter().map(|&i| looks[i].as_slice()).collect();
    let scale = [keep.width as f32 / columns as f32, keep.height as f32 / rows as f32];
    let wanted = |group: &Vec<usize>| SHARES.contains(&(group.len() as f64 / kept.len() as f64));
    let groups = groups(&rows_of).into_iter().filter(wanted).take(num);
    let prompt = |group: Vec<usize>| {
        let mut part = Grid::filled(columns, rows, false);
        group.iter().for_each(|&member| part.data[kept[member]] = true);
        points_inside(&part).into_iter().map(|[x, y]| [x * scale[0], y * scale[1]]).collect()
    };
    groups.map(prompt).collect()
}

/// Returns the numbers of the cells that lie mostly where `keep` is true.
fn kept_cells(keep: &Mask, columns: usize, rows: usize) -> Vec<usize> {
    let mut counts = vec![(0_usize, 0_usize); columns * rows];
    for (i, inside) in keep.data.iter().enumerate() {
        let (x, y) = (i % keep.width * columns / keep.width, i / keep.width * rows / keep.height);
        let count = &mut counts[y * columns + x];
        *count = (count.0 + 1, count.1 + usize::from(*inside));
    }
    (0..counts.len()).filter(|&i| 2 * counts[i].1 > counts[i].0).collect()
}

/// Returns the look of each cell, [rows × columns][dim + 3]: its mean feature at length 1, and its
/// weighted colour.
fn looks(image: &RgbImage, features: Option<&DenseMap>, columns: usize, rows: usize) -> Vec<Vec<f32>> {
    let small = image::imageops::resize(image, columns as u32, rows as u32, FilterType::Triangle);
    let map = features.filter(|map| map.width * map.height > 0);
    let mut looks =
        map.map_or_else(|| vec![Vec::new(); columns * rows], |map| mean_features(map, columns, rows));
    for (look, pixel) in looks.iter_mut().zip(small.pixels()) {
        let [r, g, b] = pixel.0.map(|v| f32::from(v) / 255.0);
        let colour = [(r + g + b) / 3.0, r - g, (r + g) / 2.0 - b];
        look.extend((0..3).map(|k| COLOUR_WEIGHTS[k] * colour[k]));
    }
    looks
}

fn mean_features(map: &DenseMap, columns: usize, rows: usize) -> Vec<Vec<f32>> {
    // The places that a cell covers, or the one that it lies in.
    let span = |cell: usize, cells: usize, places: usize| {
        let from = cell * places / cells;
        from..((cell + 1) * places / cells).clamp(from + 1, places)
    };
    let cell = |i: usize| {
        let mut mean = vec![0.0_f32; map.dim];
        for y in span(i / columns, rows, map.height) {
            for x in span(i % columns, columns, map.width) {
                let place = &map.values[(y * map.width + x) * map.dim..][..map.dim];
                mean.iter_mut().zip(place).for_each(|(mean, v)| *mean += v);
            }
        }
        mean
    };
    let means: Vec<f32> = (0..columns * rows).flat_map(cell).collect();
    let table = Array2::from_shape_vec((columns * rows, map.dim), means).unwrap_or_default();
    normalise_rows(table).outer_iter().map(|row| row.to_vec()).collect()
}

/// Returns every group that arises when rows are joined two by two, the last and largest first; each with
/// the numbers of its rows.
fn groups(rows: &[&[f32]]) -> Vec<Vec<usize>> {
    let n = rows.len();
    let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt();
    let mut distances: Vec<f32> =
        (0..n).into_par_iter().flat_map_iter(|i| (i + 1..n).map(move |j| apart(rows[i], rows[j]))).collect();
    let tree = linkage(&mut distances, n, Method::Ward);
    let mut members: Vec<Vec<usize>> = (0..n).map(|i| vec![i]).collect();
    for step in tree.steps() {
        members.push([&members[step.cluster1][..], &members[step.cluster2]].concat());
    }
    members.split_off(n).into_iter().rev().collect()
}

/// Returns points deep inside the part and far from each other, in cells.
fn points_inside(part: &Mask) -> Vec<[f32; 2]> {
    let depths = depths(part);
    let w = part.width;
    let place = |i: usize| [(i % w) as f32 + 0.5, (i / w) as f32 + 0.5];
    let distance = |a: [f32; 2], b: [f32; 2]| ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt();
    let mut points: Vec<[f32; 2]> = Vec::new();
    for _ in 0..POINTS {
        // The worth is the smaller of three times the depth and the distance to the nearest chosen point.
        let worth = |i: usize| {
            let depth = depths.data[i] as f32;
            points.iter().map(|p| distance(*p, place(i))).fold(3.0 * depth, f32::min)
        };
        let inside = (0..part.data.len()).filter(|&i| part.data[i]);
        points.extend(inside.max_by(|&a, &b| worth(a).total_cmp(&worth(b))).map(place));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn points_lie_deep_and_apart() {
        let squares = |i: usize| (i % 100 < 30 || i % 100 >= 60) && i / 100 < 30;
        let part = Grid::from_vec(100, 40, (0..4000).map(squares).collect());
        let points = points_inside(&part);
        assert_eq!(points.len(), POINTS);
        assert!(points.iter().any(|p| p[0] < 30.0) && points.iter().any(|p| p[0] > 60.0), "{points:?}");
        for (i, p) in points.iter().enumerate() {
            assert!(part.at(p[0] as usize, p[1] as usize));
            let apart = |q: &[f32; 2]| (p[0] - q[0]).hypot(p[1] - q[1]) > 6.0;
            assert!(points[..i].iter().all(apart), "{points:?}");
        }
    }

    /// Draws red with a grey band down the middle; outside the band, left and right look alike.
    fn picture() -> RgbImage {
        RgbImage::from_fn(128, 96, |x, y| match x {
            44..84 => Rgb([120, 120, 120]),
            _ => Rgb([180, 60 + (y % 2) as u8, 60]),
        })
    }

    fn shows(prompt: &[[f32; 2]]) -> Vec<bool> {
        prompt.iter().map(|p| (44.0..84.0).contains(&p[0])).collect()
    }

    #[test]
    fn what_looks_alike_is_asked_together_though_it_lies_apart() {
        let everything = Grid::filled(128, 96, true);
        let found = prompts(&picture(), None, &everything, 2);
        assert_eq!(found.len(), 2);
        assert_eq!(shows(&found[0]), [false; 3], "{found:?}");
        assert!(found[0].iter().any(|p| p[0] < 44.0) && found[0].iter().any(|p| p[0] > 84.0), "{found:?}");
        assert!(prompts(&picture(), None, &everything, 40).iter().any(|p| shows(p) == [true; 3]));
        assert!(prompts(&picture(), None, &everything, 0).is_empty());
        assert!(prompts(&picture(), None, &Grid::filled(128, 96, false), 9).is_empty());
    }

    #[test]
    fn points_lie_where_it_matters_only() {
        let left = Grid::from_vec(128, 96, (0..128 * 96).map(|i| i % 128 < 32).collect());
        for prompt in prompts(&picture(), None, &left, 40) {
            assert!(prompt.iter().all(|p| p[0] < 32.0), "{prompt:?}");
        }
    }

    #[test]
    fn features_tell_apart_what_colours_do_not() {
        // A network that distinguishes the upper and the lower half; values that are not numbers are ignored.
        let mut values: Vec<f32> =
            (0..16 * 12).flat_map(|i| if i / 16 < 6 { [0.0, 5.0] } else { [7.0, 0.0] }).collect();
        values[0] = f32::NAN;
        let map = DenseMap { width: 16, height: 12, dim: 2, values };
        let plain = RgbImage::from_pixel(128, 96, Rgb([90, 60, 60]));
        let halves = prompts(&plain, Some(&map), &Grid::filled(128, 96, true), 2);
        let is_upper = |prompt: &[[f32; 2]]| prompt.iter().all(|p| p[1] < 48.0);
        let is_lower = |prompt: &[[f32; 2]]| prompt.iter().all(|p| p[1] > 48.0);
        assert!(halves.iter().all(|p| is_upper(p) || is_lower(p)), "{halves:?}");
        assert!(halves.iter().any(|p| is_upper(p)) && halves.iter().any(|p| is_lower(p)), "{halves:?}");
    }
}
