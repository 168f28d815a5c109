// One layer of the decoder for many points: out = in W^T + b, then ReLU if asked for; twin: core::codec
// (apply).
//
// A workgroup computes a DENSE_TILE x DENSE_TILE block of the output, each invocation DENSE_EACH x
// DENSE_EACH of it. Inputs and weights go through workgroup memory, DENSE_DEPTH columns at a time.
//
// Bindings: crates/render/src/relevancy.rs.

const DENSE_EACH: u32 = 4u;
const DENSE_SIDE: u32 = DENSE_TILE / DENSE_EACH;
const DENSE_DEPTH: u32 = 16u;

// [DENSE_DEPTH][DENSE_TILE] each.
var<workgroup> input_tile: array<f32, DENSE_DEPTH * DENSE_TILE>;
var<workgroup> weight_tile: array<f32, DENSE_DEPTH * DENSE_TILE>;

// Columns [first_in, first_in + DENSE_DEPTH) of the tile's rows; zero beyond the edges.
fn load_tiles(corner: vec2u, first_in: u32, lane: u32) {
    for (var i = lane; i < DENSE_DEPTH * DENSE_TILE; i += DENSE_SIDE * DENSE_SIDE) {
        let column = first_in + i % DENSE_DEPTH;
        let row = i / DENSE_DEPTH;
        let at = (i % DENSE_DEPTH) * DENSE_TILE + row;
        var input = 0.0;
        if corner.y + row < params.num_rows && column < params.num_in {
            input = inputs[(params.first_row + corner.y + row) * params.num_in + column];
        }
        input_tile[at] = input;
        var weight = 0.0;
        if corner.x + row < params.num_out && column < params.num_in {
            weight = weights[(corner.x + row) * params.num_in + column];
        }
        weight_tile[at] = weight;
    }
}

@compute @workgroup_size(DENSE_SIDE, DENSE_SIDE)
fn dense(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(local_invocation_id) own: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let corner = tile.xy * DENSE_TILE;
    var sums = array<vec4f, DENSE_EACH>();
    for (var first_in = 0u; first_in < params.num_in; first_in += DENSE_DEPTH) {
        load_tiles(corner, first_in, lane);
        workgroupBarrier();
        for (var k = 0u; k < DENSE_DEPTH; k++) {
            let w = k * DENSE_TILE + own.x * DENSE_EACH;
            let weight = vec4f(weight_tile[w], weight_tile[w + 1u], weight_tile[w + 2u], weight_tile[w + 3u]);
            for (var i = 0u; i < DENSE_EACH; i++) {
                sums[i] += input_tile[k * DENSE_TILE + own.y * DENSE_EACH + i] * weight;
            }
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < DENSE_EACH; i++) {
        let row = corner.y + own.y * DENSE_EACH + i;
        for (var j = 0u; j < DENSE_EACH; j++) {
            let column = corner.x + own.x * DENSE_EACH + j;
            if row < params.num_rows && column < params.num_out {
                let value = sums[i][j] + biases[column];
                outputs[row * params.num_out + column] = select(value, max(value, 0.0), params.has_relu == 1u);
            }
        }
    }
}
