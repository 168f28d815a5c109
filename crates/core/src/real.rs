//! Formulas are written once over [`Real`]: f32 runs them in production, f64 gives the reference values.

use num_traits::Float;
use std::iter::Sum;

/// A floating-point number that the formulas are generic over.
pub trait Real:
    Float + Sum + Default + Send + Sync + std::fmt::Debug + std::ops::AddAssign + std::ops::SubAssign + 'static
{
    /// Converts a constant.
    fn of(value: f64) -> Self;
    /// Converts a value of the data.
    fn from_f32(value: f32) -> Self;
    /// 1 / (1 + e^-x) without overflow.
    fn sigmoid(self) -> Self {
        let e = (-self.abs()).exp();
        let small = e / (Self::one() + e);
        if self >= Self::zero() { Self::one() - small } else { small }
    }
}

impl Real for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
    fn from_f32(value: f32) -> Self {
        value
    }
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn from_f32(value: f32) -> Self {
        f64::from(value)
    }
}

/// A vector of `N` numbers.
pub type Vector<T, const N: usize> = [T; N];
/// `R` rows of `C` columns.
pub type Matrix<T, const R: usize, const C: usize> = [[T; C]; R];

/// Returns f(0) + … + f(N − 1). Unlike `Iterator::sum` it is always inlined; the speed of every
/// projection depends on this.
#[inline(always)]
pub fn sum<T: Real, const N: usize>(f: impl Fn(usize) -> T) -> T {
    let mut total = T::zero();
    for i in 0..N {
        total += f(i);
    }
    total
}

/// a · b.
#[inline]
pub fn dot<T: Real, const N: usize>(a: Vector<T, N>, b: Vector<T, N>) -> T {
    sum::<T, N>(|i| a[i] * b[i])
}

/// A v.
#[inline]
pub fn transform<T: Real, const R: usize, const C: usize>(
    a: &Matrix<T, R, C>,
    v: Vector<T, C>,
) -> Vector<T, R> {
    std::array::from_fn(|i| dot(a[i], v))
}

/// Aᵀ v.
#[inline]
pub fn transform_transposed<T: Real, const R: usize, const C: usize>(
    a: &Matrix<T, R, C>,
    v: Vector<T, R>,
) -> Vector<T, C> {
    std::array::from_fn(|j| sum::<T, R>(|i| a[i][j] * v[i]))
}

/// a × b.
#[inline]
pub fn cross<T: Real>(a: Vector<T, 3>, b: Vector<T, 3>) -> Vector<T, 3> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A B.
#[inline]
pub fn multiply<T: Real, const R: usize, const K: usize, const C: usize>(
    a: &Matrix<T, R, K>,
    b: &Matrix<T, K, C>,
) -> Matrix<T, R, C> {
    std::array::from_fn(|i| std::array::from_fn(|j| sum::<T, K>(|k| a[i][k] * b[k][j])))
}

/// Aᵀ.
#[inline]
pub fn transpose<T: Real, const R: usize, const C: usize>(a: &Matrix<T, R, C>) -> Matrix<T, C, R> {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// Returns the rotation matrix of a unit quaternion (w, x, y, z).
#[inline]
pub fn rotation_matrix<T: Real>([w, x, y, z]: Vector<T, 4>) -> Matrix<T, 3, 3> {
    let (one, two) = (T::one(), T::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// Returns the gradient with respect to the unit quaternion, given the gradient with respect to its matrix.
#[inline]
pub fn rotation_matrix_backward<T: Real>([w, x, y, z]: Vector<T, 4>, g: &Matrix<T, 3, 3>) -> Vector<T, 4> {
    let (two, four) = (T::of(2.0), T::of(4.0));
    let (a, b, c) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (xy, xz, yz) = (g[0][1] + g[1][0], g[0][2] + g[2][0], g[1][2] + g[2][1]);
    [
        two * (x * a + y * b + z * c),
        two * (w * a + y * xy + z * xz) - four * x * (g[1][1] + g[2][2]),
        two * (w * b + x * xy + z * yz) - four * y * (g[0][0] + g[2][2]),
        two * (w * c + x * xz + y * yz) - four * z * (g[0][0] + g[1][1]),
    ]
}

/// Returns q / ‖q‖ and ‖q‖; the identity rotation if the length is zero or not finite.
#[inline]
pub fn unit_quaternion<T: Real>(q: Vector<T, 4>) -> (Vector<T, 4>, T) {
    let length = dot(q, q).sqrt();
    if length > T::of(1e-12) && length.is_finite() {
        (q.map(|v| v / length), length)
    } else {
        ([T::one(), T::zero(), T::zero(), T::zero()], T::zero())
    }
}

/// Returns the gradient with respect to q, given the gradient with respect to q / ‖q‖; zero if q
/// has no direction.
#[inline]
pub fn unit_quaternion_backward<T: Real>(unit: Vector<T, 4>, length: T, g: Vector<T, 4>) -> Vector<T, 4> {
    if length == T::zero() {
        return [T::zero(); 4];
    }
    let along = dot(unit, g);
    std::array::from_fn(|i| (g[i] - unit[i] * along) / length)
}
