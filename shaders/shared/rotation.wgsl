// Rotations by unit quaternions (w, x, y, z); twin: core::real.

// Rotation matrix; its columns are the rotated axes.
fn rotation_matrix(q: vec4f) -> mat3x3f {
    let w = q.x;
    let v = q.yzw;
    return mat3x3f(
        vec3f(1.0 - 2.0 * (v.y * v.y + v.z * v.z), 2.0 * (v.x * v.y + w * v.z), 2.0 * (v.x * v.z - w * v.y)),
        vec3f(2.0 * (v.x * v.y - w * v.z), 1.0 - 2.0 * (v.x * v.x + v.z * v.z), 2.0 * (v.y * v.z + w * v.x)),
        vec3f(2.0 * (v.x * v.z + w * v.y), 2.0 * (v.y * v.z - w * v.x), 1.0 - 2.0 * (v.x * v.x + v.y * v.y)),
    );
}

// Gradient of the unit quaternion, given that of its matrix, column by column.
fn rotation_matrix_backward(q: vec4f, g: mat3x3f) -> vec4f {
    let w = q.x;
    let v = q.yzw;
    let turn = vec3f(g[1].z - g[2].y, g[2].x - g[0].z, g[0].y - g[1].x);
    let xy = g[1].x + g[0].y;
    let xz = g[2].x + g[0].z;
    let yz = g[2].y + g[1].z;
    return vec4f(
        2.0 * dot(v, turn),
        2.0 * (w * turn.x + v.y * xy + v.z * xz) - 4.0 * v.x * (g[1].y + g[2].z),
        2.0 * (w * turn.y + v.x * xy + v.z * yz) - 4.0 * v.y * (g[0].x + g[2].z),
        2.0 * (w * turn.z + v.x * xz + v.y * yz) - 4.0 * v.z * (g[0].x + g[1].y),
    );
}
