// Gradients of the features at time t -> those of the features at rest and of their gate, for each
// Gaussian; twin: core::deform::gate_feature_backward. f' = f + (W [f; t] + bias) * open, open =
// sigmoid(slope * psi_gate).
//
// Bindings: crates/render/src/train/step/chain.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl

@compute @workgroup_size(GROUP)
fn features_backward(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = flat_group(group, num_groups) * GROUP + lane;
    if n >= params.num_rows {
        return;
    }
    let network = params.num_bases;
    let bias = network + LATENT_DIM * (LATENT_DIM + 1u);
    var sums = array<f32, max(LATENT_DIM, 1u)>();
    var is_good = true;
    for (var i = 0u; i < LATENT_DIM; i++) {
        let line = network + i * (LATENT_DIM + 1u);
        var change = tables[bias + i] + tables[line + LATENT_DIM] * params.time;
        for (var j = 0u; j < LATENT_DIM; j++) {
            change += tables[line + j] * features_at_rest[n * LATENT_DIM + j];
        }
        let g = g_out[n * LATENT_DIM + i];
        let open = features[arrayLength(&features) / 2u + n * LATENT_DIM + i];
        let of_gate = g * change * open * (1.0 - open) * params.gate_slope;
        g_gate[n * LATENT_DIM + i] = of_gate;
        g_opened[n * LATENT_DIM + i] = g * open;
        for (var j = 0u; j < LATENT_DIM; j++) {
            sums[j] += g * open * tables[line + j];
        }
        is_good = is_good && is_finite(of_gate);
    }
    for (var j = 0u; j < LATENT_DIM; j++) {
        let of_feature = g_out[n * LATENT_DIM + j] + sums[j];
        g_features[n * LATENT_DIM + j] = of_feature;
        is_good = is_good && is_finite(of_feature);
    }
    if !is_good {
        atomicOr(&status[STATUS_BAD], 1u);
    }
}
