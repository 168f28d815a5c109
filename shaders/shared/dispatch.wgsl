// A dimension of a dispatch is limited (65535 groups), so long rows of groups are folded into two dimensions.

fn flat_group(group: vec3u, num_groups: vec3u) -> u32 {
    return group.y * num_groups.x + group.x;
}
