// Exclusive prefix sum in place, by blocks. `scan_blocks` scans each block and writes its sum. The sums
// are scanned in the same way, one level up. `add_offsets` then adds a block's offset to its items.
// Bindings are exactly as long as the data, so that arrayLength is the count. The sums are of integers,
// so the order cannot change the result.
//
// Bindings: crates/render/src/planes/scan.rs.

#import shared/dispatch.wgsl

const SCAN_ITEMS: u32 = SCAN_BLOCK / GROUP;

var<workgroup> lane_sums: array<u32, GROUP>;

@compute @workgroup_size(GROUP)
fn scan_blocks(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, num_groups);
    let first = block * SCAN_BLOCK + lane * SCAN_ITEMS;
    var own = array<u32, SCAN_ITEMS>();
    var sum = 0u;
    for (var i = 0u; i < SCAN_ITEMS; i++) {
        if first + i < arrayLength(&items) {
            own[i] = items[first + i];
        }
        sum += own[i];
    }
    lane_sums[lane] = sum;
    workgroupBarrier();
    for (var step = 1u; step < GROUP; step <<= 1u) {
        var before = 0u;
        if lane >= step {
            before = lane_sums[lane - step];
        }
        workgroupBarrier();
        lane_sums[lane] += before;
        workgroupBarrier();
    }
    var running = lane_sums[lane] - sum;
    for (var i = 0u; i < SCAN_ITEMS; i++) {
        if first + i < arrayLength(&items) {
            items[first + i] = running;
        }
        running += own[i];
    }
    if lane == GROUP - 1u && block < arrayLength(&block_sums) {
        block_sums[block] = running;
    }
}

@compute @workgroup_size(GROUP)
fn add_offsets(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_group(group, num_groups);
    if block >= arrayLength(&block_sums) {
        return;
    }
    let offset = block_sums[block];
    for (var i = lane; i < SCAN_BLOCK; i += GROUP) {
        let at = block * SCAN_BLOCK + i;
        if at < arrayLength(&items) {
            items[at] += offset;
        }
    }
}
