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
    // Number of pairs that the pair buffers can hold.
    pair_capacity: u32,
    // Distance between rendered pixels along both axes, and the first of them; `size` counts the rendered
    // ones.
    sampling_step: u32,
    padding: u32,
    sampling_first: vec2u,
    padding_2: vec2u,
}
