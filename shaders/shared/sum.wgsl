// Sums over a workgroup of GROUP lanes, always in the same order.

var<workgroup> lane_terms: array<vec4f, GROUP>;

// Sum of all lanes' values, returned in every lane.
fn workgroup_sum(value: vec4f, lane: u32) -> vec4f {
    workgroupBarrier();
    lane_terms[lane] = value;
    workgroupBarrier();
    for (var half = GROUP / 2u; half > 0u; half /= 2u) {
        if lane < half {
            lane_terms[lane] += lane_terms[lane + half];
        }
        workgroupBarrier();
    }
    return lane_terms[0];
}

// Sign of x; 0 for 0 and for NaN.
fn sign_of(x: f32) -> f32 {
    return select(0.0, 1.0, x > 0.0) - select(0.0, 1.0, x < 0.0);
}
