//! Inverse search of patches, and the dense flow that they agree on (Kroeger et al. 2016, §2.1 and §2.2).

use super::{
    Vector,
    pyramid::{self, PATCH},
};
use crate::grid::Grid;
use rayon::prelude::*;

/// Distance of neighbouring patches, px.
const STRIDE: usize = 3;
/// Rows of patches that are searched one after the other. Vectors spread within these rows only, so that the
/// result is the same for any number of threads.
const STRIP_ROWS: usize = 16;
/// Most steps of descent in each of the two sweeps.
const STEPS: usize = 12;
/// Step that is too short to go on, px².
const SHORT: f32 = 1e-4;
/// Addend to both diagonal entries of a patch's Hessian, levels² per px²; flat patches stay where they start.
const DAMPING: f32 = 1.0;
/// Pixels around the image that repeat its border. Patches may leave the image this far.
const MARGIN: usize = 2 * PATCH;

/// Values of a patch, row by row.
type Block = [[f32; PATCH]; PATCH];

/// Searches every patch of `from` in `to`, first near `start`, and returns the mean flow at every pixel.
pub(super) fn searched(from: &Grid<f32>, to: &Grid<f32>, start: &Grid<Vector>) -> Grid<Vector> {
    let search = Search::new(from, to);
    search.dense(&search.sparse(start))
}

/// Images of a search, the second with its margin, and the number of patches.
struct Search<'a> {
    from: &'a Grid<f32>,
    slopes: [Grid<f32>; 2],
    to: Grid<f32>,
    columns: usize,
    rows: usize,
}

impl<'a> Search<'a> {
    fn new(from: &'a Grid<f32>, to: &Grid<f32>) -> Self {
        let inside = |at: usize, size: usize| at.saturating_sub(MARGIN).min(size - 1);
        let padded = pyramid::each_pixel(to.width + 2 * MARGIN, to.height + 2 * MARGIN, |x, y| {
            to.at(inside(x, to.width), inside(y, to.height))
        });
        let count = |size: usize| (size - PATCH).div_ceil(STRIDE) + 1;
        let (columns, rows) = (count(from.width), count(from.height));
        Self { from, slopes: pyramid::slopes(from), to: padded, columns, rows }
    }

    /// Returns the top left pixel of a patch; the last patches end at the border.
    fn corner(&self, column: usize, row: usize) -> [usize; 2] {
        [(column * STRIDE).min(self.from.width - PATCH), (row * STRIDE).min(self.from.height - PATCH)]
    }

    /// Returns the flow of all patches.
    fn sparse(&self, start: &Grid<Vector>) -> Grid<Vector> {
        let mut flows = pyramid::each_pixel(self.columns, self.rows, |column, row| {
            let [x, y] = self.corner(column, row);
            start.at(x + PATCH / 2, y + PATCH / 2)
        });
        let strips = flows.data.par_chunks_mut(self.columns * STRIP_ROWS).enumerate();
        strips.for_each(|(strip, flows)| self.search_strip(strip * STRIP_ROWS, flows));
        flows
    }

    /// Searches the patches of a strip from the first to the last, then back. Each starts at the best of its
    /// own flow and those of the two neighbours visited before; the paper has no such exchange, OpenCV has.
    fn search_strip(&self, first_row: usize, flows: &mut [Vector]) {
        let columns = self.columns;
        for i in 0..flows.len() {
            let left = (i % columns > 0).then(|| flows[i - 1]);
            let above = (i >= columns).then(|| flows[i - columns]);
            flows[i] = self.patch(first_row, i).found(&self.to, flows[i], [left, above]);
        }
        for i in (0..flows.len()).rev() {
            let right = (i % columns + 1 < columns).then(|| flows[i + 1]);
            let below = flows.get(i + columns).copied();
            flows[i] = self.patch(first_row, i).found(&self.to, flows[i], [right, below]);
        }
    }

    fn patch(&self, first_row: usize, i: usize) -> Patch {
        let corner = self.corner(i % self.columns, first_row + i / self.columns);
        Patch::new(corner, block(self.from, corner), [0, 1].map(|k| block(&self.slopes[k], corner)))
    }

    /// Averages at each pixel the flows of the patches that cover it. The weight of each is
    /// 1 / max(1, |difference in levels|) at this pixel (Kroeger et al. 2016, eq. 3).
    fn dense(&self, flows: &Grid<Vector>) -> Grid<Vector> {
        let (width, height) = (self.from.width, self.from.height);
        let covering = |at: usize, size: usize, count: usize| {
            let first = (at + 1).saturating_sub(PATCH).div_ceil(STRIDE);
            (first..count).take_while(move |k| (k * STRIDE).min(size - PATCH) <= at)
        };
        pyramid::each_pixel(width, height, |x, y| {
            let (mut sum, mut total) = ([0.0; 2], 0.0);
            for row in covering(y, height, self.rows) {
                for column in covering(x, width, self.columns) {
                    let [u, v] = flows.at(column, row);
                    let place = [x as f32 + u, y as f32 + v].map(|at| at + MARGIN as f32);
                    let difference = pyramid::level_at(&self.to, place) - self.from.at(x, y);
                    let weight = 1.0 / difference.abs().max(1.0);
                    sum = [sum[0] + weight * u, sum[1] + weight * v];
                    total += weight;
                }
            }
            sum.map(|value| value / total)
        })
    }
}

fn block(image: &Grid<f32>, [x, y]: [usize; 2]) -> Block {
    std::array::from_fn(|row| {
        let values = &image.row(y + row)[x..x + PATCH];
        std::array::from_fn(|column| values[column])
    })
}

fn centred(block: Block) -> Block {
    let mean = block.iter().flatten().sum::<f32>() / (PATCH * PATCH) as f32;
    block.map(|row| row.map(|value| value - mean))
}

/// Levels of a patch, its slopes without their mean, and the inverse [xx, xy, yy] of its Hessian.
struct Patch {
    corner: [usize; 2],
    levels: Block,
    slopes: [Block; 2],
    inverse: [f32; 3],
}

/// Likeness of a patch to a place: the sum of squared differences from their mean, levels², and the
/// Gauss-Newton step, px.
struct Fit {
    cost: f32,
    step: Vector,
}

impl Patch {
    fn new(corner: [usize; 2], levels: Block, slopes: [Block; 2]) -> Self {
        let slopes = slopes.map(centred);
        let product = |a: &Block, b: &Block| -> f32 {
            a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
        };
        let [xx, xy, yy] = [(0, 0), (0, 1), (1, 1)].map(|(a, b)| product(&slopes[a], &slopes[b]));
        let (xx, yy) = (xx + DAMPING, yy + DAMPING);
        let determinant = xx * yy - xy * xy;
        let inverse = [yy / determinant, -xy / determinant, xx / determinant];
        Self { corner, levels, slopes, inverse }
    }

    /// Compares the patch with the place that the flow leads to. The mean difference does not count; as the
    /// slopes have no mean, it leaves the step alone.
    fn compare(&self, to: &Grid<f32>, flow: Vector) -> Fit {
        let limits = [to.width, to.height].map(|size| (size - PATCH - 1) as f32);
        let [x, y] =
            std::array::from_fn(|k| ((self.corner[k] + MARGIN) as f32 + flow[k]).max(0.0).min(limits[k]));
        let (left, top) = (x as usize, y as usize);
        let (across, down) = (x - left as f32, y - top as f32);
        let shares =
            [(1.0 - across) * (1.0 - down), across * (1.0 - down), (1.0 - across) * down, across * down];
        let (mut plain, mut square) = ([0.0; PATCH], [0.0; PATCH]);
        let (mut along_x, mut along_y) = ([0.0; PATCH], [0.0; PATCH]);
        for row in 0..PATCH {
            let upper = &to.row(top + row)[left..left + PATCH + 1];
            let lower = &to.row(top + row + 1)[left..left + PATCH + 1];
            for k in 0..PATCH {
                let there = shares[0] * upper[k]
                    + shares[1] * upper[k + 1]
                    + shares[2] * lower[k]
                    + shares[3] * lower[k + 1];
                let difference = there - self.levels[row][k];
                plain[k] += difference;
                square[k] += difference * difference;
                along_x[k] += difference * self.slopes[0][row][k];
                along_y[k] += difference * self.slopes[1][row][k];
            }
        }
        let [plain, square, b_x, b_y] =
            [plain, square, along_x, along_y].map(|lanes| lanes.iter().sum::<f32>());
        let [xx, xy, yy] = self.inverse;
        Fit {
            cost: square - plain * plain / (PATCH * PATCH) as f32,
            step: [-(xx * b_x + xy * b_y), -(xy * b_x + yy * b_y)],
        }
    }

    /// Descends from the best of these flows. A descent that ends farther away than a patch is not believed.
    fn found(&self, to: &Grid<f32>, own: Vector, others: [Option<Vector>; 2]) -> Vector {
        let (mut flow, mut fit) = (own, self.compare(to, own));
        for other in others.into_iter().flatten() {
            let candidate = self.compare(to, other);
            if candidate.cost < fit.cost {
                (flow, fit) = (other, candidate);
            }
        }
        let start = flow;
        for _ in 0..STEPS {
            let next = [flow[0] + fit.step[0], flow[1] + fit.step[1]];
            let candidate = self.compare(to, next);
            if !(candidate.cost < fit.cost) {
                break;
            }
            let short = square_distance(next, flow) < SHORT;
            (flow, fit) = (next, candidate);
            if short {
                break;
            }
        }
        if square_distance(flow, start) <= (PATCH * PATCH) as f32 { flow } else { start }
    }
}

fn square_distance(a: Vector, b: Vector) -> f32 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}
