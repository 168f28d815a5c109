//! Display colours as DICOM stores them: CIELab of the profile connection space (PS3.3, C.10.7.1.1).

/// White of the profile connection space, D50.
const WHITE: [f64; 3] = [0.964_22, 1.0, 0.825_21];
/// Linear sRGB to XYZ at D50 (Bradford).
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [0.436_074_7, 0.385_064_9, 0.143_080_4],
    [0.222_504_5, 0.716_878_6, 0.060_616_9],
    [0.013_932_2, 0.097_104_5, 0.714_173_3],
];

/// The inverse.
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.133_856_1, -1.616_866_7, -0.490_614_6],
    [-0.978_768_4, 1.916_141_5, 0.033_454_0],
    [0.071_945_3, -0.228_991_4, 1.405_242_7],
];

/// Converts sRGB into scaled L, a and b.
pub(crate) fn lab(colour: [u8; 3]) -> [u16; 3] {
    let linear = colour.map(|v| {
        let v = f64::from(v) / 255.0;
        if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    });
    let xyz = XYZ_FROM_RGB.map(|row| row.iter().zip(linear).map(|(m, v)| m * v).sum::<f64>());
    let f = |i: usize| {
        let t: f64 = xyz[i] / WHITE[i];
        if t > 216.0 / 24389.0 { t.cbrt() } else { (24389.0 / 27.0 * t + 16.0) / 116.0 }
    };
    let lightness = 116.0 * f(1) - 16.0;
    let (a, b) = (500.0 * (f(0) - f(1)), 200.0 * (f(1) - f(2)));
    let scaled = |share: f64| (share * f64::from(u16::MAX)).round().clamp(0.0, f64::from(u16::MAX)) as u16;
    [scaled(lightness / 100.0), scaled((a + 128.0) / 255.0), scaled((b + 128.0) / 255.0)]
}

/// Converts scaled L, a and b into sRGB; colours that it lacks are cut.
pub(crate) fn rgb(lab: [u16; 3]) -> [u8; 3] {
    let [l, a, b] = lab.map(|v| f64::from(v) / f64::from(u16::MAX));
    let y = (100.0 * l + 16.0) / 116.0;
    let f = [y + (255.0 * a - 128.0) / 500.0, y, y - (255.0 * b - 128.0) / 200.0];
    let xyz: [f64; 3] = std::array::from_fn(|i| {
        let cube = f[i].powi(3);
        WHITE[i] * if cube > 216.0 / 24389.0 { cube } else { (116.0 * f[i] - 16.0) * 27.0 / 24389.0 }
    });
    RGB_FROM_XYZ.map(|row| {
        let v = row.iter().zip(xyz).map(|(m, v)| m * v).sum::<f64>();
        let v = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (255.0 * v).round().clamp(0.0, 255.0) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_scaled_as_the_standard_says() {
        let close = |colour, expected: [u16; 3]| {
            assert!(lab(colour).iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 40), "{:?}", lab(colour));
        };
        close([255; 3], [65535, 0x8080, 0x8080]);
        close([0; 3], [0, 0x8080, 0x8080]);
        // sRGB red is L 54.29, a 80.81, b 69.89 at D50.
        close([255, 0, 0], [35579, 53665, 50858]);
        for colour in [[0; 3], [255; 3], [86, 180, 233], [213, 94, 0], [0, 158, 115]] {
            assert!(rgb(lab(colour)).iter().zip(colour).all(|(a, b)| a.abs_diff(b) <= 1), "{colour:?}");
        }
    }
}
