//! A model: token ids in, one unit embedding out.

use crate::{
    contract::{Contract, Role},
    runtime::{self, Source, short},
    settings::Pooling,
};
use ort::{
    session::{Session, SessionInputValue},
    value::Tensor,
};
use std::path::{Path, PathBuf};
use surgtpgs_core::{Error, Result};

/// Prompts are short: more threads gain little and would take cores from the renderer.
const MAX_THREADS: usize = 2;

/// A session and how to call it.
pub(crate) struct Model {
    /// Loaded when it is first needed: texts that were embedded before need no model.
    session: Option<Session>,
    source: Source,
    /// Only named in errors.
    path: PathBuf,
    contract: Contract,
    pad_id: u32,
    /// Longest text in tokens.
    context: usize,
}

impl Model {
    /// A model whose contract was read from the same bytes. `path` is only named in errors.
    pub(crate) fn new(source: Source, contract: Contract, pad_id: u32, context: usize, path: &Path) -> Self {
        Self { session: None, source, path: path.to_owned(), contract, pad_id, context }
    }

    /// Longest text in tokens.
    pub(crate) fn context(&self) -> usize {
        self.context
    }

    /// The unit embedding of one text. `text` is only named in errors.
    pub(crate) fn embed(&mut self, ids: &[u32], text: &str) -> Result<Vec<f32>> {
        let failed = |cause: String| {
            let what = format!("The encoder failed on \"{text}\" ({})", short(&cause));
            Error::input(what, "Model and tokenizer.json may not belong together.")
        };
        let inputs = self.inputs(ids).map_err(|e| failed(e.to_string()))?;
        let session = match &mut self.session {
            Some(session) => session,
            None => {
                let threads = runtime::cores().min(MAX_THREADS);
                self.session.insert(runtime::open_session(&self.source, threads, &self.path)?)
            }
        };
        let outputs = session.run(inputs).map_err(|e| failed(e.to_string()))?;
        let output =
            outputs.get(&self.contract.output).ok_or_else(|| failed("the output is missing".into()))?;
        let (shape, values) = output.try_extract_tensor::<f32>().map_err(|e| failed(e.to_string()))?;
        let pooled = pool(values, shape, &self.contract.pooling, ids.len())
            .ok_or_else(|| failed(format!("output `{}` has the shape {shape:?}", self.contract.output)))?;
        unit(pooled, text)
    }

    fn inputs(&self, ids: &[u32]) -> Result<Vec<(String, SessionInputValue<'static>)>, ort::Error> {
        let takes_mask = self.contract.inputs.iter().any(|input| input.role == Role::Mask);
        // A model that is told what is padding needs none; one that is not gets the length it was trained with.
        let length = self.contract.fixed_length.unwrap_or(if takes_mask { ids.len() } else { self.context });
        let value_at = |role: Role, i: usize| match (role, ids.get(i)) {
            (Role::Ids, id) => i64::from(id.copied().unwrap_or(self.pad_id)),
            (Role::Mask, id) => i64::from(id.is_some()),
            (Role::TokenTypes, _) => 0,
            (Role::Positions, _) => i as i64,
        };
        let mut inputs = Vec::new();
        for input in &self.contract.inputs {
            let values = (0..length).map(|i| value_at(input.role, i));
            let tensor: SessionInputValue<'static> = match input.is_i32 {
                true => {
                    Tensor::from_array(([1, length], values.map(|v| v as i32).collect::<Vec<_>>()))?.into()
                }
                false => Tensor::from_array(([1, length], values.collect::<Vec<_>>()))?.into(),
            };
            inputs.push((input.name.clone(), tensor));
        }
        Ok(inputs)
    }
}

/// Reduces an output `[1,dim]` or `[1,tokens,dim]` to one row; `None` where the shape is another.
fn pool(values: &[f32], shape: &[i64], pooling: &Pooling, num_real: usize) -> Option<Vec<f32>> {
    let dim = usize::try_from(*shape.last()?).ok().filter(|dim| *dim > 0)?;
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

/// Scales to length 1; in f64 so that no finite embedding overflows or vanishes.
fn unit(values: Vec<f32>, text: &str) -> Result<Vec<f32>> {
    if values.iter().any(|v| !v.is_finite()) {
        let what = format!("The encoder returned not-a-number for \"{text}\"");
        return Err(Error::input(
            what,
            "The model file may be damaged, or its precision too low; try a float32 export.",
        ));
    }
    let norm = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    if norm == 0.0 {
        let what = format!("The encoder returned an embedding of zeros for \"{text}\"");
        return Err(Error::input(what, "The model file may be damaged; export it again."));
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
        assert!(
            unit(vec![0.0, f32::NAN], "liver")
                .unwrap_err()
                .to_string()
                .contains("not-a-number for \"liver\"")
        );
        assert!(unit(vec![0.0, 0.0], "liver").unwrap_err().to_string().contains("zeros for \"liver\""));
        for scale in [1e30f32, 1e-30] {
            let [x, y] = unit(vec![3.0 * scale, 4.0 * scale], "liver").unwrap()[..] else {
                panic!("two values")
            };
            assert!((x - 0.6).abs() < 1e-6 && (y - 0.8).abs() < 1e-6);
        }
    }
}
