// Adam for every group of parameters, and the statistics; twin: core::train::{Adam, Optimiser,
// Statistics}. Nothing is changed after a step that was not good.
//
// Bindings: crates/render/src/train/step/update.rs.

#import shared/dispatch.wgsl
#import shared/basis.wgsl

// Updates one value; `moment` and `at` are the indices of its moments and of the value itself.
fn adam_step(at: u32, moment: u32, raw_gradient: f32, rate: f32) {
    let count = min(status[params.count], arrayLength(&corrections));
    let correction = corrections[max(count, 1u) - 1u];
    let gradient = params.gain * raw_gradient;
    let first = BETA1 * first_moments[moment] + (1.0 - BETA1) * gradient;
    let second = BETA2 * second_moments[moment] + (1.0 - BETA2) * gradient * gradient;
    first_moments[moment] = first;
    second_moments[moment] = second;
    let spread = sqrt(second * correction.y) + ADAM_EPSILON;
    parameters[at] -= params.rate * correction.x * rate * first / spread;
}

@compute @workgroup_size(GROUP)
fn adam(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, num_groups) * GROUP + lane;
    if i < params.len && status[STATUS_OK] == 1u {
        adam_step(params.first + i, params.first_moment + i, gradients[i], rates[i % params.width]);
    }
}

// Gradient of a channel of psi; padding has none.
fn psi_gradient(n: u32, channel: u32) -> f32 {
    var g = 0.0;
    if channel < ROTATION_CHANNEL {
        g = gradients[n * REST + channel];
    } else if channel < COLOUR_CHANNEL {
        // The opacity follows the mean, padding follows the scale.
        g = gradients[n * REST + channel + 1u];
    } else if channel < GATE_CHANNEL {
        g = gradients[n * REST + channel + 2u];
    }
    if channel >= params.gate_channel && channel < params.gate_channel + LATENT_DIM {
        g += g_gate[n * LATENT_DIM + channel - params.gate_channel];
    }
    return g;
}

@compute @workgroup_size(GROUP)
fn adam_basis(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, num_groups) * GROUP + lane;
    if i < params.len && status[STATUS_OK] == 1u {
        let channel = i % params.width;
        let gradient = psi_gradient(params.first_row + i / params.width, channel);
        adam_step(params.first + i, params.first_moment + i, gradient, rates[channel]);
    }
}

@compute @workgroup_size(GROUP)
fn own_basis_gradients(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, num_groups) * GROUP + lane;
    if i >= params.len {
        return;
    }
    let at = params.first + i;
    let g = psi_gradient(params.first_row + i / params.width, i % params.width);
    let along = basis_backward(params.shape, params.time, centres[at], widths[at]);
    g_weights[i] = basis(params.shape, params.time, centres[at], widths[at]) * g;
    g_centres[i] = parameters[at] * along.x * g;
    g_widths[i] = parameters[at] * along.y * g;
}

@compute @workgroup_size(GROUP)
fn add_statistics(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = flat_group(group, num_groups) * GROUP + lane;
    if n < params.len && status[STATUS_OK] == 1u && g_splats[n].pull >= 0.0 {
        pull_sums[n] += g_splats[n].pull;
        times_seen[n] += 1u;
    }
}
