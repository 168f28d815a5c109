//! Still Gaussians in Niantic's compressed format `.spz`: written in version 2, read in versions 2 and 3.
//!
//! A gzip stream of a header of 16 bytes and of columns, one after the other: places of 24 bits with a fixed
//! point, opacities, colours, log-scales, quaternions, higher colour bands. Its axes are right, up and back.

use super::{MADE_BY, Problem, Scene, ply::drop_empty_bands, still::camera_before};
use crate::{
    gaussian::Gaussians,
    num::{logit, sigmoid},
};
use flate2::{Compression, GzBuilder, read::GzDecoder};
use std::io::{Read, Write};

/// First bytes of a gzip stream.
pub(super) const MAGIC: &[u8] = &[0x1f, 0x8b];
/// "NGSP", little endian: first word of the header.
const HEADER_MAGIC: u32 = 0x5053_474e;
const HEADER: usize = 16;
/// Version that is written, and the last one that is read.
const VERSION: u32 = 2;
const LAST_VERSION: u32 = 3;
/// Largest number of Gaussians; other readers take no more.
const MOST_GAUSSIANS: u32 = 10_000_000;
/// A deflated byte stands for fewer bytes than this.
const MOST_INFLATION: u64 = 1032;

/// Bits of a place, and the most of them after the point.
const PLACE_BITS: u32 = 24;
const MOST_FRACTION_BITS: u8 = 20;
/// Bytes per unit of a colour coefficient.
const COLOUR_SCALE: f32 = 0.15 * 255.0;
/// Steps per unit of log-scale, and the log-scale of 0.
const LOG_SCALE_STEPS: f32 = 16.0;
const LEAST_LOG_SCALE: f32 = -10.0;
/// Steps between the values of bands of degree 1, and of higher ones.
const FIRST_BAND_STEP: i32 = 8;
const BAND_STEP: i32 = 16;
const FIRST_BANDS: usize = 3;
/// Signs that turn our axes (right, down, forward) into the format's, and back.
const AXES: [f32; 3] = [1.0, -1.0, -1.0];
/// The same for the higher colour bands.
const BANDS: [f32; 15] = [-1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0];

/// The header, as far as it is used.
struct Header {
    version: u32,
    count: usize,
    degree: u8,
    fraction_bits: u8,
}

impl Header {
    fn bands(&self) -> usize {
        (usize::from(self.degree) + 1).pow(2) - 1
    }

    /// Returns the bytes of a quaternion.
    fn rotation(&self) -> usize {
        if self.version < LAST_VERSION { 3 } else { 4 }
    }

    /// Returns the bytes of all columns of a Gaussian.
    fn row(&self) -> usize {
        9 + 1 + 3 + 3 + self.rotation() + 3 * self.bands()
    }

    fn to_bytes(&self) -> [u8; HEADER] {
        let mut bytes = [0; HEADER];
        bytes[..4].copy_from_slice(&HEADER_MAGIC.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.version.to_le_bytes());
        bytes[8..12].copy_from_slice(&(self.count as u32).to_le_bytes());
        bytes[12..14].copy_from_slice(&[self.degree, self.fraction_bits]);
        bytes
    }

    /// Reads the header of a stream whose deflated length is known.
    fn read(stream: &mut impl Read, deflated: u64) -> Result<Self, Problem> {
        let mut bytes = [0; HEADER];
        stream
            .read_exact(&mut bytes)
            .map_err(|_| "this is not an .spz file: its header cannot be unpacked")?;
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let (version, count, degree, fraction_bits) = (word(4), word(8), bytes[12], bytes[13]);
        if word(0) != HEADER_MAGIC {
            return Err("this gzip file is not an .spz file".into());
        }
        if !(VERSION..=LAST_VERSION).contains(&version) {
            return Err(format!("the .spz file has version {version}; versions 2 and 3 are read"));
        }
        if degree > 3 || u32::from(fraction_bits) >= PLACE_BITS {
            return Err(format!(
                "colours of degree {degree} or places with {fraction_bits} bits are not read"
            ));
        }
        let header = Self { version, count: count as usize, degree, fraction_bits };
        let is_possible = (header.count * header.row()) as u64 <= deflated.saturating_mul(MOST_INFLATION);
        if count > MOST_GAUSSIANS || !is_possible {
            return Err(format!("it is said to hold {count} Gaussians, more than can be in it"));
        }
        Ok(header)
    }
}

impl Gaussians {
    /// Returns the Gaussians as `.spz`. Numbers are rounded as the format rounds them; features are left out.
    pub fn to_spz(&self) -> Vec<u8> {
        let (bands, fraction_bits) = (self.sh_bands(), fraction_bits(&self.means));
        let header =
            Header { version: VERSION, count: self.len(), degree: self.sh_degree as u8, fraction_bits };
        let mut bytes = header.to_bytes().to_vec();
        bytes.extend(self.means.iter().flat_map(|mean| place_bytes(*mean, fraction_bits)));
        bytes.extend(self.opacity_logits.iter().map(|o| byte(255.0 * sigmoid(*o))));
        bytes.extend(self.colours.as_flattened().iter().map(|c| byte(c * COLOUR_SCALE + 127.5)));
        let log_scale = |s: &f32| byte((s - LEAST_LOG_SCALE) * LOG_SCALE_STEPS);
        bytes.extend(self.log_scales.as_flattened().iter().map(log_scale));
        bytes.extend(self.rotations.iter().flat_map(|q| first_three(*q)));
        let band = |(i, value): (usize, &f32)| band_byte(i / 3 % bands.max(1), *value);
        bytes.extend(self.sh_rest.iter().enumerate().map(band));
        let mut gzip = GzBuilder::new().comment(MADE_BY).write(Vec::new(), Compression::best());
        let written = gzip.write_all(&bytes).and_then(|()| gzip.finish());
        debug_assert!(written.is_ok(), "writing to memory does not fail");
        written.unwrap_or_default()
    }

    /// Returns the number of Gaussians with a size that `.spz` cannot tell, and that is cut to one that it can.
    pub fn beyond_spz(&self) -> usize {
        let (half, most) = (0.5 / LOG_SCALE_STEPS, LEAST_LOG_SCALE + 255.0 / LOG_SCALE_STEPS);
        let told = LEAST_LOG_SCALE - half..=most + half;
        self.log_scales.iter().filter(|sizes| sizes.iter().any(|size| !told.contains(size))).count()
    }
}

/// Returns the most bits after the point with which all places can be told.
fn fraction_bits(means: &[[f32; 3]]) -> u8 {
    let largest = means.as_flattened().iter().fold(0.0_f32, |most, v| most.max(v.abs()));
    let fits = |bits: &u8| largest * (1_u32 << bits) as f32 <= ((1 << (PLACE_BITS - 1)) - 1) as f32;
    (0..=MOST_FRACTION_BITS).rev().find(fits).unwrap_or(0)
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

fn place_bytes(mean: [f32; 3], fraction_bits: u8) -> impl Iterator<Item = u8> {
    const MOST: f32 = ((1 << (PLACE_BITS - 1)) - 1) as f32;
    let fixed =
        |k: usize| (AXES[k] * mean[k] * (1_u32 << fraction_bits) as f32).round().clamp(-MOST, MOST) as i32;
    [fixed(0), fixed(1), fixed(2)].into_iter().flat_map(|v| v.to_le_bytes().into_iter().take(3))
}

/// Returns x, y and z of a unit quaternion (w, x, y, z) whose w is positive.
fn first_three([w, x, y, z]: [f32; 4]) -> [u8; 3] {
    let length = (w * w + x * x + y * y + z * z).sqrt().max(f32::MIN_POSITIVE);
    let scale = if w < 0.0 { -127.5 } else { 127.5 } / length;
    [0, 1, 2].map(|k| byte(AXES[k] * [x, y, z][k] * scale + 127.5))
}

fn band_byte(band: usize, value: f32) -> u8 {
    let step = if band < FIRST_BANDS { FIRST_BAND_STEP } else { BAND_STEP };
    let whole = (BANDS[band] * value * 128.0).round().clamp(-1e6, 1e6) as i32 + 128;
    ((whole + step / 2).div_euclid(step) * step).clamp(0, 255) as u8
}

/// Reads a still scene. The camera stands before the Gaussians.
pub(super) fn from_bytes(bytes: &[u8]) -> Result<Scene, Problem> {
    let mut stream = GzDecoder::new(bytes);
    let header = Header::read(&mut stream, bytes.len() as u64)?;
    let expected = header.count * header.row();
    let mut columns = Vec::new();
    stream
        .take(expected as u64 + 1)
        .read_to_end(&mut columns)
        .map_err(|e| format!("the .spz file is damaged: {e}"))?;
    if columns.len() != expected {
        return Err(format!("the .spz file does not hold {} Gaussians", header.count));
    }
    let gaussians = gaussians(&header, &columns);
    let camera = camera_before(&gaussians.means);
    let mut scene = Scene::of_still(gaussians, camera);
    scene.provenance.settings = serde_json::json!({ "imported_from": "SPZ", "gaussians_left_out": 0 });
    Ok(scene)
}

fn gaussians(header: &Header, columns: &[u8]) -> Gaussians {
    let n = header.count;
    let mut rest = columns;
    let mut next = |width: usize| {
        let (column, after) = rest.split_at(n * width);
        rest = after;
        column
    };
    let (places, opacities, colours, scales) = (next(9), next(1), next(3), next(3));
    let (rotations, bands) = (next(header.rotation()), next(3 * header.bands()));
    let unit = 1.0 / (1_u32 << header.fraction_bits) as f32;
    let triples = |bytes: &[u8], value: fn(u8) -> f32| -> Vec<[f32; 3]> {
        bytes.as_chunks::<3>().0.iter().map(|b| b.map(value)).collect()
    };
    let rotation = |bytes: &[u8]| match *bytes {
        [x, y, z] => of_first_three([x, y, z]),
        [a, b, c, d] => of_smallest_three(u32::from_le_bytes([a, b, c, d])),
        _ => [1.0, 0.0, 0.0, 0.0],
    };
    let band = |(i, b): (usize, &u8)| BANDS[i / 3 % header.bands()] * (f32::from(*b) - 128.0) / 128.0;
    let mut gaussians = Gaussians {
        means: places.as_chunks::<9>().0.iter().map(|bytes| place(bytes, unit)).collect(),
        rotations: rotations.chunks_exact(header.rotation()).map(rotation).collect(),
        log_scales: triples(scales, |b| f32::from(b) / LOG_SCALE_STEPS + LEAST_LOG_SCALE),
        opacity_logits: opacities.iter().map(|b| logit(f32::from(*b) / 255.0)).collect(),
        colours: triples(colours, |b| (f32::from(b) - 127.5) / COLOUR_SCALE),
        sh_rest: bands.iter().enumerate().map(band).collect(),
        sh_degree: usize::from(header.degree),
        ..Gaussians::default()
    };
    drop_empty_bands(&mut gaussians);
    gaussians
}

fn place(bytes: &[u8; 9], unit: f32) -> [f32; 3] {
    // The lowest byte is empty, so that the sign comes out right.
    let fixed = |k: usize| i32::from_le_bytes([0, bytes[3 * k], bytes[3 * k + 1], bytes[3 * k + 2]]) >> 8;
    [0, 1, 2].map(|k| AXES[k] * fixed(k) as f32 * unit)
}

/// Returns the quaternion (w, x, y, z) of its last three numbers; w is positive.
fn of_first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f32::from(b) / 127.5 - 1.0);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    [w, AXES[0] * x, AXES[1] * y, AXES[2] * z]
}

/// Returns the quaternion (w, x, y, z) of the three numbers besides its largest: 10 bits each, the first of
/// which is the sign, and 2 bits for the place of the largest among x, y, z, w.
fn of_smallest_three(mut packed: u32) -> [f32; 4] {
    const MASK: u32 = (1 << 9) - 1;
    let largest = (packed >> 30) as usize;
    let mut q = [0.0_f32; 4];
    for k in (0..4).rev().filter(|k| *k != largest) {
        let size = std::f32::consts::FRAC_1_SQRT_2 * (packed & MASK) as f32 / MASK as f32;
        q[k] = if packed >> 9 & 1 == 1 { -size } else { size };
        packed >>= 10;
    }
    q[largest] = (1.0 - q.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    [q[3], AXES[0] * q[0], AXES[1] * q[1], AXES[2] * q[2]]
}

/// Estimates the memory of a file's contents; `None` if it cannot be read.
pub(super) fn memory_bytes(bytes: &[u8]) -> Option<u64> {
    let header = Header::read(&mut GzDecoder::new(bytes), bytes.len() as u64).ok()?;
    let numbers = 2 * (14 + 3 * header.bands()) + 32;
    Some((header.count * (header.row() + 4 * numbers)) as u64)
}

/// Tells if the first bytes of a file are those of an `.spz` with the comment of this program.
pub(super) fn is_own(start: &[u8]) -> bool {
    let comment = |stream: GzDecoder<&[u8]>| stream.header()?.comment().map(<[u8]>::to_vec);
    start.starts_with(MAGIC) && comment(GzDecoder::new(start)).is_some_and(|c| c == MADE_BY.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress;

    fn still(degree: usize) -> Gaussians {
        let mut scene = stress::ordinary(40);
        scene.gaussians.sh_degree = degree;
        let numbers = 40 * ((degree + 1).pow(2) - 1) * 3;
        scene.gaussians.sh_rest = (0..numbers).map(|i| 0.9 * (i as f32 * 0.7).sin()).collect();
        scene.all_still(0.4)
    }

    fn inflated(file: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        GzDecoder::new(file).read_to_end(&mut bytes).unwrap();
        bytes
    }

    fn deflated(bytes: &[u8]) -> Vec<u8> {
        let mut gzip = GzBuilder::new().write(Vec::new(), Compression::fast());
        gzip.write_all(bytes).unwrap();
        gzip.finish().unwrap()
    }

    fn worst(a: &[f32], b: &[f32]) -> f32 {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn gaussians_read_back_are_right_to_half_a_step() {
        for degree in 0..=3 {
            let (there, file) = (still(degree), still(degree).to_spz());
            assert!(is_own(&file) && is_own(&file[..40]) && file == still(degree).to_spz());
            let back = from_bytes(&file).unwrap().gaussians;
            assert_eq!(back.sh_degree, degree);
            assert!(worst(there.means.as_flattened(), back.means.as_flattened()) < 2e-6);
            assert!(worst(there.log_scales.as_flattened(), back.log_scales.as_flattened()) <= 0.5001 / 16.0);
            assert!(
                worst(there.colours.as_flattened(), back.colours.as_flattened()) <= 0.5001 / COLOUR_SCALE
            );
            let opacities = |g: &Gaussians| g.opacity_logits.iter().map(|o| sigmoid(*o)).collect::<Vec<_>>();
            assert!(worst(&opacities(&there), &opacities(&back)) <= 0.5001 / 255.0);
            // Bands are rounded twice: to 1/128, then to their step.
            assert!(worst(&there.sh_rest, &back.sh_rest) <= 8.51 / 128.0);
            for (a, b) in there.rotations.iter().zip(&back.rotations) {
                let cosine = a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>().abs();
                assert!(cosine > 0.9995, "{a:?} became {b:?}");
            }
        }
    }

    #[test]
    fn bytes_are_those_of_the_format() {
        let gaussians = Gaussians {
            means: vec![[1.0, 2.0, 3.0]],
            rotations: vec![[0.0, 0.0, 2.0, 0.0]],
            log_scales: vec![[-10.0, 0.0, 99.0]],
            opacity_logits: vec![0.0],
            colours: vec![[0.0, 10.0, -10.0]],
            ..Gaussians::default()
        };
        let mut bytes = inflated(&gaussians.to_spz());
        let header = [0x4e, 0x47, 0x53, 0x50, 2, 0, 0, 0, 1, 0, 0, 0, 0, 20, 0, 0];
        assert_eq!((gaussians.beyond_spz(), still(0).beyond_spz()), (1, 0), "one is too large");
        assert_eq!(bytes[..16], header, "NGSP, version, count, degree, bits, flags, reserved");
        assert_eq!(bytes[16..25], [0, 0, 0x10, 0, 0, 0xe0, 0, 0, 0xd0], "1, -2, -3: y is up, z is back");
        assert_eq!(bytes[25..], [128, 128, 255, 0, 0, 160, 255, 128, 0, 128]);
        // Version 3: the largest is w, at place 3; x is √½, y is −√½.
        bytes[4] = 3;
        bytes.truncate(32);
        bytes.extend((3_u32 << 30 | 511 << 20 | (512 | 511) << 10).to_le_bytes());
        let [w, x, y, z] = from_bytes(&deflated(&bytes)).unwrap().gaussians.rotations[0];
        let root = std::f32::consts::FRAC_1_SQRT_2;
        assert!(w.abs() < 1e-3 && (x - root).abs() < 1e-3 && (y - root).abs() < 1e-3 && z == 0.0);
    }

    #[test]
    fn a_turned_gaussian_is_turned_the_same_way_in_both_axes() {
        let there = still(1);
        let back = from_bytes(&there.to_spz()).unwrap().gaussians;
        let camera = stress::ordinary(1).cameras[0];
        let picture = |g: Gaussians| {
            use crate::raster::{CpuRenderer, Renderer};
            let scene = Scene::of_still(g, camera);
            CpuRenderer::default().render(&scene, &camera, 0.0, false).unwrap().plane(0).to_vec()
        };
        let difference = worst(&picture(there), &picture(Gaussians::clone(&back)));
        assert!(difference < 0.12, "{difference}");
    }

    #[test]
    fn broken_files_are_refused_in_words() {
        let file = still(1).to_spz();
        let whole = inflated(&file);
        let changed = |at: usize, value: u8| {
            let mut bytes = whole.clone();
            bytes[at] = value;
            from_bytes(&deflated(&bytes)).unwrap_err()
        };
        assert!(changed(0, 1).contains("not an .spz"));
        assert!(changed(4, 1).contains("version 1") && changed(4, 4).contains("version 4"));
        assert!(changed(12, 4).contains("degree 4") && changed(13, 24).contains("24 bits"));
        assert!(changed(11, 0x7f).contains("more than can be in it"));
        assert!(changed(8, 41).contains("41 Gaussians") && changed(8, 39).contains("39 Gaussians"));
        assert!(from_bytes(&file[..file.len() / 2]).unwrap_err().contains("damaged"));
        assert!(from_bytes(&file[..12]).unwrap_err().contains("header"));
        let empty = Gaussians::default().to_spz();
        assert!(from_bytes(&empty).unwrap().gaussians.is_empty());
        let mut odd = still(0);
        odd.means[0] = [f32::NAN, f32::INFINITY, -1e30];
        assert!(from_bytes(&odd.to_spz()).is_ok());
    }
}
