// Gradients of the splats -> gradients of the parameters at rest, for each Gaussian; twin:
// core::train::chain (geometry and colour), core::raster::project (project_backward,
// view_colour_backward) and core::deform::move_geometry_backward.
//
// The parameters at rest and psi are added, so their gradients are the same numbers.
//
// Bindings: crates/render/src/train/step/chain.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl
#import shared/sh.wgsl
#import shared/rotation.wgsl
#import shared/sum.wgsl

struct Geometry {
    mean: vec3f,
    rotation: vec4f,
    scale: vec3f,
    camera: Twist,
}

// A motion of the camera: turn about its axes, then shift along them.
struct Twist {
    turn: vec3f,
    shift: vec3f,
}

// Conic = covariance^-1 gives dL/dcovariance = -C G C, and covariance = U U^T + DILATION gives dL/dU = 2
// (dL/dcov) U. The rows of U are u and v.
struct Root {
    u: vec3f,
    v: vec3f,
}

fn root_backward(root: Root, g_conic: vec3f) -> Root {
    let xx = dot(root.u, root.u) + DILATION;
    let xy = dot(root.u, root.v);
    let yy = dot(root.v, root.v) + DILATION;
    let across = cross(root.u, root.v);
    let determinant =
        dot(across, across) + DILATION * (dot(root.u, root.u) + dot(root.v, root.v)) + DILATION * DILATION;
    if !(determinant > 0.0) {
        return Root(vec3f(0.0), vec3f(0.0));
    }
    let conic = mat2x2f(vec2f(yy, -xy) / determinant, vec2f(-xy, xx) / determinant);
    let g = mat2x2f(vec2f(g_conic.x, 0.5 * g_conic.y), vec2f(0.5 * g_conic.y, g_conic.z));
    let g_covariance = -2.0 * (conic * g * conic);
    return Root(
        g_covariance[0].x * root.u + g_covariance[1].x * root.v,
        g_covariance[0].y * root.u + g_covariance[1].y * root.v,
    );
}

// Gradients of one axis of the picture with respect to the point in the camera: through the centre, and
// through its row of the Jacobian (f/z, -f slope/z), where slope = x/z unless clamped by the guard. The
// result is along that axis, then along z.
fn axis_backward(axis: u32, point: vec3f, slope: f32, is_inside: bool, g_centre: f32, g_row: vec2f) -> vec2f {
    let per_depth = view.focal[axis] / point.z;
    var out = vec2f(g_centre * per_depth, -g_centre * per_depth * point[axis] / point.z);
    out.y += (g_row.y * slope - g_row.x) * per_depth / point.z;
    if is_inside {
        out += vec2f(-g_row.y * per_depth / point.z, g_row.y * per_depth * slope / point.z);
    }
    return out;
}

// A direction in the world as one in the camera.
fn to_camera(direction: vec3f) -> vec3f {
    let rows = view.camera_from_world;
    return vec3f(dot(rows[0].xyz, direction), dot(rows[1].xyz, direction), dot(rows[2].xyz, direction));
}

// A turn w of the camera moves the point in it by cross(w, p), and every column of its rotation W by its
// cross product with w. dL/dW W^T = J^T dL/dJ, given by the rows of dL/dJ; its odd part holds their sum.
fn turn_backward(point: vec3f, slope: vec2f, g_point: vec3f, g_x: vec3f, g_y: vec3f) -> vec3f {
    let per_depth = view.focal / point.z;
    let along_x = per_depth.x * g_x;
    let along_y = per_depth.y * g_y;
    let along_z = -slope.x * along_x - slope.y * along_y;
    let by_rotation = vec3f(along_z.y - along_y.z, along_x.z - along_z.x, along_y.x - along_x.y);
    return cross(point, g_point) + by_rotation;
}

fn project_backward(geometry: DeformedRow, g: SplatGradientRow) -> Geometry {
    let rows = view.camera_from_world;
    let mean = vec4f(geometry.mean, 1.0);
    let point = vec3f(dot(rows[0], mean), dot(rows[1], mean), dot(rows[2], mean));
    let free = point.xy / point.z;
    let slope = clamp(free, view.guard_low, view.guard_high);
    let is_inside = (free >= view.guard_low) & (free <= view.guard_high);
    let per_depth = view.focal / point.z;
    let jw_x = per_depth.x * (rows[0].xyz - slope.x * rows[2].xyz);
    let jw_y = per_depth.y * (rows[1].xyz - slope.y * rows[2].xyz);
    let rotation = rotation_matrix(geometry.rotation);
    let oriented_x = jw_x * rotation;
    let oriented_y = jw_y * rotation;
    let g_root = root_backward(Root(oriented_x * geometry.scale, oriented_y * geometry.scale), g.conic);
    let g_oriented_x = g_root.u * geometry.scale;
    let g_oriented_y = g_root.v * geometry.scale;
    var out: Geometry;
    out.scale = g_root.u * oriented_x + g_root.v * oriented_y;
    // dL/dR = (J W)^T dL/d(J W R), by columns.
    let g_matrix = mat3x3f(
        jw_x * g_oriented_x.x + jw_y * g_oriented_y.x,
        jw_x * g_oriented_x.y + jw_y * g_oriented_y.y,
        jw_x * g_oriented_x.z + jw_y * g_oriented_y.z,
    );
    out.rotation = rotation_matrix_backward(geometry.rotation, g_matrix);
    let g_jw_x = rotation * g_oriented_x;
    let g_jw_y = rotation * g_oriented_y;
    let g_x = to_camera(g_jw_x);
    let g_y = to_camera(g_jw_y);
    let x = axis_backward(0u, point, slope.x, is_inside.x, g.centre.x, g_x.xz);
    let y = axis_backward(1u, point, slope.y, is_inside.y, g.centre.y, g_y.yz);
    let g_point = vec3f(x.x, y.x, g.depth + x.y + y.y);
    out.mean = rows[0].xyz * g_point.x + rows[1].xyz * g_point.y + rows[2].xyz * g_point.z;
    out.camera = Twist(turn_backward(point, slope, g_point, g_x, g_y), g_point);
    return out;
}

// Gradient of the mean through the viewing direction; writes those of the colour bands.
fn bands_backward(n: u32, mean: vec3f, g: vec3f) -> vec3f {
    let num_bands = (view.sh_degree + 1u) * (view.sh_degree + 1u) - 1u;
    let along = mean - view.position;
    let length = sqrt(dot(along, along));
    var direction = vec3f(0.0, 0.0, 1.0);
    if length > 1e-12 {
        direction = along / length;
    }
    var bands = sh_bands(view.sh_degree, direction);
    var g_bands = array<f32, MAX_SH_BANDS>();
    for (var k = 0u; k < num_bands; k++) {
        let at = (n * num_bands + k) * 3u;
        g_bands[k] = dot(g, vec3f(sh_rest[at], sh_rest[at + 1u], sh_rest[at + 2u]));
        let g_band = select(vec3f(0.0), g * bands[k], k < params.learned_bands);
        g_sh_rest[at] = g_band.x;
        g_sh_rest[at + 1u] = g_band.y;
        g_sh_rest[at + 2u] = g_band.z;
    }
    if length <= 1e-12 {
        return vec3f(0.0);
    }
    let g_direction = sh_bands_backward(view.sh_degree, direction, g_bands);
    return (g_direction - direction * dot(direction, g_direction)) / length;
}

// True for scales that are not clamped; clamped scales have no gradient.
fn is_free(scale: vec3f) -> vec3<bool> {
    return (scale < vec3f(MAX_SCALE)) & (scale > vec3f(1.0 / MAX_SCALE));
}

// Writes the gradients of Gaussian n; returns its part of the camera's.
fn one_backward(n: u32) -> Twist {
    let geometry = deformed[n];
    let splat = splats[n];
    var g_splat = g_splats[n];
    let is_visible = splat.extent_x > 0.0;
    if !is_visible {
        g_splat = SplatGradientRow();
    }
    var out = RestRow();
    let g_colour = select(vec3f(0.0), g_splat.colour, splat.colour > vec3f(0.0));
    var g_seen = vec3f(0.0);
    if view.sh_degree > 0u {
        g_seen = bands_backward(n, geometry.mean, g_colour);
    }
    if !is_visible {
        g_rest[n] = out;
        return Twist();
    }
    let g = project_backward(geometry, g_splat);
    out.mean = g.mean + g_seen;
    if geometry.quaternion_length > 0.0 {
        let along = dot(geometry.rotation, g.rotation);
        out.rotation = (g.rotation - geometry.rotation * along) / geometry.quaternion_length;
    }
    out.log_scale = select(vec3f(0.0), g.scale * geometry.scale, is_free(geometry.scale));
    out.colour = g_colour * SH_C0;
    out.opacity_logit = g_splat.opacity * splat.opacity * (1.0 - splat.opacity);
    g_rest[n] = out;
    // A turn about the camera changes no viewing direction, a shift does.
    return Twist(g.camera.turn, g.camera.shift + to_camera(g_seen));
}

fn are_finite(v: vec3f) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

// Notes a gradient that is not finite.
fn check(n: u32) {
    let g = g_rest[n];
    let is_good = are_finite(g.mean) && are_finite(g.rotation.xyz) && is_finite(g.rotation.w)
        && are_finite(g.log_scale) && are_finite(g.colour) && is_finite(g.opacity_logit)
        && are_finite(g_splats[n].colour);
    if !is_good {
        atomicOr(&status[STATUS_BAD], 1u);
    }
}

@compute @workgroup_size(GROUP)
fn chain(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, num_groups);
    let n = block * GROUP + lane;
    var camera = Twist();
    if n < view.num_gaussians {
        camera = one_backward(n);
        check(n);
    }
    let turn = workgroup_sum(vec4f(camera.turn, 0.0), lane);
    let shift = workgroup_sum(vec4f(camera.shift, 0.0), lane);
    if lane == 0u && block * GROUP < view.num_gaussians {
        g_cameras[2u * block] = turn;
        g_cameras[2u * block + 1u] = shift;
    }
}
