// Adam for every group of parameters, and the statistics; twin: core::train::{Adam, Optimiser,
// Statistics}. Nothing is changed after a step that was not good.

#import constants
#import shared/dispatch.wgsl
#import shared/gaussian.wgsl
#import shared/basis.wgsl

struct Update {
    // Number of values to update.
    len: u32,
    // Index of the first of them among the parameters.
    first: u32,
    // Period of the learning rates: value k has the rate rate * rates[k % width].
    width: u32,
    // Index of the group's counter of updates in the status.
    count: u32,
    rate: f32,
    // What gradients are multiplied by.
    gain: f32,
    // Factor of the gradients.
    first_moment: u32,
    // Index of the first of their moments.
    first_row: u32,
    // For the bases: first Gaussian of the part.
    gate_channel: u32,
    // Shape of bases that are not shared.
    shape: u32,
    time: f32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> params: Update;
@group(0) @binding(1) var<storage, read> status: array<u32>;
// Bias corrections of the first and second moments, indexed by the number of the update.
@group(0) @binding(2) var<storage, read> corrections: array<vec2f>;
@group(0) @binding(3) var<storage, read> rates: array<f32>;
@group(0) @binding(4) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(5) var<storage, read_write> first_moments: array<f32>;
@group(0) @binding(6) var<storage, read_write> second_moments: array<f32>;
// Gradients, in the order of the parameters; for the bases those of the parameters at rest, [N][REST].
@group(0) @binding(7) var<storage, read> gradients: array<f32>;
// Gradients of the gate, [N][LATENT_DIM]; for the bases.
@group(0) @binding(8) var<storage, read> g_gate: array<f32>;
@group(0) @binding(9) var<storage, read> g_splats: array<SplatGradientRow>;
@group(0) @binding(10) var<storage, read_write> pull_sums: array<f32>;
@group(0) @binding(11) var<storage, read_write> times_seen: array<u32>;
// Centres and widths of bases that are not shared, in the order of the weights.
@group(0) @binding(12) var<storage, read> centres: array<f32>;
@group(0) @binding(13) var<storage, read> widths: array<f32>;
// dL/d(weight, centre, width) of one basis function, [rows][stride].
@group(0) @binding(14) var<storage, read_write> g_weights: array<f32>;
@group(0) @binding(15) var<storage, read_write> g_centres: array<f32>;
@group(0) @binding(16) var<storage, read_write> g_widths: array<f32>;

// Number of values of a row at rest.
const REST: u32 = 16u;

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
