//! Colour scales for scores, from dark to bright in steps that look equal.

/// Declares the palettes: name on the command line, name in the window, coefficients.
macro_rules! palettes {
    ($($(#[$doc:meta])* $palette:ident $name:literal $label:literal [$($coefficients:expr),* $(,)?])*) => {
        /// A colour scale whose lightness grows evenly, so that it can be read without hue. After the
        /// scales of matplotlib, as polynomials of sixth degree.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Palette {
            $($(#[$doc])* $palette,)*
        }

        impl Palette {
            /// All palettes.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$palette),*];

            /// Returns the palette's name on the command line.
            pub fn name(self) -> &'static str {
                match self { $(Self::$palette => $name),* }
            }

            /// Returns the palette's name in the window.
            pub fn label(self) -> &'static str {
                match self { $(Self::$palette => $label),* }
            }

            /// Returns the factors of the powers 0 to 6 of a share, for red, green and blue from 0 to 1.
            fn coefficients(self) -> [[f32; 3]; DEGREE + 1] {
                match self { $(Self::$palette => [$($coefficients),*]),* }
            }
        }
    };
}

/// Degree of the polynomials.
const DEGREE: usize = 6;

palettes! {
    /// From black over purple and orange to pale yellow: the default.
    #[default]
    Inferno "inferno" "Inferno" [
        [0.000_218_940, 0.001_651_005, -0.019_480_9],
        [0.106_513_42, 0.563_956_44, 3.932_712_4],
        [11.602_493, -3.972_854, -15.942_394],
        [-41.703_996, 17.436_4, 44.354_145],
        [77.162_93, -33.402_36, -81.807_31],
        [-71.319_43, 32.626_064, 73.209_52],
        [25.131_126, -12.242_669, -23.070_325],
    ]
    /// From black over purple and pink to pale yellow.
    Magma "magma" "Magma" [
        [-0.002_136_485, -0.000_749_655, -0.005_386_128],
        [0.251_660_54, 0.677_523_24, 2.494_026_6],
        [8.353_717, -3.577_719_5, 0.314_467_9],
        [-27.668_733, 14.264_731, -13.649_213],
        [52.176_14, -27.943_606, 12.944_169],
        [-50.768_525, 29.046_583, 4.234_153],
        [18.655_705, -11.489_774, -5.601_961_5],
    ]
    /// From dark blue over green to yellow.
    Viridis "viridis" "Viridis" [
        [0.277_727_33, 0.005_407_345, 0.334_099_8],
        [0.105_093_04, 1.404_613_5, 1.384_590_2],
        [-0.330_861_83, 0.214_847_56, 0.095_095_16],
        [-4.634_230_5, -5.799_101, -19.332_441],
        [6.228_27, 14.179_933, 56.690_55],
        [4.776_385, -13.745_145, -65.353_033],
        [-5.435_456, 4.645_852_6, 26.312_435],
    ]
}

impl Palette {
    /// Returns the colour of a share, red, green and blue from 0 to 255; `share` is 0 at the dark and 1 at
    /// the bright end.
    pub fn colour(self, share: f32) -> [f32; 3] {
        let factors = self.coefficients();
        std::array::from_fn(|c| {
            let value = factors.iter().rev().fold(0.0, |value, factor| value * share + factor[c]);
            255.0 * value.clamp(0.0, 1.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lightness after ITU-R BT.709, without gamma.
    fn luma([r, g, b]: [f32; 3]) -> f32 {
        0.2126 * r + 0.7152 * g + 0.0722 * b
    }

    #[test]
    fn every_palette_grows_lighter_from_one_end_to_the_other() {
        for palette in Palette::ALL {
            let lumas: Vec<f32> = (0..=50_u8).map(|i| luma(palette.colour(f32::from(i) / 50.0))).collect();
            assert!(lumas.windows(2).all(|pair| pair[1] > pair[0] - 0.6), "{palette:?}: {lumas:?}");
            assert!(lumas[0] < 25.0 && lumas[50] > 190.0);
        }
    }

    #[test]
    fn the_middles_are_those_of_matplotlib() {
        let near = |palette: Palette, expected: [f32; 3]| {
            let colour = palette.colour(0.5);
            assert!(colour.iter().zip(expected).all(|(a, b)| (a - b).abs() < 6.0), "{palette:?} {colour:?}");
        };
        near(Palette::Inferno, [188.0, 55.0, 84.0]);
        near(Palette::Magma, [183.0, 55.0, 121.0]);
        near(Palette::Viridis, [33.0, 145.0, 140.0]);
    }
}
