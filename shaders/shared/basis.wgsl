// One basis function over time; twin: core::deform::{basis, basis_backward}.

fn basis(shape: u32, time: f32, centre: f32, width: f32) -> f32 {
    let offset = time - centre;
    let w = max(abs(width), MIN_WIDTH);
    if shape == SHAPE_QUARTIC {
        let e = offset * offset / (width * width + QUARTIC_EPSILON);
        return exp(-e * e);
    }
    if shape == SHAPE_SPLINE {
        let u = abs(offset / w);
        let outer = max(2.0 - u, 0.0);
        let inner = max(1.0 - u, 0.0);
        return (outer * outer * outer - 4.0 * inner * inner * inner) / 6.0;
    }
    return exp(-(offset * offset) / (2.0 * w * w));
}

// Derivatives of the basis function with respect to centre and width.
fn basis_backward(shape: u32, time: f32, centre: f32, width: f32) -> vec2f {
    let offset = time - centre;
    let value = basis(shape, time, centre, width);
    let w = max(abs(width), MIN_WIDTH);
    if shape == SHAPE_QUARTIC {
        let q = width * width + QUARTIC_EPSILON;
        let e = offset * offset / q;
        return vec2f(value * 4.0 * e * offset / q, value * 4.0 * e * e * width / q);
    }
    var out: vec2f;
    if shape == SHAPE_SPLINE {
        let u = abs(offset / w);
        let outer = max(2.0 - u, 0.0);
        let inner = max(1.0 - u, 0.0);
        let along = 0.5 * (4.0 * inner * inner - outer * outer);
        out = vec2f(-along * sign(offset) / w, -along * u / width);
    } else {
        out = vec2f(value * offset / (w * w), value * offset * offset / (w * w * w) * sign(width));
    }
    // A width clamped to its bound has no gradient.
    return vec2f(out.x, select(0.0, out.y, abs(width) > MIN_WIDTH));
}
