//! Gaussians at one time as the `.ply` that 3-D Gaussian splatting viewers read.

use super::Scene;
use crate::{
    deform::{Deformed, deform},
    num::logit,
};
use ply_rs_bw::{
    ply::{
        Addable, DefaultElement, ElementDef, Encoding, Ply, Property, PropertyDef, PropertyType, ScalarType,
    },
    writer::Writer,
};

/// Channels of a colour.
const CHANNELS: usize = 3;

impl Scene {
    /// The Gaussians `chosen`, as they are at `time`: centre, normal (0), colour coefficients (higher bands channel by
    /// channel), logit of opacity, log-scales and quaternion (w, x, y, z), all 32-bit floats, little endian.
    pub fn to_ply(&self, time: f32, chosen: &[usize]) -> Vec<u8> {
        let deformed = deform(&self.gaussians, &self.deformation, time, false);
        let bands = self.gaussians.sh_bands();
        let names = property_names(bands);
        let mut vertex = ElementDef::new("vertex".to_owned());
        for name in &names {
            let kind = PropertyType::Scalar(ScalarType::Float);
            vertex.properties.add(PropertyDef::new(name.clone(), kind));
        }
        let mut ply = Ply::<DefaultElement>::new();
        ply.header.encoding = Encoding::BinaryLittleEndian;
        ply.header.elements.add(vertex);
        let row = |&i: &usize| -> DefaultElement {
            let values = self.ply_row(&deformed, i, bands);
            names.iter().cloned().zip(values.into_iter().map(Property::Float)).collect()
        };
        ply.payload.insert("vertex".to_owned(), chosen.iter().map(row).collect());
        let mut bytes = Vec::new();
        // Writing to memory fails only where the header and the rows differ.
        let written = Writer::new().write_ply(&mut bytes, &mut ply);
        debug_assert!(written.is_ok(), "{written:?}");
        bytes
    }

    /// The values of one Gaussian, in the order of [`property_names`].
    fn ply_row(&self, deformed: &Deformed, i: usize, bands: usize) -> Vec<f32> {
        let mut values = deformed.means[i].to_vec();
        values.extend([0.0; 3]);
        values.extend(deformed.colours[i]);
        let rest = &self.gaussians.sh_rest[i * bands * CHANNELS..(i + 1) * bands * CHANNELS];
        for channel in 0..CHANNELS {
            values.extend(rest.iter().skip(channel).step_by(CHANNELS));
        }
        values.push(logit(deformed.opacities[i]));
        values.extend(deformed.scales[i].map(f32::ln));
        values.extend(deformed.rotations[i]);
        values
    }
}

fn property_names(bands: usize) -> Vec<String> {
    let numbered = |name: &str, n: usize| (0..n).map(|i| format!("{name}_{i}")).collect::<Vec<_>>();
    let plain = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    [
        plain(&["x", "y", "z", "nx", "ny", "nz"]),
        numbered("f_dc", CHANNELS),
        numbered("f_rest", CHANNELS * bands),
        plain(&["opacity"]),
        numbered("scale", 3),
        numbered("rot", 4),
    ]
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress;
    use ply_rs_bw::parser::Parser;

    #[test]
    fn a_file_read_back_holds_the_gaussians_at_that_time() {
        let mut scene = stress::ordinary(9);
        scene.gaussians.sh_degree = 1;
        scene.gaussians.sh_rest = (0..9 * 9).map(|i| i as f32).collect();
        let bytes = scene.to_ply(0.4, &[2, 7]);
        let read = Parser::<DefaultElement>::new().read_ply(&mut bytes.as_slice()).unwrap();
        let rows = &read.payload["vertex"];
        assert_eq!(rows.len(), 2);
        let number = |row: usize, name: &str| match rows[row][name] {
            Property::Float(v) => v,
            ref other => panic!("{name}: {other:?}"),
        };
        let expected = deform(&scene.gaussians, &scene.deformation, 0.4, false);
        assert_eq!([number(1, "x"), number(1, "y"), number(1, "z")], expected.means[7]);
        assert_eq!([0, 1, 2, 3].map(|k| number(0, &format!("rot_{k}"))), expected.rotations[2]);
        assert!((number(0, "scale_1").exp() - expected.scales[2][1]).abs() < 1e-6);
        assert_eq!(number(1, "f_dc_2"), expected.colours[7][2]);
        // Gaussian 7, green, band 1 of [bands][channels].
        assert_eq!(number(1, "f_rest_4"), (7 * 9 + 3 + 1) as f32);
        let text = String::from_utf8_lossy(&bytes[..120]);
        assert!(
            text.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\n"),
            "{text}"
        );
    }

    #[test]
    fn nothing_chosen_is_a_valid_file() {
        let bytes = stress::ordinary(3).to_ply(0.0, &[]);
        let read = Parser::<DefaultElement>::new().read_ply(&mut bytes.as_slice()).unwrap();
        assert!(read.payload.get("vertex").is_none_or(|rows| rows.is_empty()));
    }
}
