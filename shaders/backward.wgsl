// Gradients of the image planes -> one slot per splat-tile pair; twin: core::raster::backward.
//
// Each tile replays its splats front to back, and it alone writes the slots of its pairs. So there are no
// atomics, and the sums have a fixed order. For any number of channels the replay needs two numbers per
// pixel: transmittance T and rest = sum over the splats not yet visited of w (c . g), which starts as
// (image . g). Then dL/dalpha = T (c . g) - rest / (1 - alpha).
//
// Splats are processed in batches. First a thread per pixel computes each splat's weight and dL/d(exponent),
// then LANES threads per splat sum them up over the tile. The slots must have been cleared.
//
// Bindings: crates/render/src/train/step/backward.rs.

#import shared/alpha.wgsl
#import shared/slot.wgsl

const PIXELS: u32 = TILE * TILE;
const NUM_FEATURES: u32 = max(LATENT_DIM, 1u);
// Threads that sum up one splat, and pixels of each thread.
const LANES: u32 = PIXELS / BACKWARD_BATCH;
const LANE_PIXELS: u32 = PIXELS / LANES;
// Numbers of a slot that fit into the shared memory at once.
const ROUND: u32 = 2u * BACKWARD_BATCH;

var<workgroup> batch: array<SplatRow, BACKWARD_BATCH>;
var<workgroup> batch_features: array<f32, BACKWARD_BATCH * NUM_FEATURES>;
// (weight, dL/d(exponent)) of each splat and pixel; then the lanes' sums.
var<workgroup> replayed: array<vec2f, BACKWARD_BATCH * PIXELS>;
var<workgroup> range: vec2u;
var<workgroup> num_done: atomic<u32>;
var<workgroup> all_done: u32;

struct Pixel {
    // dL/d(channel) and dL/d(alpha).
    g: array<f32, SLOT_CHANNELS>,
    g_alpha: f32,
    transmittance: f32,
    rest: f32,
    is_done: bool,
}

// Plane of a blended channel: r, g, b, depth, features. Alpha lies between depth and features.
fn plane_of(channel: u32) -> u32 {
    return channel + select(0u, 1u, channel >= ALPHA_PLANE);
}

fn load_pixel(at: vec2u) -> Pixel {
    var pixel: Pixel;
    pixel.transmittance = 1.0;
    pixel.is_done = true;
    if at.x >= view.size.x || at.y >= view.size.y {
        return pixel;
    }
    let plane = view.size.x * view.size.y;
    let p = at.y * view.size.x + at.x;
    pixel.g_alpha = g_planes[ALPHA_PLANE * plane + p];
    pixel.rest = pixel.g_alpha * planes[ALPHA_PLANE * plane + p];
    // Not a comparison of the sum with 0: NaN must reach the gradients, so that it is noticed there.
    pixel.is_done = pixel.g_alpha == 0.0;
    for (var c = 0u; c < SLOT_CHANNELS; c++) {
        let g = g_planes[plane_of(c) * plane + p];
        pixel.g[c] = g;
        pixel.rest += g * planes[plane_of(c) * plane + p];
        pixel.is_done = pixel.is_done && g == 0.0;
    }
    return pixel;
}

fn channel_of(k: u32, c: u32) -> f32 {
    if c < 3u {
        return batch[k].colour[c];
    }
    if c == 3u {
        return batch[k].depth;
    }
    return batch_features[k * NUM_FEATURES + c - SLOT_BASE_CHANNELS];
}

// Blends splat k of the batch into the pixel; returns its weight and dL/d(exponent).
fn replay(k: u32, position: vec2f, pixel: ptr<function, Pixel>) -> vec2f {
    let raw = unclamped_alpha_at(batch[k], position);
    let alpha = min(raw, MAX_ALPHA);
    if alpha < MIN_ALPHA {
        return vec2f(0.0);
    }
    let transmittance = (*pixel).transmittance;
    let weight = alpha * transmittance;
    let next = transmittance - weight;
    if next < MIN_TRANSMITTANCE {
        (*pixel).is_done = true;
        return vec2f(0.0);
    }
    var value = (*pixel).g_alpha;
    for (var c = 0u; c < SLOT_CHANNELS; c++) {
        value += channel_of(k, c) * (*pixel).g[c];
    }
    (*pixel).rest -= weight * value;
    (*pixel).transmittance = next;
    let g_alpha = transmittance * value - (*pixel).rest / (1.0 - alpha);
    // There is no gradient through a clamped alpha.
    return vec2f(weight, select(0.0, g_alpha * alpha, raw <= MAX_ALPHA));
}

// One lane's part of the slot of splat k: moments of dL/d(exponent) about its centre, then the channels.
fn lane_sums(k: u32, lane: u32, origin: vec2u) -> array<f32, SLOT> {
    var sums = array<f32, SLOT>();
    let plane = view.size.x * view.size.y;
    for (var i = 0u; i < LANE_PIXELS; i++) {
        let number = i * LANES + lane;
        let found = replayed[k * PIXELS + number];
        let at = origin + vec2u(number % TILE, number / TILE);
        let d = vec2f(at) + 0.5 - batch[k].centre;
        let moment = found.y * d;
        sums[0] += found.y;
        sums[1] += moment.x;
        sums[2] += moment.y;
        sums[3] += moment.x * d.x;
        sums[4] += moment.x * d.y;
        sums[5] += moment.y * d.y;
        // Pixels beyond the picture have weight 0.
        let inside = min(at, view.size - 1u);
        let p = inside.y * view.size.x + inside.x;
        for (var c = 0u; c < SLOT_CHANNELS; c++) {
            sums[SLOT_MOMENTS + c] += found.x * g_planes[plane_of(c) * plane + p];
        }
    }
    return sums;
}

fn load_batch(first: u32, count: u32, thread: u32) {
    if thread < count {
        batch[thread] = splats[pair_splats[first + thread]];
    }
    for (var i = thread; i < count * NUM_FEATURES && LATENT_DIM > 0u; i += PIXELS) {
        let splat = pair_splats[first + i / NUM_FEATURES];
        batch_features[i] = features[splat * NUM_FEATURES + i % NUM_FEATURES];
    }
}

@compute @workgroup_size(TILE, TILE)
fn backward(
    @builtin(workgroup_id) tile: vec3u,
    @builtin(global_invocation_id) at: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    if thread == 0u {
        range = tile_ranges[tile.y * view.tiles.x + tile.x];
        atomicStore(&num_done, 0u);
    }
    let span = workgroupUniformLoad(&range);
    let position = vec2f(at.xy) + 0.5;
    var pixel = load_pixel(at.xy);
    if pixel.is_done {
        atomicAdd(&num_done, 1u);
    }
    for (var first = span.x; first < span.y; first += BACKWARD_BATCH) {
        let count = min(BACKWARD_BATCH, span.y - first);
        workgroupBarrier();
        load_batch(first, count, thread);
        if thread == 0u {
            all_done = atomicLoad(&num_done);
        }
        if workgroupUniformLoad(&all_done) == PIXELS {
            break;
        }
        for (var k = 0u; k < count; k++) {
            var found = vec2f(0.0);
            if !pixel.is_done {
                found = replay(k, position, &pixel);
                if pixel.is_done {
                    atomicAdd(&num_done, 1u);
                }
            }
            replayed[k * PIXELS + thread] = found;
        }
        workgroupBarrier();
        var sums = array<f32, SLOT>();
        let splat = thread / LANES;
        if splat < count {
            sums = lane_sums(splat, thread % LANES, tile.xy * TILE);
        }
        // Adds the lanes' sums, ROUND numbers of the slot at a time.
        for (var start = 0u; start < SLOT; start += ROUND) {
            workgroupBarrier();
            for (var j = 0u; j < BACKWARD_BATCH; j++) {
                var pair = vec2f(0.0);
                if start + 2u * j < SLOT {
                    pair.x = sums[start + 2u * j];
                }
                if start + 2u * j + 1u < SLOT {
                    pair.y = sums[start + 2u * j + 1u];
                }
                replayed[j * PIXELS + thread] = pair;
            }
            workgroupBarrier();
            for (var i = thread; i < count * BACKWARD_BATCH; i += PIXELS) {
                let k = i / BACKWARD_BATCH;
                let j = i % BACKWARD_BATCH;
                var sum = vec2f(0.0);
                for (var lane = 0u; lane < LANES; lane++) {
                    sum += replayed[j * PIXELS + k * LANES + lane];
                }
                let slot = pair_slots[first + k] * SLOT + start + 2u * j;
                if start + 2u * j < SLOT {
                    slots[slot] = sum.x;
                }
                if start + 2u * j + 1u < SLOT {
                    slots[slot + 1u] = sum.y;
                }
            }
        }
    }
}
