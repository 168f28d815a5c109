// Adds Gaussians where the gradient of the picture pulls at them, and removes those that have faded;
// twin: core::train::densify.
//
//   decide  (scan, stable sort by key)  choose  (scan)  list  copy_rows (for every array)  part
//
// Between the sort and `choose` the host reads the numbers of kept and of pulled Gaussians, and decides
// how many of the latter are divided into two. It has to make room for the new rows anyway.
//
// Bindings: crates/render/src/train/densify.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl
#import shared/rotation.wgsl
#import shared/random.wgsl

const FRESH: u32 = 0x80000000u;
const NOT_PULLED: u32 = 0xffffffffu;

fn are_finite(v: vec3f) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

fn is_parted(n: u32) -> bool {
    return children[n + 1u] > children[n];
}

@compute @workgroup_size(GROUP)
fn decide(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = flat_group(group, num_groups) * GROUP + lane;
    if n > params.num_gaussians {
        return;
    }
    if n == params.num_gaussians {
        places[n] = 0u;
        return;
    }
    let gaussian = rest[n];
    let keeps = are_finite(gaussian.mean) && are_finite(gaussian.log_scale)
        && !is_nan(gaussian.opacity_logit) && gaussian.opacity_logit >= params.min_opacity_logit;
    let mean_pull = pull_sums[n] / f32(max(times_seen[n], 1u));
    let is_pulled = keeps && mean_pull >= params.min_pull;
    places[n] = select(0u, 1u, keeps);
    // Pulls are positive, so their bits sort like the numbers.
    pull_keys[n] = select(NOT_PULLED, ~bitcast<u32>(mean_pull), is_pulled);
    ranked[n] = n;
    if keeps {
        atomicAdd(&counts[0], 1u);
    }
    if is_pulled {
        atomicAdd(&counts[1], 1u);
    }
}

@compute @workgroup_size(GROUP)
fn choose(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let rank = flat_group(group, num_groups) * GROUP + lane;
    if rank < params.num_gaussians {
        children[ranked[rank]] = select(0u, 1u, rank < params.num_children);
    } else if rank == params.num_gaussians {
        children[rank] = 0u;
    }
}

@compute @workgroup_size(GROUP)
fn list(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = flat_group(group, num_groups) * GROUP + lane;
    if n >= params.num_gaussians {
        return;
    }
    if places[n + 1u] > places[n] {
        parents[places[n]] = n | select(0u, FRESH, is_parted(n) && params.split_only == 1u);
    }
    if is_parted(n) {
        parents[params.num_kept + children[n]] = n | FRESH;
    }
}

@compute @workgroup_size(GROUP)
fn copy_rows(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, num_groups) * GROUP + lane;
    if i >= copied.num_planes * copied.num_rows * copied.width {
        return;
    }
    let line = i / copied.width;
    let plane = line / copied.num_rows;
    let entry = parents[copied.first_row + line % copied.num_rows];
    // A row below the part wraps around and is then too large.
    let row = (entry & ~FRESH) - copied.old_first_row;
    if row >= copied.old_num_rows {
        return;
    }
    let is_cleared = copied.clears_fresh == 1u && (entry & FRESH) != 0u;
    let at = (plane * copied.old_num_rows + row) * copied.width + i % copied.width;
    rows[i] = select(source[at], 0.0, is_cleared);
}

// Makes two Gaussians of one. A large one becomes two smaller ones along its longest axis. A small one
// becomes two side by side that together cover the same area.
fn split_or_clone(parent: u32, child: u32) {
    let one = new_rest[parent];
    var longest = 0u;
    for (var axis = 1u; axis < 3u; axis++) {
        // If several are equal, the last one is taken, as in the twin.
        if one.log_scale[axis] >= one.log_scale[longest] {
            longest = axis;
        }
    }
    let is_large = one.log_scale[longest] > params.split_log_scale;
    var along = vec3f(0.0);
    along[longest] = select(CLONE_DISTANCE, SPLIT_DISTANCE, is_large) * exp(one.log_scale[longest]);
    let offset = rotation_matrix(unit(one.rotation)) * along;
    var halves = one;
    if is_large {
        halves.log_scale[longest] -= LN_SPLIT;
    } else {
        halves.opacity_logit = logit(1.0 - sqrt(1.0 - sigmoid(one.opacity_logit)));
    }
    new_rest[parent] = halves;
    new_rest[parent].mean = one.mean - offset;
    new_rest[child] = halves;
    new_rest[child].mean = one.mean + offset;
}

// Places two smaller Gaussians at random where one was, as the released code does.
fn scatter(parent: u32, child: u32, seed: u32) {
    let one = new_rest[parent];
    let turn = rotation_matrix(unit(one.rotation));
    for (var half = 0u; half < 2u; half++) {
        let at = select(parent, child, half == 1u);
        let along = exp(one.log_scale) * normal4(vec4u(params.seed, seed, half)).xyz;
        new_rest[at] = one;
        new_rest[at].mean = one.mean + turn * along;
        new_rest[at].log_scale = one.log_scale - LN_SPLIT;
    }
}

// The unit quaternion; the identity if there is no direction.
fn unit(q: vec4f) -> vec4f {
    let length = sqrt(dot(q, q));
    return select(vec4f(1.0, 0.0, 0.0, 0.0), q / length, length > 1e-12 && is_finite(length));
}

@compute @workgroup_size(GROUP)
fn part(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = flat_group(group, num_groups) * GROUP + lane;
    if n >= params.num_gaussians || !is_parted(n) {
        return;
    }
    if params.split_only == 1u {
        scatter(places[n], params.num_kept + children[n], n);
    } else {
        split_or_clone(places[n], params.num_kept + children[n]);
    }
}
