// Slot that a tile writes for each of its splats: six moments of dL/d(exponent) about the splat's centre
// (1, x, y, xx, xy, yy), then dL/d(channel) of r, g, b, depth and the features.

const SLOT_CHANNELS: u32 = SLOT_BASE_CHANNELS + LATENT_DIM;
const SLOT: u32 = SLOT_MOMENTS + SLOT_CHANNELS;
