// Structs that the passes hand to each other; mirrors of layout::{RestRow, DeformedRow, SplatRow}.

#import constants

// A Gaussian at rest: raw parameters.
struct RestRow {
    mean: vec3f,
    opacity_logit: f32,
    // (w, x, y, z), not normalised.
    rotation: vec4f,
    log_scale: vec3f,
    padding: f32,
    colour: vec3f,
    padding_2: f32,
}

// A Gaussian at one time: activated parameters.
struct DeformedRow {
    mean: vec3f,
    opacity: f32,
    // Unit, (w, x, y, z).
    rotation: vec4f,
    scale: vec3f,
    // Length of the quaternion before it was normalised; 0 if it had no direction.
    quaternion_length: f32,
    // Band-0 coefficients.
    colour: vec3f,
    padding_2: f32,
}

// A Gaussian on the image plane.
struct SplatRow {
    // Continuous pixels; the centre of pixel (i, j) is (i + 0.5, j + 0.5).
    centre: vec2f,
    depth: f32,
    opacity: f32,
    // Inverse covariance (xx, xy, yy).
    conic: vec3f,
    // Half width of the ellipse where alpha falls to MIN_ALPHA; 0 if culled.
    extent_x: f32,
    colour: vec3f,
    // Half height of the ellipse.
    extent_y: f32,
}

// Gradients with respect to the values of a splat that the raster pass reads.
struct SplatGradientRow {
    centre: vec2f,
    depth: f32,
    opacity: f32,
    conic: vec3f,
    // Length of the centre's gradient, for the statistics; -1 if the splat is culled.
    pull: f32,
    colour: vec3f,
    padding: f32,
}

// Alpha of a splat at the pixel at `position`, regardless of the splats in front of it and without bounds.
fn unclamped_alpha_at(splat: SplatRow, position: vec2f) -> f32 {
    let d = position - splat.centre;
    let q = splat.conic.x * d.x * d.x + 2.0 * splat.conic.y * d.x * d.y + splat.conic.z * d.y * d.y;
    return select(splat.opacity * exp(-0.5 * q), 0.0, q < 0.0);
}

// Alpha of a splat at the pixel at `position`; below MIN_ALPHA it counts as 0.
fn alpha_at(splat: SplatRow, position: vec2f) -> f32 {
    return min(MAX_ALPHA, unclamped_alpha_at(splat, position));
}
