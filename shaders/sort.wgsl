// Stable radix sort of (key, value) pairs, one 4-bit digit per pass, least significant first; twin: a
// stable sort by key. A pass is `histogram`, an exclusive scan of the histogram (scan.wgsl), and
// `scatter`. The number of pairs is only known on the device, so blocks beyond the end count zero.

#import constants
#import shared/dispatch.wgsl

struct Digit {
    // Lowest bit of this pass's digit.
    shift: u32,
    num_blocks: u32,
    // Largest number of pairs that fit the buffers.
    capacity: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> digit: Digit;
// Number of pairs that were wanted; may exceed the capacity.
@group(0) @binding(1) var<storage, read> num_wanted: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;
// [DIGITS][num_blocks]: counts; after the scan the places of each block's pairs with that digit.
@group(0) @binding(6) var<storage, read_write> places: array<u32>;

const DIGITS: u32 = 16u;
const SORT_ITEMS: u32 = SORT_BLOCK / SORT_GROUP;

fn num_pairs() -> u32 {
    return min(num_wanted[0], digit.capacity);
}

fn digit_of(key: u32) -> u32 {
    return (key >> digit.shift) & (DIGITS - 1u);
}

var<workgroup> digit_counts: array<atomic<u32>, DIGITS>;

@compute @workgroup_size(SORT_GROUP)
fn histogram(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, num_groups);
    if lane < DIGITS {
        atomicStore(&digit_counts[lane], 0u);
    }
    workgroupBarrier();
    let end = min((block + 1u) * SORT_BLOCK, num_pairs());
    for (var i = block * SORT_BLOCK + lane; i < end; i += SORT_GROUP) {
        atomicAdd(&digit_counts[digit_of(keys_in[i])], 1u);
    }
    workgroupBarrier();
    if lane < DIGITS && block < digit.num_blocks {
        places[lane * digit.num_blocks + block] = atomicLoad(&digit_counts[lane]);
    }
}

// [DIGITS][SORT_GROUP]: for each digit and lane first the count, then the next place.
var<workgroup> lane_places: array<u32, DIGITS * SORT_GROUP>;
var<workgroup> partial_sums: array<u32, SORT_GROUP>;

// Turns counts into places. Each lane owns a run of DIGITS counters; SORT_GROUP / DIGITS lanes share a digit.
fn place_lanes(block: u32, lane: u32) {
    let first = lane * DIGITS;
    var sum = 0u;
    for (var i = 0u; i < DIGITS; i++) {
        sum += lane_places[first + i];
    }
    partial_sums[lane] = sum;
    workgroupBarrier();
    let lanes_per_digit = SORT_GROUP / DIGITS;
    let own_digit = lane / lanes_per_digit;
    var running = 0u;
    if block < digit.num_blocks {
        running = places[own_digit * digit.num_blocks + block];
    }
    for (var other = own_digit * lanes_per_digit; other < lane; other++) {
        running += partial_sums[other];
    }
    for (var i = 0u; i < DIGITS; i++) {
        let count = lane_places[first + i];
        lane_places[first + i] = running;
        running += count;
    }
    workgroupBarrier();
}

@compute @workgroup_size(SORT_GROUP)
fn scatter(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, num_groups);
    for (var d = 0u; d < DIGITS; d++) {
        lane_places[d * SORT_GROUP + lane] = 0u;
    }
    // Each lane takes consecutive pairs, which keeps the sort stable.
    let first = block * SORT_BLOCK + lane * SORT_ITEMS;
    let end = min(first + SORT_ITEMS, num_pairs());
    for (var i = first; i < end; i++) {
        lane_places[digit_of(keys_in[i]) * SORT_GROUP + lane] += 1u;
    }
    workgroupBarrier();
    place_lanes(block, lane);
    for (var i = first; i < end; i++) {
        let key = keys_in[i];
        let counter = digit_of(key) * SORT_GROUP + lane;
        let place = lane_places[counter];
        lane_places[counter] = place + 1u;
        keys_out[place] = key;
        values_out[place] = values_in[i];
    }
}
