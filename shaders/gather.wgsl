// Slots of each splat, summed in the order of its tiles -> gradients of the splats; twin:
// core::raster::backward (gather), core::raster::project::Sampling::apply_backward and
// core::train::Statistics::add.
//
// The slots of the splat with depth rank r are first_pair[r]..first_pair[r + 1].

#import constants
#import shared/dispatch.wgsl
#import shared/gaussian.wgsl
#import shared/view.wgsl
#import shared/slot.wgsl

struct Gather {
    // Factors of the pull at a centre.
    pull_scale: vec2f,
    // 0 if the gradient of depth does not move centres.
    depth_moves_centres: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> params: Gather;
@group(0) @binding(2) var<storage, read> splats: array<SplatRow>;
@group(0) @binding(3) var<storage, read> depth_order: array<u32>;
@group(0) @binding(4) var<storage, read> first_pair: array<u32>;
@group(0) @binding(5) var<storage, read> num_wanted: array<u32>;
@group(0) @binding(6) var<storage, read> slots: array<f32>;
@group(0) @binding(7) var<storage, read_write> g_splats: array<SplatGradientRow>;
// dL/d(feature at time t), [N][LATENT_DIM].
@group(0) @binding(8) var<storage, read_write> g_features: array<f32>;

@compute @workgroup_size(GROUP)
fn gather(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let rank = flat_group(group, num_groups) * GROUP + lane;
    if rank >= view.num_gaussians {
        return;
    }
    var end = num_wanted[0];
    if rank + 1u < view.num_gaussians {
        end = first_pair[rank + 1u];
    }
    end = min(end, view.pair_capacity);
    var sums = array<f32, SLOT>();
    for (var slot = first_pair[rank]; slot < end; slot++) {
        for (var i = 0u; i < SLOT; i++) {
            sums[i] += slots[slot * SLOT + i];
        }
    }
    let n = depth_order[rank];
    let splat = splats[n];
    var g: SplatGradientRow;
    g.pull = -1.0;
    if splat.extent_x > 0.0 {
        let step = f32(view.sampling_step);
        let conic = splat.conic;
        // The moments are linear in the gradients that they sum up.
        g.centre = vec2f(conic.x * sums[1] + conic.y * sums[2], conic.y * sums[1] + conic.z * sums[2]) / step;
        g.conic = vec3f(-0.5 * sums[3], -sums[4], -0.5 * sums[5]) * step * step;
        g.opacity = sums[0] / splat.opacity;
        g.colour = vec3f(sums[SLOT_MOMENTS], sums[SLOT_MOMENTS + 1u], sums[SLOT_MOMENTS + 2u]);
        g.depth = select(0.0, sums[SLOT_MOMENTS + 3u], params.depth_moves_centres == 1u);
        g.pull = length(g.centre * params.pull_scale);
    }
    g_splats[n] = g;
    for (var d = 0u; d < LATENT_DIM; d++) {
        g_features[n * LATENT_DIM + d] = sums[SLOT_MOMENTS + SLOT_BASE_CHANNELS + d];
    }
}
