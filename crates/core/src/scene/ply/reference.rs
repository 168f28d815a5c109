//! The deforming `.ply` of the released code (method §6.5): ordinary columns of degree 3, then per
//! Gaussian `coefs_…` [channel][weights, centres, widths][basis], its feature `lang_0..2` and an opacity
//! that is never used. The weights of the feature network are in a separate file.

use super::{
    splats::{self, CHANNELS, RELEASED},
    table::{PlyTable, numbered},
};
use crate::{
    deform::{
        BasisShape, Deformation, GATE_CHANNEL, RELEASED_GATE_SLOPE, SCALE_CHANNEL, num_channels, stride_for,
    },
    gaussian::MAX_SH_BANDS,
    reading::weights_beside,
    scene::{
        MADE_BY, Problem, RELEASED_BASES as BASES, Scene,
        released::{DIM, GEOMETRY},
        still::camera_at_origin,
    },
};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::path::Path;

/// Kinds of coefficients: weights, centres, widths.
const KINDS: usize = 3;
/// Number of frames of a scene that comes without its recording: that of a CholecSeg8K clip.
const FRAMES: usize = 80;
/// The feature network's file beside the `.ply`: `safetensors.torch.save_file` of the contents of
/// `lang_deformation.pth`.
pub const LANG_DEFORMATION_FILE: &str = "lang_deformation.safetensors";
const WEIGHT: &str = "conv_beta.weight";
const BIAS: &str = "conv_beta.bias";
/// Weights that the released code loads and never uses.
const UNUSED: [&str; 2] = ["conv_alpha.weight", "conv_alpha.bias"];

/// Beginning of the comment that holds the weights.
const WEIGHTS_COMMENT: &str = "lang_deformation";

/// The feature network of the released code, `lang_deformation`.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceWeights {
    /// W, [3][4].
    weight: Vec<f32>,
    /// b, [3].
    bias: Vec<f32>,
}

impl ReferenceWeights {
    /// Reads the weights beside a `.ply`; `None` if there are none.
    pub(in crate::scene) fn beside(ply: &Path) -> Result<Option<Self>, Problem> {
        weights_beside(ply, LANG_DEFORMATION_FILE, "lang_deformation.pth", Self::from_bytes)
    }

    /// Reads the weights from safetensors with `conv_beta.weight` [3, 4, 1] and `conv_beta.bias` [3], the
    /// names in `lang_deformation.pth`. The error says what is wrong, without a full stop.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let file =
            SafeTensors::deserialize(bytes).map_err(|e| format!("this is not a safetensors file: {e}"))?;
        let read = |name: &str, len: usize| -> Result<Vec<f32>, Problem> {
            let view = file.tensor(name).map_err(|_| format!("there is no tensor `{name}`"))?;
            let (bytes, rest) = view.data().as_chunks::<4>();
            if view.dtype() != Dtype::F32 || bytes.len() != len || !rest.is_empty() {
                let found = (view.dtype(), view.shape());
                return Err(format!("tensor `{name}` should hold {len} F32, but is {found:?}"));
            }
            let values: Vec<f32> = bytes.iter().map(|b| f32::from_le_bytes(*b)).collect();
            if values.iter().all(|v| v.is_finite()) {
                Ok(values)
            } else {
                Err(format!("tensor `{name}` has a value that is not a number"))
            }
        };
        Ok(Self { weight: read(WEIGHT, DIM * (DIM + 1))?, bias: read(BIAS, DIM)? })
    }

    /// Returns the weights as a comment of the `.ply`, so that it is whole without the file beside it.
    fn to_comment(&self) -> String {
        let numbers = self.weight.iter().chain(&self.bias);
        let hexadecimal: String = numbers.map(|v| format!("{:08x}", v.to_bits())).collect();
        format!("{WEIGHTS_COMMENT} {hexadecimal}")
    }

    /// Reads the comment that [`Self::to_comment`] writes; `None` if there is none of it.
    pub(super) fn from_comments(comments: &[String]) -> Option<Self> {
        let text = comments.iter().find_map(|comment| comment.strip_prefix(WEIGHTS_COMMENT))?.trim();
        let (digits, rest) = text.as_bytes().as_chunks::<8>();
        let number =
            |d: &[u8; 8]| u32::from_str_radix(std::str::from_utf8(d).ok()?, 16).ok().map(f32::from_bits);
        let mut weight: Vec<f32> = digits.iter().map(number).collect::<Option<_>>()?;
        let is_whole = rest.is_empty() && weight.len() == DIM * (DIM + 2);
        let bias = weight.split_off(weight.len().min(DIM * (DIM + 1)));
        let is_finite = weight.iter().chain(&bias).all(|v| v.is_finite());
        (is_whole && is_finite).then_some(Self { weight, bias })
    }

    /// Returns the weights as safetensors.
    pub fn to_bytes(&self) -> Vec<u8> {
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let zeros = [vec![0; 4 * DIM * (DIM + 1)], vec![0; 4 * DIM]];
        let (weight, bias) = (bytes(&self.weight), bytes(&self.bias));
        let shapes = [vec![DIM, DIM + 1, 1], vec![DIM]];
        let named =
            [(WEIGHT, 0, &weight), (BIAS, 1, &bias), (UNUSED[0], 0, &zeros[0]), (UNUSED[1], 1, &zeros[1])];
        let views = named.into_iter().filter_map(|(name, shape, bytes): (&str, usize, &Vec<u8>)| {
            TensorView::new(Dtype::F32, shapes[shape].clone(), bytes).ok().map(|view| (name, view))
        });
        let made_by = [("surgtpgs_version".to_owned(), env!("CARGO_PKG_VERSION").to_owned())].into();
        safetensors::serialize(views, Some(made_by)).unwrap_or_default()
    }
}

/// Returns the motion with as many basis functions as the format has, separate for every Gaussian.
fn spread(deformation: &Deformation, n: usize) -> Deformation {
    let mut own = deformation.clone();
    if own.is_shared() {
        own = own.with_own_bases();
    }
    for values in [&mut own.weights, &mut own.centres, &mut own.widths] {
        values.resize(BASES * n * own.stride, 0.0);
    }
    own
}

impl Scene {
    /// Returns the scene in the released code's format: 576 properties per Gaussian. Scenes that were
    /// trained like the released code are kept to the last bit. Others are written in their
    /// [released form](Self::released).
    pub fn to_reference_ply(&self) -> Vec<u8> {
        let scene = self.released().scene;
        let weights = scene.reference_weights();
        let (n, still) = (scene.gaussians.len(), &scene);
        let d = &spread(&scene.deformation, n);
        let mut values =
            Vec::with_capacity(n * (17 + MAX_SH_BANDS * CHANNELS + GEOMETRY * KINDS * BASES + 4));
        for i in 0..n {
            values.extend(splats::row(&still.gaussians, i, MAX_SH_BANDS));
            for channel in 0..GEOMETRY {
                for kind in [&d.weights, &d.centres, &d.widths] {
                    values.extend((0..BASES).map(|b| kind[(b * n + i) * d.stride + channel]));
                }
            }
            let feature = still.gaussians.features.get(i * DIM..(i + 1) * DIM);
            values.extend(feature.unwrap_or(&[0.0; DIM]));
            values.push(0.0);
        }
        let names = [
            splats::names(MAX_SH_BANDS),
            numbered("coefs", GEOMETRY * KINDS * BASES),
            numbered(RELEASED, DIM),
            vec!["opa_lang".to_owned()],
        ]
        .concat();
        let comments = vec![MADE_BY.to_owned(), weights.to_comment()];
        PlyTable { names, comments, values }.to_bytes()
    }

    /// Returns the feature network of a scene in [released form](Self::released); zeros if it has none.
    pub fn reference_weights(&self) -> ReferenceWeights {
        let d = &self.deformation;
        let (mut weight, mut bias) = (d.feature_weight.clone(), d.feature_bias.clone());
        weight.resize(DIM * (DIM + 1), 0.0);
        bias.resize(DIM, 0.0);
        ReferenceWeights { weight, bias }
    }
}

/// Reads a deforming scene of [`FRAMES`] frames, seen from the origin.
pub(super) fn from_table(table: &PlyTable, weights: Option<ReferenceWeights>) -> Result<Scene, Problem> {
    let (coefficients, latent_dim) = (table.count_numbered("coefs"), table.count_numbered(RELEASED));
    if ![0, DIM].contains(&latent_dim) {
        return Err(format!(
            "the vertices have {latent_dim} properties `{RELEASED}_…`, expected none or {DIM}"
        ));
    }
    // With 13 channels the last three are the features' gate (the paper's Θ^f).
    let channels = match coefficients {
        n if n % (GEOMETRY * KINDS) == 0 => GEOMETRY,
        n if n % ((GEOMETRY + DIM) * KINDS) == 0 && latent_dim == DIM => GEOMETRY + DIM,
        n => {
            return Err(format!(
                "the vertices have {n} properties `coefs_…`, expected {KINDS} × {GEOMETRY} channels × bases"
            ));
        }
    };
    let coefs = table.columns(&numbered("coefs", coefficients))?;
    let (gaussians, rows) = splats::gaussians(table, RELEASED, &coefs)?;
    let num_bases = coefficients / (KINDS * channels);
    let (n, stride) = (rows.len(), stride_for(latent_dim));
    let mut kinds = vec![vec![0.0; num_bases * n * stride]; KINDS];
    for (i, row) in rows.iter().map(|&k| table.row(k)).enumerate() {
        for (k, &column) in coefs.iter().enumerate() {
            let (channel, kind, b) = (k / (KINDS * num_bases), k / num_bases % KINDS, k % num_bases);
            let channel = if channel < GEOMETRY { channel } else { channel - GEOMETRY + GATE_CHANNEL };
            kinds[kind][(b * n + i) * stride + channel] = row[column];
        }
    }
    debug_assert!(num_channels(latent_dim) <= stride);
    let mut kinds = kinds.into_iter();
    let mut next = || kinds.next().unwrap_or_default();
    let camera = camera_at_origin(&gaussians.means);
    let mut scene = Scene::of_still(gaussians, camera);
    scene.cameras = vec![camera; FRAMES];
    *scene.deformation = Deformation {
        shape: BasisShape::Quartic,
        num_bases,
        stride,
        weights: next(),
        centres: next(),
        widths: next(),
        gate_slope: RELEASED_GATE_SLOPE,
        gate_channel: if channels == GEOMETRY { SCALE_CHANNEL } else { GATE_CHANNEL },
        feature_weight: vec![0.0; latent_dim * (latent_dim + 1)],
        feature_bias: vec![0.0; latent_dim],
    };
    if let Some(ReferenceWeights { weight, bias }) = weights.filter(|_| latent_dim == DIM) {
        (scene.deformation.feature_weight, scene.deformation.feature_bias) = (weight, bias);
    }
    scene.provenance.settings = serde_json::json!({
        "imported_from": "deforming .ply of the released code",
        "gaussians_left_out": table.num_rows() - n,
    });
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::{super::from_bytes, *};
    use crate::{deform::deform, stress};

    /// Returns a scene as the `paper` profile trains it: own quartic bases, the gate on scale,
    /// constant colours.
    fn released() -> Scene {
        let mut scene = stress::ordinary(7);
        let wave = |i: usize| (i as f32 * 0.37).sin();
        let mut d = Deformation::at_rest(7, DIM, BASES, 0.01, RELEASED_GATE_SLOPE).with_own_bases();
        (d.shape, d.gate_channel) = (BasisShape::Quartic, SCALE_CHANNEL);
        for (k, values) in [&mut d.weights, &mut d.centres, &mut d.widths].into_iter().enumerate() {
            for (i, v) in values.iter_mut().enumerate().filter(|(i, _)| i % d.stride < GEOMETRY) {
                *v += 0.1 * wave(i + 1000 * k);
            }
        }
        (d.feature_weight, d.feature_bias) = ((0..12).map(wave).collect(), vec![0.1, 0.2, 0.3]);
        *scene.deformation = d;
        scene
    }

    #[test]
    fn a_scene_of_the_released_kind_is_kept_to_the_last_bit() {
        let scene = released();
        let (ply, weights) = (scene.to_reference_ply(), scene.reference_weights());
        assert_eq!(scene.released().lost, Vec::<String>::new());
        let table = PlyTable::from_bytes(&ply).unwrap();
        assert_eq!((table.names.len(), table.num_rows()), (576, 7));
        let read = from_bytes(&ply, || Ok(Some(weights))).unwrap();
        assert_eq!(read.gaussians, scene.gaussians);
        let values = |d: &Deformation| [0.0, 0.3, 0.99].map(|t| d.psi(7, t));
        assert_eq!(values(&read.deformation), values(&scene.deformation));
        assert_eq!(read.deformation.feature_net().weight, scene.deformation.feature_net().weight);
        assert_eq!(read.to_reference_ply(), ply, "written again it is the same file");
        // The coefficients of Gaussian 2 begin at column 62: the weight of basis 1, channel 4 is at
        // 62 + 4 · 51 + 1.
        assert_eq!(table.names[62], "coefs_0");
        let stride = scene.deformation.stride;
        assert_eq!(table.row(2)[62 + 4 * 51 + 1], scene.deformation.weights[(7 + 2) * stride + 4]);
    }

    #[test]
    fn other_motion_is_fitted() {
        let mut scene = stress::ordinary(20);
        scene.cameras = vec![scene.cameras[0]; 30];
        let lost = scene.released().lost;
        assert_eq!(lost.len(), 3, "{lost:?}");
        let read = from_bytes(&scene.to_reference_ply(), || Ok(None)).unwrap();
        for time in [0.0, 0.37, 0.9] {
            let [a, b] = [&scene, &read].map(|s| deform(&s.gaussians, &s.deformation, time, true));
            let worst = a.means.as_flattened().iter().zip(b.means.as_flattened());
            let worst = worst.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            // The released bases are further apart and miss up to a tenth of a weight, 0.05, at the ends.
            assert!(worst < 6e-3, "{worst} at {time}");
            let away = a.features.iter().zip(&b.features).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(away < 0.3, "{away} at {time}");
        }
    }

    #[test]
    fn a_scene_that_stands_still_loses_nothing() {
        let scene = stress::ordinary(9);
        let still = Scene::of_still(scene.all_still(0.4), scene.cameras[0]);
        assert_eq!(still.released().lost, Vec::<String>::new());
        let read = from_bytes(&still.to_reference_ply(), || Ok(None)).unwrap();
        assert_eq!(read.gaussians.means, still.gaussians.means);
        assert!(read.deformation.psi(9, 0.7).iter().all(|v| *v == 0.0));
    }

    #[test]
    fn a_gate_of_its_own_and_no_features_are_read() {
        let mut table = PlyTable::from_bytes(&released().to_reference_ply()).unwrap();
        let keep = table.names.len() - 4;
        let without = PlyTable {
            values: (0..7).flat_map(|i| table.row(i)[..keep].to_vec()).collect(),
            names: table.names[..keep].to_vec(),
            comments: Vec::new(),
        };
        assert_eq!(from_bytes(&without.to_bytes(), || Ok(None)).unwrap().gaussians.latent_dim, 0);
        table.names[62 + 509] = "other".into();
        assert!(from_bytes(&table.to_bytes(), || Ok(None)).unwrap_err().contains("509"));
    }

    #[test]
    fn weights_survive_and_others_are_refused() {
        let weights = released().reference_weights();
        assert_eq!(ReferenceWeights::from_bytes(&weights.to_bytes()).unwrap(), weights);
        assert!(ReferenceWeights::from_bytes(b"PK").unwrap_err().contains("safetensors"));
        let folder = tempfile::tempdir().unwrap();
        let ply = folder.path().join("point_cloud.ply");
        assert_eq!(ReferenceWeights::beside(&ply).unwrap(), None);
        // Those of this program are whole by themselves.
        let own = released().to_reference_ply();
        std::fs::write(&ply, &own).unwrap();
        assert_eq!(Scene::load(&ply).unwrap().deformation.feature_weight, weights.weight);
        let comment = weights.to_comment();
        let start = own.windows(comment.len()).position(|part| part == comment.as_bytes()).unwrap();
        let line = start - "comment ".len()..start + comment.len() + 1;
        let foreign = [&own[..line.start], &own[line.end..]].concat();
        std::fs::write(&ply, foreign).unwrap();
        assert_ne!(Scene::load(&ply).unwrap().deformation.feature_weight, weights.weight);
        std::fs::write(folder.path().join(LANG_DEFORMATION_FILE), weights.to_bytes()).unwrap();
        assert_eq!(Scene::load(&ply).unwrap().deformation.feature_weight, weights.weight);
        std::fs::write(folder.path().join(LANG_DEFORMATION_FILE), b"PK").unwrap();
        assert!(Scene::load(&ply).unwrap_err().to_string().contains("save_file"));
    }
}
