//! Pictures and arrays as the bytes of files.

use crate::{
    Result,
    error::{Error, Hint},
};
use image::{DynamicImage, ImageFormat};
use ndarray::ArrayView;
use ndarray_npy::WriteNpyExt;
use std::io::Cursor;

/// Encodes a picture as PNG; `hint` says what can be done if it cannot be encoded.
pub fn png(picture: impl Into<DynamicImage>, hint: impl Into<Hint>) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    let encoded = picture.into().write_to(&mut bytes, ImageFormat::Png);
    encoded.map_err(|e| Error::input(format!("a picture could not be encoded as PNG: {e}"), hint))?;
    Ok(bytes.into_inner())
}

/// Encodes `values` as a NumPy array; `hint` says what can be done if they do not fill the shape.
pub fn npy(shape: &[usize], values: &[f32], hint: impl Into<Hint>) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let array = ArrayView::from_shape(shape, values).map_err(|e| e.to_string());
    let encoded = array.and_then(|array| array.write_npy(&mut bytes).map_err(|e| e.to_string()));
    encoded.map_err(|e| Error::input(format!("values could not be encoded as a NumPy array: {e}"), hint))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_read_back_as_they_were() {
        use ndarray_npy::ReadNpyExt;
        let bytes = npy(&[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.5], "").unwrap();
        let array = ndarray::Array2::<f32>::read_npy(Cursor::new(bytes)).unwrap();
        assert_eq!((array.dim(), array[[1, 2]]), ((2, 3), 6.5));
        let refused = npy(&[2, 2], &[1.0], "Choose another size.").unwrap_err().to_string();
        assert!(refused.contains("NumPy") && refused.ends_with("Choose another size."), "{refused}");
    }
}
