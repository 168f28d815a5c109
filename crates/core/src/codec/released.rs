//! The autoencoder of LangSplat and of the released code, as their training saves it.

use super::{Codec, mlp::Linear};
use crate::reading::weights_beside;
use ndarray::{Array1, ArrayD, Axis, Ix1, Ix2};
use safetensors::{Dtype, SafeTensors};
use std::path::Path;

/// The autoencoder's file beside a `.ply` with features: `safetensors.torch.save_file` of the contents of
/// `best_ckpt.pth`.
pub const AUTOENCODER_FILE: &str = "autoencoder.safetensors";

/// Largest number of a part in either half: the released ones go up to 12.
const MOST_PARTS: usize = 64;
/// Added to variances by PyTorch's batch normalisation.
const EPSILON: f32 = 1e-5;

impl Codec {
    /// Reads the autoencoder beside a `.ply`; `None` if there is none. The error says what is wrong, without
    /// a full stop.
    pub(crate) fn beside(ply: &Path) -> Result<Option<Self>, String> {
        weights_beside(ply, AUTOENCODER_FILE, "best_ckpt.pth", Self::from_released)
    }

    /// Reads safetensors with the parts of two `ModuleList`s, `encoder.0.weight` and so on (method §7). Batch
    /// normalisation becomes part of the linear layer before it. The error says what is wrong, without a full
    /// stop.
    pub fn from_released(bytes: &[u8]) -> Result<Self, String> {
        let file =
            SafeTensors::deserialize(bytes).map_err(|e| format!("this is not a safetensors file: {e}"))?;
        let codec = Self { encoder: half(&file, "encoder")?, decoder: half(&file, "decoder")? };
        codec.validate().map_err(|e| e.to_string())?;
        Ok(codec)
    }
}

/// Reads the linear layers of `encoder` or `decoder`, of which the parts without weights are ReLUs.
fn half(file: &SafeTensors<'_>, name: &str) -> Result<Vec<Linear>, String> {
    let mut layers: Vec<Linear> = Vec::new();
    for part in (0..MOST_PARTS).map(|i| format!("{name}.{i}")) {
        let Some(weight) = tensor(file, &format!("{part}.weight"))? else { continue };
        let row = |what: &str| {
            let found = tensor(file, &format!("{part}.{what}"))?;
            let found = found.and_then(|values| values.into_dimensionality::<Ix1>().ok());
            found.ok_or_else(|| format!("there is no usable tensor `{part}.{what}`"))
        };
        let is_norm = weight.ndim() == 1 && file.tensor(&format!("{part}.running_mean")).is_ok();
        match (weight.into_dimensionality::<Ix2>(), layers.last_mut()) {
            (Ok(weight), _) => layers.push(Linear { weight, bias: row("bias")? }),
            (Err(_), Some(before)) if is_norm => {
                let rows = [row("weight")?, row("bias")?, row("running_mean")?, row("running_var")?];
                let width = before.bias.len();
                if rows.iter().any(|row| row.len() != width) {
                    return Err(format!("`{part}` does not fit the {width} numbers of the layer before it"));
                }
                fold_norm(before, &rows);
            }
            _ => {
                return Err(format!("`{part}` is neither a linear layer nor batch normalisation behind one"));
            }
        }
    }
    Ok(layers)
}

/// Makes batch normalisation part of the layer before it, from its weights, biases, means and variances.
fn fold_norm(before: &mut Linear, [weight, bias, mean, variance]: &[Array1<f32>; 4]) {
    let scale = weight / &variance.mapv(|v| (v + EPSILON).sqrt());
    before.weight *= &scale.view().insert_axis(Axis(1));
    before.bias = (&before.bias - mean) * &scale + bias;
}

/// Returns a tensor of 32-bit floats; `None` if there is none of the name.
fn tensor(file: &SafeTensors<'_>, name: &str) -> Result<Option<ArrayD<f32>>, String> {
    let Ok(view) = file.tensor(name) else { return Ok(None) };
    if view.dtype() != Dtype::F32 {
        return Err(format!("tensor `{name}` should be of F32, but is of {:?}", view.dtype()));
    }
    let values = view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    ArrayD::from_shape_vec(view.shape(), values).map(Some).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{apply, mlp::init, normalise_rows};
    use ndarray::Array2;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use safetensors::tensor::TensorView;

    type Tensors = Vec<(String, Vec<usize>, Vec<f32>)>;

    fn linear(name: &str, layer: &Linear) -> Tensors {
        let (rows, columns) = layer.weight.dim();
        vec![
            (format!("{name}.weight"), vec![rows, columns], layer.weight.iter().copied().collect()),
            (format!("{name}.bias"), vec![rows], layer.bias.to_vec()),
        ]
    }

    fn norm(name: &str, parts: [&[f32]; 4]) -> Tensors {
        let names = ["weight", "bias", "running_mean", "running_var"];
        let tensor =
            |(what, values): (&str, &[f32])| (format!("{name}.{what}"), vec![values.len()], values.to_vec());
        names.into_iter().zip(parts).map(tensor).collect()
    }

    fn file(tensors: &Tensors) -> Vec<u8> {
        let bytes: Vec<Vec<u8>> =
            tensors.iter().map(|t| t.2.iter().flat_map(|v| v.to_le_bytes()).collect()).collect();
        let views = tensors.iter().zip(&bytes).map(|((name, shape, _), bytes)| {
            (name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap())
        });
        safetensors::serialize(views, None).unwrap()
    }

    /// An autoencoder of 5 numbers as PyTorch saves it: linear, normalisation, ReLU, linear; and linear,
    /// ReLU, linear. Also returns its linear layers.
    fn released() -> (Tensors, [Linear; 4]) {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut layers = init(&[5, 4, 3], &mut rng);
        layers.extend(init(&[3, 4, 5], &mut rng));
        let layers: [Linear; 4] = layers.try_into().unwrap();
        let [a, b, c, d] = &layers;
        let parts = [
            &[0.5, 2.0, -1.0, 1.0][..],
            &[0.1, 0.2, 0.3, 0.4],
            &[0.3, 0.0, -0.2, 1.0],
            &[4.0, 0.25, 1.0, 9.0],
        ];
        let tensors = [
            linear("encoder.0", a),
            norm("encoder.1", parts),
            linear("encoder.3", b),
            linear("decoder.0", c),
            linear("decoder.2", d),
        ];
        (tensors.concat(), layers)
    }

    #[test]
    fn the_released_autoencoder_is_read() {
        let (tensors, [a, b, c, d]) = released();
        let codec = Codec::from_released(&file(&tensors)).unwrap();
        assert_eq!((codec.encoder.len(), codec.latent_dim(), codec.embedding_dim()), (2, 3, 5));
        assert_eq!(codec.decoder, [c, d]);
        let rows = Array2::from_shape_fn((6, 5), |(i, k)| ((7 * i + 3 * k) as f32).sin());
        // Step by step, as PyTorch does.
        let mut hidden = apply(&[a], rows.view());
        for mut row in hidden.outer_iter_mut() {
            let of = |k: usize| {
                let (g, s) = ([0.5, 2.0, -1.0, 1.0][k], [0.1, 0.2, 0.3, 0.4][k]);
                (g, s, [0.3, 0.0, -0.2, 1.0][k], [4.0, 0.25, 1.0, 9.0_f32][k])
            };
            for k in 0..4 {
                let (scale, shift, mean, variance) = of(k);
                row[k] = (scale * (row[k] - mean) / (variance + 1e-5).sqrt() + shift).max(0.0);
            }
        }
        let expected = normalise_rows(apply(&[b], hidden.view()));
        let worst = (&codec.encode(rows.view()) - &expected).mapv(f32::abs).fold(0.0_f32, |a, b| a.max(*b));
        assert!(worst < 1e-5, "{worst}");
    }

    #[test]
    fn what_cannot_be_used_is_refused_in_words() {
        let refused = |change: &dyn Fn(&mut Tensors), part: &str| {
            let mut tensors = released().0;
            change(&mut tensors);
            let why = Codec::from_released(&file(&tensors)).unwrap_err();
            assert!(why.contains(part), "{why}");
        };
        refused(&|t| t.retain(|t| !t.0.contains("running")), "`encoder.1` is neither");
        refused(&|t| t.retain(|t| t.0 != "encoder.1.running_var"), "`encoder.1.running_var`");
        refused(&|t| t.retain(|t| t.0 != "decoder.2.bias"), "`decoder.2.bias`");
        refused(&|t| t.retain(|t| !t.0.starts_with("decoder")), "no decoder");
        refused(&|t| t[0].2[0] = f32::NAN, "not finite");
        let longer = |t: &mut Tensors| t[2..6].iter_mut().for_each(|t| (t.1[0], t.2) = (5, vec![1.0; 5]));
        refused(&longer, "does not fit the 4 numbers");
        assert!(Codec::from_released(b"PK").unwrap_err().contains("safetensors"));
    }
}
