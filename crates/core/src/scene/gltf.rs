//! Still Gaussians as binary glTF with the extension `KHR_gaussian_splatting`; viewers that do not
//! support it show coloured points.

use super::GENERATOR;
use crate::{
    camera::Camera,
    gaussian::{Gaussians, SH_C0},
    num::sigmoid,
};
use glam::{Mat4, Quat, Vec3};
use serde_json::{Value, json};

/// glTF's component types of 32-bit floats and of unsigned 16-bit integers.
const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
/// The primitive mode of points.
const POINTS: u32 = 0;
/// First bytes of every binary glTF.
const MAGIC: &[u8; 4] = b"glTF";
/// "JSON" and "BIN\0", little endian.
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BIN_CHUNK: u32 = 0x004e_4942;
/// Nearest distance that the camera sees, in scene units.
const NEAR: f32 = 0.01;

/// Attributes that are collected for writing.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: serde_json::Map<String, Value>,
}

impl Buffer {
    fn add(&mut self, name: &str, accessor: Value, bytes: impl Iterator<Item = u8>) {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        self.views.push(json!({
            "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start,
        }));
        let mut accessor = accessor;
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.attributes.insert(name.to_owned(), json!(self.accessors.len()));
        self.accessors.push(accessor);
    }

    fn floats<const C: usize>(&mut self, name: &str, values: impl ExactSizeIterator<Item = [f32; C]>) {
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][C - 1];
        let accessor = json!({ "componentType": FLOAT, "count": values.len(), "type": kind });
        self.add(name, accessor, values.flat_map(|v| v.map(f32::to_le_bytes)).flatten());
    }
}

impl Gaussians {
    /// Returns the Gaussians as `.glb`. The root node turns our axes (x right, y down, z forward) into
    /// glTF's (y up, z backward). `camera` becomes a camera of the file. Features are left out. glTF
    /// cannot express a file without any Gaussian.
    pub fn to_glb(&self, camera: Option<&Camera>) -> Vec<u8> {
        let mut buffer = Buffer::default();
        self.add_attributes(&mut buffer);
        let mut nodes = vec![
            json!({ "name": "reconstruction", "rotation": [1.0, 0.0, 0.0, 0.0], "children": [1] }),
            json!({ "name": "Gaussians", "mesh": 0 }),
        ];
        let primitive = json!({
            "mode": POINTS,
            "attributes": buffer.attributes,
            "extensions": { "KHR_gaussian_splatting": {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "projection": "perspective",
                "sortingMethod": "cameraDistance",
            }},
        });
        let mut gltf = json!({
            "asset": { "version": "2.0", "generator": format!("{GENERATOR} {}", env!("CARGO_PKG_VERSION")) },
            "extensionsUsed": ["KHR_gaussian_splatting"],
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "meshes": [{ "primitives": [primitive] }],
            "accessors": buffer.accessors,
            "bufferViews": buffer.views,
            "buffers": [{ "byteLength": buffer.bytes.len() }],
        });
        if let Some(camera) = camera {
            nodes[0]["children"] = json!([1, 2]);
            nodes.push(json!({ "name": "endoscope", "camera": 0, "matrix": placed(camera).to_cols_array() }));
            gltf["cameras"] = json!([{ "type": "perspective", "perspective": {
                "yfov": 2.0 * (0.5 * camera.height as f32 / camera.fy).atan(),
                "aspectRatio": camera.width as f32 / camera.height as f32 * camera.fy / camera.fx,
                "znear": NEAR,
            }}]);
        }
        gltf["nodes"] = Value::Array(nodes);
        container(gltf.to_string().into_bytes(), buffer.bytes)
    }

    fn add_attributes(&self, buffer: &mut Buffer) {
        buffer.floats("POSITION", self.means.iter().copied());
        // Readers need the range of the positions without reading them.
        let bound = |pick: fn(f32, f32) -> f32| -> Option<[f32; 3]> {
            self.means.iter().copied().reduce(|a, b| [0, 1, 2].map(|i| pick(a[i], b[i])))
        };
        buffer.accessors[0]["min"] = json!(bound(f32::min).unwrap_or_default());
        buffer.accessors[0]["max"] = json!(bound(f32::max).unwrap_or_default());
        buffer.floats(
            "KHR_gaussian_splatting:ROTATION",
            self.rotations.iter().map(|&[w, x, y, z]| {
                Quat::from_xyzw(x, y, z, w)
                    .normalize()
                    .to_array()
                    .map(|v| if v.is_finite() { v } else { 0.0 })
            }),
        );
        buffer.floats("KHR_gaussian_splatting:SCALE", self.log_scales.iter().map(|s| s.map(f32::exp)));
        buffer.floats("KHR_gaussian_splatting:OPACITY", self.opacity_logits.iter().map(|&o| [sigmoid(o)]));
        buffer.floats("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0", self.colours.iter().copied());
        let bands = self.sh_bands();
        for band in 0..bands {
            let degree = (1..=3).rfind(|l| l * l - 1 <= band).unwrap_or(1);
            let name =
                format!("KHR_gaussian_splatting:SH_DEGREE_{degree}_COEF_{}", band + 1 - degree * degree);
            let value = |i: usize| {
                let at = (i * bands + band) * 3;
                [self.sh_rest[at], self.sh_rest[at + 1], self.sh_rest[at + 2]]
            };
            buffer.floats(&name, (0..self.len()).map(value));
        }
        let fallback = (0..self.len()).flat_map(|i| {
            let [r, g, b] = self.colours[i].map(|c| linear(0.5 + SH_C0 * c));
            [r, g, b, sigmoid(self.opacity_logits[i])].map(|v| (v * 65535.0).round() as u16)
        });
        let accessor = json!({ "componentType": UNSIGNED_SHORT, "normalized": true, "count": self.len(), "type": "VEC4" });
        buffer.add("COLOR_0", accessor, fallback.flat_map(u16::to_le_bytes));
    }
}

/// Returns the pose of a camera, in our axes, by glTF's convention: looking along −z, y up.
fn placed(camera: &Camera) -> Mat4 {
    Mat4::from(camera.camera_from_world.inverse()) * Mat4::from_scale(Vec3::new(1.0, -1.0, -1.0))
}

/// Converts sRGB to linear light, as `COLOR_0` requires it; 0 to 1.
fn linear(c: f32) -> f32 {
    let c = c.clamp(0.0, 1.0);
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Joins the two chunks, each padded to whole words.
fn container(mut json: Vec<u8>, mut binary: Vec<u8>) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let word = |v: u32| v.to_le_bytes();
    let mut file = Vec::with_capacity(total);
    file.extend([*MAGIC, word(2), word(total as u32)].concat());
    for (kind, chunk) in [(JSON_CHUNK, json), (BIN_CHUNK, binary)] {
        file.extend([word(chunk.len() as u32), word(kind)].concat());
        file.extend(chunk);
    }
    file
}

/// Tells if the first bytes of a file are those of a binary glTF that names this program as its generator.
pub(super) fn is_own(start: &[u8]) -> bool {
    const HEAD: usize = 20;
    if !start.starts_with(MAGIC) || start.len() < HEAD {
        return false;
    }
    let len = u32::from_le_bytes([start[12], start[13], start[14], start[15]]) as usize;
    let json =
        start.get(HEAD..HEAD.saturating_add(len)).and_then(|j| serde_json::from_slice::<Value>(j).ok());
    let generator = json.as_ref().and_then(|json| json["asset"]["generator"].as_str());
    generator.is_some_and(|name| name.split(' ').next() == Some(GENERATOR))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress;

    /// Returns the JSON and the binary chunk.
    fn chunks(file: &[u8]) -> (Value, &[u8]) {
        let word =
            |at: usize| u32::from_le_bytes([file[at], file[at + 1], file[at + 2], file[at + 3]]) as usize;
        assert_eq!((&file[..4], word(4), word(8)), (&b"glTF"[..], 2, file.len()));
        let json = &file[20..20 + word(12)];
        assert_eq!(word(20 + json.len()) + 28 + json.len(), file.len());
        (serde_json::from_slice(json).unwrap(), &file[28 + json.len()..])
    }

    #[test]
    fn attributes_are_what_the_extension_says() {
        let mut scene = stress::ordinary(5);
        scene.gaussians.sh_degree = 2;
        scene.gaussians.sh_rest = (0..5 * 8 * 3).map(|i| i as f32).collect();
        let still = scene.all_still(0.3);
        let file = still.to_glb(Some(&scene.cameras[0]));
        let (json, binary) = chunks(&file);
        let primitive = &json["meshes"][0]["primitives"][0];
        let floats = |name: &str| -> Vec<f32> {
            let accessor = &json["accessors"][primitive["attributes"][name].as_u64().unwrap() as usize];
            let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
            let (start, len) = (view["byteOffset"].as_u64().unwrap(), view["byteLength"].as_u64().unwrap());
            assert_eq!((accessor["count"].as_u64(), start % 4), (Some(5), 0), "{name}");
            binary[start as usize..(start + len) as usize]
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect()
        };
        assert_eq!(floats("POSITION"), still.means.as_flattened());
        let [w, x, y, z] = still.rotations[1];
        let rotation = &floats("KHR_gaussian_splatting:ROTATION")[4..8];
        assert!(rotation.iter().zip([x, y, z, w]).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!(floats("KHR_gaussian_splatting:SCALE")[2], still.log_scales[0][2].exp());
        assert_eq!(floats("KHR_gaussian_splatting:OPACITY")[4], sigmoid(still.opacity_logits[4]));
        // Band 3 of 8 is the first of degree 2.
        assert_eq!(floats("KHR_gaussian_splatting:SH_DEGREE_2_COEF_0")[3..6], [24.0 + 9.0, 34.0, 35.0]);
        assert_eq!(floats("KHR_gaussian_splatting:SH_DEGREE_1_COEF_2")[..3], [6.0, 7.0, 8.0]);
        assert!(primitive["attributes"].get("KHR_gaussian_splatting:SH_DEGREE_2_COEF_4").is_some());
        assert_eq!(primitive["attributes"].as_object().unwrap().len(), 6 + 8);
    }

    #[test]
    fn the_camera_sees_what_ours_sees() {
        let mut camera = Camera::with_field_of_view(64, 48, 60.0);
        camera.camera_from_world =
            glam::Affine3A::from_rotation_y(0.4) * glam::Affine3A::from_translation(Vec3::new(1.0, 2.0, 3.0));
        let ahead = camera.unproject(48.0, 12.0, 5.0);
        let seen = placed(&camera).inverse().transform_point3(ahead);
        // Right of the middle, above it, and in front of a camera that looks along −z.
        assert!(seen.x > 0.0 && seen.y > 0.0 && (seen.z + 5.0).abs() < 1e-4, "{seen}");
    }
}
