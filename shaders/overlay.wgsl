// Draws the found regions over a frame; twin: core::overlay. One invocation per pixel.
//
// Outline and fill: pixels up to CONTOUR_WIDTH inside the border of the found region, by city-block
// distance, are contour, and the next pixel on either side is halo. Heatmap: the highest score in the
// colours of a palette, fixed range 0-1.
//
// Bindings: crates/render/src/shown/overlay.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl

fn score_at(prompt: u32, pixel: vec2i) -> f32 {
    let size = vec2i(params.size);
    return scores[(i32(prompt) * size.y + pixel.y) * size.x + pixel.x];
}

fn is_inside_frame(pixel: vec2i) -> bool {
    return all(pixel >= vec2i(0)) && all(pixel < vec2i(params.size));
}

// A score of NaN is not found. The compiler may ignore NaN in comparisons, so its bits are tested.
fn is_found(prompt: u32, pixel: vec2i) -> bool {
    let score = score_at(prompt, pixel);
    return !is_nan(score) && score > prompts[prompt].threshold;
}

// City-block distance to the nearest pixel of the frame that is not found, up to `limit`, else `limit` + 1.
fn depth_inside(prompt: u32, pixel: vec2i, limit: i32) -> i32 {
    if !is_found(prompt, pixel) {
        return 0;
    }
    var depth = limit + 1;
    for (var dy = -limit; dy <= limit; dy++) {
        let reach = limit - abs(dy);
        for (var dx = -reach; dx <= reach; dx++) {
            let other = pixel + vec2i(dx, dy);
            if is_inside_frame(other) && !is_found(prompt, other) {
                depth = min(depth, abs(dx) + abs(dy));
            }
        }
    }
    return depth;
}

fn touches_found(prompt: u32, pixel: vec2i) -> bool {
    var steps = array(vec2i(-1, 0), vec2i(1, 0), vec2i(0, -1), vec2i(0, 1));
    for (var i = 0; i < 4; i++) {
        let other = pixel + steps[i];
        if is_inside_frame(other) && is_found(prompt, other) {
            return true;
        }
    }
    return false;
}

fn mix_by(a: vec3f, b: vec3f, share: f32) -> vec3f {
    return a + (b - a) * clamp(share, 0.0, 1.0);
}

// Where a dashed contour has a gap.
fn is_gap(pixel: vec2i) -> bool {
    return (u32(pixel.x + pixel.y) / DASH) % 2u == 1u;
}

fn draw_region(base: vec3f, prompt: u32, pixel: vec2i) -> vec3f {
    let is_dashed = prompts[prompt].is_dashed == 1u;
    if is_dashed && is_gap(pixel) {
        return base;
    }
    let halo = mix_by(base, vec3f(0.0), HALO_DARKNESS * params.outline_opacity);
    let width = i32(CONTOUR_WIDTH);
    let depth = depth_inside(prompt, pixel, width + 1);
    if depth == 0 {
        if touches_found(prompt, pixel) {
            return halo;
        }
        return base;
    }
    if depth <= width {
        return mix_by(base, prompts[prompt].colour, params.outline_opacity);
    }
    if depth == width + 1 {
        return halo;
    }
    if params.style == STYLE_FILL && !is_dashed {
        return mix_by(base, prompts[prompt].colour, params.opacity);
    }
    return base;
}

// Colour of a score from 0 to 1, by the polynomial of the palette.
fn heat_colour(score: f32) -> vec3f {
    var value = params.heat_6;
    value = value * score + params.heat_5;
    value = value * score + params.heat_4;
    value = value * score + params.heat_3;
    value = value * score + params.heat_2;
    value = value * score + params.heat_1;
    value = value * score + params.heat_0;
    return 255.0 * clamp(value.xyz, vec3f(0.0), vec3f(1.0));
}

fn heat(base: vec3f, pixel: vec2i) -> vec3f {
    var best = 0.0;
    for (var prompt = 0u; prompt < params.num_prompts; prompt++) {
        let score = score_at(prompt, pixel);
        if !is_nan(score) && score > best {
            best = score;
        }
    }
    if best > 0.0 {
        return mix_by(base, heat_colour(min(best, 1.0)), params.opacity);
    }
    return base;
}

@compute @workgroup_size(GROUP)
fn overlay(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = flat_group(group, num_groups) * GROUP + lane;
    if at >= params.size.x * params.size.y {
        return;
    }
    let pixel = vec2i(vec2u(at % params.size.x, at / params.size.x));
    let packed = pixels[at];
    var colour = vec3f(vec3u(packed & 255u, (packed >> 8u) & 255u, (packed >> 16u) & 255u));
    if params.style == STYLE_HEATMAP {
        colour = heat(colour, pixel);
    } else {
        for (var prompt = 0u; prompt < params.num_prompts; prompt++) {
            colour = draw_region(colour, prompt, pixel);
        }
    }
    let bytes = vec3u(colour + 0.5);
    pixels[at] = bytes.x | (bytes.y << 8u) | (bytes.z << 16u) | 0xff000000u;
}
