//! A compact form of scenes: numbers are rounded to whole numbers of small steps, and these are deflated.
//!
//! value = offset + step · n, with a step and an offset for each column (the last axis). The whole
//! numbers are stored column by column, each as 2 |n| (− 1 if n < 0) of 32 bits, all lowest bytes first,
//! all highest bytes last, in a zlib stream. If NAME.mix exists, [A, A] for the first axis of A, the
//! values are its product with the stored ones: weights over time are stored as their cosine transform,
//! most of which is small.

use crate::{
    deform::{COLOUR_CHANNEL, GATE_CHANNEL, MEAN_CHANNEL, ROTATION_CHANNEL, SCALE_CHANNEL, num_channels},
    scene::{Problem, Scene},
};
use flate2::read::ZlibDecoder;
use miniz_oxide::deflate::core::{
    CompressionStrategy, CompressorOxide, TDEFLFlush, TDEFLStatus, compress_to_output,
    create_comp_flags_from_zip_params,
};
use std::{collections::BTreeMap, io::Read};

/// Number of Gaussians at which the steps below are used unchanged. Smaller scenes are stored more
/// finely, larger ones less finely: the fewer Gaussians, the more of the picture each covers, and the
/// more bytes are available.
const USUAL_GAUSSIANS: f32 = 30_000.0;
const FINENESS_EXPONENT: f32 = 0.667;
/// Steps at rest: centres in pixels, others in their own units.
const CENTRE_PX: f32 = 0.02;
const ROTATION: f32 = 0.01;
const LOG_SCALE: f32 = 0.02;
const OPACITY_LOGIT: f32 = 0.03;
const COLOUR: f32 = 0.007;
const FEATURE: f32 = 0.005;
/// Steps of the weights over time.
const MOTION_PX: f32 = 0.2;
const ROTATION_OVER_TIME: f32 = 0.035;
const LOG_SCALE_OVER_TIME: f32 = 0.09;
const COLOUR_OVER_TIME: f32 = 0.025;
const GATE_OVER_TIME: f32 = 0.3;
/// Steps of centres and widths of bases that each Gaussian has for itself, as a share of the
/// recording's length.
const BASIS_TIME: f32 = 2e-4;
/// Largest n.
const MAX_COUNT: f32 = (1_u32 << 29) as f32;
/// Number of bytes of a whole number.
const PLANES: usize = 4;

/// Rounding steps of the columns of each tensor.
pub(in crate::scene) struct Steps(BTreeMap<&'static str, Vec<f32>>);

impl Steps {
    /// Chooses steps such that the pictures of `scene` change by less than their own error.
    pub(in crate::scene) fn for_scene(scene: &Scene) -> Self {
        let (pixel, dim) = (pixel_size(scene), scene.gaussians.latent_dim);
        let mut over_time = vec![GATE_OVER_TIME; num_channels(dim)];
        for (channels, step) in [
            (MEAN_CHANNEL..ROTATION_CHANNEL, MOTION_PX * pixel),
            (ROTATION_CHANNEL..SCALE_CHANNEL, ROTATION_OVER_TIME),
            (SCALE_CHANNEL..COLOUR_CHANNEL, LOG_SCALE_OVER_TIME),
            (COLOUR_CHANNEL..GATE_CHANNEL, COLOUR_OVER_TIME),
        ] {
            over_time[channels].fill(step);
        }
        let mut steps = BTreeMap::from([
            ("means", vec![CENTRE_PX * pixel; 3]),
            ("rotations", vec![ROTATION; 4]),
            ("log_scales", vec![LOG_SCALE; 3]),
            ("opacity_logits", vec![OPACITY_LOGIT]),
            ("colours", vec![COLOUR; 3]),
            ("sh_rest", vec![COLOUR; 3]),
            ("features", vec![FEATURE; dim]),
            ("basis_weights", over_time),
        ]);
        if !scene.deformation.is_shared() {
            steps.insert("basis_centres", vec![BASIS_TIME; num_channels(dim)]);
            steps.insert("basis_widths", vec![BASIS_TIME; num_channels(dim)]);
        }
        let fineness =
            (scene.gaussians.len() as f32 / USUAL_GAUSSIANS).powf(FINENESS_EXPONENT).clamp(0.25, 1.6);
        steps.values_mut().flatten().for_each(|step| *step *= fineness);
        Self(steps)
    }

    /// Returns the steps of the columns of a tensor; `None` if it is kept unchanged.
    pub(in crate::scene) fn of(&self, name: &str) -> Option<&[f32]> {
        self.0.get(name).map(Vec::as_slice)
    }
}

/// Returns the size of a pixel in scene units, for Gaussians that are nearer than most.
fn pixel_size(scene: &Scene) -> f32 {
    let Some(camera) = scene.cameras.first() else { return 1.0 };
    let depth = camera.depth_percentile(&scene.gaussians.means, 25.0);
    depth.unwrap_or(1.0) / camera.fx.max(camera.fy)
}

/// Returns the cosine transform of `n` values as a matrix of rows, whose transpose undoes it
/// (DCT-II, orthonormal).
pub(in crate::scene) fn cosines(n: usize) -> Vec<f32> {
    let value = |i: usize| {
        let (k, x) = ((i / n) as f64, (i % n) as f64 + 0.5);
        let length = if k == 0.0 { 1.0 } else { 2.0 } / n as f64;
        (length.sqrt() * (std::f64::consts::PI * k * x / n as f64).cos()) as f32
    };
    (0..n * n).map(value).collect()
}

/// Returns the transpose of `matrix`.
pub(super) fn transposed(matrix: &[f32], n: usize) -> Vec<f32> {
    (0..n * n).map(|i| matrix[i % n * n + i / n]).collect()
}

/// Number of values mixed side by side; only these are held in memory twice.
const MIXED_AT_ONCE: usize = 1 << 12;

/// Multiplies an n × n matrix with values along their first axis, n.
pub(in crate::scene) fn mix(matrix: &[f32], n: usize, values: &mut [f32]) {
    let len = values.len() / n.max(1);
    for start in (0..len).step_by(MIXED_AT_ONCE) {
        let width = MIXED_AT_ONCE.min(len - start);
        let row = |k: usize| k * len + start..k * len + start + width;
        let before: Vec<f32> = (0..n).flat_map(|k| values[row(k)].iter().copied()).collect();
        for k in 0..n {
            let out = &mut values[row(k)];
            out.fill(0.0);
            for (factor, values) in matrix[k * n..(k + 1) * n].iter().zip(before.chunks_exact(width)) {
                out.iter_mut().zip(values).for_each(|(o, v)| *o += factor * v);
            }
        }
    }
}

/// Deflated whole numbers.
pub(in crate::scene) struct Packed {
    pub(in crate::scene) bytes: Vec<u8>,
    /// Offsets of the columns.
    pub(in crate::scene) offsets: Vec<f32>,
}

/// Rounds rows of `steps.len()` columns. Numbers more than 2²⁹ steps away are clamped.
pub(in crate::scene) fn pack(values: &[f32], steps: &[f32]) -> Packed {
    let columns = steps.len();
    let mut offsets = Vec::with_capacity(columns);
    let mut counts = Vec::with_capacity(values.len());
    for (c, step) in steps.iter().enumerate() {
        let column = || values.iter().skip(c).step_by(columns);
        let (low, high) = column().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        // Zero stays exactly zero if the column has numbers on both sides of it.
        let offset = if low <= 0.0 && high >= 0.0 { 0.0 } else { 0.5 * (low + high) };
        offsets.push(offset);
        counts.extend(column().map(|v| {
            let n = ((v - offset) / step).round().clamp(-MAX_COUNT, MAX_COUNT) as i32;
            (if n < 0 { -2 * n - 1 } else { 2 * n }) as u32
        }));
    }
    let plane = |k: usize| counts.iter().map(move |n: &u32| (n >> (8 * k)) as u8);
    Packed { bytes: deflated(&(0..PLANES).flat_map(plane).collect::<Vec<u8>>()), offsets }
}

/// Effort of the search for codes, the largest of zlib.
const BEST: i32 = 9;
/// Size of the window of a zlib stream, bits.
const WINDOW_BITS: i32 = 15;

/// Returns a zlib stream of bytes. Of repetitions only runs of one byte are looked for: numbers that look
/// random repeat by chance, and naming such repetitions takes more room than the bytes do.
pub(in crate::scene) fn deflated(bytes: &[u8]) -> Vec<u8> {
    let flags = create_comp_flags_from_zip_params(BEST, WINDOW_BITS, CompressionStrategy::RLE as i32);
    let mut out = Vec::new();
    let (status, _) =
        compress_to_output(&mut CompressorOxide::new(flags), bytes, TDEFLFlush::Finish, |part| {
            out.extend_from_slice(part);
            true
        });
    debug_assert_eq!(status, TDEFLStatus::Done, "writing to memory does not fail");
    out
}

/// Returns `len` values, the inverse of [`pack`] up to rounding. The caller has reserved memory for them.
pub(super) fn unpack(bytes: &[u8], len: usize, steps: &[f32], offsets: &[f32]) -> Result<Vec<f32>, Problem> {
    let columns = steps.len();
    if columns == 0 || offsets.len() != columns || !len.is_multiple_of(columns) {
        return Err(format!("{len} values do not make {columns} columns"));
    }
    let too_few = |_| format!("it does not hold {len} values");
    let mut planes = ZlibDecoder::new(bytes);
    let mut counts = vec![0_u32; len];
    let mut column = vec![0; len / columns];
    for shift in (0..8 * PLANES).step_by(8) {
        for c in 0..columns {
            planes.read_exact(&mut column).map_err(too_few)?;
            let counts = counts.iter_mut().skip(c).step_by(columns);
            counts.zip(&column).for_each(|(n, byte)| *n |= u32::from(*byte) << shift);
        }
    }
    if planes.read(&mut [0]).map_err(|e| e.to_string())? > 0 {
        return Err(format!("it holds more than {len} values"));
    }
    let value = |(i, n): (usize, u32)| {
        let (half, c) = ((n >> 1) as f32, i % columns);
        offsets[c] + steps[c] * if n & 1 == 1 { -half - 1.0 } else { half }
    };
    Ok(counts.into_iter().enumerate().map(value).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_number_is_right_to_half_a_step(values in prop::collection::vec(-90.0_f32..90.0, 0..60)) {
            let steps = [0.01, 0.5, 3.0];
            let values = &values[..values.len() / 3 * 3];
            let packed = pack(values, &steps);
            let read = unpack(&packed.bytes, values.len(), &steps, &packed.offsets).unwrap();
            for (i, (a, b)) in values.iter().zip(&read).enumerate() {
                prop_assert!((a - b).abs() <= 0.501 * steps[i % 3], "{a} became {b}");
            }
        }
    }

    #[test]
    fn zero_stays_zero_and_outliers_are_cut() {
        let packed = pack(&[0.0, 0.3, -1e9, 1e9], &[0.1]);
        assert_eq!(packed.offsets, [0.0]);
        let read = unpack(&packed.bytes, 4, &[0.1], &[0.0]).unwrap();
        assert_eq!(read[0], 0.0);
        assert_eq!(read[2..], [-0.1 * MAX_COUNT, 0.1 * MAX_COUNT]);
    }

    #[test]
    fn the_cosine_transform_is_undone_by_its_transpose() {
        let matrix = cosines(7);
        let values: Vec<f32> = (0..21).map(|i| (i as f32).sin()).collect();
        let mut there = values.clone();
        mix(&matrix, 7, &mut there);
        assert!((there[0] - (0..7).map(|b| values[3 * b]).sum::<f32>() / 7.0_f32.sqrt()).abs() < 1e-5);
        mix(&transposed(&matrix, 7), 7, &mut there);
        assert!(values.iter().zip(&there).all(|(a, b)| (a - b).abs() < 1e-5));
        mix(&[], 0, &mut []);
    }

    #[test]
    fn damage_is_refused() {
        let packed = pack(&[1.0; 12], &[0.1, 0.1]);
        for len in [0, 11, 13, 24] {
            assert!(unpack(&packed.bytes, len, &[0.1, 0.1], &packed.offsets).is_err(), "{len}");
        }
        assert!(unpack(&packed.bytes[..5], 12, &[0.1, 0.1], &packed.offsets).is_err());
        assert!(unpack(&packed.bytes, 12, &[], &[]).is_err());
    }
}
