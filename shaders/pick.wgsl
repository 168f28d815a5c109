// The Gaussian at one pixel: of those in its tile, the one that contributes most to it; twin:
// core::raster::pick.
//
// Bindings: crates/render/src/planes/pick.rs.

#import shared/alpha.wgsl

const NO_GAUSSIAN: u32 = 0xffffffffu;

@compute @workgroup_size(1)
fn pick() {
    picked[0].gaussian = NO_GAUSSIAN;
    picked[0].weight = 0.0;
    picked[0].depth = 0.0;
    if any(picked[0].pixel >= view.size) {
        return;
    }
    let position = vec2f(picked[0].pixel) + 0.5;
    let tile = picked[0].pixel / TILE;
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
        if weight > picked[0].weight {
            picked[0].gaussian = gaussian;
            picked[0].weight = weight;
            picked[0].depth = splat.depth;
        }
        transmittance = next;
    }
}
