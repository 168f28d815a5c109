//! The deforming `.ply` of the released code (method §6.5): ordinary columns of degree 3, then per
//! Gaussian `coefs_…` [channel][weights, centres, widths][basis], its feature `lang_0..2` and an opacity
//! that is never used. The weights of the feature network are in a separate file.

use super::{
    splats::{self, CHANNELS},
    table::{MADE_BY, PlyTable, numbered},
};
use crate::{
    deform::{
        BasisShape, COLOUR_CHANNEL, Deformation, GATE_CHANNEL, MEAN_CHANNEL, SCALE_CHANNEL, deform,
        num_channels, stride_for,
    },
    gaussian::MAX_SH_BANDS,
    reading::{is_present, read_regular},
    scene::{
        Problem, Scene,
        fit::{fit_motion, sample_times},
        still::camera_at_origin,
    },
};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::path::Path;

/// Number of deformed channels in the released configuration: centre, quaternion, log-scale, in our order.
const GEOMETRY: usize = COLOUR_CHANNEL;
/// Number of its basis functions.
const BASES: usize = 17;
/// Kinds of coefficients: weights, centres, widths.
const KINDS: usize = 3;
/// Number of its latent values.
const DIM: usize = 3;
/// δ of its gate, which reads the channels of scale (method §3.3).
const GATE_SLOPE: f32 = 1.5;
/// Number of frames of a scene that comes without its recording: that of a CholecSeg8K clip.
const FRAMES: usize = 80;
/// √(σ² + 1e-4) of bases that replace others, in units of the distance between two centres. Of values
/// from 0.7 to 2.2 this one follows splines best.
const FITTED_WIDTH: f32 = 1.0;
/// The feature network's file beside the `.ply`: `safetensors.torch.save_file` of the contents of
/// `lang_deformation.pth`.
pub const LANG_DEFORMATION_FILE: &str = "lang_deformation.safetensors";
const WEIGHT: &str = "conv_beta.weight";
const BIAS: &str = "conv_beta.bias";
/// Weights that the released code loads and never uses.
const UNUSED: [&str; 2] = ["conv_alpha.weight", "conv_alpha.bias"];

/// Largest size of that file in bytes; it needs less than a thousand.
const MOST_BYTES: u64 = 1 << 20;
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
        let path = ply.with_file_name(LANG_DEFORMATION_FILE);
        if !is_present(&path) {
            return Ok(None);
        }
        let read = read_regular(&path, MOST_BYTES)
            .map_err(|e| e.to_string())
            .and_then(|bytes| Self::from_bytes(&bytes));
        read.map(Some).map_err(|what| {
            format!(
                "{LANG_DEFORMATION_FILE} beside it cannot be read ({what}); make it in Python with \
                 safetensors.torch.save_file(torch.load(\"lang_deformation.pth\"), \"{LANG_DEFORMATION_FILE}\")"
            )
        })
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

/// A scene in the files of the released code.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferencePly {
    /// `point_cloud.ply`.
    pub ply: Vec<u8>,
    /// `lang_deformation`.
    pub weights: ReferenceWeights,
    /// Properties of the scene that these files cannot express, each a clause.
    pub lost: Vec<String>,
}

impl Scene {
    /// Returns the scene in the released code's format: 576 properties per Gaussian. Scenes that were
    /// trained like the released code are kept to the last bit. Other motion is fitted with its bases.
    /// Changes that the format cannot hold are averaged over time.
    pub fn to_reference_ply(&self) -> ReferencePly {
        let mut lost = Vec::new();
        let motion = self.reference_motion(&mut lost);
        let still = self.averaged(&mut lost);
        let weights = self.reference_weights();
        let (n, d) = (self.gaussians.len(), &motion);
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
            numbered("lang", DIM),
            vec!["opa_lang".to_owned()],
        ]
        .concat();
        let comments = vec![MADE_BY.to_owned(), weights.to_comment()];
        ReferencePly { ply: PlyTable { names, comments, values }.to_bytes(), weights, lost }
    }

    /// Returns the motion in the released code's bases: 17 quartic ones, separate for every Gaussian.
    fn reference_motion(&self, lost: &mut Vec<String>) -> Deformation {
        let (d, n) = (&*self.deformation, self.gaussians.len());
        if d.shape == BasisShape::Quartic && d.num_bases <= BASES {
            let mut same = if d.is_shared() { d.clone().with_own_bases() } else { d.clone() };
            for values in [&mut same.weights, &mut same.centres, &mut same.widths] {
                values.resize(BASES * n * d.stride, 0.0);
            }
            return same;
        }
        let mut fitted = Deformation::at_rest(n, self.gaussians.latent_dim, BASES, 0.0, GATE_SLOPE);
        fitted.shape = BasisShape::Quartic;
        let spacing = FITTED_WIDTH / (BASES - 1) as f32;
        fitted.widths.fill((spacing * spacing - 1e-4).max(0.0).sqrt());
        let times = sample_times(self.num_frames().max(4 * BASES));
        fit_motion(&mut fitted, d, n, &times);
        let error = motion_error(d, &fitted, n, &times);
        lost.push(format!(
            "motion is fitted with {BASES} bases: centres are right to {error:.2e} scene units (root mean square)"
        ));
        fitted.with_own_bases()
    }

    /// Returns the Gaussians with colours averaged over the frames. Features are averaged too if the
    /// released code could not deform them the same way.
    fn averaged(&self, lost: &mut Vec<String>) -> Self {
        let mut still = self.clone();
        let (g, frames) = (&mut *still.gaussians, self.num_frames().max(1));
        let mut colours = vec![0.0; g.colours.len() * CHANNELS];
        let mut features = vec![0.0; g.features.len()];
        for i in 0..frames {
            let now = deform(&self.gaussians, &self.deformation, self.time(i), true);
            let share = 1.0 / frames as f32;
            colours.iter_mut().zip(now.colours.as_flattened()).for_each(|(sum, c)| *sum += share * c);
            features.iter_mut().zip(&now.features).for_each(|(sum, f)| *sum += share * f);
        }
        if self.changes(COLOUR_CHANNEL..COLOUR_CHANNEL + CHANNELS) {
            g.colours = colours.as_chunks().0.to_vec();
            lost.push("colour is that of the middle of its change over time".into());
        }
        match g.latent_dim {
            0 => {}
            DIM if self.has_reference_gate() => {}
            DIM => {
                g.features = features;
                lost.push("features are averaged over time".into());
            }
            other => {
                g.features.clear();
                lost.push(format!("features have {other} numbers instead of {DIM} and are left out"));
            }
        }
        still
    }

    fn reference_weights(&self) -> ReferenceWeights {
        let d = &self.deformation;
        if self.has_reference_gate() {
            ReferenceWeights { weight: d.feature_weight.clone(), bias: d.feature_bias.clone() }
        } else {
            ReferenceWeights { weight: vec![0.0; DIM * (DIM + 1)], bias: vec![0.0; DIM] }
        }
    }

    fn has_reference_gate(&self) -> bool {
        let d = &self.deformation;
        self.gaussians.latent_dim == DIM && d.gate_channel == SCALE_CHANNEL && d.gate_slope == GATE_SLOPE
    }

    /// Returns `true` if any of these channels moves.
    fn changes(&self, channels: std::ops::Range<usize>) -> bool {
        let d = &self.deformation;
        d.weights.chunks_exact(d.stride).any(|row| row[channels.clone()].iter().any(|w| *w != 0.0))
    }
}

/// Returns the root mean square distance between two motions of the centres.
fn motion_error(a: &Deformation, b: &Deformation, n: usize, times: &[f32]) -> f64 {
    let mut sum = 0.0;
    for time in times {
        let (a_psi, b_psi) = (a.psi(n, *time), b.psi(n, *time));
        let rows = a_psi.chunks_exact(a.stride).zip(b_psi.chunks_exact(b.stride));
        sum += rows
            .flat_map(|(a, b)| (MEAN_CHANNEL..MEAN_CHANNEL + 3).map(|c| f64::from(a[c] - b[c]).powi(2)))
            .sum::<f64>();
    }
    (sum / (n * times.len()).max(1) as f64).sqrt()
}

/// Reads a deforming scene of [`FRAMES`] frames, seen from the origin.
pub(super) fn from_table(table: &PlyTable, weights: Option<ReferenceWeights>) -> Result<Scene, Problem> {
    let (coefficients, latent_dim) = (table.count_numbered("coefs"), table.count_numbered("lang"));
    if ![0, DIM].contains(&latent_dim) {
        return Err(format!("the vertices have {latent_dim} properties `lang_…`, expected none or {DIM}"));
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
    let lang = table.columns(&numbered("lang", latent_dim))?;
    let (mut gaussians, rows) = splats::gaussians(table, &[&coefs[..], &lang].concat())?;
    gaussians.latent_dim = latent_dim;
    gaussians.features = rows.iter().flat_map(|&k| lang.iter().map(move |&c| table.row(k)[c])).collect();
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
        gate_slope: GATE_SLOPE,
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
    use crate::stress;

    /// Returns a scene as the `paper` profile trains it: own quartic bases, the gate on scale,
    /// constant colours.
    fn released() -> Scene {
        let mut scene = stress::ordinary(7);
        let wave = |i: usize| (i as f32 * 0.37).sin();
        let mut d = Deformation::at_rest(7, DIM, BASES, 0.01, GATE_SLOPE).with_own_bases();
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
        let files = scene.to_reference_ply();
        assert_eq!(files.lost, Vec::<String>::new());
        let table = PlyTable::from_bytes(&files.ply).unwrap();
        assert_eq!((table.names.len(), table.num_rows()), (576, 7));
        let read = from_bytes(&files.ply, || Ok(Some(files.weights.clone()))).unwrap();
        assert_eq!(read.gaussians, scene.gaussians);
        let values = |d: &Deformation| [0.0, 0.3, 0.99].map(|t| d.psi(7, t));
        assert_eq!(values(&read.deformation), values(&scene.deformation));
        assert_eq!(read.deformation.feature_net().weight, scene.deformation.feature_net().weight);
        assert_eq!(read.to_reference_ply().ply, files.ply, "written again it is the same file");
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
        let files = scene.to_reference_ply();
        assert_eq!(files.lost.len(), 3, "{:?}", files.lost);
        let read = from_bytes(&files.ply, || Ok(Some(files.weights.clone()))).unwrap();
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
    fn a_gate_of_its_own_and_no_features_are_read() {
        let mut table = PlyTable::from_bytes(&released().to_reference_ply().ply).unwrap();
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
        let own = released().to_reference_ply().ply;
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
