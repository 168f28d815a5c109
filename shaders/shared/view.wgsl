// The camera and the sizes of the frame; mirror of layout::View.

struct View {
    // Rows of [R | t].
    camera_from_world: array<vec4f, 3>,
    position: vec3f,
    sh_degree: u32,
    focal: vec2f,
    centre: vec2f,
    // Range of x/z and y/z in which the Jacobian is evaluated.
    guard_low: vec2f,
    guard_high: vec2f,
    // Image size in pixels and in tiles.
    size: vec2u,
    tiles: vec2u,
    num_gaussians: u32,
    // How many pairs the pair buffers hold.
    pair_capacity: u32,
    // Every how many pixels are rendered, along both axes, and the first; `size` counts those rendered.
    sampling_step: u32,
    padding: u32,
    sampling_first: vec2u,
    padding_2: vec2u,
}
