// Judges a step: sums the loss terms and the camera's gradient, and checks that all gradients were finite
// and all pairs fitted; twin: the decisions of core::train::CpuBackend::step. One workgroup. Everything stays
// on the device; the host reads the history now and then.
//
// A step whose pairs did not fit changes nothing, nor do those after it, until the host has made room and
// repeats them.
//
// Bindings: crates/render/src/train/step/update.rs.

#import shared/num.wgsl
#import shared/sum.wgsl

const QUADS: u32 = max((LATENT_DIM + 3u) / 4u, 1u);

fn decide(terms: array<vec4f, 2>, camera: array<vec4f, 2>) {
    let is_bad = status[STATUS_BAD] != 0u;
    status[STATUS_BAD] = 0u;
    status[STATUS_OK] = 0u;
    status[STATUS_WANTED] = max(status[STATUS_WANTED], num_pairs_wanted[0]);
    if num_pairs_wanted[0] > params.capacity {
        status[STATUS_OVERFLOWN] = 1u;
    }
    if status[STATUS_OVERFLOWN] != 0u {
        return;
    }
    let total = dot(terms[0] + terms[1], vec4f(1.0));
    let is_dropped = is_bad || !is_finite(total);
    let at = status[STATUS_DONE];
    history[at] = StepResult(terms, camera, select(0u, 1u, is_dropped), 0u, vec2u(0u));
    status[STATUS_DONE] = at + 1u;
    if is_dropped {
        return;
    }
    status[STATUS_OK] = 1u;
    if params.updates == 1u {
        status[COUNT_REST] += 1u;
        status[COUNT_SH_REST] += 1u;
        status[COUNT_FEATURES] += 1u;
        status[COUNT_NETWORK] += params.updates_network;
        for (var b = params.first_basis; b < params.last_basis; b++) {
            status[COUNT_BASES + b] += 1u;
        }
    }
}

@compute @workgroup_size(GROUP)
fn finish_step(@builtin(local_invocation_index) lane: u32) {
    var terms = array<vec4f, 2>();
    for (var q = 0u; q < TERM_QUADS; q++) {
        var sum = vec4f(0.0);
        for (var i = lane; i < params.num_sums; i += GROUP) {
            sum += partial_sums[i * TERM_QUADS + q];
        }
        terms[q] = workgroup_sum(sum, lane);
    }
    var spread = vec4f(0.0);
    for (var i = lane; i < params.num_regions * QUADS; i += GROUP) {
        spread += spreads[2u * i];
    }
    terms[REGION_TERM / 4u][REGION_TERM % 4u] = dot(workgroup_sum(spread, lane), vec4f(params.smoothness));
    var camera = array<vec4f, 2>();
    for (var half = 0u; half < 2u; half++) {
        var sum = vec4f(0.0);
        for (var i = lane; i < params.num_camera_sums; i += GROUP) {
            sum += g_cameras[2u * i + half];
        }
        camera[half] = workgroup_sum(sum, lane);
    }
    if lane == 0u {
        decide(terms, camera);
    }
}
