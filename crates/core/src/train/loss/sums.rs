//! Sums that do not depend on the number of threads.

use crate::real::Real;
use fearless_simd::Simd;
use fearless_simd_macros::simd;

/// Rows per parallel piece. Partial sums are added piece by piece, so that the thread count does not matter.
pub(super) const STRIP_ROWS: usize = 16;

/// Sign of `v`; 0 at 0, unlike `signum`. Written so that it vectorises.
pub(super) fn sign<T: Real>(v: T) -> T {
    let one = |yes: bool| if yes { T::one() } else { T::zero() };
    one(v > T::zero()) - one(v < T::zero())
}

/// Σ f(v), in 16 lanes so that it vectorises.
#[simd]
pub(super) fn lane_sum<S: Simd, T: Real, F: Fn(T) -> T>(_: S, values: &[T], f: F) -> T {
    let (chunks, rest) = values.as_chunks::<16>();
    let mut lanes = [T::zero(); 16];
    for chunk in chunks {
        for (lane, v) in lanes.iter_mut().zip(chunk) {
            *lane += f(*v);
        }
    }
    lanes.into_iter().chain(rest.iter().map(|v| f(*v))).sum()
}
