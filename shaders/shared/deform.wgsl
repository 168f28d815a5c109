// Deformation of one part at one time; mirror of layout::Deform.

struct Deform {
    // This part is the rows [first_row, first_row + num_rows) of the scene.
    first_row: u32,
    num_rows: u32,
    stride: u32,
    // Live bases [first_basis, last_basis).
    first_basis: u32,
    last_basis: u32,
    num_bases: u32,
    // 1 if all Gaussians share centres and widths: `tables` then starts with the basis values.
    is_shared: u32,
    // SHAPE_GAUSSIAN, SHAPE_QUARTIC (of the released code) or SHAPE_SPLINE.
    shape: u32,
    time: f32,
    gate_slope: f32,
    // First channel of the features' gate.
    gate_channel: u32,
    padding: u32,
}
