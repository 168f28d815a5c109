// Stable radix sort of (key, value) pairs, one 4-bit digit per pass, least significant first; twin: a
// stable sort by key. A pass is `histogram`, an exclusive scan of the histogram (scan.wgsl), and
// `scatter`. The number of pairs is only known on the device, so blocks beyond the end count zero.
//
// Bindings: crates/render/src/planes/sort.rs.

#import shared/dispatch.wgsl

const DIGITS: u32 = 16u;
const SORT_ITEMS: u32 = SORT_BLOCK / SORT_GROUP;

fn num_pairs() -> u32 {
    return min(num_pairs_wanted[0], params.capacity);
}

fn digit_of(key: u32) -> u32 {
    return (key >> params.shift) & (DIGITS - 1u);
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
    if lane < DIGITS && block < params.num_blocks {
        places[lane * params.num_blocks + block] = atomicLoad(&digit_counts[lane]);
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
    if block < params.num_blocks {
        running = places[own_digit * params.num_blocks + block];
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
