// Draws a part of a picture into a rectangle of the window.

struct Quad {
    // Left, top, right and bottom of the rectangle in the window, -1 to 1, upwards.
    place: vec4<f32>,
    // Left, top, right and bottom of the part of the picture, 0 to 1, downwards.
    part: vec4<f32>,
    // Size of a pixel of the window in the picture, 0 to 1.
    step: vec2<f32>,
    // Number of samples per pixel of the window, across and down.
    samples: vec2<f32>,
}

@group(0) @binding(0) var<uniform> quad: Quad;
@group(0) @binding(1) var picture: texture_2d<f32>;
@group(0) @binding(2) var linear: sampler;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) at: vec2<f32>,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    let share = vec2<f32>(f32(index & 1u), f32(index >> 1u));
    let position = mix(quad.place.xy, quad.place.zw, share);
    return Corner(vec4<f32>(position, 0.0, 1.0), mix(quad.part.xy, quad.part.zw, share));
}

// Draws a picture that is about as large as it is, or larger.
@fragment
fn plain(corner: Corner) -> @location(0) vec4<f32> {
    return textureSampleLevel(picture, linear, corner.at, 0.0);
}

// Draws a picture smaller than it is: each pixel is the mean of what it covers.
@fragment
fn averaged(corner: Corner) -> @location(0) vec4<f32> {
    var sum = vec4<f32>(0.0);
    for (var y = 0.5; y < quad.samples.y; y += 1.0) {
        for (var x = 0.5; x < quad.samples.x; x += 1.0) {
            let offset = (vec2<f32>(x, y) / quad.samples - 0.5) * quad.step;
            sum += textureSampleLevel(picture, linear, corner.at + offset, 0.0);
        }
    }
    return sum / (quad.samples.x * quad.samples.y);
}
