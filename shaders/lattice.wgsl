// Rendered features -> scores, looked up in the tables of core::relevancy::Lattice (lattice/look_up.rs is
// the twin). One invocation per pixel.
//
// A pixel that no table can decide is left open: its number and its latent are appended to a list. The
// CPU, which owns the tables, scores it and makes the cells that were missing.
//
// Bindings: crates/render/src/shown/lattice.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl

const BRICK_MASK: u32 = (1u << LATTICE_BRICK_LEVELS) - 1u;
// Sigmoid of its negative is the smallest normal number, about.
const LARGEST_LOGIT: f32 = 87.0;

fn joined(at: vec3u, bits: u32) -> u32 {
    return (at.x << (2u * bits)) | (at.y << bits) | at.z;
}

// Value of a finest cell.
fn cell_at(fine: vec3u) -> u32 {
    let coarse = fine >> vec3u(2u * LATTICE_BRICK_LEVELS);
    var value = cells[joined(coarse, LATTICE_COARSE_BITS)];
    for (var level = 1u; level <= 2u && (value & LATTICE_EMPTY) == LATTICE_BRICK; level++) {
        let shift = (2u - level) * LATTICE_BRICK_LEVELS;
        let number = joined((fine >> vec3u(shift)) & vec3u(BRICK_MASK), LATTICE_BRICK_LEVELS);
        value = cells[value - LATTICE_BRICK + number];
    }
    return value;
}

fn interpolated(near: vec4f, far: vec4f, at: vec3f) -> f32 {
    let low = fma(fma(at.z, near.w, near.z), at.y, fma(at.z, near.y, near.x));
    let high = fma(fma(at.z, far.w, far.z), at.y, fma(at.z, far.y, far.x));
    return fma(high, at.x, low);
}

fn set_all(pixel: u32, score: f32) {
    for (var prompt = 0u; prompt < params.num_prompts; prompt++) {
        scores[prompt * params.num_pixels + pixel] = score;
    }
}

fn leave_open(pixel: u32, latent: vec3f) {
    open[atomicAdd(&num_open[0], 1u)] = OpenPixel(latent, pixel);
}

@compute @workgroup_size(GROUP)
fn look_up(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = flat_group(group, num_groups) * GROUP + lane;
    if pixel >= params.num_pixels {
        return;
    }
    set_all(pixel, 0.0);
    let alpha = planes[ALPHA_PLANE * params.num_pixels + pixel];
    let is_inside = (inside[pixel / 32u] >> (pixel % 32u) & 1u) == 1u;
    if !is_inside || is_nan(alpha) || alpha < params.min_alpha {
        return;
    }
    let feature = vec3f(
        planes[FEATURE_PLANE * params.num_pixels + pixel],
        planes[(FEATURE_PLANE + 1u) * params.num_pixels + pixel],
        planes[(FEATURE_PLANE + 2u) * params.num_pixels + pixel],
    );
    let shortest = MIN_LATENT_LENGTH * alpha;
    if dot(feature, feature) < shortest * shortest {
        return;
    }
    let latent = feature / alpha;
    if !(is_finite(latent.x) && is_finite(latent.y) && is_finite(latent.z)) {
        return;
    }
    let at = (latent + LATTICE_EXTENT) * LATTICE_FINE_PER_UNIT;
    if any(at < vec3f(0.0)) || any(at >= vec3f(LATTICE_FINE)) {
        leave_open(pixel, latent);
        return;
    }
    let fine = vec3u(at);
    let value = cell_at(fine);
    if value >= LATTICE_BRICK {
        leave_open(pixel, latent);
        return;
    }
    let leaf = value >> 3u;
    // Number of times that a finest cell must be doubled to get the cell.
    let doublings = 2u * LATTICE_BRICK_LEVELS - (value & 7u);
    let corner = (fine >> vec3u(doublings)) << vec3u(doublings);
    let within = (at - vec3f(corner)) / f32(1u << doublings);
    var is_open = false;
    for (var prompt = 0u; prompt < params.num_prompts; prompt++) {
        let row = 2u * (prompt * params.num_leaves + leaf);
        let margin = interpolated(polynomials[row], polynomials[row + 1u], within);
        if is_nan(margin) {
            is_open = true;
        } else {
            // A score of 0 would say that nothing is seen there.
            let logit = clamp(params.temperature * margin, -LARGEST_LOGIT, LARGEST_LOGIT);
            scores[prompt * params.num_pixels + pixel] = sigmoid(logit);
        }
    }
    if is_open {
        leave_open(pixel, latent);
    }
}

// Writes scores that were computed on the CPU.
@compute @workgroup_size(GROUP)
fn write_open(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = (flat_group(group, num_groups) * GROUP + lane) * (1u + params.num_prompts);
    if row + params.num_prompts >= arrayLength(&patches) {
        return;
    }
    let pixel = patches[row];
    for (var prompt = 0u; prompt < params.num_prompts; prompt++) {
        scores[prompt * params.num_pixels + pixel] = bitcast<f32>(patches[row + 1u + prompt]);
    }
}
