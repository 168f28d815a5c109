//! Vectors of eight numbers, shared by several kernels.

use fearless_simd::{f32x8, prelude::*, u32x8};
use fearless_simd_macros::simd;

/// Numbers in a vector. Wider vectors make the rasterizer run out of registers with AVX2, and waste more
/// lanes at the edges of small splats.
pub(crate) const LANES: usize = 8;

/// Loads the first `inside` of [`LANES`] values; the others are 0.
#[inline(always)]
pub(crate) fn load_block(values: &[f32], inside: usize) -> [f32; LANES] {
    match values.first_chunk() {
        Some(block) if inside == LANES => *block,
        _ => std::array::from_fn(|i| if i < inside { values[i] } else { 0.0 }),
    }
}

/// 2^x for x in [-126, 126], relative error below 2e-7: nearest integer by the magic number, then the
/// minimax polynomial of degree 5. For x below -126 the result may be any number.
#[simd]
pub(crate) fn exp2<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    const MAGIC: f32 = 12_582_912.0;
    let splat = |v: f32| f32x8::splat(simd, v);
    let shifted = x + MAGIC;
    let r = x - (shifted - MAGIC);
    let mut p = splat(1.327_65e-3);
    for c in [9.675_54e-3, 5.550_713e-2, 2.402_212e-1, std::f32::consts::LN_2, 1.0] {
        p = p.mul_add(r, splat(c));
    }
    let exponent: u32x8<S> = shifted.bitcast();
    let mantissa: u32x8<S> = p.bitcast();
    (mantissa + (exponent << 23)).bitcast()
}
