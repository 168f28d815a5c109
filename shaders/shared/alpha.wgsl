// Alpha of a splat at a pixel; twin: core::raster::tile (log2_alpha).

// Alpha of a splat at the pixel at `position`, regardless of the splats in front of it and without bounds.
fn unclamped_alpha_at(splat: SplatRow, position: vec2f) -> f32 {
    let d = position - splat.centre;
    let q = splat.conic.x * d.x * d.x + 2.0 * splat.conic.y * d.x * d.y + splat.conic.z * d.y * d.y;
    // Of a needle, q is a difference of large numbers: rounding can make it negative on the needle's axis.
    return splat.opacity * exp(-0.5 * q);
}

// Alpha of a splat at the pixel at `position`; below MIN_ALPHA it counts as 0.
fn alpha_at(splat: SplatRow, position: vec2f) -> f32 {
    return min(MAX_ALPHA, unclamped_alpha_at(splat, position));
}
