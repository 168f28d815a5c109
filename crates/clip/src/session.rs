//! A model: token ids in, one unit embedding out.

use crate::{
    contract::{Contract, Role},
    model_source::ModelSource,
    network::Network,
    runtime,
    settings::Pooling,
    tensor::{Input, NOT_FINITE, floats},
};
use std::path::{Path, PathBuf};
use surgtpgs_core::{Error, Result};

/// Largest number of threads. Prompts are short: more threads gain little and take cores from the renderer.
const MAX_THREADS: usize = 2;

/// A network and its calling convention.
pub(crate) struct Model {
    /// Loaded when it is first needed. Texts whose embeddings are cached need no model.
    network: Option<Network>,
    source: ModelSource,
    /// Path of the model; only named in errors.
    path: PathBuf,
    contract: Contract,
    pad_id: u32,
    /// Longest text in tokens.
    context: usize,
}

impl Model {
    /// Makes a model from the contract that was read from the same bytes. `path` is only named in errors.
    pub(crate) fn new(
        source: ModelSource,
        contract: Contract,
        pad_id: u32,
        context: usize,
        path: &Path,
    ) -> Self {
        Self { network: None, source, path: path.to_owned(), contract, pad_id, context }
    }

    /// Longest text in tokens.
    pub(crate) fn context(&self) -> usize {
        self.context
    }

    /// Unit embedding of one text. `text` is only named in errors.
    pub(crate) fn embed(&mut self, ids: &[u32], text: &str) -> Result<Vec<f32>> {
        let failed = |cause: String| {
            let what = format!("The encoder failed on \"{text}\" ({cause})");
            Error::input_at(&self.path, what, "Model and tokenizer.json may not belong together.")
        };
        let inputs = inputs(&self.contract, ids, self.context, self.pad_id);
        let network = match &mut self.network {
            Some(network) => network,
            None => {
                let threads = runtime::cores().min(MAX_THREADS);
                self.network.insert(runtime::open(&self.source, threads, &self.path)?)
            }
        };
        let outputs = network.run(inputs).map_err(failed)?;
        let (shape, values) = floats(&outputs, &self.contract.output).map_err(failed)?;
        let pooled = pool(values, &shape, &self.contract.pooling, ids.len())
            .ok_or_else(|| failed(format!("output `{}` has the shape {shape:?}", self.contract.output)))?;
        unit(pooled, text, &self.path)
    }
}

/// Inputs of the model for the tokens `ids`.
fn inputs<'a>(
    contract: &'a Contract,
    ids: &[u32],
    context: usize,
    pad_id: u32,
) -> Vec<(&'a str, Input<'static>)> {
    let takes_mask = contract.inputs.iter().any(|input| input.role == Role::Mask);
    // A model with a mask input needs no padding. Without one it gets the length it was trained with.
    let length = contract.fixed_length.unwrap_or(if takes_mask { ids.len() } else { context });
    let value_at = |role: Role, i: usize| match (role, ids.get(i)) {
        (Role::Ids, id) => i64::from(id.copied().unwrap_or(pad_id)),
        (Role::Mask, id) => i64::from(id.is_some()),
        (Role::TokenTypes, _) => 0,
        (Role::Positions, _) => i as i64,
    };
    let input = |input: &'a crate::contract::Input| {
        let values = (0..length).map(|i| value_at(input.role, i)).collect();
        (input.name.as_str(), Input::I64(vec![1, length], values))
    };
    contract.inputs.iter().map(input).collect()
}

/// Reduces an output `[1,dim]` or `[1,tokens,dim]` to one row; `None` for any other shape.
fn pool(values: &[f32], shape: &[usize], pooling: &Pooling, num_real: usize) -> Option<Vec<f32>> {
    let dim = shape.last().copied().filter(|dim| *dim > 0)?;
    match (shape, pooling) {
        ([1, _], _) => Some(values.to_vec()),
        ([1, _, _], Pooling::EndOfText) => {
            values.chunks_exact(dim).nth(num_real.checked_sub(1)?).map(<[f32]>::to_vec)
        }
        ([1, _, _], Pooling::Mean) => {
            let mut sum = vec![0.0; dim];
            for row in values.chunks_exact(dim).take(num_real) {
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
            }
            Some(sum)
        }
        _ => None,
    }
}

/// Scales to length 1. Computes in f64 so that no finite embedding overflows or vanishes.
fn unit(values: Vec<f32>, text: &str, path: &Path) -> Result<Vec<f32>> {
    if values.iter().any(|v| !v.is_finite()) {
        let what = format!("The encoder returned not-a-number for \"{text}\"");
        return Err(Error::input_at(path, what, NOT_FINITE));
    }
    let norm = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    if norm == 0.0 {
        let what = format!("The encoder returned an embedding of zeros for \"{text}\"");
        return Err(Error::input_at(path, what, "The model file may be damaged; export it again."));
    }
    Ok(values.into_iter().map(|v| (f64::from(v) / norm) as f32).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pooling_reads_real_tokens_only() {
        let values = [1.0, 2.0, 3.0, 4.0, 100.0, 100.0];
        assert_eq!(pool(&values, &[1, 3, 2], &Pooling::Mean, 2), Some(vec![4.0, 6.0]));
        assert_eq!(pool(&values, &[1, 3, 2], &Pooling::EndOfText, 2), Some(vec![3.0, 4.0]));
        assert_eq!(pool(&values, &[1, 6], &Pooling::Mean, 2), Some(values.to_vec()));
        assert_eq!(pool(&values, &[1, 3, 2], &Pooling::Output("x".into()), 2), None);
        assert_eq!(pool(&values, &[2, 3], &Pooling::Mean, 2), None);
        assert_eq!(pool(&[], &[1, 0], &Pooling::Mean, 2), None);
    }

    #[test]
    fn unit_refuses_what_has_no_direction() {
        let refused = |values: [f32; 2]| {
            unit(values.to_vec(), "liver", Path::new("model.onnx")).unwrap_err().to_string()
        };
        let message = refused([0.0, f32::NAN]);
        assert!(
            message.contains("not-a-number for \"liver\"") && message.contains("(model.onnx)"),
            "{message}"
        );
        assert!(refused([0.0, 0.0]).contains("zeros for \"liver\""));
        for scale in [1e30f32, 1e-30] {
            let [x, y] = unit(vec![3.0 * scale, 4.0 * scale], "liver", Path::new("m")).unwrap()[..] else {
                panic!("two values")
            };
            assert!((x - 0.6).abs() < 1e-6 && (y - 0.8).abs() < 1e-6);
        }
    }
}
