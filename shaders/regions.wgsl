// Region smoothness (method section 5.4); twin: core::train::loss::regions.
//
// RS = sum over large regions of the mean of |F - region mean|. The gradient also goes through the mean.
// Supervised pixels of large regions are listed region by region, cut into blocks of one region each:
//
//   sum_values  fold_means  sum_deviations  fold_spreads  add_gradients
//
// Four latent numbers are processed together as one vec4f.
//
// Bindings: crates/render/src/train/step/loss.rs.

#import shared/dispatch.wgsl
#import shared/sum.wgsl

const QUADS: u32 = max((LATENT_DIM + 3u) / 4u, 1u);

fn feature_at(p: u32, quad: u32) -> vec4f {
    var out = vec4f(0.0);
    for (var k = 0u; k < 4u; k++) {
        let d = 4u * quad + k;
        if d < LATENT_DIM {
            out[k] = planes[(FEATURE_PLANE + d) * params.num_pixels + p];
        }
    }
    return out;
}

fn signs_of(v: vec4f) -> vec4f {
    return vec4f(sign_of(v.x), sign_of(v.y), sign_of(v.z), sign_of(v.w));
}

@compute @workgroup_size(GROUP)
fn sum_values(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = min(flat_group(group, num_groups), params.num_blocks - 1u);
    let block = blocks[number];
    for (var quad = 0u; quad < QUADS; quad++) {
        var sum = vec4f(0.0);
        for (var i = block.first + lane; i < block.end; i += GROUP) {
            sum += feature_at(listed[i], quad);
        }
        let total = workgroup_sum(sum, lane);
        if lane == 0u {
            block_sums[(number * QUADS + quad) * 2u] = total;
        }
    }
}

// The sum, or the mean over all latent numbers in each component if regions are pooled.
fn pooled_sum(sum: vec4f, total: f32) -> vec4f {
    if params.is_pooled == 1u {
        return vec4f(total / f32(LATENT_DIM));
    }
    return sum;
}

fn sum_of_blocks(region: Region, quad: u32, which: u32) -> vec4f {
    var sum = vec4f(0.0);
    for (var b = region.first; b < region.end; b++) {
        sum += block_sums[(b * QUADS + quad) * 2u + which];
    }
    return sum;
}

// Sum over all latent numbers; components beyond them are 0.
fn total_of_blocks(region: Region, which: u32) -> f32 {
    var total = 0.0;
    for (var quad = 0u; quad < QUADS && params.is_pooled == 1u; quad++) {
        total += dot(sum_of_blocks(region, quad, which), vec4f(1.0));
    }
    return total;
}

@compute @workgroup_size(GROUP)
fn fold_means(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = flat_group(group, num_groups) * GROUP + lane;
    if number >= params.num_regions {
        return;
    }
    let region = regions[number];
    let total = total_of_blocks(region, 0u);
    for (var quad = 0u; quad < QUADS; quad++) {
        let sum = pooled_sum(sum_of_blocks(region, quad, 0u), total);
        means[number * QUADS + quad] = sum / f32(region.num_pixels);
    }
}

@compute @workgroup_size(GROUP)
fn sum_deviations(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = min(flat_group(group, num_groups), params.num_blocks - 1u);
    let block = blocks[number];
    for (var quad = 0u; quad < QUADS; quad++) {
        let mean = means[block.region * QUADS + quad];
        var spread = vec4f(0.0);
        var signs = vec4f(0.0);
        for (var i = block.first + lane; i < block.end; i += GROUP) {
            let deviation = feature_at(listed[i], quad) - mean;
            spread += abs(deviation);
            signs += signs_of(deviation);
        }
        // Components beyond the latent numbers are padding, whose deviation from the mean does not count.
        for (var k = 0u; k < 4u; k++) {
            if 4u * quad + k >= LATENT_DIM {
                spread[k] = 0.0;
                signs[k] = 0.0;
            }
        }
        let spread_total = workgroup_sum(spread, lane);
        let sign_total = workgroup_sum(signs, lane);
        if lane == 0u {
            block_sums[(number * QUADS + quad) * 2u] = spread_total;
            block_sums[(number * QUADS + quad) * 2u + 1u] = sign_total;
        }
    }
}

@compute @workgroup_size(GROUP)
fn fold_spreads(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = flat_group(group, num_groups) * GROUP + lane;
    if number >= params.num_regions {
        return;
    }
    let region = regions[number];
    let total = total_of_blocks(region, 1u);
    for (var quad = 0u; quad < QUADS; quad++) {
        let at = (number * QUADS + quad) * 2u;
        spreads[at] = sum_of_blocks(region, quad, 0u) / f32(region.num_pixels);
        spreads[at + 1u] = pooled_sum(sum_of_blocks(region, quad, 1u), total) / f32(region.num_pixels);
    }
}

@compute @workgroup_size(GROUP)
fn add_gradients(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = flat_group(group, num_groups);
    if number >= params.num_blocks {
        return;
    }
    let block = blocks[number];
    let factor = params.smoothness / f32(regions[block.region].num_pixels);
    for (var i = block.first + lane; i < block.end; i += GROUP) {
        let p = listed[i];
        for (var quad = 0u; quad < QUADS; quad++) {
            let at = block.region * QUADS + quad;
            let pull = (signs_of(feature_at(p, quad) - means[at]) - spreads[2u * at + 1u]) * factor;
            for (var k = 0u; k < 4u; k++) {
                let d = 4u * quad + k;
                if d < LATENT_DIM {
                    g_planes[(FEATURE_PLANE + d) * params.num_pixels + p] += pull[k];
                }
            }
        }
    }
}
