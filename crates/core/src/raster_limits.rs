//! Limits of the rasterizer, shared with the shaders and with pages of scenes.

/// Edge of a tile, px.
pub const TILE: usize = 16;
/// Gaussians nearer than this (scene units) are culled. Scenes in metres are seen from some centimetres away.
pub const NEAR: f32 = 0.01;
/// Blur that is added to the diagonal of the 2-D covariance (px²).
pub const DILATION: f32 = 0.3;
/// Smallest alpha of a contribution; smaller ones are skipped.
pub const MIN_ALPHA: f32 = 1.0 / 255.0;
/// Largest alpha, so that transmittance never reaches zero.
pub const MAX_ALPHA: f32 = 0.99;
/// Smallest transmittance; a pixel stops before it would fall below this.
pub const MIN_TRANSMITTANCE: f32 = 1e-4;
/// Guard of the EWA Jacobian, which is evaluated within this multiple of the image's half-extent.
pub const FRUSTUM_GUARD: f32 = 1.3;

/// Returns the lowest and the highest x/z (or y/z) at which the Jacobian is evaluated: `size` and `centre` of
/// the image and the focal length along this axis, px.
pub fn jacobian_guard(size: u32, focal: f32, centre: f32) -> (f64, f64) {
    let (size, focal, centre) = (f64::from(size), f64::from(focal), f64::from(centre));
    let slack = (f64::from(FRUSTUM_GUARD) - 1.0) * 0.5 * size;
    ((-centre - slack) / focal, (size - centre + slack) / focal)
}

/// Smallest accumulated opacity of a pixel whose depth is shown.
pub const MIN_DEPTH_ALPHA: f32 = 0.5;

/// Smallest half extent of a visible splat (px); 0 means culled.
pub const MIN_EXTENT: f32 = 1e-6;
