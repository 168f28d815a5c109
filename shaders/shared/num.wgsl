// Numbers at the edges; twin of core::num. Tests on bit patterns, because shader compilers may assume that
// NaN and infinity do not occur and drop comparisons that look for them.

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn is_nan(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) > 0x7f800000u;
}

// 1 / (1 + e^-x) without overflow.
fn sigmoid(x: f32) -> f32 {
    let e = exp(-abs(x));
    let small = e / (1.0 + e);
    return select(small, 1.0 - small, x >= 0.0);
}
