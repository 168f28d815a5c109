// The Gaussian at one pixel: of those in its tile, the one that contributes most to it; twin:
// core::raster::pick.

#import constants
#import shared/gaussian.wgsl
#import shared/view.wgsl

struct Picked {
    // Input: the pixel. The fields after it are the result.
    pixel: vec2u,
    // Index of the Gaussian; NO_GAUSSIAN if nothing contributes.
    gaussian: u32,
    // Its share of the pixel.
    weight: f32,
    // Depth of its centre.
    depth: f32,
    padding: u32,
    padding_2: vec2u,
}

const NO_GAUSSIAN: u32 = 0xffffffffu;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<SplatRow>;
// Gaussian indices, sorted by tile, then depth.
@group(0) @binding(2) var<storage, read> pair_gaussians: array<u32>;
// [first, end) of each tile in pair_gaussians.
@group(0) @binding(3) var<storage, read> tile_ranges: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> picked: Picked;

@compute @workgroup_size(1)
fn pick() {
    picked.gaussian = NO_GAUSSIAN;
    picked.weight = 0.0;
    picked.depth = 0.0;
    if any(picked.pixel >= view.size) {
        return;
    }
    let position = vec2f(picked.pixel) + 0.5;
    let tile = picked.pixel / TILE;
    let span = tile_ranges[tile.y * view.tiles.x + tile.x];
    var transmittance = 1.0;
    for (var i = span.x; i < span.y; i++) {
        let gaussian = pair_gaussians[i];
        let splat = splats[gaussian];
        let alpha = alpha_at(splat, position);
        if alpha < MIN_ALPHA {
            continue;
        }
        let weight = alpha * transmittance;
        let next = transmittance - weight;
        if next < MIN_TRANSMITTANCE {
            break;
        }
        if weight > picked.weight {
            picked.gaussian = gaussian;
            picked.weight = weight;
            picked.depth = splat.depth;
        }
        transmittance = next;
    }
}
