// Image planes -> the shown picture: colours of 8 bits, and depth divided by opacity; twin:
// core::raster::Images (to_rgb, normalised_depth), with pixels outside the field of view blanked. One
// invocation per pixel.
//
// Bindings: crates/render/src/shown/compose.rs.

#import shared/dispatch.wgsl

fn to_byte(value: f32) -> u32 {
    return u32(clamp(value, 0.0, 1.0) * 255.0 + 0.5);
}

@compute @workgroup_size(GROUP)
fn compose(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = flat_group(group, num_groups) * GROUP + lane;
    if at >= params.num_pixels {
        return;
    }
    if (inside[at / 32u] >> (at % 32u) & 1u) == 0u {
        pixels[at] = 0xff000000u;
        depths[at] = 0.0;
        return;
    }
    let red = to_byte(planes[at]);
    let green = to_byte(planes[params.num_pixels + at]);
    let blue = to_byte(planes[2u * params.num_pixels + at]);
    pixels[at] = red | (green << 8u) | (blue << 16u) | 0xff000000u;
    let alpha = planes[ALPHA_PLANE * params.num_pixels + at];
    var depth = 0.0;
    if alpha >= params.min_alpha {
        depth = planes[DEPTH_PLANE * params.num_pixels + at] / alpha;
    }
    depths[at] = depth;
}
