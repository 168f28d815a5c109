// Decoded embeddings and their products with the texts -> scores (method section 9.2); twin:
// core::relevancy::Exact.
//
//   score = sigmoid(temperature * min(max p - max n, largest margin)), p and n cosines with what the prompt
//   means and with what it is compared with
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

// Largest of `count` products from `first` on.
fn best_product(first: u32, count: u32) -> f32 {
    var best = products[first];
    for (var i = 1u; i < count; i++) {
        best = max(best, products[first + i]);
    }
    return best;
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
    var margin = best_product(own, params.num_meant);
    if params.num_negatives > 0u {
        margin -= best_product(own + params.num_meant, params.num_negatives);
    }
    margin = min(margin * inverse_length(row), params.largest_margin);
    scores[params.first_score + row] = sigmoid(params.temperature * margin);
}
