// Splats, tile by tile and front to back -> image planes (method section 4.3); twin: core::raster (forward).
//
// For each pixel: alpha = min(MAX_ALPHA, opacity exp(-d^T conic d / 2)), skipped below MIN_ALPHA. The
// pixel stops before its transmittance T would fall below MIN_TRANSMITTANCE. Planes: r, g, b, sum of w z,
// 1 - T, features. One workgroup per tile. Splats go through workgroup memory in small batches, which
// keeps occupancy high.
//
// Bindings: crates/render/src/planes/raster.rs.

#import shared/alpha.wgsl

const NUM_FEATURES: u32 = max(LATENT_DIM, 1u);
const PIXELS: u32 = TILE * TILE;

var<workgroup> batch: array<SplatRow, RASTER_BATCH>;
var<workgroup> batch_features: array<f32, RASTER_BATCH * NUM_FEATURES>;
var<workgroup> range: vec2u;
var<workgroup> num_done: atomic<u32>;
var<workgroup> all_done: u32;

fn load_batch(first: u32, count: u32, lane: u32) {
    if lane < count {
        batch[lane] = splats[pair_gaussians[first + lane]];
    }
    if LATENT_DIM > 0u {
        for (var i = lane; i < count * NUM_FEATURES; i += PIXELS) {
            let gaussian = pair_gaussians[first + i / NUM_FEATURES];
            batch_features[i] = features[gaussian * NUM_FEATURES + i % NUM_FEATURES];
        }
    }
}

@compute @workgroup_size(TILE, TILE)
fn raster(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(global_invocation_id) pixel: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let is_inside = pixel.x < view.size.x && pixel.y < view.size.y;
    let position = vec2f(pixel.xy) + 0.5;
    if lane == 0u {
        range = tile_ranges[tile.y * view.tiles.x + tile.x];
        atomicStore(&num_done, 0u);
    }
    let span = workgroupUniformLoad(&range);
    var colour = vec3f(0.0);
    var depth = 0.0;
    var feature = array<f32, NUM_FEATURES>();
    var transmittance = 1.0;
    var is_done = !is_inside;
    if is_done {
        atomicAdd(&num_done, 1u);
    }
    for (var first = span.x; first < span.y; first += RASTER_BATCH) {
        let count = min(RASTER_BATCH, span.y - first);
        workgroupBarrier();
        load_batch(first, count, lane);
        if lane == 0u {
            all_done = atomicLoad(&num_done);
        }
        if workgroupUniformLoad(&all_done) == PIXELS {
            break;
        }
        for (var k = 0u; k < count && !is_done; k++) {
            let splat = batch[k];
            let alpha = alpha_at(splat, position);
            if alpha < MIN_ALPHA {
                continue;
            }
            let weight = alpha * transmittance;
            let next = transmittance - weight;
            if next < MIN_TRANSMITTANCE {
                is_done = true;
                atomicAdd(&num_done, 1u);
                break;
            }
            colour += weight * splat.colour;
            depth += weight * splat.depth;
            if LATENT_DIM > 0u {
                for (var c = 0u; c < NUM_FEATURES; c++) {
                    feature[c] += weight * batch_features[k * NUM_FEATURES + c];
                }
            }
            transmittance = next;
        }
    }
    if !is_inside {
        return;
    }
    let plane = view.size.x * view.size.y;
    let at = pixel.y * view.size.x + pixel.x;
    planes[at] = colour.x;
    planes[plane + at] = colour.y;
    planes[2u * plane + at] = colour.z;
    planes[DEPTH_PLANE * plane + at] = depth;
    planes[ALPHA_PLANE * plane + at] = 1.0 - transmittance;
    for (var c = 0u; c < LATENT_DIM; c++) {
        planes[(FEATURE_PLANE + c) * plane + at] = feature[c];
    }
}
