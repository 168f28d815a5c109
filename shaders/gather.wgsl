// Slots of each splat, summed in the order of its tiles -> gradients of the splats; twin:
// core::raster::backward (gather), core::raster::project::Sampling::apply_backward and
// core::train::Statistics::add.
//
// The slots of the splat with depth rank r are first_pair[r]..first_pair[r + 1].
//
// Bindings: crates/render/src/train/step/backward.rs.

#import shared/dispatch.wgsl
#import shared/slot.wgsl

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
    var end = num_pairs_wanted[0];
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
