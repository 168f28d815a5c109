//! Projection of one Gaussian at time t onto the image plane (method §4.1–4.2); twin of
//! `shaders/project.wgsl`.

use super::{DILATION, MIN_ALPHA, MIN_EXTENT, NEAR, jacobian_guard, sh};
use crate::{
    camera::{Camera, Twist},
    deform::{Deformed, Geometry},
    gaussian::{Gaussians, MAX_SH_BANDS, SH_C0},
    real::{
        Matrix, Real, Vector, cross, dot, multiply, rotation_matrix, rotation_matrix_backward, sum,
        transform, transform_transposed, transpose,
    },
};

/// A camera in the form that the formulas need.
#[derive(Clone, Copy, Debug)]
pub struct CameraView<T> {
    rotation: Matrix<T, 3, 3>,
    translation: Vector<T, 3>,
    position: Vector<T, 3>,
    focal: Vector<T, 2>,
    centre: Vector<T, 2>,
    /// Lowest and highest x/z and y/z at which the Jacobian is evaluated.
    guard: [(T, T); 2],
}

impl<T: Real> CameraView<T> {
    /// Makes a view of a camera.
    pub fn new(camera: &Camera) -> Self {
        let (m, t) = (camera.camera_from_world.matrix3, camera.camera_from_world.translation);
        let position = camera.position_in_world();
        let guard = |size: u32, focal: f32, centre: f32| {
            let (low, high) = jacobian_guard(size, focal, centre);
            (T::of(low), T::of(high))
        };
        Self {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| T::from_f32(m.col(j)[i]))),
            translation: t.to_array().map(T::from_f32),
            position: position.to_array().map(T::from_f32),
            focal: [T::from_f32(camera.fx), T::from_f32(camera.fy)],
            centre: [T::from_f32(camera.cx), T::from_f32(camera.cy)],
            guard: [guard(camera.width, camera.fx, camera.cx), guard(camera.height, camera.fy, camera.cy)],
        }
    }

    /// The view after a small motion; exact to first order.
    #[cfg(test)]
    pub(crate) fn moved(&self, motion: &Twist<T>) -> Self {
        let [x, y, z] = motion.turn.map(|angle| angle * T::of(0.5));
        let turn = rotation_matrix(crate::real::unit_quaternion([T::one(), x, y, z]).0);
        let mut view = Self { rotation: multiply(&turn, &self.rotation), ..*self };
        view.translation = transform(&turn, self.translation);
        view.translation.iter_mut().zip(motion.shift).for_each(|(at, by)| *at += by);
        view.position = transform_transposed(&view.rotation, view.translation.map(|v| -v));
        view
    }

    /// Returns a direction in the world as one in the camera.
    pub fn to_camera(&self, direction: Vector<T, 3>) -> Vector<T, 3> {
        transform(&self.rotation, direction)
    }
}

/// A Gaussian on the image plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Splat<T> {
    /// Centre in continuous pixel coordinates; the centre of pixel (i, j) is (i + 0.5, j + 0.5).
    pub centre: Vector<T, 2>,
    /// Inverse 2-D covariance: (xx, xy, yy), px⁻².
    pub conic: Vector<T, 3>,
    /// Depth: z in the camera, scene units.
    pub depth: T,
    /// Opacity, 0–1.
    pub opacity: T,
    /// Colour seen from the camera, ≥ 0.
    pub colour: Vector<T, 3>,
    /// Half width and half height of the ellipse where alpha falls to [`MIN_ALPHA`], px; 0 if culled.
    pub extent: Vector<T, 2>,
}

impl<T: Real> Splat<T> {
    /// Returns `true` if any part of it can be seen.
    pub fn is_visible(&self) -> bool {
        self.extent[0] > T::zero()
    }

    /// Returns the way from the centre to the middle of a pixel, px, and the alpha there before it is limited.
    pub fn at_pixel(&self, x: usize, y: usize) -> (Vector<T, 2>, T) {
        let [dx, dy] = [T::of(x as f64 + 0.5) - self.centre[0], T::of(y as f64 + 0.5) - self.centre[1]];
        let q = self.conic[0] * dx * dx + T::of(2.0) * self.conic[1] * dx * dy + self.conic[2] * dy * dy;
        ([dx, dy], self.opacity * (T::of(-0.5) * q).exp())
    }
}

impl Splat<f32> {
    /// Returns the splat in f64, for the twins.
    pub fn widened(&self) -> Splat<f64> {
        Splat {
            centre: self.centre.map(f64::from),
            conic: self.conic.map(f64::from),
            depth: f64::from(self.depth),
            opacity: f64::from(self.opacity),
            colour: self.colour.map(f64::from),
            extent: self.extent.map(f64::from),
        }
    }
}

/// Gradients with respect to the values of a splat that the raster pass reads.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatGradient<T> {
    /// ∂L/∂centre, per px.
    pub centre: Vector<T, 2>,
    /// ∂L/∂conic for (xx, xy, yy), xy counted once.
    pub conic: Vector<T, 3>,
    /// ∂L/∂depth.
    pub depth: T,
    /// ∂L/∂opacity.
    pub opacity: T,
    /// ∂L/∂colour.
    pub colour: Vector<T, 3>,
}

/// Choice of the pixels of an image that are rendered: every `step`-th along both axes, starting at
/// `first`. A rendered pixel has the same value as in the full image, so that a sample can be trained on
/// in place of all pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Distance between rendered pixels, ≥ 1.
    pub step: usize,
    /// Column and row of the first pixel, < step.
    pub first: [usize; 2],
}

impl Sampling {
    /// Renders every pixel.
    pub const ALL: Self = Self { step: 1, first: [0, 0] };

    /// Number of columns and rows that are rendered of an image of `width × height`.
    pub fn size(&self, width: usize, height: usize) -> (usize, usize) {
        let count = |size: usize, first: usize| size.saturating_sub(first).div_ceil(self.step);
        (count(width, self.first[0]), count(height, self.first[1]))
    }

    /// Moves the splat to the grid of the rendered pixels.
    pub fn apply<T: Real>(&self, splat: &mut Splat<T>) {
        let step = T::of(self.step as f64);
        for (axis, first) in self.first.into_iter().enumerate() {
            let half = T::of(0.5);
            splat.centre[axis] = (splat.centre[axis] - T::of(first as f64) - half) / step + half;
            splat.extent[axis] = splat.extent[axis] / step;
        }
        splat.conic = splat.conic.map(|c| c * step * step);
    }

    /// Converts the gradient with respect to the splat on the grid to that with respect to the splat.
    pub fn apply_backward<T: Real>(&self, g: &mut SplatGradient<T>) {
        let step = T::of(self.step as f64);
        g.centre = g.centre.map(|v| v / step);
        g.conic = g.conic.map(|v| v * step * step);
    }
}

impl<T: Real> SplatGradient<T> {
    /// Centre, conic, depth, opacity, colour.
    pub fn to_array(&self) -> [T; 10] {
        let ([x, y], [xx, xy, yy], [r, g, b]) = (self.centre, self.conic, self.colour);
        [x, y, xx, xy, yy, self.depth, self.opacity, r, g, b]
    }
}

/// Intermediate values for forward and backward: camera point, Jacobian and the 2×3 square root U of the
/// covariance.
struct Footprint<T> {
    point: Vector<T, 3>,
    /// x/z and y/z, clamped to the guard, each with `true` if it was inside.
    slope: [(T, bool); 2],
    jacobian: Matrix<T, 2, 3>,
    jacobian_world: Matrix<T, 2, 3>,
    oriented: Matrix<T, 2, 3>,
    root: Matrix<T, 2, 3>,
}

impl<T: Real> Footprint<T> {
    fn new(view: &CameraView<T>, geometry: &Geometry<T>) -> Option<Self> {
        let rotated = transform(&view.rotation, geometry.mean);
        let point: Vector<T, 3> = std::array::from_fn(|i| rotated[i] + view.translation[i]);
        // Negated so that NaN fails too.
        if !(point[2] > T::from_f32(NEAR)) || !point.iter().all(|v| v.is_finite()) {
            return None;
        }
        let slope = std::array::from_fn(|i| {
            let (s, (low, high)) = (point[i] / point[2], view.guard[i]);
            (s.max(low).min(high), s >= low && s <= high)
        });
        let per_depth = [view.focal[0] / point[2], view.focal[1] / point[2]];
        let zero = T::zero();
        let jacobian = [
            [per_depth[0], zero, -per_depth[0] * slope[0].0],
            [zero, per_depth[1], -per_depth[1] * slope[1].0],
        ];
        let jacobian_world = multiply(&jacobian, &view.rotation);
        let oriented = multiply(&jacobian_world, &rotation_matrix(geometry.rotation));
        let root = oriented.map(|row| std::array::from_fn(|j| row[j] * geometry.scale[j]));
        Some(Self { point, slope, jacobian, jacobian_world, oriented, root })
    }

    /// 2-D covariance (xx, xy, yy), including the pixel's own blur.
    fn covariance(&self) -> Vector<T, 3> {
        let [u, v] = self.root;
        [dot(u, u) + T::from_f32(DILATION), dot(u, v), dot(v, v) + T::from_f32(DILATION)]
    }

    /// Determinant of the covariance, as a sum of positive numbers: xx yy − xy² would cancel for needles.
    fn determinant(&self) -> T {
        let ([u, v], blur) = (self.root, T::from_f32(DILATION));
        let across = cross(u, v);
        dot(across, across) + blur * (dot(u, u) + dot(v, v)) + blur * blur
    }
}

/// Projects one Gaussian; a culled one has extent 0. `colour` is the activated colour.
pub fn project<T: Real>(
    view: &CameraView<T>,
    geometry: &Geometry<T>,
    opacity: T,
    colour: Vector<T, 3>,
) -> Splat<T> {
    let culled = Splat::default();
    if !(opacity >= T::from_f32(MIN_ALPHA)) {
        return culled;
    }
    let Some(footprint) = Footprint::new(view, geometry) else { return culled };
    let ([xx, xy, yy], determinant) = (footprint.covariance(), footprint.determinant());
    if !(determinant > T::zero()) || !determinant.is_finite() {
        return culled;
    }
    let point = footprint.point;
    // alpha = opacity · exp(−½ q) is at least MIN_ALPHA where q ≤ cut.
    let cut = T::of(2.0) * (opacity / T::from_f32(MIN_ALPHA)).ln();
    Splat {
        centre: std::array::from_fn(|i| view.focal[i] * point[i] / point[2] + view.centre[i]),
        conic: [yy / determinant, -xy / determinant, xx / determinant],
        depth: point[2],
        opacity,
        colour,
        extent: [cut * xx, cut * yy].map(|e| e.sqrt().max(T::from_f32(MIN_EXTENT))),
    }
}

/// Gradients with respect to mean, unit quaternion and scale, and to a motion of the camera.
pub fn project_backward<T: Real>(
    view: &CameraView<T>,
    geometry: &Geometry<T>,
    g: &SplatGradient<T>,
) -> (Geometry<T>, Twist<T>) {
    let zero = Geometry { mean: [T::zero(); 3], rotation: [T::zero(); 4], scale: [T::zero(); 3] };
    let Some(footprint) = Footprint::new(view, geometry) else {
        return (zero, Twist { turn: [T::zero(); 3], shift: [T::zero(); 3] });
    };
    let g_root = covariance_root_backward(&footprint, g.conic);
    let scale = std::array::from_fn(|j| sum::<T, 2>(|i| g_root[i][j] * footprint.oriented[i][j]));
    let g_oriented: Matrix<T, 2, 3> = g_root.map(|row| std::array::from_fn(|j| row[j] * geometry.scale[j]));
    let matrix = rotation_matrix(geometry.rotation);
    let g_matrix: Matrix<T, 3, 3> = std::array::from_fn(|i| {
        std::array::from_fn(|j| sum::<T, 2>(|k| footprint.jacobian_world[k][i] * g_oriented[k][j]))
    });
    let g_jacobian_world: Matrix<T, 2, 3> = std::array::from_fn(|i| transform(&matrix, g_oriented[i]));
    let g_jacobian: Matrix<T, 2, 3> = std::array::from_fn(|i| transform(&view.rotation, g_jacobian_world[i]));
    let g_point = point_backward(view, &footprint, &g_jacobian, g);
    let g_geometry = Geometry {
        mean: transform_transposed(&view.rotation, g_point),
        rotation: rotation_matrix_backward(geometry.rotation, &g_matrix),
        scale,
    };
    (g_geometry, camera_backward(&footprint, &g_jacobian, g_point))
}

/// Gradient of the camera's motion. A turn ω moves the point in the camera by ω × p, and every column of the
/// camera's rotation W, which the Jacobian is multiplied by, by its cross product with ω.
fn camera_backward<T: Real>(
    footprint: &Footprint<T>,
    g_jacobian: &Matrix<T, 2, 3>,
    g_point: Vector<T, 3>,
) -> Twist<T> {
    let by_point = cross(footprint.point, g_point);
    // ∂L/∂W Wᵀ = Jᵀ ∂L/∂J; its odd part holds the sum of the cross products.
    let a = multiply(&transpose(&footprint.jacobian), g_jacobian);
    let by_rotation = [a[2][1] - a[1][2], a[0][2] - a[2][0], a[1][0] - a[0][1]];
    Twist { turn: std::array::from_fn(|k| by_point[k] + by_rotation[k]), shift: g_point }
}

/// Gradient of U from that of the conic: C = Σ⁻¹ gives ∂L/∂Σ = −C G C, and Σ = U Uᵀ + blur gives ∂L/∂U =
/// 2 (∂L/∂Σ) U.
fn covariance_root_backward<T: Real>(footprint: &Footprint<T>, g_conic: Vector<T, 3>) -> Matrix<T, 2, 3> {
    let ([xx, xy, yy], determinant) = (footprint.covariance(), footprint.determinant());
    if !(determinant > T::zero()) {
        return [[T::zero(); 3]; 2];
    }
    let conic = [[yy / determinant, -xy / determinant], [-xy / determinant, xx / determinant]];
    let half = g_conic[1] * T::of(0.5);
    let g = [[g_conic[0], half], [half, g_conic[2]]];
    let g_covariance = multiply(&multiply(&conic, &g), &conic).map(|row| row.map(|v| -v));
    multiply(&g_covariance, &footprint.root).map(|row| row.map(|v| v + v))
}

/// Gradient of the point in the camera, through centre, depth and Jacobian.
fn point_backward<T: Real>(
    view: &CameraView<T>,
    footprint: &Footprint<T>,
    g_jacobian: &Matrix<T, 2, 3>,
    g: &SplatGradient<T>,
) -> Vector<T, 3> {
    let [x, y, z] = footprint.point;
    let mut g_point = [T::zero(), T::zero(), g.depth];
    for (axis, value) in [x, y].into_iter().enumerate() {
        let per_depth = view.focal[axis] / z;
        let (slope, inside) = footprint.slope[axis];
        g_point[axis] += g.centre[axis] * per_depth;
        g_point[2] -= g.centre[axis] * per_depth * value / z;
        // J[axis][axis] = f/z and J[axis][2] = −f·slope/z; slope = x/z unless clamped by the guard.
        g_point[2] -= g_jacobian[axis][axis] * per_depth / z;
        g_point[2] += g_jacobian[axis][2] * per_depth * slope / z;
        if inside {
            g_point[axis] -= g_jacobian[axis][2] * per_depth / z;
            g_point[2] += g_jacobian[axis][2] * per_depth * slope / z;
        }
    }
    g_point
}

/// Colour of one Gaussian seen from the camera: max(0, 0.5 + C₀ c₀ + Σ higher bands); 0 if that is not
/// finite. `rest` is [bands][3] flat.
pub fn view_colour<T: Real>(
    view: &CameraView<T>,
    mean: Vector<T, 3>,
    band0: Vector<T, 3>,
    degree: usize,
    rest: &[T],
) -> Vector<T, 3> {
    let mut colour = band0.map(|c| T::of(0.5) + T::from_f32(SH_C0) * c);
    if degree > 0 {
        let (direction, _) = sh::unit_direction(std::array::from_fn(|i| mean[i] - view.position[i]));
        let bands = sh::bands(degree, direction);
        for (band, coefficients) in bands.iter().zip(rest.chunks_exact(3)) {
            for (c, k) in colour.iter_mut().zip(coefficients) {
                *c += *band * *k;
            }
        }
    }
    // Values that are not finite become black.
    colour.map(|c| if c.is_finite() { c.max(T::zero()) } else { T::zero() })
}

/// Gradients of [`view_colour`]: adds to `g_rest` and returns those of the mean and of band 0.
pub fn view_colour_backward<T: Real>(
    view: &CameraView<T>,
    mean: Vector<T, 3>,
    degree: usize,
    rest: &[T],
    colour: Vector<T, 3>,
    g_colour: Vector<T, 3>,
    g_rest: &mut [T],
) -> (Vector<T, 3>, Vector<T, 3>) {
    let g: Vector<T, 3> =
        std::array::from_fn(|i| if colour[i] > T::zero() { g_colour[i] } else { T::zero() });
    let g_band0 = g.map(|v| v * T::from_f32(SH_C0));
    if degree == 0 {
        return ([T::zero(); 3], g_band0);
    }
    let (direction, length) = sh::unit_direction(std::array::from_fn(|i| mean[i] - view.position[i]));
    let bands = sh::bands(degree, direction);
    let mut g_bands = [T::zero(); MAX_SH_BANDS];
    for (k, coefficients) in rest.chunks_exact(3).enumerate() {
        g_bands[k] = sum::<T, 3>(|c| g[c] * coefficients[c]);
        for c in 0..3 {
            g_rest[k * 3 + c] += g[c] * bands[k];
        }
    }
    let g_direction = sh::bands_backward(degree, direction, &g_bands);
    if length == T::zero() {
        return ([T::zero(); 3], g_band0);
    }
    let along = dot(direction, g_direction);
    (std::array::from_fn(|i| (g_direction[i] - direction[i] * along) / length), g_band0)
}

/// Projects all Gaussians of a scene at one time.
pub fn project_all(gaussians: &Gaussians, deformed: &Deformed, camera: &Camera) -> Vec<Splat<f32>> {
    let mut splats = Vec::new();
    project_into(gaussians, deformed, camera, Sampling::ALL, &mut splats);
    splats
}

/// Does the work of [`project_all`] on the grid of the rendered pixels and into the caller's memory.
pub fn project_into(
    gaussians: &Gaussians,
    deformed: &Deformed,
    camera: &Camera,
    sampling: Sampling,
    splats: &mut Vec<Splat<f32>>,
) {
    use rayon::prelude::*;
    let view = CameraView::new(camera);
    let bands = gaussians.sh_bands() * 3;
    splats.resize(gaussians.len(), Splat::default());
    splats.par_iter_mut().with_min_len(1024).enumerate().for_each(|(n, splat)| {
        let mean = deformed.means[n];
        let rest = &gaussians.sh_rest[n * bands..(n + 1) * bands];
        let colour = view_colour(&view, mean, deformed.colours[n], gaussians.sh_degree, rest);
        *splat = project(&view, &deformed.geometry(n), deformed.opacities[n], colour);
        sampling.apply(splat);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Quat, Vec3};

    fn camera() -> Camera {
        let mut camera = Camera::with_field_of_view(64, 48, 70.0);
        camera.camera_from_world = Affine3A::from_rotation_translation(
            Quat::from_euler(glam::EulerRot::XYZ, 0.1, -0.2, 0.3),
            Vec3::new(0.2, 0.1, 0.5),
        );
        camera
    }

    fn weighted(s: &Splat<f64>) -> f64 {
        let w = [0.3, -0.8, 1.7, 0.9, -1.1, 0.4];
        w[0] * s.centre[0]
            + w[1] * s.centre[1]
            + 9.0 * (w[2] * s.conic[0] + w[3] * s.conic[1] + w[4] * s.conic[2])
            + w[5] * s.depth
    }

    fn check(geometry: Geometry<f64>) {
        let view = CameraView::<f64>::new(&camera());
        let g = SplatGradient {
            centre: [0.3, -0.8],
            conic: [9.0 * 1.7, 9.0 * 0.9, 9.0 * -1.1],
            depth: 0.4,
            ..Default::default()
        };
        let (analytic, by_camera) = project_backward(&view, &geometry, &g);
        let at = |edit: &dyn Fn(&mut Geometry<f64>)| {
            let mut moved = geometry;
            edit(&mut moved);
            weighted(&project(&view, &moved, 0.7, [0.0; 3]))
        };
        let compare = |name: &str, analytic: f64, edit: &dyn Fn(&mut Geometry<f64>, f64)| {
            let h = 1e-6;
            let numeric = (at(&|m| edit(m, h)) - at(&|m| edit(m, -h))) / (2.0 * h);
            assert!(
                (analytic - numeric).abs() <= 1e-5 * (1.0 + numeric.abs()),
                "{name}: {analytic} against {numeric}"
            );
        };
        for i in 0..3 {
            compare("mean", analytic.mean[i], &|m, h| m.mean[i] += h);
            compare("scale", analytic.scale[i], &|m, h| m.scale[i] += h);
        }
        for i in 0..4 {
            compare("rotation", analytic.rotation[i], &|m, h| m.rotation[i] += h);
        }
        for i in 0..6 {
            let h = 1e-6;
            let seen = |h: f64| {
                let motion = Twist::of(std::array::from_fn(|k| if k == i { h } else { 0.0 }));
                weighted(&project(&view.moved(&motion), &geometry, 0.7, [0.0; 3]))
            };
            let (numeric, analytic) = ((seen(h) - seen(-h)) / (2.0 * h), by_camera.to_array()[i]);
            let close = (analytic - numeric).abs() <= 1e-5 * (1.0 + numeric.abs());
            assert!(close, "camera {i}: {analytic} against {numeric}");
        }
    }

    #[test]
    fn gradients_match_finite_differences_inside_and_outside_the_guard() {
        let rotation = unit([0.8, 0.3, -0.4, 0.2]);
        check(Geometry { mean: [0.3, -0.2, 3.0], rotation, scale: [0.2, 0.5, 0.1] });
        check(Geometry { mean: [6.0, -0.2, 3.0], rotation, scale: [0.2, 0.5, 0.1] });
        check(Geometry { mean: [-5.0, 5.2, 3.0], rotation, scale: [0.02, 1.5, 0.1] });
    }

    fn unit(q: [f64; 4]) -> [f64; 4] {
        crate::real::unit_quaternion(q).0
    }

    #[test]
    fn a_round_gaussian_on_the_axis_has_the_closed_form() {
        let view = CameraView::<f64>::new(&Camera::with_field_of_view(64, 48, 90.0));
        let geometry = Geometry { mean: [0.0, 0.0, 4.0], rotation: [1.0, 0.0, 0.0, 0.0], scale: [0.5; 3] };
        let splat = project(&view, &geometry, 1.0, [0.5; 3]);
        let variance = (32.0 * 0.5 / 4.0_f64).powi(2) + f64::from(DILATION);
        assert!((splat.conic[0] - 1.0 / variance).abs() < 1e-9 && splat.conic[1].abs() < 1e-12);
        assert_eq!(splat.centre, [32.0, 24.0]);
        assert!((splat.extent[0] - (2.0 * 255f64.ln() * variance).sqrt()).abs() < 1e-5);
    }

    #[test]
    fn what_cannot_be_seen_is_culled() {
        let view = CameraView::<f32>::new(&Camera::with_field_of_view(64, 48, 90.0));
        let at = |mean, scale, opacity| {
            project(&view, &Geometry { mean, rotation: [1.0, 0.0, 0.0, 0.0], scale }, opacity, [0.5; 3])
                .is_visible()
        };
        assert!(at([0.0, 0.0, 1.0], [0.1; 3], 0.5));
        assert!(!at([0.0, 0.0, 0.9 * NEAR], [0.1; 3], 0.5));
        assert!(!at([0.0, 0.0, -1.0], [0.1; 3], 0.5));
        assert!(!at([0.0, 0.0, 1.0], [0.1; 3], 0.003));
        assert!(!at([f32::NAN, 0.0, 1.0], [0.1; 3], 0.5));
        assert!(!at([0.0, 0.0, 1.0], [f32::INFINITY; 3], 0.5));
        assert!(!at([0.0, 0.0, 1.0], [0.1; 3], f32::NAN));
    }
}
