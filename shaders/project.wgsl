// Gaussians at time t -> splats on the image plane (method section 4.1-4.2); twin: core::raster::project.
//
// EWA splatting: covariance = U U^T + DILATION with U = J W R S, J the Jacobian of the pinhole projection
// evaluated within the guard. A splat that cannot be seen gets extent 0.
//
// Bindings: crates/render/src/planes/project.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl
#import shared/sh.wgsl
#import shared/rotation.wgsl

fn positive(x: f32) -> f32 {
    return select(0.0, max(x, 0.0), is_finite(x));
}

// max(0, 0.5 + C0 c0 + sum of the higher bands).
fn view_colour(n: u32, mean: vec3f, band0: vec3f) -> vec3f {
    var colour = 0.5 + SH_C0 * band0;
    if view.sh_degree > 0u {
        let along = mean - view.position;
        let length = sqrt(dot(along, along));
        var direction = vec3f(0.0, 0.0, 1.0);
        if length > 1e-12 {
            direction = along / length;
        }
        var bands = sh_bands(view.sh_degree, direction);
        let num_bands = (view.sh_degree + 1u) * (view.sh_degree + 1u) - 1u;
        for (var k = 0u; k < num_bands; k++) {
            let at = (n * num_bands + k) * 3u;
            colour += bands[k] * vec3f(sh_rest[at], sh_rest[at + 1u], sh_rest[at + 2u]);
        }
    }
    // Values that are not finite become black.
    return vec3f(positive(colour.x), positive(colour.y), positive(colour.z));
}

fn project_one(n: u32) -> SplatRow {
    var splat = SplatRow();
    let g = deformed[n];
    let mean = vec4f(g.mean, 1.0);
    let rows = view.camera_from_world;
    let point = vec3f(dot(rows[0], mean), dot(rows[1], mean), dot(rows[2], mean));
    let can_be_seen = g.opacity >= MIN_ALPHA && is_finite(g.opacity) && point.z > NEAR;
    if !can_be_seen || !(is_finite(point.x) && is_finite(point.y) && is_finite(point.z)) {
        return splat;
    }
    let slope = clamp(point.xy / point.z, view.guard_low, view.guard_high);
    let per_depth = view.focal / point.z;
    // Rows of J W.
    let jw_x = per_depth.x * (rows[0].xyz - slope.x * rows[2].xyz);
    let jw_y = per_depth.y * (rows[1].xyz - slope.y * rows[2].xyz);
    let rotation = rotation_matrix(g.rotation);
    let u = (jw_x * rotation) * g.scale;
    let v = (jw_y * rotation) * g.scale;
    let xx = dot(u, u) + DILATION;
    let xy = dot(u, v);
    let yy = dot(v, v) + DILATION;
    // xx yy - xy^2 as a sum of positive numbers: the difference would cancel for needles.
    let across = cross(u, v);
    let determinant = dot(across, across) + DILATION * (dot(u, u) + dot(v, v)) + DILATION * DILATION;
    if !(determinant > 0.0) || !is_finite(determinant) {
        return splat;
    }
    // alpha = opacity exp(-q / 2) >= MIN_ALPHA  <=>  q <= cut.
    let cut = 2.0 * log(g.opacity / MIN_ALPHA);
    splat.centre = view.focal * point.xy / point.z + view.centre;
    splat.depth = point.z;
    splat.opacity = g.opacity;
    splat.conic = vec3f(yy, -xy, xx) / determinant;
    splat.extent_x = max(sqrt(max(cut * xx, 0.0)), MIN_EXTENT);
    splat.extent_y = max(sqrt(max(cut * yy, 0.0)), MIN_EXTENT);
    splat.colour = view_colour(n, g.mean, g.colour);
    if view.sampling_step > 1u {
        // Moves the splat to the grid of the rendered pixels.
        let step = f32(view.sampling_step);
        splat.centre = (splat.centre - vec2f(view.sampling_first) - 0.5) / step + 0.5;
        splat.conic *= step * step;
        splat.extent_x /= step;
        splat.extent_y /= step;
    }
    return splat;
}

@compute @workgroup_size(GROUP)
fn project(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = flat_group(group, num_groups) * GROUP + lane;
    if n < view.num_gaussians {
        splats[n] = project_one(n);
    }
}
