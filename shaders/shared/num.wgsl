// Numbers at the edges; twin of core::num. NaN and infinity are detected by bit patterns, because shader
// compilers may assume that they do not occur and drop comparisons that look for them.

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn is_nan(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) > 0x7f800000u;
}

// Inverse of sigmoid; p is first clamped to at least 1e-6 from 0 and 1.
fn logit(p: f32) -> f32 {
    let inside = clamp(p, 1e-6, 1.0 - 1e-6);
    return log(inside / (1.0 - inside));
}

// 1 / (1 + e^-x) without overflow.
fn sigmoid(x: f32) -> f32 {
    let e = exp(-abs(x));
    let small = e / (1.0 + e);
    return select(small, 1.0 - small, x >= 0.0);
}
