// Copies an array, for the measurement of the memory's bandwidth.
//
// Bindings: crates/render/src/traffic.rs.

#import shared/dispatch.wgsl

@compute @workgroup_size(GROUP)
fn copy(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = flat_group(group, num_groups) * GROUP + lane;
    if i < arrayLength(&source) {
        copied[i] = source[i];
    }
}
