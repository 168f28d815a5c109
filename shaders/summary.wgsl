// Summary of the scores of each prompt; twin: core::summary. One invocation per pixel. All sums are of
// integers, so that their order does not matter.

#import constants
#import shared/num.wgsl
#import shared/dispatch.wgsl

struct Summarise {
    size: vec2u,
    num_prompts: u32,
    padding: u32,
}

struct PromptRow {
    // 0-255
    colour: vec3f,
    threshold: f32,
}

@group(0) @binding(0) var<uniform> params: Summarise;
@group(0) @binding(1) var<storage, read> prompts: array<PromptRow>;
// [prompts][rows][columns]
@group(0) @binding(2) var<storage, read> scores: array<f32>;
// [prompts]: SCORE_BINS of the histogram, the bits of the largest score, the number of found pixels of
// each column, of each row.
@group(0) @binding(3) var<storage, read_write> summaries: array<atomic<u32>>;

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
