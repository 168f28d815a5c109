//! Small systems of linear equations.

use glam::DMat3;

/// A symmetric matrix, of which the lower half is stored.
pub(crate) struct Symmetric {
    n: usize,
    /// Values, row by row; those right of the diagonal are not used.
    values: Vec<f64>,
}

impl Symmetric {
    /// Creates a matrix of zeros.
    pub(crate) fn zero(n: usize) -> Self {
        Self { n, values: vec![0.0; n * n] }
    }

    /// Creates a matrix of `value(row, column)`, which is asked for `column` ≤ `row`.
    pub(crate) fn from_fn(n: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        let mut matrix = Self::zero(n);
        for row in 0..n {
            (0..=row).for_each(|column| matrix.values[row * n + column] = value(row, column));
        }
        matrix
    }

    /// Adds weight · Σ row rowᵀ to the 6×6 block on the diagonal at `start`.
    pub(crate) fn add_outer(&mut self, start: usize, rows: &[[f64; 6]], weight: f64) {
        for a in 0..6 {
            for b in 0..=a {
                let product: f64 = rows.iter().map(|row| row[a] * row[b]).sum();
                self.values[(start + a) * self.n + start + b] += weight * product;
            }
        }
    }

    /// Subtracts `value(a, b)` from the 6×6 block at (`row`, `column`), `column` ≤ `row`.
    pub(crate) fn subtract(&mut self, row: usize, column: usize, value: impl Fn(usize, usize) -> f64) {
        for a in 0..6 {
            let line = &mut self.values[(row + a) * self.n + column..][..6];
            line.iter_mut().enumerate().for_each(|(b, v)| *v -= value(a, b));
        }
    }

    /// Multiplies the diagonal by 1 + `by`.
    pub(crate) fn damp(&mut self, by: f64) {
        for k in 0..self.n {
            let diagonal = &mut self.values[k * self.n + k];
            *diagonal += by * *diagonal + 1e-12;
        }
    }

    /// Solves matrix · x = `right` in place; returns `false` if the matrix is not positive definite.
    /// The matrix is overwritten.
    pub(crate) fn solve(&mut self, right: &mut [f64]) -> bool {
        self.factorize() && self.substitute(right)
    }

    /// Replaces the matrix by its Cholesky factor; returns `false` if it is not positive definite.
    pub(crate) fn factorize(&mut self) -> bool {
        let n = self.n;
        for i in 0..n {
            let (above, from_row) = self.values.split_at_mut(i * n);
            let row = &mut from_row[..=i];
            for j in 0..i {
                let other = &above[j * n..=j * n + j];
                row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
            }
            let square = row[i] - dot(&row[..i], &row[..i]);
            if square.is_nan() || square <= 0.0 {
                return false;
            }
            row[i] = square.sqrt();
        }
        true
    }

    /// Solves factor · factorᵀ · x = `right` in place; returns `false` if x is not finite.
    pub(crate) fn substitute(&self, right: &mut [f64]) -> bool {
        let n = self.n;
        for i in 0..n {
            let row = &self.values[i * n..=i * n + i];
            right[i] = (right[i] - dot(&row[..i], &right[..i])) / row[i];
        }
        for i in (0..n).rev() {
            let row = &self.values[i * n..=i * n + i];
            right[i] /= row[i];
            let solved = right[i];
            right[..i].iter_mut().zip(row).for_each(|(r, v)| *r -= v * solved);
        }
        right.iter().all(|v| v.is_finite())
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four sums, so that the processor can add several at once.
    let (quads, rest) = a.as_chunks::<4>();
    let (others, other_rest) = b.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (a, b) in quads.iter().zip(others) {
        (0..4).for_each(|k| sums[k] += a[k] * b[k]);
    }
    sums.iter().sum::<f64>() + rest.iter().zip(other_rest).map(|(a, b)| a * b).sum::<f64>()
}

/// Returns the inverse of a symmetric positive definite matrix; `None` if it has none.
pub(crate) fn inverse3(matrix: &DMat3) -> Option<DMat3> {
    (matrix.determinant() > 0.0).then(|| matrix.inverse()).filter(DMat3::is_finite)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_are_solved_or_refused() {
        let value = |i: usize, j: usize| if i == j { 4.0 + i as f64 } else { 1.0 / (1 + i - j) as f64 };
        let mut matrix = Symmetric::from_fn(7, value);
        let at = |i: usize, j: usize| matrix.values[i.max(j) * 7 + i.min(j)];
        let truth: Vec<f64> = (0..7).map(|i| f64::from(i) - 2.5).collect();
        let mut right: Vec<f64> = (0..7).map(|i| (0..7).map(|j| at(i, j) * truth[j]).sum()).collect();
        assert!(matrix.solve(&mut right));
        assert!(right.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-12), "{right:?}");
        assert!(!Symmetric::zero(2).solve(&mut [1.0, 1.0]));
        assert_eq!(inverse3(&DMat3::ZERO), None);
    }
}
