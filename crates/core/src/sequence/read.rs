//! Listings of folders in natural order, frames, and one-channel maps.

use crate::{
    Error, Result,
    grid::Grid,
    reading::{self, Values, npy_f32},
};
use image::{DynamicImage, RgbImage};
use rayon::prelude::*;
use std::{
    cmp::Ordering,
    io::Read,
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

/// Returns the visible files of `folder` with one of the given endings, in natural order of their names.
pub(super) fn list(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
    list_where(folder, |path| {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        endings.contains(&ending.as_str())
    })
}

/// Returns the visible files of `folder` that are `wanted`, in natural order of their names.
pub(super) fn list_where(folder: &Path, wanted: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io("list the folder", folder, e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if wanted(&path) && !file_name(&path).starts_with('.') && !path.is_dir() {
            if !path.is_file() {
                return Err(Error::input_at(
                    &path,
                    "this is a pipe, a device or a link that leads nowhere, not a file",
                    "Remove it, or put a file there.",
                ));
            }
            files.push(path);
        }
    }
    files.sort_by(|a, b| natural_order(&file_name(a), &file_name(b)));
    Ok(files)
}

/// Returns the last part of a path, as text.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Returns the file name without its ending, as text.
pub(super) fn stem(path: &Path) -> String {
    path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Returns `true` if the folder `path` exists and holds at least one file with one of the endings. Also
/// `true` if it cannot be listed: the error is then reported when it is opened.
pub(super) fn holds(path: &Path, endings: &[&str]) -> bool {
    path.is_dir() && list(path, endings).map_or(true, |files| !files.is_empty())
}

/// Returns the size (columns, rows) that all pictures share, from their headers alone.
pub(super) fn common_size(pictures: &[PathBuf]) -> Result<(usize, usize)> {
    let sizes: Vec<_> = pictures.par_iter().map(|path| reading::picture_size(path)).collect::<Result<_>>()?;
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

/// Decodes a frame and checks its size.
pub(super) fn frame(path: &Path, width: usize, height: usize) -> Result<RgbImage> {
    let image = reading::picture(path)?.into_rgb8();
    expect_size(path, (image.width() as usize, image.height() as usize), (width, height))?;
    Ok(image)
}

/// Returns an error unless `found` is the size of the frames.
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

/// Returns the brightest channel of each pixel of a mask, as stored: 0–255 or, for 16-bit files, 0–65535.
/// Masks may have any colour.
pub(crate) fn lightness(path: &Path) -> Result<Grid<u16>> {
    reading::values(path).map(brightest)
}

/// Returns the brightest channel of each pixel, as stored.
pub(super) fn brightest(picture: Values) -> Grid<u16> {
    let Values { image, palette } = picture;
    if let Some(palette) = palette {
        let brightest = |place: &u16| palette.get(usize::from(*place)).and_then(|c| c.iter().max().copied());
        return first_channel_of(image).map(|place| brightest(place).map_or(0, u16::from));
    }
    if !image.color().has_color() && !image.color().has_alpha() {
        return first_channel_of(image);
    }
    let (width, height) = (image.width() as usize, image.height() as usize);
    let is_deep = image.color().bytes_per_pixel() > image.color().channel_count();
    // Nothing is seen of a colour that is transparent.
    let brightest = |&[r, g, b, opacity]: &[u16; 4]| r.max(g).max(b).min(opacity);
    let rgba: Vec<u16> = match is_deep {
        true => image.into_rgba16().into_raw(),
        false => image.into_rgba8().as_raw().iter().map(|v| u16::from(*v)).collect(),
    };
    Grid::from_vec(width, height, rgba.as_chunks::<4>().0.iter().map(brightest).collect())
}

/// Returns the least value of a mask that is white. Every part of an instrument may have a number of its own;
/// but JPEG leaves small numbers around borders.
pub(super) fn least_white(path: &Path) -> u16 {
    const JPEG_MAGIC: [u8; 3] = [0xff, 0xd8, 0xff];
    let mut start = [0; JPEG_MAGIC.len()];
    let read = reading::open_regular(path).and_then(|mut file| file.read_exact(&mut start));
    if read.is_ok() && start == JPEG_MAGIC { 128 } else { 1 }
}

/// Returns the first channel of a decoded picture.
pub(super) fn first_channel_of(picture: DynamicImage) -> Grid<u16> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let channels = usize::from(picture.color().channel_count());
    let data = match picture {
        DynamicImage::ImageLuma16(p) => p.into_raw(),
        DynamicImage::ImageLumaA16(p) => p.as_raw().iter().step_by(channels).copied().collect(),
        DynamicImage::ImageRgb16(p) => p.as_raw().iter().step_by(channels).copied().collect(),
        DynamicImage::ImageRgba16(p) => p.as_raw().iter().step_by(channels).copied().collect(),
        // All other colour types that PNG and JPEG decode to have 8 bits.
        other => other.as_bytes().iter().step_by(channels).map(|&v| u16::from(v)).collect(),
    };
    Grid::from_vec(width, height, data)
}

/// Reads a NumPy array as a map: `[h, w]`, with any number of leading axes of length 1.
pub(crate) fn npy_map(path: &Path) -> Result<Grid<f32>> {
    let (shape, values) = npy_f32(path)?;
    let [leading @ .., height, width] = shape.as_slice() else {
        return Err(Error::input_at(path, format!("expected a map [h, w], found the shape {shape:?}"), ""));
    };
    if leading.iter().any(|&n| n != 1) || values.is_empty() {
        return Err(Error::input_at(path, format!("expected a map [h, w], found the shape {shape:?}"), ""));
    }
    Ok(Grid::from_vec(*width, *height, values))
}
