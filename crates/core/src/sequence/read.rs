//! Reading single files: listings in natural order, pictures, one-channel maps, NumPy arrays.

use crate::{Error, Result, camera::check_image_size, grid::Grid};
use half::f16;
use image::{DynamicImage, ImageError, ImageReader, RgbImage};
use ndarray::ArrayD;
use ndarray_npy::{ReadDataError, ReadNpyError, ReadNpyExt, ReadableElement};
use py_literal::Value;
use rayon::prelude::*;
use std::{
    cmp::Ordering,
    fs::File,
    io::{BufReader, Read},
    path::{Path, PathBuf},
};

/// File name endings (lower case) that count as pictures.
pub(super) const PICTURES: &[&str] = &["png", "jpg", "jpeg"];

/// Compares file names as people do: runs of digits by their number (`frame_9` before `frame_10`).
pub(super) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a, b);
    loop {
        let (digits_a, rest_a) = leading_digits(a);
        let (digits_b, rest_b) = leading_digits(b);
        if !digits_a.is_empty() && !digits_b.is_empty() {
            let (x, y) = (digits_a.trim_start_matches('0'), digits_b.trim_start_matches('0'));
            let order = x.len().cmp(&y.len()).then(x.cmp(y)).then(digits_a.len().cmp(&digits_b.len()));
            if order.is_ne() {
                return order;
            }
            (a, b) = (rest_a, rest_b);
            continue;
        }
        let (mut chars_a, mut chars_b) = (a.chars(), b.chars());
        match (chars_a.next(), chars_b.next()) {
            (None, None) => return Ordering::Equal,
            (x, y) if x != y => return x.cmp(&y),
            _ => (a, b) = (chars_a.as_str(), chars_b.as_str()),
        }
    }
}

fn leading_digits(text: &str) -> (&str, &str) {
    text.split_at(text.bytes().take_while(u8::is_ascii_digit).count())
}

/// The visible files of `folder` with one of the given endings, in natural order of their names.
pub(super) fn list(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io("list the folder", folder, e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if endings.contains(&ending.as_str()) && !file_name(&path).starts_with('.') && path.is_file() {
            files.push(path);
        }
    }
    files.sort_by(|a, b| natural_order(&file_name(a), &file_name(b)));
    Ok(files)
}

/// The last part of a path, as text.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The file name without its ending, as text.
pub(super) fn stem(path: &Path) -> String {
    path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Whether the folder `path` exists and holds at least one file with one of the endings.
pub(super) fn holds(path: &Path, endings: &[&str]) -> bool {
    path.is_dir() && list(path, endings).is_ok_and(|files| !files.is_empty())
}

/// The size (columns, rows) that all pictures share, from their headers alone.
pub(super) fn common_size(pictures: &[PathBuf]) -> Result<(usize, usize)> {
    let sizes: Vec<_> = pictures.par_iter().map(|path| size(path)).collect::<Result<_>>()?;
    let Some(&first) = sizes.first() else {
        return Err(Error::input(
            "no frames were found",
            "A recording needs at least one PNG or JPEG picture.",
        ));
    };
    match sizes.iter().position(|&s| s != first) {
        None => Ok(first),
        Some(i) => Err(Error::input_at(
            &pictures[i],
            format!("frame {i} is {}×{}, the first is {}×{}", sizes[i].0, sizes[i].1, first.0, first.1),
            "All frames of a recording must have the same size.",
        )),
    }
}

fn size(path: &Path) -> Result<(usize, usize)> {
    let (width, height) = reader(path)?.into_dimensions().map_err(|e| unreadable(path, e))?;
    if width == 0 || height == 0 {
        return Err(Error::input_at(path, "the picture is empty", ""));
    }
    let (width, height) = (width as usize, height as usize);
    check_image_size(width, height)
        .map_err(|what| Error::input_at(path, what, "Scale the recording down."))?;
    Ok((width, height))
}

fn reader(path: &Path) -> Result<ImageReader<BufReader<File>>> {
    let fail = |e| Error::io("open the picture", path, e);
    ImageReader::open(path).map_err(fail)?.with_guessed_format().map_err(fail)
}

fn unreadable(path: &Path, error: ImageError) -> Error {
    Error::input_at(
        path,
        format!("the picture cannot be read: {error}"),
        "The file may be damaged, incomplete or of another kind than PNG or JPEG.",
    )
}

/// Decodes any PNG or JPEG.
pub(super) fn picture(path: &Path) -> Result<DynamicImage> {
    reader(path)?.decode().map_err(|e| unreadable(path, e))
}

/// Decodes a frame and checks its size.
pub(super) fn frame(path: &Path, width: usize, height: usize) -> Result<RgbImage> {
    let image = picture(path)?.into_rgb8();
    expect_size(path, (image.width() as usize, image.height() as usize), (width, height))?;
    Ok(image)
}

/// Errs unless `found` is the size of the frames.
pub(super) fn expect_size(path: &Path, found: (usize, usize), frames: (usize, usize)) -> Result<()> {
    if found == frames {
        return Ok(());
    }
    Err(Error::input_at(
        path,
        format!("the picture is {}×{}, the frames are {}×{}", found.0, found.1, frames.0, frames.1),
        "Masks and labels must have the size of the frames.",
    ))
}

/// The first channel of a picture, as stored: 0–255 or, for 16-bit files, 0–65535.
pub(super) fn first_channel(path: &Path) -> Result<Grid<u16>> {
    Ok(first_channel_of(picture(path)?))
}

/// As [`first_channel`], of a decoded picture.
pub(super) fn first_channel_of(picture: DynamicImage) -> Grid<u16> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let channels = usize::from(picture.color().channel_count());
    let data = match picture {
        DynamicImage::ImageLuma16(p) => p.into_raw(),
        DynamicImage::ImageLumaA16(p) => p.as_raw().iter().step_by(channels).copied().collect(),
        DynamicImage::ImageRgb16(p) => p.as_raw().iter().step_by(channels).copied().collect(),
        DynamicImage::ImageRgba16(p) => p.as_raw().iter().step_by(channels).copied().collect(),
        // Everything else that PNG and JPEG decode to has 8 bits.
        other => other.as_bytes().iter().step_by(channels).map(|&v| u16::from(v)).collect(),
    };
    Grid::from_vec(width, height, data)
}

/// A NumPy array of any real number type: its shape and its values in row-major order.
pub fn npy(path: &Path) -> Result<(Vec<usize>, Vec<f64>)> {
    type Reader = fn(&Path) -> std::result::Result<(Vec<usize>, Vec<f64>), ReadNpyError>;
    let readers: [Reader; 8] = [
        |p| npy_of(p, |v: f32| f64::from(v)),
        |p| npy_of(p, |v: f64| v),
        |p| npy_of(p, |v: Half| v.0.to_f64()),
        |p| npy_of(p, |v: u8| f64::from(v)),
        |p| npy_of(p, |v: u16| f64::from(v)),
        |p| npy_of(p, |v: i16| f64::from(v)),
        |p| npy_of(p, |v: i32| f64::from(v)),
        |p| npy_of(p, |v: i64| v as f64),
    ];
    let mut why = "its number type is not supported".to_owned();
    for reader in readers {
        match reader(path) {
            Ok(array) => return Ok(array),
            Err(ReadNpyError::WrongDescriptor(_)) => {}
            Err(ReadNpyError::Io(error)) => return Err(Error::io("read the array", path, error)),
            Err(error) => {
                why = error.to_string();
                break;
            }
        }
    }
    Err(Error::input_at(
        path,
        format!("the array cannot be read: {why}"),
        "Save it as float32 with numpy.save.",
    ))
}

/// A half-precision number, which ndarray-npy does not read by itself.
#[derive(Clone, Copy)]
struct Half(f16);

impl ReadableElement for Half {
    fn read_to_end_exact_vec<R: Read>(
        mut reader: R,
        type_desc: &Value,
        len: usize,
    ) -> std::result::Result<Vec<Self>, ReadDataError> {
        if *type_desc != Value::String("<f2".to_owned()) {
            return Err(ReadDataError::WrongDescriptor(type_desc.clone()));
        }
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes)?;
        match bytes.len().cmp(&len.saturating_mul(2)) {
            Ordering::Less => Err(ReadDataError::MissingData),
            Ordering::Greater => Err(ReadDataError::ExtraBytes(bytes.len() - 2 * len)),
            Ordering::Equal => {
                Ok(bytes.chunks_exact(2).map(|b| Self(f16::from_le_bytes([b[0], b[1]]))).collect())
            }
        }
    }
}

fn npy_of<T: ReadableElement + Copy>(
    path: &Path,
    to_f64: fn(T) -> f64,
) -> std::result::Result<(Vec<usize>, Vec<f64>), ReadNpyError> {
    let array = ArrayD::<T>::read_npy(BufReader::new(File::open(path)?))?;
    Ok((array.shape().to_vec(), array.iter().map(|&v| to_f64(v)).collect()))
}

/// A NumPy array as a map: `[h, w]`, with any number of leading axes of length 1.
pub(crate) fn npy_map(path: &Path) -> Result<Grid<f32>> {
    let (shape, values) = npy(path)?;
    let [leading @ .., height, width] = shape.as_slice() else {
        return Err(Error::input_at(path, format!("expected a map [h, w], found the shape {shape:?}"), ""));
    };
    if leading.iter().any(|&n| n != 1) || values.is_empty() {
        return Err(Error::input_at(path, format!("expected a map [h, w], found the shape {shape:?}"), ""));
    }
    Ok(Grid::from_vec(*width, *height, values.into_iter().map(|v| v as f32).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_arrays_are_read_and_short_ones_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let header = "{'descr': '<f2', 'fortran_order': False, 'shape': (1, 2), }";
        let padded = format!("{header:<117}\n");
        let start = [&b"\x93NUMPY\x01\x00\x76\x00"[..], padded.as_bytes()].concat();
        let values: Vec<u8> = [1.5, -2.0].iter().flat_map(|v| f16::from_f64(*v).to_le_bytes()).collect();
        std::fs::write(&path, [&start[..], &values].concat()).unwrap();
        assert_eq!(npy(&path).unwrap(), (vec![1, 2], vec![1.5, -2.0]));
        assert_eq!(npy_map(&path).unwrap().data, [1.5, -2.0]);
        std::fs::write(&path, [&start[..], &values[..3]].concat()).unwrap();
        assert!(npy(&path).unwrap_err().to_string().contains("the array cannot be read"));
    }
}
