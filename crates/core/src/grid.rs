//! Row-major images of any value type: labels, depth, masks, scores.

/// `width × height` values, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grid<T> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `data[y * width + x]`.
    pub data: Vec<T>,
}

/// Yes or no for each pixel; the producer of a mask documents the meaning of `true`.
pub type Mask = Grid<bool>;

impl<T> Grid<T> {
    /// Wraps `data`; panics if its length is not `width * height` (a programming error).
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Self {
        assert_eq!(data.len(), width * height, "grid data must have width × height values");
        Self { width, height, data }
    }

    /// Returns row `y`.
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Applies `f` to every value.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Grid<U> {
        Grid { width: self.width, height: self.height, data: self.data.iter().map(f).collect() }
    }
}

impl<T: Copy> Grid<T> {
    /// Creates a grid filled with one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, data: vec![value; width * height] }
    }

    /// Resamples to another size by nearest neighbour; an empty grid stays empty.
    pub fn sampled(&self, width: usize, height: usize) -> Self {
        if self.data.is_empty() {
            return Self { width: 0, height: 0, data: Vec::new() };
        }
        if (self.width, self.height) == (width, height) {
            return self.clone();
        }
        let at = |i: usize| {
            let (x, y) = (i % width, i / width);
            self.at((2 * x + 1) * self.width / (2 * width), (2 * y + 1) * self.height / (2 * height))
        };
        Self { width, height, data: (0..width * height).map(at).collect() }
    }

    /// Returns the value at (x, y).
    pub fn at(&self, x: usize, y: usize) -> T {
        self.data[y * self.width + x]
    }

    /// Sets the value at (x, y).
    pub fn set(&mut self, x: usize, y: usize, value: T) {
        self.data[y * self.width + x] = value;
    }
}

impl Mask {
    /// Draws a mask for a test: `#` is `true`.
    #[cfg(test)]
    pub(crate) fn drawn(rows: &[&str]) -> Self {
        let data = rows.iter().flat_map(|row| row.bytes().map(|b| b == b'#')).collect();
        Self::from_vec(rows[0].len(), rows.len(), data)
    }

    /// Returns the number of pixels that are `true`.
    pub fn count(&self) -> usize {
        self.data.iter().filter(|&&v| v).count()
    }

    /// Returns the share of the pixels that are `true`; NaN without pixels.
    pub fn share(&self) -> f64 {
        self.count() as f64 / self.data.len() as f64
    }
}
