// Gradient of the feature network, summed over the Gaussians block by block, then over the blocks; twin:
// core::deform::gate_feature_backward (g_net) and core::train::chain.
//
// Number (i, j) of W is the sum of g_opened_i * [f; t]_j, number i of the bias is the sum of g_opened_i.
//
// Bindings: crates/render/src/train/step/chain.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl

const WEIGHTS: u32 = LATENT_DIM * (LATENT_DIM + 1u);
const NUMBERS: u32 = max(WEIGHTS + LATENT_DIM, 1u);
// Number of lanes that share a number.
const SHARE: u32 = max(GROUP / NUMBERS, 1u);

var<workgroup> lane_sums: array<f32, max(SHARE * NUMBERS, GROUP)>;

fn term(n: u32, number: u32) -> f32 {
    if number >= WEIGHTS {
        return g_opened[n * LATENT_DIM + number - WEIGHTS];
    }
    let i = number / (LATENT_DIM + 1u);
    let j = number % (LATENT_DIM + 1u);
    var input = params.time;
    if j < LATENT_DIM {
        input = features_at_rest[n * LATENT_DIM + j];
    }
    return g_opened[n * LATENT_DIM + i] * input;
}

@compute @workgroup_size(GROUP)
fn sum_blocks(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, num_groups);
    let end = min((block + 1u) * NETWORK_BLOCK, params.num_gaussians);
    for (var at = lane; at < SHARE * NUMBERS; at += GROUP) {
        var sum = 0.0;
        for (var n = block * NETWORK_BLOCK + at / NUMBERS; n < end; n += SHARE) {
            sum += term(n, at % NUMBERS);
        }
        lane_sums[at] = sum;
    }
    workgroupBarrier();
    for (var number = lane; number < NUMBERS && block < params.num_blocks; number += GROUP) {
        var sum = 0.0;
        for (var share = 0u; share < SHARE; share++) {
            sum += lane_sums[share * NUMBERS + number];
        }
        block_sums[block * NUMBERS + number] = sum;
    }
}

@compute @workgroup_size(GROUP)
fn fold_blocks(@builtin(local_invocation_index) lane: u32) {
    for (var number = lane; number < NUMBERS; number += GROUP) {
        var sum = 0.0;
        for (var block = 0u; block < params.num_blocks; block++) {
            sum += block_sums[block * NUMBERS + number];
        }
        g_network[number] = sum;
        if !is_finite(sum) {
            atomicOr(&status[STATUS_BAD], 1u);
        }
    }
}
