// Gaussians at rest -> Gaussians at time t (method section 3); twin: core::deform::deform.
//
//   psi_c(t) = sum over live bases b of G_b(t) * weight[b][n][c]
//   mean += psi[0..3], q = unit(q + psi[3..7]), scale = exp(log_scale + psi[7..10]), colour += psi[10..13],
//   f' = f + (W [f; t] + bias) * sigmoid(slope * psi[gate_channel..][..D])
//
// One thread per Gaussian of one part. The weights of all Gaussians may be larger than a binding, so they
// are cut into ranges of Gaussians, each with its own [bases][rows][stride] block.
//
// Bindings: crates/render/src/planes/deform.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl
#import shared/basis.wgsl

fn basis_value(b: u32, at: u32) -> f32 {
    if params.is_shared == 1u {
        return tables[b];
    }
    let value = basis(params.shape, params.time, centres[at], widths[at]);
    return select(0.0, value, value > LIVE_BASIS);
}

fn psi(row: u32, channel: u32) -> f32 {
    var sum = 0.0;
    for (var b = params.first_basis; b < params.last_basis; b++) {
        let at = (b * params.num_rows + row) * params.stride + channel;
        sum += basis_value(b, at) * weights[at];
    }
    return sum;
}

fn psi3(row: u32, channel: u32) -> vec3f {
    return vec3f(psi(row, channel), psi(row, channel + 1u), psi(row, channel + 2u));
}

// Length of a quaternion; 0 if it has no direction.
fn quaternion_length(q: vec4f) -> f32 {
    let length = sqrt(dot(q, q));
    return select(0.0, length, length > 1e-12 && is_finite(length));
}

fn deform_features(row: u32, n: u32) {
    let network = params.num_bases;
    let bias = network + LATENT_DIM * (LATENT_DIM + 1u);
    for (var i = 0u; i < LATENT_DIM; i++) {
        let line = network + i * (LATENT_DIM + 1u);
        var change = tables[bias + i] + tables[line + LATENT_DIM] * params.time;
        for (var j = 0u; j < LATENT_DIM; j++) {
            change += tables[line + j] * features_at_rest[n * LATENT_DIM + j];
        }
        let open = sigmoid(params.gate_slope * psi(row, params.gate_channel + i));
        let value = features_at_rest[n * LATENT_DIM + i] + change * open;
        features[n * LATENT_DIM + i] = select(0.0, value, is_finite(value));
        features[arrayLength(&features) / 2u + n * LATENT_DIM + i] = open;
    }
}

// A log-scale clamped to its bounds; the lowest for NaN.
fn bounded(x: f32) -> f32 {
    return select(clamp(x, -MAX_LOG_SCALE, MAX_LOG_SCALE), -MAX_LOG_SCALE, is_nan(x));
}

@compute @workgroup_size(GROUP)
fn deform(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = flat_group(group, num_groups) * GROUP + lane;
    if row >= params.num_rows {
        return;
    }
    let n = params.first_row + row;
    let r = rest[n];
    var out: DeformedRow;
    out.mean = r.mean + psi3(row, MEAN_CHANNEL);
    out.opacity = sigmoid(r.opacity_logit);
    let turn = vec4f(psi(row, ROTATION_CHANNEL), psi3(row, ROTATION_CHANNEL + 1u));
    let turned = r.rotation + turn;
    out.quaternion_length = quaternion_length(turned);
    out.rotation = vec4f(1.0, 0.0, 0.0, 0.0);
    if out.quaternion_length > 0.0 {
        out.rotation = turned / out.quaternion_length;
    }
    let exponent = r.log_scale + psi3(row, SCALE_CHANNEL);
    out.scale = exp(vec3f(bounded(exponent.x), bounded(exponent.y), bounded(exponent.z)));
    out.colour = r.colour + psi3(row, COLOUR_CHANNEL);
    deformed[n] = out;
    if LATENT_DIM > 0u {
        deform_features(row, n);
    }
}
