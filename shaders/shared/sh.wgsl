// Real spherical harmonics of bands 1 to 3, in the order and with the signs of 3D Gaussian splatting;
// twin of core::raster::sh.

const MAX_SH_BANDS: u32 = 15u;

fn sh_bands(degree: u32, d: vec3f) -> array<f32, MAX_SH_BANDS> {
    var b = array<f32, MAX_SH_BANDS>();
    if degree >= 1u {
        b[0] = -SH_C1 * d.y;
        b[1] = SH_C1 * d.z;
        b[2] = -SH_C1 * d.x;
    }
    let s = d * d;
    if degree >= 2u {
        b[3] = SH_C2[0] * d.x * d.y;
        b[4] = SH_C2[1] * d.y * d.z;
        b[5] = SH_C2[2] * (2.0 * s.z - s.x - s.y);
        b[6] = SH_C2[3] * d.x * d.z;
        b[7] = SH_C2[4] * (s.x - s.y);
    }
    if degree >= 3u {
        b[8] = SH_C3[0] * d.y * (3.0 * s.x - s.y);
        b[9] = SH_C3[1] * d.x * d.y * d.z;
        b[10] = SH_C3[2] * d.y * (4.0 * s.z - s.x - s.y);
        b[11] = SH_C3[3] * d.z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y);
        b[12] = SH_C3[4] * d.x * (4.0 * s.z - s.x - s.y);
        b[13] = SH_C3[5] * d.z * (s.x - s.y);
        b[14] = SH_C3[6] * d.x * (s.x - 3.0 * s.y);
    }
    return b;
}

// Gradient of the (unnormalised) direction, given one gradient per band.
fn sh_bands_backward(degree: u32, d: vec3f, given: array<f32, MAX_SH_BANDS>) -> vec3f {
    var g = given;
    var out = vec3f(0.0);
    if degree >= 1u {
        out += SH_C1 * vec3f(-g[2], -g[0], g[1]);
    }
    if degree >= 2u {
        out += g[3] * SH_C2[0] * vec3f(d.y, d.x, 0.0);
        out += g[4] * SH_C2[1] * vec3f(0.0, d.z, d.y);
        out += g[5] * SH_C2[2] * vec3f(-2.0 * d.x, -2.0 * d.y, 4.0 * d.z);
        out += g[6] * SH_C2[3] * vec3f(d.z, 0.0, d.x);
        out += g[7] * SH_C2[4] * vec3f(2.0 * d.x, -2.0 * d.y, 0.0);
    }
    if degree >= 3u {
        let s = d * d;
        out += g[8] * SH_C3[0] * vec3f(6.0 * d.x * d.y, 3.0 * (s.x - s.y), 0.0);
        out += g[9] * SH_C3[1] * vec3f(d.y * d.z, d.x * d.z, d.x * d.y);
        out += g[10] * SH_C3[2] * vec3f(-2.0 * d.x * d.y, 4.0 * s.z - s.x - 3.0 * s.y, 8.0 * d.y * d.z);
        out += g[11] * SH_C3[3] * vec3f(-6.0 * d.x * d.z, -6.0 * d.y * d.z, 6.0 * s.z - 3.0 * s.x - 3.0 * s.y);
        out += g[12] * SH_C3[4] * vec3f(4.0 * s.z - 3.0 * s.x - s.y, -2.0 * d.x * d.y, 8.0 * d.x * d.z);
        out += g[13] * SH_C3[5] * vec3f(2.0 * d.x * d.z, -2.0 * d.y * d.z, s.x - s.y);
        out += g[14] * SH_C3[6] * vec3f(3.0 * (s.x - s.y), -6.0 * d.x * d.y, 0.0);
    }
    return out;
}
