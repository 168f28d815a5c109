// Assignment of splats to the tiles they touch, front to back; twin: core::raster::bin.
//
//   depth_keys  (sort by depth)  count_tiles  (scan)  emit_pairs  (stable sort by tile)  find_ranges
//
// For training each pair also has a slot, its place before the sort by tile. number_pairs replaces the
// Gaussians by slots before that sort, resolve_pairs looks them up after it.
//
// The splats are sorted by depth once and the pairs by tile only, which keeps the keys short. The sort is
// stable, so the pairs of a tile stay front to back, ties by index. The count of pairs stays on the
// device. Pairs beyond the capacity are not written. The host reads the count with the picture, grows the
// buffers and repeats.
//
// Bindings: crates/render/src/planes/bin.rs.

#import shared/dispatch.wgsl

const NO_DEPTH: u32 = 0xffffffffu;

// Depths are positive, so their bits sort like the numbers.
@compute @workgroup_size(GROUP)
fn depth_keys(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = flat_group(group, num_groups) * GROUP + lane;
    if n < view.num_gaussians {
        let splat = splats[n];
        depth_keys_out[n] = select(NO_DEPTH, bitcast<u32>(splat.depth), splat.extent_x > 0.0);
        depth_order[n] = n;
    }
}

// [first, end) of the tiles that have a pixel centre in [low, high]; empty if there is none or for NaN.
fn tile_range(low: f32, high: f32, num_tiles: u32) -> vec2u {
    let first = max(ceil(low - 0.5), 0.0);
    let last = min(floor(high - 0.5), f32(num_tiles * TILE) - 1.0);
    if first <= last {
        return vec2u(u32(first) / TILE, u32(last) / TILE + 1u);
    }
    return vec2u(0u);
}

// x of the ellipse's edge at height dy from its centre: to the right for side 1, to the left for -1.
fn edge(splat: SplatRow, cut: f32, dy: f32, side: f32) -> f32 {
    let conic = splat.conic;
    let determinant = conic.x * conic.z - conic.y * conic.y;
    let inside = sqrt(max(cut * conic.x - determinant * dy * dy, 0.0));
    return (-conic.y * dy + side * inside) / conic.x;
}

// Tile columns that the ellipse touches in one tile row. In a band it reaches furthest right at its rightmost
// point if that lies in the band, else at the band's edge nearest to it; the same holds for the left.
fn tile_span(splat: SplatRow, row: u32) -> vec2u {
    let cut = 2.0 * log(splat.opacity / MIN_ALPHA);
    let dy_right = -splat.conic.y / splat.conic.z * splat.extent_x;
    let top = f32(row * TILE) + 0.5 - splat.centre.y;
    let low = max(top, -splat.extent_y);
    let high = min(top + f32(TILE - 1u), splat.extent_y);
    if low > high {
        return vec2u(0u);
    }
    let right = edge(splat, cut, clamp(dy_right, low, high), 1.0);
    let left = edge(splat, cut, clamp(-dy_right, low, high), -1.0);
    return tile_range(splat.centre.x + left, splat.centre.x + right, view.tiles.x);
}

fn tile_rows(splat: SplatRow) -> vec2u {
    if !(splat.extent_x > 0.0) {
        return vec2u(0u);
    }
    return tile_range(splat.centre.y - splat.extent_y, splat.centre.y + splat.extent_y, view.tiles.y);
}

@compute @workgroup_size(GROUP)
fn count_tiles(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let rank = flat_group(group, num_groups) * GROUP + lane;
    // Without any splat there is still one item to scan.
    if rank >= arrayLength(&first_pair) {
        return;
    }
    var count = 0u;
    if rank < view.num_gaussians {
        let splat = splats[depth_order[rank]];
        let rows = tile_rows(splat);
        for (var row = rows.x; row < rows.y; row++) {
            let span = tile_span(splat, row);
            count += span.y - span.x;
        }
    }
    first_pair[rank] = count;
}

@compute @workgroup_size(GROUP)
fn emit_pairs(
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
    let gaussian = depth_order[rank];
    let splat = splats[gaussian];
    let rows = tile_rows(splat);
    var at = first_pair[rank];
    for (var row = rows.x; row < rows.y; row++) {
        let span = tile_span(splat, row);
        for (var column = span.x; column < span.y && at < end; column++) {
            pair_tiles[at] = row * view.tiles.x + column;
            pair_values[at] = gaussian;
            at++;
        }
    }
    // The compiler may round differently here than in count_tiles. Pairs that were counted but not found
    // go to a tile that does not exist.
    for (; at < end; at++) {
        pair_tiles[at] = view.tiles.x * view.tiles.y;
        pair_values[at] = gaussian;
    }
}

@compute @workgroup_size(GROUP)
fn find_ranges(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = flat_group(group, num_groups) * GROUP + lane;
    let num_pairs = min(num_pairs_wanted[0], view.pair_capacity);
    if at >= num_pairs {
        return;
    }
    let tile = pair_tiles[at];
    if tile >= view.tiles.x * view.tiles.y {
        return;
    }
    if at == 0u || pair_tiles[at - 1u] != tile {
        tile_ranges[tile].x = at;
    }
    if at + 1u == num_pairs || pair_tiles[at + 1u] != tile {
        tile_ranges[tile].y = at + 1u;
    }
}

@compute @workgroup_size(GROUP)
fn number_pairs(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = flat_group(group, num_groups) * GROUP + lane;
    if at < min(num_pairs_wanted[0], view.pair_capacity) {
        slot_gaussians[at] = pair_values[at];
        pair_values[at] = at;
    }
}

@compute @workgroup_size(GROUP)
fn resolve_pairs(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) num_groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = flat_group(group, num_groups) * GROUP + lane;
    if at < min(num_pairs_wanted[0], view.pair_capacity) {
        pair_gaussians[at] = slot_gaussians[pair_values[at]];
    }
}
