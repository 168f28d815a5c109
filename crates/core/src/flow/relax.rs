//! Successive over-relaxation of a system with four neighbours and two unknowns for each pixel.

use super::{Vector, pyramid::rows_at_once};
use crate::grid::Grid;
use rayon::prelude::*;

/// Sweeps over all pixels.
const SWEEPS: usize = 5;
/// Factor of over-relaxation: 1 would be Gauss-Seidel, 2 diverges.
const OMEGA: f32 = 1.6;

/// Equation of one pixel, solved for its flow: base + inverse · Σ pull · neighbour.
#[derive(Clone, Copy, Default)]
pub(super) struct Cell {
    base: Vector,
    inverse: [f32; 3],
    /// Pulls of the neighbours left, right, above and below.
    pulls: [f32; 4],
}

impl Cell {
    /// Makes the equation (matrix + Σ pull) · flow = target + Σ pull · neighbour. The symmetric matrix is
    /// [uu, uv, vv].
    pub(super) fn new(matrix: [f32; 3], target: Vector, pulls: [f32; 4]) -> Self {
        let sum: f32 = pulls.iter().sum();
        let (uu, uv, vv) = (matrix[0] + sum, matrix[1], matrix[2] + sum);
        let determinant = uu * vv - uv * uv;
        let inverse = [vv / determinant, -uv / determinant, uu / determinant];
        Self { base: product(inverse, target), inverse, pulls }
    }

    fn relaxed(&self, here: Vector, neighbours: [Vector; 4]) -> Vector {
        let mut sum = [0.0; 2];
        for (pull, [u, v]) in self.pulls.iter().zip(neighbours) {
            sum = [sum[0] + pull * u, sum[1] + pull * v];
        }
        let [u, v] = product(self.inverse, sum);
        let (u, v) = (self.base[0] + u, self.base[1] + v);
        [here[0] + OMEGA * (u - here[0]), here[1] + OMEGA * (v - here[1])]
    }
}

fn product([uu, uv, vv]: [f32; 3], [u, v]: Vector) -> Vector {
    [uu * u + uv * v, uv * u + vv * v]
}

/// Relaxes the flow towards the solution. Even rows need only odd rows and themselves, and the other way
/// round, so each half is updated in parallel.
pub(super) fn relax(cells: &Grid<Cell>, flow: &mut Grid<Vector>) {
    let width = flow.width;
    let rows = |first: usize| -> Vec<Vector> {
        flow.data.chunks_exact(width).skip(first).step_by(2).flatten().copied().collect()
    };
    let (mut even, mut odd) = (rows(0), rows(1));
    for _ in 0..SWEEPS {
        relax_half(cells, 0, &mut even, &odd);
        relax_half(cells, 1, &mut odd, &even);
    }
    for (y, row) in flow.data.chunks_exact_mut(width).enumerate() {
        let half = if y % 2 == 0 { &even } else { &odd };
        row.copy_from_slice(&half[y / 2 * width..][..width]);
    }
}

/// Updates every second row, from `first` on; `others` are the rows between.
fn relax_half(cells: &Grid<Cell>, first: usize, half: &mut [Vector], others: &[Vector]) {
    let width = cells.width;
    let last = others.len() / width - 1;
    half.par_chunks_exact_mut(width).with_min_len(rows_at_once(width)).enumerate().for_each(|(k, row)| {
        let cells = cells.row(2 * k + first);
        let [above, below] = [(k + first).saturating_sub(1), (k + first).min(last)]
            .map(|other| &others[other * width..][..width]);
        for x in (0..width).step_by(2).chain((1..width).step_by(2)) {
            let neighbours = [row[x.saturating_sub(1)], row[(x + 1).min(width - 1)], above[x], below[x]];
            row[x] = cells[x].relaxed(row[x], neighbours);
        }
    });
}
