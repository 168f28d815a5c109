//! The scene as safetensors: plain tensors, and one JSON text under the metadata key `surgtpgs`. In the
//! compact form some tensors are whole numbers of small steps (see [`compact`]); `NAME.shape`,
//! `NAME.step`, `NAME.offset` and, for weights over time, `NAME.mix` go with them.
//!
//! | tensor | shape | |
//! |---|---|---|
//! | `means` `rotations` `log_scales` `opacity_logits` `colours` | [N, 3 / 4 / 3 / – / 3] | at rest, raw |
//! | `sh_rest` | [N, bands, 3] | only if the camera moves |
//! | `features` | [N, D] | |
//! | `moving` | [M] u32 | Gaussians that have basis weights; all if it is not there |
//! | `basis_weights` | [B, M, channels] | |
//! | `basis_centres` `basis_widths` | [B], or [B, M, channels] | |
//! | `feature_net_weight` `feature_net_bias` | [D, D + 1], [D] | |
//! | `cameras` | [frames, 18] | width, height, fx, fy, cx, cy, camera_from_world as 3×4 rows |
//! | `times` | [frames] | 0 to 1; frame i of N is at i / N if it is not there |
//! | `field_of_view` | [H, ⌈W / 8⌉] u8 | bits, most significant first |
//! | `class_embeddings` | [classes, dim] | |
//! | `vocabulary` | [texts · dim, 2] u8 | vectors of the vocabulary's texts as little-endian f16 |
//! | `encoder.K.weight` `encoder.K.bias` `decoder.K.…` | | the codec's layers |

pub(super) mod chapters;
pub(super) mod compact;
mod tensors;

use super::{
    Chapters, Problem, Provenance, Scene,
    camera_row::{CAMERA_WIDTH, camera_row, read_camera},
};
use crate::{
    Error, Result,
    camera::Camera,
    codec::{Codec, Linear, MAX_LATENT_DIM},
    deform::{BasisShape, Deformation, GATE_CHANNEL, num_channels, stride_for},
    gaussian::Gaussians,
    grid::Mask,
    meaning::{EncoderIdentity, WordFacts},
    reading::open_regular,
    sequence::Class,
};
use compact::Steps;
use half::f16;
use ndarray::{Array1, Array2};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::de::IgnoredAny;
use std::{collections::HashMap, io::Read, path::Path, sync::Arc};
use tensors::{MOST_PLAUSIBLE_BASES, Reader, Writer};

/// Version of the layout above; a reader refuses a newer one.
const VERSION: u32 = 1;
const METADATA_KEY: &str = "surgtpgs";
/// Largest size in bytes of the header of a safetensors file; the format allows no more.
const MOST_HEADER: u64 = 100_000_000;

#[derive(serde::Serialize, serde::Deserialize)]
struct SceneHeader {
    version: u32,
    gaussians: usize,
    latent_dim: usize,
    sh_degree: usize,
    basis_shape: BasisShape,
    gate_slope: f32,
    /// Absent in scenes that are older than the choice of the gate.
    #[serde(default = "own_gate")]
    gate_channel: usize,
    width: usize,
    classes: Vec<Class>,
    encoder: Option<EncoderIdentity>,
    /// Absent in older scenes.
    #[serde(default, skip_serializing_if = "WordFacts::is_empty")]
    words: WordFacts,
    provenance: Provenance,
    /// SHA-256 over all tensors, hexadecimal; absent in older scenes.
    #[serde(default)]
    tensors_sha256: Option<String>,
}

fn own_gate() -> usize {
    GATE_CHANNEL
}

/// Returns the bytes of the file; `compact` gives up exactness for about a sixth of the size.
pub(super) fn to_bytes(scene: &Scene, compact: bool) -> Result<Vec<u8>> {
    let g = &scene.gaussians;
    let n = g.len();
    let mut w = Writer::new(compact.then(|| Steps::for_scene(scene)));
    w.f32("means", &[n, 3], g.means.as_flattened());
    w.f32("rotations", &[n, 4], g.rotations.as_flattened());
    w.f32("log_scales", &[n, 3], g.log_scales.as_flattened());
    w.f32("opacity_logits", &[n], &g.opacity_logits);
    w.f32("colours", &[n, 3], g.colours.as_flattened());
    w.f32("sh_rest", &[n, g.sh_bands(), 3], &g.sh_rest);
    w.f32("features", &[n, g.latent_dim], &g.features);
    write_deformation(&mut w, scene);
    let cameras: Vec<f32> = scene.cameras.iter().flat_map(camera_row).collect();
    w.f32("cameras", &[scene.cameras.len(), CAMERA_WIDTH], &cameras);
    if !scene.times.is_empty() {
        w.f32("times", &[scene.times.len()], &scene.times);
    }
    let fov = &scene.field_of_view;
    w.bytes("field_of_view", &[fov.height, fov.width.div_ceil(8)], pack_bits(fov));
    let dim = scene.classes.first().map_or(0, |c| c.1.len());
    let embeddings: Vec<f32> = scene.classes.iter().flat_map(|c| c.1.iter().copied()).collect();
    w.f32("class_embeddings", &[scene.classes.len(), dim], &embeddings);
    let vectors = &scene.words.vectors;
    if !vectors.is_empty() {
        let bytes: Vec<u8> = vectors.iter().flat_map(|v| v.to_le_bytes()).collect();
        w.bytes("vocabulary", &[vectors.len(), 2], bytes);
    }
    if let Some(codec) = &scene.codec {
        write_layers(&mut w, "encoder", &codec.encoder);
        write_layers(&mut w, "decoder", &codec.decoder);
    }
    let header = SceneHeader {
        version: VERSION,
        gaussians: n,
        latent_dim: g.latent_dim,
        sh_degree: g.sh_degree,
        basis_shape: scene.deformation.shape,
        gate_slope: scene.deformation.gate_slope,
        gate_channel: scene.deformation.gate_channel,
        width: fov.width,
        classes: scene.classes.iter().map(|c| c.0.clone()).collect(),
        encoder: scene.encoder.clone(),
        words: scene.words.clone(),
        provenance: scene.provenance.clone(),
        tensors_sha256: Some(w.checksum()?),
    };
    let json = serde_json::to_string(&header)
        .map_err(|e| Error::input(format!("the scene could not be written: {e}"), ""))?;
    w.finish(METADATA_KEY, json)
}

/// Writes the deformation. Only Gaussians with a weight that is not zero carry their bases.
fn write_deformation(w: &mut Writer, scene: &Scene) {
    let (d, n) = (&scene.deformation, scene.gaussians.len());
    let channels = num_channels(scene.gaussians.latent_dim);
    let at = |b: usize, i: usize| (b * n + i) * d.stride..(b * n + i) * d.stride + channels;
    let moves = |i: &u32| (0..d.num_bases).any(|b| d.weights[at(b, *i as usize)].iter().any(|w| *w != 0.0));
    let moving: Vec<u32> = (0..n as u32).filter(moves).collect();
    let rows = |values: &[f32]| -> Vec<f32> {
        (0..d.num_bases)
            .flat_map(|b| moving.iter().flat_map(move |&i| values[at(b, i as usize)].to_vec()))
            .collect()
    };
    let shape = [d.num_bases, moving.len(), channels];
    if moving.len() < n {
        w.u32("moving", &moving);
    }
    w.over_time("basis_weights", &shape, &rows(&d.weights));
    if d.is_shared() {
        w.f32("basis_centres", &shape[..1], &d.centres);
        w.f32("basis_widths", &shape[..1], &d.widths);
    } else {
        w.f32("basis_centres", &shape, &rows(&d.centres));
        w.f32("basis_widths", &shape, &rows(&d.widths));
    }
    let dim = scene.gaussians.latent_dim;
    w.f32("feature_net_weight", &[dim, dim + 1], &d.feature_weight);
    w.f32("feature_net_bias", &[dim], &d.feature_bias);
}

fn write_layers(w: &mut Writer, name: &str, layers: &[Linear]) {
    for (k, layer) in layers.iter().enumerate() {
        let weight: Vec<f32> = layer.weight.iter().copied().collect();
        w.network(&format!("{name}.{k}.weight"), layer.weight.shape(), &weight);
        w.network(&format!("{name}.{k}.bias"), &[layer.bias.len()], &layer.bias.to_vec());
    }
}

/// Returns the bits of a mask, row by row in whole bytes, most significant first.
pub(super) fn pack_bits(mask: &Mask) -> Vec<u8> {
    let pack =
        |bits: &[bool]| bits.iter().enumerate().fold(0u8, |byte, (i, b)| byte | u8::from(*b) << (7 - i));
    (0..mask.height).flat_map(|y| mask.row(y).chunks(8).map(pack).collect::<Vec<_>>()).collect()
}

/// Tells if the file at `path` is a safetensors file that names this program in its metadata.
pub(super) fn is_own(path: &Path) -> bool {
    metadata(path).is_some_and(|metadata| metadata.keys().any(|key| key.starts_with(METADATA_KEY)))
}

/// Reads the record of a scene file, and nothing else of it; `None` if there is none.
pub(super) fn provenance(path: &Path) -> Option<Provenance> {
    let header: SceneHeader = serde_json::from_str(metadata(path)?.get(METADATA_KEY)?).ok()?;
    Some(header.provenance)
}

/// Reads the number of Gaussians of a scene file, and nothing else of it; `None` if it cannot be read.
pub(super) fn num_gaussians(file: impl Read) -> Option<usize> {
    let header: SceneHeader = serde_json::from_str(metadata_of(file)?.get(METADATA_KEY)?).ok()?;
    Some(header.gaussians)
}

/// Returns `true` if a scene file has layers of a codec; nothing but its header is read.
pub(super) fn has_codec(path: &Path) -> bool {
    let header = open_regular(path).and_then(header_of);
    let tensors = header.ok().and_then(|h| serde_json::from_slice::<HashMap<String, IgnoredAny>>(&h).ok());
    tensors.is_some_and(|tensors| tensors.keys().any(|name| name.starts_with("encoder.")))
}

/// Reads the metadata of the safetensors file at `path`.
fn metadata(path: &Path) -> Option<HashMap<String, String>> {
    metadata_of(open_regular(path).ok()?)
}

/// Reads the metadata of a safetensors file.
fn metadata_of(file: impl Read) -> Option<HashMap<String, String>> {
    #[derive(serde::Deserialize)]
    struct Names {
        #[serde(rename = "__metadata__")]
        metadata: HashMap<String, String>,
    }
    serde_json::from_slice::<Names>(&header_of(file).ok()?).ok().map(|names| names.metadata)
}

/// Reads the header of a safetensors file.
fn header_of(mut file: impl Read) -> std::io::Result<Vec<u8>> {
    let mut len = [0; 8];
    file.read_exact(&mut len)?;
    let mut header = Vec::new();
    file.take(u64::from_le_bytes(len).min(MOST_HEADER)).read_to_end(&mut header)?;
    Ok(header)
}

/// Estimates the memory of a file's contents: its tensors twice, as stored and as used, and the weights
/// of all Gaussians.
pub(super) fn memory_bytes(bytes: &[u8]) -> Option<u64> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).ok()?;
    let header: SceneHeader = serde_json::from_str(metadata.metadata().as_ref()?.get(METADATA_KEY)?).ok()?;
    let reader = Reader::new(bytes).ok()?;
    let rows = reader.view("means").ok().and_then(|means| means.shape().first().copied());
    if !reader.has("means.shape") && rows != Some(header.gaussians) {
        return None;
    }
    let product = |shape: &[u64]| shape.iter().fold(1_u64, |product, n| product.saturating_mul(*n));
    let values = |(name, view): (String, TensorView<'_>)| match reader.u32(&format!("{name}.shape")) {
        Ok(shape) => product(&shape.into_iter().map(u64::from).collect::<Vec<_>>()),
        Err(_) => product(&view.shape().iter().map(|n| *n as u64).collect::<Vec<_>>()),
    };
    let stored = reader.tensors().into_iter().map(values).fold(0, u64::saturating_add);
    let bases = reader.u32("basis_weights.shape").ok().and_then(|shape| shape.first().map(|n| *n as usize));
    let bases = bases.or_else(|| reader.view("basis_weights").ok()?.shape().first().copied()).unwrap_or(0);
    // Centres and widths are either shared or as many as the weights.
    let has_own_bases = ["basis_centres.shape", "basis_centres"].iter().any(|name| match reader.u32(name) {
        Ok(shape) => shape.len() > 1,
        Err(_) => reader.rank(name).is_some_and(|rank| rank > 1),
    });
    let tables = if has_own_bases { 3 } else { 1 };
    let stride = stride_for(header.latent_dim.min(MAX_LATENT_DIM));
    let weights = product(&[header.gaussians, bases, stride, tables].map(|n| n as u64));
    Some(stored.saturating_mul(2).saturating_add(weights).saturating_mul(4))
}

pub(super) fn from_bytes(bytes: &[u8]) -> Result<Scene, Problem> {
    let damaged = |e: safetensors::SafeTensorError| format!("this is not a complete scene file: {e}");
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let json = metadata.metadata().as_ref().and_then(|m| m.get(METADATA_KEY));
    let json =
        json.ok_or("this safetensors file is not a SurgTPGS scene (it lacks the `surgtpgs` metadata)")?;
    let header: SceneHeader =
        serde_json::from_str(json).map_err(|e| format!("the scene's metadata is damaged: {e}"))?;
    if header.version > VERSION {
        return Err(format!(
            "the scene file has version {}, this program reads up to {VERSION}",
            header.version
        ));
    }
    if !(header.latent_dim <= MAX_LATENT_DIM && header.sh_degree <= 3) {
        let (d, sh) = (header.latent_dim, header.sh_degree);
        return Err(format!(
            "latent dimension {d} (0 to {MAX_LATENT_DIM}) or colour degree {sh} (0 to 3) is out of range"
        ));
    }
    let reader = Reader::new(bytes).map_err(damaged)?;
    if header.tensors_sha256.as_ref().is_some_and(|written| *written != reader.checksum()) {
        return Err("the scene file is damaged or was changed: its checksum differs".into());
    }
    let gaussians = read_gaussians(&reader, &header)?;
    let deformation = read_deformation(&reader, &header)?;
    let (camera_shape, cameras) = reader.f32("cameras", 2)?;
    if camera_shape[1] != CAMERA_WIDTH || camera_shape[0] == 0 {
        return Err(format!("tensor `cameras` should be [frames, {CAMERA_WIDTH}], but is {camera_shape:?}"));
    }
    let cameras: Vec<Camera> = cameras.chunks_exact(CAMERA_WIDTH).map(read_camera).collect();
    check_cameras(&cameras)?;
    let times = read_times(&reader, cameras.len())?;
    let field_of_view = read_field_of_view(&reader, &header, &cameras[0])?;
    let codec = read_codec(&reader, header.latent_dim)?;
    let (shape, embeddings) = reader.f32("class_embeddings", 2)?;
    if shape[0] != header.classes.len() || (shape[0] > 0 && shape[1] == 0) {
        return Err(format!("{} classes, but class embeddings of shape {shape:?}", header.classes.len()));
    }
    let embeddings = embeddings.chunks(shape[1].max(1)).map(<[f32]>::to_vec);
    let classes = header.classes.into_iter().zip(embeddings).collect();
    Ok(Scene {
        gaussians: gaussians.into(),
        deformation: deformation.into(),
        chapters: Chapters::default(),
        cameras,
        times,
        field_of_view,
        codec,
        classes,
        encoder: header.encoder,
        words: WordFacts { vectors: read_vectors(&reader)?, ..header.words },
        provenance: header.provenance,
    })
}

fn read_gaussians(reader: &Reader<'_>, header: &SceneHeader) -> Result<Gaussians, Problem> {
    let (n, degree) = (header.gaussians, header.sh_degree);
    Ok(Gaussians {
        means: reader.rows("means", n)?,
        rotations: reader.rows("rotations", n)?,
        log_scales: reader.rows("log_scales", n)?,
        opacity_logits: reader.shaped("opacity_logits", &[n])?,
        colours: reader.rows("colours", n)?,
        sh_rest: reader.shaped("sh_rest", &[n, (degree + 1) * (degree + 1) - 1, 3])?,
        sh_degree: degree,
        features: reader.shaped("features", &[n, header.latent_dim])?,
        latent_dim: header.latent_dim,
    })
}

fn read_deformation(reader: &Reader<'_>, header: &SceneHeader) -> Result<Deformation, Problem> {
    let (n, dim) = (header.gaussians, header.latent_dim);
    let (channels, stride) = (num_channels(dim), stride_for(dim));
    let moving: Vec<usize> = match reader.view("moving") {
        Ok(_) => reader.u32("moving")?.into_iter().map(|i| i as usize).collect(),
        Err(_) => (0..n).collect(),
    };
    if let Some(bad) = moving.iter().find(|i| **i >= n) {
        return Err(format!("tensor `moving` names Gaussian {bad} of {n}"));
    }
    if header.gate_channel.checked_add(dim).is_none_or(|end| end > channels) {
        return Err(format!("the features' gate is said to be at channel {}", header.gate_channel));
    }
    let (shape, weights) = reader.f32("basis_weights", 3)?;
    let num_bases = shape[0];
    if shape[1..] != [moving.len(), channels] || num_bases > MOST_PLAUSIBLE_BASES {
        return Err(format!(
            "tensor `basis_weights` should be [bases, {}, {channels}], but is {shape:?}",
            moving.len()
        ));
    }
    let spread = |name: &str, rows: Vec<f32>| -> Result<Vec<f32>, Problem> {
        let mut all = vec![0.0; reader.set_aside(name, &[num_bases, n, stride])?];
        for (k, row) in rows.chunks_exact(channels).enumerate() {
            let (b, i) = (k / moving.len(), moving[k % moving.len()]);
            all[(b * n + i) * stride..][..channels].copy_from_slice(row);
        }
        Ok(all)
    };
    let weights = spread("basis_weights", weights)?;
    let own_bases = reader.rank("basis_centres") == Some(3);
    let bases = |name: &str| {
        if own_bases { spread(name, reader.shaped(name, &shape)?) } else { reader.shaped(name, &[num_bases]) }
    };
    Ok(Deformation {
        shape: header.basis_shape,
        num_bases,
        stride,
        weights,
        centres: bases("basis_centres")?,
        widths: bases("basis_widths")?,
        gate_slope: header.gate_slope,
        gate_channel: header.gate_channel,
        feature_weight: reader.shaped("feature_net_weight", &[dim, dim + 1])?,
        feature_bias: reader.shaped("feature_net_bias", &[dim])?,
    })
}

/// Checks that all cameras have one size, within the limits of an image.
fn check_cameras(cameras: &[Camera]) -> Result<(), Problem> {
    let (w, h) = (cameras[0].width, cameras[0].height);
    let is_good = |c: &Camera| (c.width, c.height) == (w, h) && c.is_usable();
    if !cameras.iter().all(is_good) {
        return Err(format!("the cameras are damaged (first: {w}×{h}, focal length {})", cameras[0].fx));
    }
    Ok(())
}

/// Reads the times of the frames; none from older scenes.
fn read_times(reader: &Reader<'_>, num_frames: usize) -> Result<Vec<f32>, Problem> {
    if !reader.has("times") {
        return Ok(Vec::new());
    }
    let times: Vec<f32> = reader.shaped("times", &[num_frames])?;
    if times.iter().all(|t| (0.0..=1.0).contains(t)) {
        Ok(times)
    } else {
        Err("tensor `times` has a time that is not between 0 and 1".into())
    }
}

fn read_field_of_view(reader: &Reader<'_>, header: &SceneHeader, camera: &Camera) -> Result<Mask, Problem> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let view = reader.view("field_of_view")?;
    let stride = width.div_ceil(8);
    if header.width != width || view.dtype() != Dtype::U8 || view.shape() != [height, stride] {
        return Err(format!("tensor `field_of_view` does not fit the cameras' {width}×{height}"));
    }
    let bit = |x: usize, y: usize| view.data()[y * stride + x / 8] >> (7 - x % 8) & 1 == 1;
    let data = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| bit(x, y)).collect();
    Ok(Mask::from_vec(width, height, data))
}

/// Reads the vectors of the vocabulary; none from older scenes.
fn read_vectors(reader: &Reader<'_>) -> Result<Arc<Vec<f16>>, Problem> {
    if !reader.has("vocabulary") {
        return Ok(Arc::default());
    }
    let view = reader.view("vocabulary")?;
    if view.dtype() != Dtype::U8 {
        return Err("tensor `vocabulary` is not made of bytes".into());
    }
    Ok(Arc::new(view.data().as_chunks().0.iter().map(|b| f16::from_le_bytes(*b)).collect()))
}

fn read_codec(reader: &Reader<'_>, latent_dim: usize) -> Result<Option<Codec>, Problem> {
    if latent_dim == 0 {
        return Ok(None);
    }
    let (encoder, decoder) = (read_layers(reader, "encoder")?, read_layers(reader, "decoder")?);
    // Features without their codec can be displayed, but not queried.
    if encoder.is_empty() && decoder.is_empty() {
        return Ok(None);
    }
    Codec { encoder, decoder }.of_latents(latent_dim).map(Some)
}

fn read_layers(reader: &Reader<'_>, name: &str) -> Result<Vec<Linear>, Problem> {
    let mut layers: Vec<Linear> = Vec::new();
    while reader.has(&format!("{name}.{}.weight", layers.len())) {
        let k = layers.len();
        let (shape, weight) = reader.f32(&format!("{name}.{k}.weight"), 2)?;
        if layers.last().is_some_and(|l| l.weight.nrows() != shape[1]) {
            return Err(format!("layer {k} of the {name} does not fit the layer before it"));
        }
        let bias = reader.shaped(&format!("{name}.{k}.bias"), &shape[..1])?;
        let weight = Array2::from_shape_vec((shape[0], shape[1]), weight).map_err(|e| e.to_string())?;
        layers.push(Linear { weight, bias: Array1::from_vec(bias) });
    }
    Ok(layers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::{GATE_SLOPE, deform};
    use glam::{Affine3A, Vec3};

    fn scene() -> Scene {
        let n = 4;
        let mut deformation = Deformation::at_rest(n, 3, 5, 0.1, GATE_SLOPE);
        let stride = deformation.stride;
        deformation.weights[(2 * n + 1) * stride + 4] = 0.5;
        deformation.feature_weight[3] = 0.25;
        let mut camera = Camera::with_field_of_view(13, 6, 60.0);
        camera.camera_from_world =
            Affine3A::from_rotation_x(0.3) * Affine3A::from_translation(Vec3::new(1.0, 2.0, 3.0));
        let layer = |i: usize, o: usize| Linear {
            weight: Array2::from_shape_fn((o, i), |(r, c)| (r * 3 + c) as f32),
            bias: Array1::from_elem(o, 0.5),
        };
        Scene {
            gaussians: Gaussians {
                means: (0..n).map(|i| [i as f32, 1.0, 2.0]).collect(),
                rotations: vec![[1.0, 0.0, 0.0, 0.1]; n],
                log_scales: vec![[0.1, 0.2, 0.3]; n],
                opacity_logits: vec![0.3; n],
                colours: vec![[0.4, 0.5, 0.6]; n],
                sh_rest: vec![0.7; n * 9],
                sh_degree: 1,
                features: vec![0.8; n * 3],
                latent_dim: 3,
            }
            .into(),
            deformation: deformation.into(),
            chapters: Chapters::default(),
            cameras: vec![camera; 3],
            times: vec![0.0, 0.5, 0.5],
            field_of_view: Mask::from_vec(13, 6, (0..78).map(|i| i % 7 < 3).collect()),
            codec: Some(Codec { encoder: vec![layer(8, 3)], decoder: vec![layer(3, 5), layer(5, 8)] }),
            classes: vec![(Class { id: 4, name: "liver".into(), colour: [1, 2, 3] }, vec![0.5; 8])],
            encoder: None,
            words: WordFacts {
                unseen: vec!["hepatic vein".into()],
                from_marks: true,
                calibration: None,
                vectors: vec![f16::from_f32(0.5), f16::from_f32(-0.25)].into(),
            },
            provenance: Provenance { sequence_name: "café".into(), steps: 7, ..Provenance::default() },
        }
    }

    #[test]
    fn a_scene_survives_the_round_trip() {
        let before = scene();
        let bytes = to_bytes(&before, false).unwrap();
        assert_eq!(bytes, to_bytes(&before, false).unwrap(), "the same scene gives the same bytes");
        let after = from_bytes(&bytes).unwrap();
        assert_eq!(after.gaussians, before.gaussians);
        assert_eq!(after.deformation, before.deformation);
        assert_eq!((after.cameras, after.times), (before.cameras, before.times));
        assert_eq!(after.field_of_view, before.field_of_view);
        assert_eq!(after.codec, before.codec);
        assert_eq!((after.classes, after.words), (before.classes, before.words));
        assert_eq!(after.provenance, before.provenance);
    }

    #[test]
    fn the_compact_form_is_nearly_the_same() {
        let before = crate::stress::ordinary(500);
        let bytes = to_bytes(&before, true).unwrap();
        assert_eq!(bytes, to_bytes(&before, true).unwrap(), "the same scene gives the same bytes");
        assert!(bytes.len() * 3 < to_bytes(&before, false).unwrap().len());
        let after = from_bytes(&bytes).unwrap();
        let [a, b] = [&before, &after].map(|s| deform(&s.gaussians, &s.deformation, 0.3, true));
        let close = |a: &[f32], b: &[f32], by: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() < by);
        assert!(close(a.means.as_flattened(), b.means.as_flattened(), 0.01));
        assert!(close(a.rotations.as_flattened(), b.rotations.as_flattened(), 0.1));
        assert!(close(a.colours.as_flattened(), b.colours.as_flattened(), 0.03));
        assert!(close(&a.opacities, &b.opacities, 0.01) && close(&a.features, &b.features, 0.2));
        // Writing it a second time loses nothing more.
        assert_eq!(
            from_bytes(&to_bytes(&after, true).unwrap()).unwrap().gaussians.colours,
            after.gaussians.colours
        );
        let mut whole = scene();
        whole.deformation = (*whole.deformation).clone().with_own_bases().into();
        let read = from_bytes(&to_bytes(&whole, true).unwrap()).unwrap();
        assert!(!read.deformation.is_shared() && read.codec.is_some());
        assert_eq!((read.cameras, read.classes), (whole.cameras, whole.classes));
    }

    #[test]
    fn features_may_come_without_their_codec() {
        let mut before = scene();
        before.codec = None;
        let after = from_bytes(&to_bytes(&before, false).unwrap()).unwrap();
        assert_eq!((after.codec, &after.gaussians.features), (None, &before.gaussians.features));
    }

    #[test]
    fn the_header_tells_if_there_is_a_codec() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        assert!(!has_codec(&path));
        let without = Scene { codec: None, ..scene() };
        for (scene, expected) in [(scene(), true), (without, false)] {
            for compact in [false, true] {
                std::fs::write(&path, to_bytes(&scene, compact).unwrap()).unwrap();
                assert_eq!(has_codec(&path), expected, "{compact}");
            }
        }
    }

    #[test]
    fn a_file_cut_short_anywhere_is_refused_in_words() {
        let bytes = to_bytes(&scene(), false).unwrap();
        for len in (0..bytes.len()).step_by(97) {
            assert!(!from_bytes(&bytes[..len]).unwrap_err().is_empty());
        }
        assert!(from_bytes(&bytes[..bytes.len() - 1]).is_err());
    }

    #[test]
    fn a_changed_value_is_noticed_and_older_files_have_no_checksum() {
        for compact in [false, true] {
            let bytes = to_bytes(&scene(), compact).unwrap();
            let tensors = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
            for at in (tensors..bytes.len()).step_by(61) {
                let mut changed = bytes.clone();
                changed[at] ^= 1;
                assert!(from_bytes(&changed).unwrap_err().contains("checksum"), "byte {at}");
            }
            let before =
                String::from_utf8_lossy(&bytes[8..tensors]).replace("tensors_sha256", "tensors_sha000");
            let older = [&bytes[..8], before.as_bytes(), &bytes[tensors..]].concat();
            assert!(from_bytes(&older).is_ok());
        }
    }

    #[test]
    fn poisoned_and_mismatched_tensors_are_refused() {
        let mut s = scene();
        s.gaussians.means[2][1] = f32::NAN;
        assert!(from_bytes(&to_bytes(&s, false).unwrap()).unwrap_err().contains("`means`"));
        let mut s = scene();
        s.gaussians.features.pop();
        assert!(to_bytes(&s, false).is_err());
    }
}
