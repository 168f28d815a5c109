// Random numbers by counter; twin: core::train::random. There is no state: the same counter gives the
// same numbers, in any order.

// PCG in four dimensions (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020).
fn pcg4d(counter: vec4u) -> vec4u {
    var v = counter * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> vec4u(16u);
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// Four numbers, evenly distributed over [0, 1).
fn uniform4(counter: vec4u) -> vec4f {
    return vec4f(pcg4d(counter) >> vec4u(8u)) / 16777216.0;
}

// Four normally distributed numbers (Box and Muller).
fn normal4(counter: vec4u) -> vec4f {
    const TAU: f32 = 6.2831855;
    let u = uniform4(counter);
    // 1 - u is in (0, 1], so that the logarithm is finite.
    let radius = sqrt(-2.0 * log(1.0 - u.xy));
    return vec4f(radius * cos(TAU * u.zw), radius * sin(TAU * u.zw));
}
