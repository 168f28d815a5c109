// Decoded embeddings and their products with the texts -> scores (method section 9.2); twin:
// core::relevancy::Exact.
//
//   score = sigmoid(temperature * (p - max n)), p and n cosines with the prompt and the negatives
//
// Bindings: crates/render/src/relevancy.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl

// 1 / length; 0 if there is no direction.
fn inverse_length(row: u32) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < params.embedding_dim; i++) {
        let value = embeddings[row * params.embedding_dim + i];
        sum += value * value;
    }
    let length = sqrt(sum);
    return select(0.0, 1.0 / length, length > 1e-12 && is_finite(length));
}

@compute @workgroup_size(GROUP)
fn score(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = flat_group(group, num_groups) * GROUP + lane;
    if row >= params.num_rows {
        return;
    }
    let own = row * params.num_texts + params.first_text;
    var margin = products[own];
    if params.num_negatives > 0u {
        var best = products[own + 1u];
        for (var i = 2u; i <= params.num_negatives; i++) {
            best = max(best, products[own + i]);
        }
        margin -= best;
    }
    scores[params.first_score + row] = sigmoid(params.temperature * margin * inverse_length(row));
}
