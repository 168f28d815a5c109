//! PNG and JPEG pictures: their colours, or the stored numbers. Both are rotated as the EXIF orientation
//! says. Profiles and texts in a file are skipped: they may be compressed a thousandfold.

use super::open_regular;
use crate::{
    Error, Result,
    camera::{MAX_IMAGE_PIXELS, MAX_IMAGE_SIDE, check_image_size},
    grid::Grid,
};
use image::{
    DynamicImage, ImageBuffer, ImageDecoder, ImageError, Limits, Pixel, codecs::jpeg::JpegDecoder,
    metadata::Orientation,
};
use png::{BitDepth, ColorType, Transformations};
use std::{
    fs::File,
    io::{BufReader, Cursor, Read, Seek},
    path::Path,
};

/// First bytes of every PNG.
const PNG_MAGIC: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
/// Largest size of a picture in memory in bytes: four channels of 16 bits.
const MOST_BYTES: usize = MAX_IMAGE_PIXELS * 8;

/// The stored numbers of a picture, neither spread to 8 bits nor looked up in its palette.
#[derive(Clone, Debug)]
pub struct Values {
    /// The numbers; in a picture with a palette they are indices into it.
    pub image: DynamicImage,
    /// Colours of the palette, if the numbers are indices into one.
    pub palette: Option<Vec<[u8; 3]>>,
}

/// Returns the size (columns, rows) of a picture as [`picture`] decodes it, from its header alone.
pub fn picture_size(path: &Path) -> Result<(usize, usize)> {
    let ((width, height), orientation) = match OpenPicture::open(path, Transformations::EXPAND)? {
        OpenPicture::Png(reader) => (reader.info().size(), png_orientation(&reader)),
        OpenPicture::Jpeg(mut decoder, _) => (decoder.dimensions(), jpeg_orientation(&mut decoder)),
    };
    let (width, height) = (width as usize, height as usize);
    Ok(if swaps_sides(orientation) { (height, width) } else { (width, height) })
}

/// Decodes any PNG or JPEG to the colours that it shows.
pub fn picture(path: &Path) -> Result<DynamicImage> {
    Ok(decoded(path, Transformations::EXPAND)?.image)
}

/// Decodes any PNG or JPEG to the numbers that it holds.
pub fn values(path: &Path) -> Result<Values> {
    decoded(path, Transformations::IDENTITY)
}

/// Returns the opacity of each pixel; `None` if all of them are opaque. A cut-out says by it what is cut out,
/// and shows what is there.
pub(crate) fn opacity(picture: &DynamicImage) -> Option<Grid<u16>> {
    let pixels = picture.color().has_alpha().then(|| picture.to_luma_alpha16())?;
    let (width, height) = (pixels.width() as usize, pixels.height() as usize);
    let opacity = Grid::from_vec(width, height, pixels.pixels().map(|pixel| pixel.0[1]).collect());
    opacity.data.iter().any(|value| *value < u16::MAX).then_some(opacity)
}

fn decoded(path: &Path, transformations: Transformations) -> Result<Values> {
    let (mut image, palette, orientation) = match OpenPicture::open(path, transformations)? {
        OpenPicture::Png(reader) => {
            let orientation = png_orientation(&reader);
            // A picture in true colour may suggest a palette for screens with few colours.
            let is_index = reader.info().color_type == ColorType::Indexed;
            let is_stored = is_index && transformations == Transformations::IDENTITY;
            let palette = reader.info().palette.as_ref().filter(|_| is_stored);
            let palette = palette.map(|p| p.as_chunks::<3>().0.to_vec());
            (png_image(reader).map_err(|e| unreadable(path, &e))?, palette, orientation)
        }
        OpenPicture::Jpeg(_, false) => return Err(unreadable(path, "the file is cut off")),
        OpenPicture::Jpeg(mut decoder, true) => {
            let orientation = jpeg_orientation(&mut decoder);
            let image = DynamicImage::from_decoder(*decoder);
            (image.map_err(|e| unreadable(path, &e.to_string()))?, None, orientation)
        }
    };
    image.apply_orientation(orientation);
    Ok(Values { image, palette })
}

/// A picture with a valid size, of which only the header was read.
enum OpenPicture {
    Png(Box<png::Reader<BufReader<File>>>),
    /// With `true` if the file is whole.
    Jpeg(Box<JpegDecoder<Cursor<Vec<u8>>>>, bool),
}

impl OpenPicture {
    fn open(path: &Path, transformations: Transformations) -> Result<Self> {
        let fail = |e| Error::io("open the picture", path, e);
        let file = open_regular(path).map_err(fail)?;
        if file.metadata().map_err(fail)?.len() > MOST_BYTES as u64 {
            return Err(unreadable(path, "the file is larger than any picture"));
        }
        let mut file = BufReader::new(file);
        let mut start = Vec::new();
        file.by_ref().take(PNG_MAGIC.len() as u64).read_to_end(&mut start).map_err(fail)?;
        file.rewind().map_err(fail)?;
        let fits = |(width, height): (u32, u32)| {
            check_image_size(width as usize, height as usize)
                .map_err(|what| Error::input_at(path, what, "Scale the recording down."))
        };
        if start == PNG_MAGIC {
            let wrong = |e: png::DecodingError| unreadable(path, &e.to_string());
            let mut decoder = png::Decoder::new_with_limits(file, png::Limits { bytes: MOST_BYTES });
            decoder.set_ignore_text_chunk(true);
            decoder.set_ignore_iccp_chunk(true);
            decoder.set_transformations(transformations);
            fits(decoder.read_header_info().map_err(wrong)?.size())?;
            let reader = decoder.read_info().map_err(wrong)?;
            require_palette(reader.info()).map_err(|what| unreadable(path, what))?;
            return Ok(Self::Png(Box::new(reader)));
        }
        let wrong = |e: ImageError| unreadable(path, &e.to_string());
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(fail)?;
        if bytes.is_empty() {
            return Err(unreadable(path, "the file is empty"));
        }
        let is_whole = has_jpeg_end(&bytes);
        let mut decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(wrong)?;
        fits(decoder.dimensions())?;
        decoder.set_limits(limits()).map_err(wrong)?;
        Ok(Self::Jpeg(Box::new(decoder), is_whole))
    }
}

/// Limits for decoders of JPEG.
fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE as u32);
    limits.max_image_height = Some(MAX_IMAGE_SIDE as u32);
    limits.max_alloc = Some(MOST_BYTES as u64);
    limits
}

/// Decodes a JPEG stream. The error says why that is not possible.
pub(crate) fn jpeg(bytes: &[u8]) -> Result<DynamicImage, String> {
    let mut decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions();
    check_image_size(width as usize, height as usize)?;
    decoder.set_limits(limits()).map_err(|e| e.to_string())?;
    if !has_jpeg_end(bytes) {
        return Err("it is cut off".to_owned());
    }
    DynamicImage::from_decoder(decoder).map_err(|e| e.to_string())
}

/// Returns an error unless a palette consists of 1 to 256 complete colours, with at most one opacity for
/// each. The decoder relies on this.
fn require_palette(info: &png::Info<'_>) -> Result<(), &'static str> {
    let Some(palette) = info.palette.as_deref().filter(|_| info.color_type == ColorType::Indexed) else {
        return Ok(());
    };
    let (colours, rest) = palette.as_chunks::<3>();
    let opacities = info.trns.as_ref().map_or(0, |opacities| opacities.len());
    let is_whole = rest.is_empty() && (1..=256).contains(&colours.len()) && opacities <= colours.len();
    if is_whole { Ok(()) } else { Err("its palette is damaged") }
}

fn unreadable(path: &Path, what: &str) -> Error {
    Error::input_at(
        path,
        format!("the picture cannot be read: {what}"),
        "The file may be damaged, incomplete or of another kind than PNG or JPEG.",
    )
}

fn png_orientation<R: std::io::BufRead + Seek>(reader: &png::Reader<R>) -> Orientation {
    let exif = reader.info().exif_metadata.as_deref();
    exif.and_then(Orientation::from_exif_chunk).unwrap_or(Orientation::NoTransforms)
}

/// Returns the orientation; an invalid one rotates nothing.
fn jpeg_orientation<R: std::io::BufRead + Seek>(decoder: &mut JpegDecoder<R>) -> Orientation {
    decoder.orientation().unwrap_or(Orientation::NoTransforms)
}

/// Returns `true` if the picture in a JPEG file has an end (ITU-T T.81, annex B): decoders make up what is
/// missing before it.
fn has_jpeg_end(bytes: &[u8]) -> bool {
    const END: u8 = 0xd9;
    // Behind the mark of the beginning.
    let mut rest = bytes.get(2..).unwrap_or_default();
    loop {
        let next = rest.iter().position(|byte| *byte == 0xff);
        let Some((kind, tail)) = next.and_then(|at| rest[at + 1..].split_first()) else { return false };
        rest = tail;
        match *kind {
            END => return true,
            // Filling, a byte of coded data, marks without content.
            0xff => rest = &bytes[bytes.len() - tail.len() - 1..],
            0x00 | 0x01 | 0xd0..=0xd8 => {}
            // A segment says how long it is; coded data may follow.
            _ => {
                let Some(len) = tail.first_chunk::<2>() else { return false };
                rest = tail.get(usize::from(u16::from_be_bytes(*len))..).unwrap_or_default();
            }
        }
    }
}

fn swaps_sides(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

fn png_image<R: std::io::BufRead + Seek>(mut reader: Box<png::Reader<R>>) -> Result<DynamicImage, String> {
    let (width, height) = reader.info().size();
    let size = reader.output_buffer_size().filter(|n| *n <= MOST_BYTES).ok_or("it is too large")?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(|e| e.to_string())?;
    drop(reader);
    if matches!(info.bit_depth, BitDepth::One | BitDepth::Two | BitDepth::Four) {
        bytes = unpacked(&bytes, info.line_size, width as usize, info.bit_depth as usize);
    }
    let image = match (info.color_type, info.bit_depth == BitDepth::Sixteen) {
        (ColorType::Grayscale | ColorType::Indexed, false) => {
            buffer(width, height, bytes).map(DynamicImage::ImageLuma8)
        }
        (ColorType::GrayscaleAlpha, false) => buffer(width, height, bytes).map(DynamicImage::ImageLumaA8),
        (ColorType::Rgb, false) => buffer(width, height, bytes).map(DynamicImage::ImageRgb8),
        (ColorType::Rgba, false) => buffer(width, height, bytes).map(DynamicImage::ImageRgba8),
        (ColorType::Grayscale | ColorType::Indexed, true) => {
            buffer(width, height, shorts(&bytes)).map(DynamicImage::ImageLuma16)
        }
        (ColorType::GrayscaleAlpha, true) => {
            buffer(width, height, shorts(&bytes)).map(DynamicImage::ImageLumaA16)
        }
        (ColorType::Rgb, true) => buffer(width, height, shorts(&bytes)).map(DynamicImage::ImageRgb16),
        (ColorType::Rgba, true) => buffer(width, height, shorts(&bytes)).map(DynamicImage::ImageRgba16),
    };
    image.ok_or_else(|| "it has too few pixels".into())
}

fn buffer<P: Pixel>(
    width: u32,
    height: u32,
    values: Vec<P::Subpixel>,
) -> Option<ImageBuffer<P, Vec<P::Subpixel>>> {
    ImageBuffer::from_raw(width, height, values)
}

fn shorts(bytes: &[u8]) -> Vec<u16> {
    bytes.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b)).collect()
}

/// Unpacks lines of `line_size` bytes into one byte per value of `bits` bits; the first is in
/// the highest bits.
fn unpacked(bytes: &[u8], line_size: usize, width: usize, bits: usize) -> Vec<u8> {
    let (in_a_byte, mask) = (8 / bits, (1_u8 << bits) - 1);
    let value = |line: &[u8], x: usize| line[x / in_a_byte] >> (8 - bits - x % in_a_byte * bits) & mask;
    bytes.chunks_exact(line_size).flat_map(|line| (0..width).map(move |x| value(line, x))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    fn encoded(
        color: ColorType,
        depth: BitDepth,
        size: (u32, u32),
        data: &[u8],
        extra: &[([u8; 4], Vec<u8>)],
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            encoder.set_palette(vec![0, 0, 0, 9, 8, 7, 1, 2, 3, 4, 5, 6]);
        }
        let mut writer = encoder.write_header().unwrap();
        for (kind, content) in extra {
            writer.write_chunk(png::chunk::ChunkType(*kind), content).unwrap();
        }
        writer.write_image_data(data).unwrap();
        drop(writer);
        bytes
    }

    #[test]
    fn a_jpeg_that_is_cut_off_is_refused() {
        let picture = RgbImage::from_fn(64, 48, |x, y| Rgb([(x * y) as u8, x as u8, (3 * y) as u8]));
        let mut bytes = Cursor::new(Vec::new());
        DynamicImage::from(picture).write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
        let mut bytes = bytes.into_inner();
        for behind in [&b""[..], b"\0\0", b"\xff\xff\xd9 a note"] {
            bytes.extend(behind);
            let (_kept, path) = saved(&bytes);
            assert!(super::picture(&path).is_ok());
        }
        let end = bytes.windows(2).position(|pair| pair == b"\xff\xd9").unwrap();
        for len in [end, end - 1, end / 2, 700] {
            let (_kept, path) = saved(&bytes[..len]);
            assert!(super::picture(&path).is_err(), "{len} of {end}");
        }
        let (_kept, path) = saved(b"");
        assert!(super::picture(&path).unwrap_err().to_string().contains("the file is empty"));
    }

    fn saved(bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    #[test]
    fn few_bits_are_read_as_they_are() {
        for (depth, data, wanted) in [
            (BitDepth::One, [0b0110_0000, 0b1000_0000], [0, 1, 1, 1, 0, 0]),
            (BitDepth::Two, [0b0110_1100, 0b1000_0100], [1, 2, 3, 2, 0, 1]),
        ] {
            for color in [ColorType::Grayscale, ColorType::Indexed] {
                let (_folder, path) = saved(&encoded(color, depth, (3, 2), &data, &[]));
                let read = values(&path).unwrap();
                assert_eq!(read.image.as_bytes(), wanted, "{color:?} {depth:?}");
                assert_eq!(read.palette.map(|p| p[1]), (color == ColorType::Indexed).then_some([9, 8, 7]));
            }
        }
        let (_folder, path) =
            saved(&encoded(ColorType::Grayscale, BitDepth::Four, (3, 1), &[0x1f, 0x70], &[]));
        assert_eq!(values(&path).unwrap().image.as_bytes(), [1, 15, 7]);
        assert_eq!(picture(&path).unwrap().as_bytes(), [17, 255, 119], "what it shows is spread");
        let (_folder, path) = saved(&encoded(ColorType::Grayscale, BitDepth::Sixteen, (1, 1), &[1, 2], &[]));
        assert_eq!(values(&path).unwrap().image.to_luma16().into_raw(), [258]);
        let (_folder, path) = saved(&encoded(ColorType::Indexed, BitDepth::Two, (2, 1), &[0b0110_0000], &[]));
        assert_eq!(picture(&path).unwrap().to_rgb8().into_raw(), [9, 8, 7, 1, 2, 3]);
    }

    #[test]
    fn a_suggested_palette_is_none_of_the_numbers() {
        let palette = [(*b"PLTE", vec![0, 0, 0, 9, 8, 7])];
        let (_folder, path) =
            saved(&encoded(ColorType::Rgb, BitDepth::Eight, (2, 1), &[1, 2, 3, 4, 5, 6], &palette));
        let read = values(&path).unwrap();
        assert_eq!((read.image.as_bytes(), read.palette), (&[1, 2, 3, 4, 5, 6][..], None));
    }

    /// Makes an EXIF block that contains only the orientation.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut block = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        block.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        block
    }

    #[test]
    fn pictures_are_turned_upright() {
        let chunk = |orientation| [(*b"eXIf", exif(orientation))];
        for (orientation, size, first) in [(1, (3, 2), 10), (3, (3, 2), 15), (6, (2, 3), 13), (8, (2, 3), 12)]
        {
            let data = [10, 11, 12, 13, 14, 15];
            let (_folder, path) =
                saved(&encoded(ColorType::Grayscale, BitDepth::Eight, (3, 2), &data, &chunk(orientation)));
            assert_eq!(picture_size(&path).unwrap(), size, "{orientation}");
            let image = picture(&path).unwrap();
            assert_eq!((image.width() as usize, image.height() as usize), size, "{orientation}");
            assert_eq!(image.as_bytes()[0], first, "{orientation}");
            assert_eq!(values(&path).unwrap().image, image);
        }
        let mut jpeg = Cursor::new(Vec::new());
        RgbImage::from_pixel(16, 8, Rgb([90; 3])).write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
        let block = [b"Exif\0\0", &exif(6)[..]].concat();
        let length = (block.len() as u16 + 2).to_be_bytes();
        let jpeg = jpeg.into_inner();
        let (_folder, path) = saved(&[&jpeg[..2], b"\xff\xe1", &length, &block, &jpeg[2..]].concat());
        assert_eq!(picture_size(&path).unwrap(), (8, 16));
        assert_eq!(picture(&path).unwrap().width(), 8);
    }

    #[test]
    fn sizes_beyond_a_picture_and_other_files_are_refused() {
        let mut large = encoded(ColorType::Grayscale, BitDepth::Eight, (1, 1), &[0], &[]);
        large[16..24].copy_from_slice(&[0, 0, 0x40, 0, 0, 0, 0x40, 0]);
        let sum = crc(&large[12..29]).to_be_bytes();
        large[29..33].copy_from_slice(&sum);
        for (bytes, words) in
            [(&large[..], "16384×16384"), (b"", "cannot be read"), (b"GIF89a", "cannot be read")]
        {
            let (_folder, path) = saved(bytes);
            for what in
                [picture(&path).unwrap_err(), values(&path).unwrap_err(), picture_size(&path).unwrap_err()]
            {
                assert!(what.to_string().contains(words), "{what}");
            }
        }
    }

    fn crc(bytes: &[u8]) -> u32 {
        let mut crc = flate2::Crc::new();
        crc.update(bytes);
        crc.sum()
    }

    #[test]
    fn profiles_and_texts_are_passed_over() {
        let zeros = {
            let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
            std::io::Write::write_all(&mut encoder, &vec![0; 4 << 20]).unwrap();
            encoder.finish().unwrap()
        };
        let profile = (*b"iCCP", [b"a\0\0", &zeros[..]].concat());
        let text = (*b"zTXt", [b"a\0\0", &zeros[..]].concat());
        let (_folder, path) =
            saved(&encoded(ColorType::Grayscale, BitDepth::Eight, (1, 1), &[7], &[profile, text]));
        let OpenPicture::Png(reader) = OpenPicture::open(&path, Transformations::EXPAND).unwrap() else {
            panic!()
        };
        assert!(reader.info().icc_profile.is_none() && reader.info().compressed_latin1_text.is_empty());
        assert_eq!(picture(&path).unwrap().as_bytes(), [7]);
    }
}
