// Gradients of the image planes -> one slot per splat-tile pair; twin: core::raster::backward.
//
// Each tile replays its splats front to back, and it alone writes the slots of its pairs. So there are no
// atomics, and the sums have a fixed order. For any number of channels the replay needs two numbers per
// pixel: transmittance T and rest = sum over the splats not yet visited of w (c . g), which starts as
// (image . g). Then dL/dalpha = T (c . g) - rest / (1 - alpha).
//
// Splats are replayed in small batches. First a thread per pixel computes each splat's weight and
// dL/d(exponent). Then the threads change their roles: one for each splat, kind of number and column of the
// tile sums down that column. At last a thread for each number of a slot adds up the columns. Slots of pairs
// that no pixel reaches must have been cleared.
//
// Bindings: crates/render/src/train/step/backward.rs.

#import shared/alpha.wgsl
#import shared/slot.wgsl

const PIXELS: u32 = TILE * TILE;
const NUM_FEATURES: u32 = max(LATENT_DIM, 1u);
// Kinds of numbers: the moments, and equal shares of the channels.
const KINDS: u32 = PIXELS / (BACKWARD_BATCH * TILE);
const SHARE: u32 = (SLOT_CHANNELS + KINDS - 2u) / (KINDS - 1u);
// Room for the columns' sums of one number. One more than there are, so that threads that read the same
// column of neighbouring numbers do not wait for each other.
const COLUMNS: u32 = TILE + 1u;
// Number of splats that are loaded at once: a multiple of the batch that the least memory of a workgroup,
// 16 KiB, has room for.
const SPLAT_BYTES: u32 = 4u * (13u + NUM_FEATURES);
const ROOM: u32 = 16000u - 4u * BACKWARD_BATCH * (2u * PIXELS + SLOT * COLUMNS);
const LOADED: u32 = min(32u, ROOM / SPLAT_BYTES / BACKWARD_BATCH * BACKWARD_BATCH);

var<workgroup> loaded: array<SplatRow, LOADED>;
var<workgroup> loaded_features: array<f32, LOADED * NUM_FEATURES>;
var<workgroup> loaded_slots: array<u32, LOADED>;
// Weight and dL/d(exponent) of each splat of the batch at each pixel.
var<workgroup> replayed: array<vec2f, BACKWARD_BATCH * PIXELS>;
// Sums of the columns, [splat of the batch][number of its slot][column].
var<workgroup> column_sums: array<f32, BACKWARD_BATCH * SLOT * COLUMNS>;
var<workgroup> range: vec2u;
var<workgroup> num_done: atomic<u32>;
var<workgroup> all_done: u32;

struct Pixel {
    // dL/d(channel) and dL/d(alpha).
    g_colour: vec3f,
    g_depth: f32,
    g_features: array<f32, NUM_FEATURES>,
    g_alpha: f32,
    transmittance: f32,
    rest: f32,
    is_done: bool,
}

// Plane of a blended channel: r, g, b, depth, features. Alpha lies between depth and features.
fn plane_of(channel: u32) -> u32 {
    return channel + select(0u, 1u, channel >= ALPHA_PLANE);
}

// dL/d(channel) at pixel p; adds its part of the pixel's sum of image . g.
fn gradient_at(channel: u32, p: u32, pixel: ptr<function, Pixel>) -> f32 {
    let at = plane_of(channel) * view.size.x * view.size.y + p;
    let g = g_planes[at];
    (*pixel).rest += g * planes[at];
    // Not a comparison of the sum with 0: NaN must reach the gradients, so that it is noticed there.
    (*pixel).is_done = (*pixel).is_done && g == 0.0;
    return g;
}

fn load_pixel(at: vec2u) -> Pixel {
    var pixel: Pixel;
    pixel.transmittance = 1.0;
    pixel.is_done = true;
    if at.x >= view.size.x || at.y >= view.size.y {
        return pixel;
    }
    let p = at.y * view.size.x + at.x;
    let alpha = ALPHA_PLANE * view.size.x * view.size.y + p;
    pixel.g_alpha = g_planes[alpha];
    pixel.rest = pixel.g_alpha * planes[alpha];
    pixel.is_done = pixel.g_alpha == 0.0;
    pixel.g_colour.x = gradient_at(0u, p, &pixel);
    pixel.g_colour.y = gradient_at(1u, p, &pixel);
    pixel.g_colour.z = gradient_at(2u, p, &pixel);
    pixel.g_depth = gradient_at(3u, p, &pixel);
    for (var d = 0u; d < LATENT_DIM; d++) {
        pixel.g_features[d] = gradient_at(SLOT_BASE_CHANNELS + d, p, &pixel);
    }
    return pixel;
}

// Blends loaded splat k into the pixel; returns its weight and dL/d(exponent).
fn replay(k: u32, position: vec2f, pixel: ptr<function, Pixel>) -> vec2f {
    let raw = unclamped_alpha_at(loaded[k], position);
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
    var value = (*pixel).g_alpha + dot(loaded[k].colour, (*pixel).g_colour) + loaded[k].depth * (*pixel).g_depth;
    for (var d = 0u; d < LATENT_DIM; d++) {
        value += loaded_features[k * NUM_FEATURES + d] * (*pixel).g_features[d];
    }
    (*pixel).rest -= weight * value;
    (*pixel).transmittance = next;
    let g_alpha = transmittance * value - (*pixel).rest / (1.0 - alpha);
    // There is no gradient through a clamped alpha.
    return vec2f(weight, select(0.0, g_alpha * alpha, raw <= MAX_ALPHA));
}

// Sums down a column the moments of dL/d(exponent) about the centre of splat k of the batch.
fn sum_moments(k: u32, column: u32, centre: vec2f, origin: vec2u) {
    let first = vec2f(origin + vec2u(column, 0u)) + 0.5 - centre;
    var sums = vec3f(0.0);
    for (var row = 0u; row < TILE; row++) {
        let dy = first.y + f32(row);
        sums += replayed[k * PIXELS + row * TILE + column].y * vec3f(1.0, dy, dy * dy);
    }
    let at = k * SLOT * COLUMNS + column;
    column_sums[at] = sums.x;
    column_sums[at + COLUMNS] = first.x * sums.x;
    column_sums[at + 2u * COLUMNS] = sums.y;
    column_sums[at + 3u * COLUMNS] = first.x * first.x * sums.x;
    column_sums[at + 4u * COLUMNS] = first.x * sums.y;
    column_sums[at + 5u * COLUMNS] = sums.z;
}

// Sums down a column a share of the channels' gradients for splat k of the batch.
fn sum_channels(k: u32, column: u32, first: u32, origin: vec2u) {
    let plane = view.size.x * view.size.y;
    var sums = array<f32, SHARE>();
    for (var row = 0u; row < TILE; row++) {
        let weight = replayed[k * PIXELS + row * TILE + column].x;
        // Pixels beyond the picture have weight 0.
        let inside = min(origin + vec2u(column, row), view.size - 1u);
        let p = inside.y * view.size.x + inside.x;
        for (var i = 0u; i < SHARE; i++) {
            let channel = min(first + i, SLOT_CHANNELS - 1u);
            sums[i] += weight * g_planes[plane_of(channel) * plane + p];
        }
    }
    for (var i = 0u; i < SHARE && first + i < SLOT_CHANNELS; i++) {
        column_sums[(k * SLOT + SLOT_MOMENTS + first + i) * COLUMNS + column] = sums[i];
    }
}

fn load(first: u32, count: u32, thread: u32) {
    if thread < count {
        loaded[thread] = splats[pair_gaussians[first + thread]];
        loaded_slots[thread] = pair_slots[first + thread];
    }
    for (var i = thread; i < count * NUM_FEATURES && LATENT_DIM > 0u; i += PIXELS) {
        let splat = pair_gaussians[first + i / NUM_FEATURES];
        loaded_features[i] = features[splat * NUM_FEATURES + i % NUM_FEATURES];
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
    let origin = tile.xy * TILE;
    let position = vec2f(at.xy) + 0.5;
    let column = thread % TILE;
    let own_splat = thread / TILE % BACKWARD_BATCH;
    let kind = thread / (TILE * BACKWARD_BATCH);
    var pixel = load_pixel(at.xy);
    if pixel.is_done {
        atomicAdd(&num_done, 1u);
    }
    for (var first = span.x; first < span.y; first += LOADED) {
        let num_loaded = min(LOADED, span.y - first);
        workgroupBarrier();
        load(first, num_loaded, thread);
        if thread == 0u {
            all_done = atomicLoad(&num_done);
        }
        if workgroupUniformLoad(&all_done) == PIXELS {
            break;
        }
        for (var batch = 0u; batch < num_loaded; batch += BACKWARD_BATCH) {
            let count = min(BACKWARD_BATCH, num_loaded - batch);
            for (var k = 0u; k < count; k++) {
                var found = vec2f(0.0);
                if !pixel.is_done {
                    found = replay(batch + k, position, &pixel);
                    if pixel.is_done {
                        atomicAdd(&num_done, 1u);
                    }
                }
                replayed[k * PIXELS + thread] = found;
            }
            workgroupBarrier();
            if own_splat < count {
                if kind == 0u {
                    sum_moments(own_splat, column, loaded[batch + own_splat].centre, origin);
                } else {
                    sum_channels(own_splat, column, (kind - 1u) * SHARE, origin);
                }
            }
            workgroupBarrier();
            for (var i = thread; i < count * SLOT; i += PIXELS) {
                var sum = 0.0;
                for (var c = 0u; c < TILE; c++) {
                    sum += column_sums[i * COLUMNS + c];
                }
                slots[loaded_slots[batch + i / SLOT] * SLOT + i % SLOT] = sum;
            }
        }
    }
}
