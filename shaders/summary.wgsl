// Summary of the scores of each prompt; twin: core::summary. One invocation per pixel. All sums are of
// integers, so that their order does not matter.
//
// Bindings: crates/render/src/shown/summary.rs.

#import shared/num.wgsl
#import shared/dispatch.wgsl

@compute @workgroup_size(GROUP)
fn summarise(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = flat_group(group, num_groups) * GROUP + lane;
    let num_pixels = params.size.x * params.size.y;
    if pixel >= num_pixels {
        return;
    }
    let length = SCORE_BINS + 1u + params.size.x + params.size.y;
    for (var prompt = 0u; prompt < params.num_prompts; prompt++) {
        let score = scores[prompt * num_pixels + pixel];
        // Exactly 0 is a hole or outside the field of view: a score is never 0.
        if is_nan(score) || score <= 0.0 {
            continue;
        }
        let first = prompt * length;
        atomicAdd(&summaries[first + min(u32(score * f32(SCORE_BINS)), SCORE_BINS - 1u)], 1u);
        // Positive numbers sort like their bits.
        atomicMax(&summaries[first + SCORE_BINS], bitcast<u32>(score));
        if score > prompts[prompt].threshold {
            atomicAdd(&summaries[first + SCORE_BINS + 1u + pixel % params.size.x], 1u);
            atomicAdd(&summaries[first + SCORE_BINS + 1u + params.size.x + pixel / params.size.x], 1u);
        }
    }
}
