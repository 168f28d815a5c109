//! Feature maps: an embedding for every place of a picture.

/// Embeddings of the places of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseMap {
    /// Columns of places.
    pub width: usize,
    /// Rows of places.
    pub height: usize,
    /// Length of an embedding.
    pub dim: usize,
    /// [height][width][dim].
    pub values: Vec<f32>,
}

impl DenseMap {
    /// Creates a map from planes [dim][height][width]; surplus values are left out. Panics if there are
    /// fewer (a programming error).
    pub fn of_planes(width: usize, height: usize, dim: usize, planes: &[f32]) -> Self {
        let places = width * height;
        let place = |i: usize| (0..dim).map(move |c| planes[c * places + i]);
        Self { width, height, dim, values: (0..places).flat_map(place).collect() }
    }

    /// Keeps the first `width` columns and `height` rows.
    pub fn cropped(self, width: usize, height: usize) -> Self {
        let (width, height) = (width.min(self.width), height.min(self.height));
        let rows = self.values.chunks_exact((self.width * self.dim).max(1)).take(height);
        let values = rows.flat_map(|row| &row[..width * self.dim]).copied().collect();
        Self { width, height, dim: self.dim, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_become_places() {
        let map = DenseMap::of_planes(2, 1, 3, &[1.0, 2.0, 10.0, 20.0, 100.0, 200.0]);
        assert_eq!(map.values, [1.0, 10.0, 100.0, 2.0, 20.0, 200.0]);
    }
}
