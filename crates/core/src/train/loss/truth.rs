//! Ground truth of a frame.

/// Ground truth that a frame is compared with.
#[derive(Clone, Copy, Debug)]
pub struct Truth<'a> {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Colours r, g, b, plane after plane, 0–255.
    pub colour: &'a [u8],
    /// Pixels that are supervised: `true` = supervise.
    pub mask: &'a [bool],
    /// Depth: z in scene units, 0 where unknown; empty if there is no depth.
    pub depth: &'a [f32],
    /// Row of the latent table for each pixel, [`crate::prepare::NO_REGION`] if none; empty if there are
    /// no features.
    pub regions: &'a [u16],
    /// Table of latent features, [rows][D].
    pub latents: &'a [f32],
    /// Typical depth (scene units), which makes the inverse-depth term independent of units.
    pub typical_depth: f32,
}
