// Draws triangles whose corners have colours.

struct Corner {
    @builtin(position) position: vec4<f32>,
    // sRGB, 0 to 1, premultiplied.
    @location(0) colour: vec4<f32>,
}

@vertex
fn vertex(@location(0) at: vec2<f32>, @location(1) colour: vec4<f32>) -> Corner {
    return Corner(vec4<f32>(at, 0.0, 1.0), colour);
}

@fragment
fn gamma(corner: Corner) -> @location(0) vec4<f32> {
    return corner.colour;
}

// Draws into a target that takes linear colours.
@fragment
fn linear(corner: Corner) -> @location(0) vec4<f32> {
    let colour = corner.colour.rgb;
    let bright = pow((colour + 0.055) / 1.055, vec3<f32>(2.4));
    return vec4<f32>(select(bright, colour / 12.92, colour < vec3<f32>(0.04045)), corner.colour.a);
}
