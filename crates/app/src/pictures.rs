//! Pictures put together from pictures, for reports.

use image::{DynamicImage, RgbImage, imageops};
use surgtpgs_core::{Error, Result, files};

/// Pixels between the pictures of a figure.
const GAP: u32 = 4;

/// Encodes a picture as PNG.
pub(crate) fn png(picture: impl Into<DynamicImage>) -> Result<Vec<u8>> {
    files::png(picture, "Choose another size.")
}

/// Encodes a photograph as JPEG, in a fraction of the bytes.
pub(crate) fn jpeg(picture: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90);
    picture.write_with_encoder(encoder).map_err(|e| {
        Error::input(format!("a picture could not be encoded as JPEG: {e}"), "Choose another size.")
    })?;
    Ok(bytes)
}

/// Returns the picture, made smaller if it is wider than `width`.
pub(crate) fn narrowed(picture: RgbImage, width: u32) -> RgbImage {
    if picture.width() <= width {
        return picture;
    }
    let height = (u64::from(picture.height()) * u64::from(width) / u64::from(picture.width())).max(1) as u32;
    imageops::thumbnail(&picture, width, height)
}

/// Puts pictures into one row.
pub(crate) fn side_by_side(pictures: &[RgbImage]) -> RgbImage {
    let width = pictures.iter().map(|p| p.width() + GAP).sum::<u32>().saturating_sub(GAP);
    let height = pictures.iter().map(|p| p.height()).max().unwrap_or(0);
    let mut row = RgbImage::new(width, height);
    let mut x = 0;
    for picture in pictures {
        imageops::replace(&mut row, picture, i64::from(x), 0);
        x += picture.width() + GAP;
    }
    row
}

/// Puts rows one below the other.
pub(crate) fn stacked(rows: &[RgbImage]) -> RgbImage {
    let width = rows.iter().map(|r| r.width()).max().unwrap_or(0);
    let height = rows.iter().map(|r| r.height() + GAP).sum::<u32>().saturating_sub(GAP);
    let mut all = RgbImage::new(width, height);
    let mut y = 0;
    for row in rows {
        imageops::replace(&mut all, row, 0, i64::from(y));
        y += row.height() + GAP;
    }
    all
}
