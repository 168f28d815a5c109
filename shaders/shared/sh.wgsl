// Real spherical harmonics of bands 1 to 3, order and signs of 3D Gaussian splatting; twin of core::raster::sh.

#import constants

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
