// Image planes -> loss terms and their gradient with respect to the planes (method section 5); twin:
// core::train::loss.
//
// For each pixel: |colour - truth| and its square, |inverse depth - truth|, |feature - wanted| if supervised, and for
// each plane |here - neighbour| to the right and below if both count. Region smoothness is added by
// regions.wgsl. Each workgroup writes one weighted sum of each term; finish_step.wgsl adds them up in order.
//
// Bindings: crates/render/src/train/step/loss.rs.

#import shared/dispatch.wgsl
#import shared/sum.wgsl

// Terms of a pixel.
struct Terms {
    colour: f32,
    depth: f32,
    variation: f32,
    features: f32,
}

// The terms in the order of core::train::LossTerms; then zeros.
fn quads_of(terms: Terms) -> array<vec4f, TERM_QUADS> {
    return array<vec4f, TERM_QUADS>(vec4f(terms.colour, terms.depth, terms.variation, terms.features));
}

fn is_supervised(p: u32) -> bool {
    return (pixels[p] >> 24u) != 0u;
}

fn varies(p: u32) -> bool {
    return params.unmasked_variation == 1u || is_supervised(p);
}

// Sum of |here - neighbour| to the right and below, and the gradient at the pixel from all four neighbours.
fn plane_variation(base: u32, p: u32, at: vec2u) -> vec2f {
    if !varies(p) {
        return vec2f(0.0);
    }
    var out = vec2f(0.0);
    let here = planes[base + p];
    let row = params.size.x;
    if at.x + 1u < params.size.x && varies(p + 1u) {
        let d = here - planes[base + p + 1u];
        out += vec2f(abs(d), sign_of(d));
    }
    if at.y + 1u < params.size.y && varies(p + row) {
        let d = here - planes[base + p + row];
        out += vec2f(abs(d), sign_of(d));
    }
    if at.x > 0u && varies(p - 1u) {
        out.y -= sign_of(planes[base + p - 1u] - here);
    }
    if at.y > 0u && varies(p - row) {
        out.y -= sign_of(planes[base + p - row] - here);
    }
    return out;
}

// Inverse depth, and 1 if there is one.
fn inverse_depth(p: u32) -> vec2f {
    let plane = params.size.x * params.size.y;
    let depth = planes[DEPTH_PLANE * plane + p];
    let alpha = planes[ALPHA_PLANE * plane + p];
    let is_opaque = params.raw_depth == 1u || alpha > MIN_LOSS_ALPHA;
    if !(is_supervised(p) && is_opaque && depth > MIN_LOSS_DEPTH) {
        return vec2f(0.0);
    }
    return vec2f(select(params.typical_depth * alpha, 1.0, params.raw_depth == 1u) / depth, 1.0);
}

fn depth_variation(here: f32, p: u32, at: vec2u) -> vec2f {
    var out = vec2f(0.0);
    let row = params.size.x;
    if at.x + 1u < params.size.x {
        let other = inverse_depth(p + 1u);
        out += other.y * vec2f(abs(here - other.x), sign_of(here - other.x));
    }
    if at.y + 1u < params.size.y {
        let other = inverse_depth(p + row);
        out += other.y * vec2f(abs(here - other.x), sign_of(here - other.x));
    }
    if at.x > 0u {
        let other = inverse_depth(p - 1u);
        out.y -= other.y * sign_of(other.x - here);
    }
    if at.y > 0u {
        let other = inverse_depth(p - row);
        out.y -= other.y * sign_of(other.x - here);
    }
    return out;
}

// Writes the gradients of depth and alpha; returns the depth and variation terms.
fn depth_terms(p: u32, at: vec2u) -> vec2f {
    let plane = params.size.x * params.size.y;
    var g_depth = 0.0;
    var g_alpha = 0.0;
    var terms = vec2f(0.0);
    let inverse = inverse_depth(p);
    if params.has_depth == 1u && inverse.y > 0.0 {
        var typical = params.typical_depth;
        if params.raw_depth == 1u {
            typical = 1.0;
        }
        let variation = depth_variation(inverse.x, p, at);
        var difference = 0.0;
        if depths[p] > 0.0 {
            difference = inverse.x - typical / depths[p];
        }
        let g = sign_of(difference) * params.depth_difference + variation.y * params.depth_variation;
        let depth = planes[DEPTH_PLANE * plane + p];
        g_depth = -g * inverse.x / depth;
        g_alpha = select(g * typical / depth, 0.0, params.raw_depth == 1u);
        terms = vec2f(abs(difference) * params.depth_difference, variation.x * params.depth_variation);
    }
    g_planes[DEPTH_PLANE * plane + p] = g_depth;
    g_planes[ALPHA_PLANE * plane + p] = g_alpha;
    return terms;
}

fn pixel_terms(p: u32) -> Terms {
    let plane = params.size.x * params.size.y;
    let at = vec2u(p % params.size.x, p / params.size.x);
    let supervised = is_supervised(p);
    var terms = Terms();
    for (var c = 0u; c < 3u; c++) {
        var difference = 0.0;
        if supervised {
            difference = planes[c * plane + p] - f32((pixels[p] >> (8u * c)) & 255u) / 255.0;
        }
        let variation = plane_variation(c * plane, p, at);
        g_planes[c * plane + p] = sign_of(difference) * params.colour_difference
            + 2.0 * difference * params.colour_square + variation.y * params.colour_variation;
        terms.colour +=
            abs(difference) * params.colour_difference + difference * difference * params.colour_square;
        terms.variation += variation.x * params.colour_variation;
    }
    let of_depth = depth_terms(p, at);
    terms.depth = of_depth.x;
    terms.variation += of_depth.y;
    for (var d = 0u; d < LATENT_DIM; d++) {
        let base = (FEATURE_PLANE + d) * plane;
        var g = 0.0;
        if params.has_regions == 1u {
            var difference = 0.0;
            if supervised && regions[p] < params.num_rows {
                difference = planes[base + p] - latents[regions[p] * LATENT_DIM + d];
            }
            let variation = plane_variation(base, p, at);
            g = sign_of(difference) * params.feature_difference + variation.y * params.feature_variation;
            terms.features += abs(difference) * params.feature_difference;
            terms.variation += variation.x * params.feature_variation;
        }
        g_planes[base + p] = g;
    }
    return terms;
}

@compute @workgroup_size(GROUP)
fn loss(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, num_groups);
    let p = block * GROUP + lane;
    var terms = Terms();
    if p < params.size.x * params.size.y {
        terms = pixel_terms(p);
    }
    var quads = quads_of(terms);
    for (var q = 0u; q < TERM_QUADS; q++) {
        let sum = workgroup_sum(quads[q], lane);
        if lane == 0u && block * TERM_QUADS + q < arrayLength(&partial_sums) {
            partial_sums[block * TERM_QUADS + q] = sum;
        }
    }
}
