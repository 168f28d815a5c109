//! Named tensors: collected and written, looked up and checked.

use super::{
    Problem,
    compact::{self, Steps},
};
use crate::{Error, Result};
use half::f16;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use sha2::{Digest, Sha256};
use std::collections::HashMap;

/// Tensors being collected for writing.
pub(super) struct Writer {
    tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)>,
    /// What may be rounded to what; nothing if `None`.
    steps: Option<Steps>,
}

impl Writer {
    pub(super) fn new(steps: Option<Steps>) -> Self {
        Self { tensors: Vec::new(), steps }
    }

    pub(super) fn f32(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        match self.steps.as_ref().and_then(|s| s.of(name)).map(<[f32]>::to_vec) {
            Some(steps) if !values.is_empty() => {
                let packed = compact::pack(values, &steps);
                self.raw_f32(&format!("{name}.step"), &[steps.len()], &steps);
                self.raw_f32(&format!("{name}.offset"), &[steps.len()], &packed.offsets);
                self.u32(&format!("{name}.shape"), &Vec::from_iter(shape.iter().map(|&n| n as u32)));
                self.bytes(name, &[packed.bytes.len()], packed.bytes);
            }
            _ => self.raw_f32(name, shape, values),
        }
    }

    /// Values whose first axis is time: where rounding is allowed, by what they are made of over time.
    pub(super) fn over_time(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        if self.steps.is_none() || values.is_empty() {
            return self.f32(name, shape, values);
        }
        let matrix = compact::cosines(shape[0]);
        self.raw_f32(&format!("{name}.mix"), &[shape[0]; 2], &compact::transposed(&matrix, shape[0]));
        self.f32(name, shape, &compact::mixed(&matrix, shape[0], values));
    }

    /// Weights of a network: in half precision where rounding is allowed.
    pub(super) fn network(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        if self.steps.is_none() {
            return self.raw_f32(name, shape, values);
        }
        let bytes = values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        self.tensors.push((name.to_owned(), Dtype::F16, shape.to_vec(), bytes));
    }

    fn raw_f32(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.tensors.push((name.to_owned(), Dtype::F32, shape.to_vec(), bytes));
    }

    pub(super) fn u32(&mut self, name: &str, values: &[u32]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.tensors.push((name.to_owned(), Dtype::U32, vec![values.len()], bytes));
    }

    pub(super) fn bytes(&mut self, name: &str, shape: &[usize], bytes: Vec<u8>) {
        self.tensors.push((name.to_owned(), Dtype::U8, shape.to_vec(), bytes));
    }

    /// The file, with `metadata` under `key`.
    pub(super) fn finish(self, key: &str, metadata: String) -> Result<Vec<u8>> {
        let metadata = HashMap::from([(key.to_owned(), metadata)]);
        safetensors::serialize(self.views()?, Some(metadata)).map_err(not_written)
    }

    /// SHA-256 over all tensors so far, hexadecimal.
    pub(super) fn checksum(&self) -> Result<String> {
        Ok(checksum(self.views()?))
    }

    fn views(&self) -> Result<Vec<(&str, TensorView<'_>)>> {
        let views = self.tensors.iter().map(|(name, dtype, shape, bytes)| {
            TensorView::new(*dtype, shape.clone(), bytes).map(|view| (name.as_str(), view))
        });
        views.collect::<Result<_, _>>().map_err(not_written)
    }
}

fn not_written(e: safetensors::SafeTensorError) -> Error {
    Error::input(format!("the scene could not be written: {e}"), "")
}

/// SHA-256 over names, kinds, shapes and values, hexadecimal; in whatever order they lie.
fn checksum(mut tensors: Vec<(impl AsRef<str> + Ord, TensorView<'_>)>) -> String {
    tensors.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut hash = Sha256::new();
    for (name, view) in &tensors {
        hash.update(format!("{} {:?} {:?}\n", name.as_ref(), view.dtype(), view.shape()));
        hash.update(view.data());
    }
    format!("{:x}", hash.finalize())
}

/// Tensors of a file.
pub(super) struct Reader<'a>(pub(super) SafeTensors<'a>);

impl Reader<'_> {
    /// As [`Writer::checksum`].
    pub(super) fn checksum(&self) -> String {
        checksum(self.0.tensors())
    }

    /// The values and shape of a tensor of finite numbers with as many dimensions as `rank`, however it is stored.
    pub(super) fn f32(&self, name: &str, rank: usize) -> Result<(Vec<usize>, Vec<f32>), Problem> {
        let is_packed = self.0.tensor(&format!("{name}.shape")).is_ok();
        let (shape, values) = if is_packed { self.packed(name)? } else { self.plain(name)? };
        if shape.len() != rank {
            return Err(format!("tensor `{name}` should be {rank}-dimensional, but is {shape:?}"));
        }
        if let Some(bad) = values.iter().position(|v| !v.is_finite()) {
            return Err(format!("tensor `{name}` has a value that is not a number at position {bad}"));
        }
        Ok((shape, values))
    }

    fn plain(&self, name: &str) -> Result<(Vec<usize>, Vec<f32>), Problem> {
        let view = self.view(name)?;
        let data = view.data();
        let values = match view.dtype() {
            Dtype::F32 => data.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            Dtype::F16 => data.as_chunks::<2>().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect(),
            other => return Err(format!("tensor `{name}` should be F32 or F16, but is {other:?}")),
        };
        Ok((view.shape().to_vec(), values))
    }

    fn packed(&self, name: &str) -> Result<(Vec<usize>, Vec<f32>), Problem> {
        let shape: Vec<usize> = self.u32(&format!("{name}.shape"))?.into_iter().map(|n| n as usize).collect();
        let (step, offset) =
            (self.plain(&format!("{name}.step"))?.1, self.plain(&format!("{name}.offset"))?.1);
        let len = shape.iter().try_fold(1_usize, |len, n| len.checked_mul(*n));
        let len = len.ok_or_else(|| format!("tensor `{name}` is said to be {shape:?}"))?;
        let values = compact::unpack(self.view(name)?.data(), len, &step, &offset)
            .map_err(|what| format!("tensor `{name}` is damaged: {what}"))?;
        let mix = format!("{name}.mix");
        if self.0.tensor(&mix).is_err() {
            return Ok((shape, values));
        }
        let (size, matrix) = self.plain(&mix)?;
        match (&shape[..], &size[..]) {
            ([n, ..], [a, b]) if a == n && b == n => {
                Ok((shape.clone(), compact::mixed(&matrix, *n, &values)))
            }
            _ => Err(format!("tensor `{mix}` is {size:?} for values of {shape:?}")),
        }
    }

    pub(super) fn view(&self, name: &str) -> Result<TensorView<'_>, Problem> {
        self.0.tensor(name).map_err(|_| format!("the scene file lacks the tensor `{name}`"))
    }

    pub(super) fn u32(&self, name: &str) -> Result<Vec<u32>, Problem> {
        let view = self.view(name)?;
        if view.dtype() != Dtype::U32 || view.shape().len() != 1 {
            return Err(format!("tensor `{name}` should be one-dimensional U32"));
        }
        Ok(view.data().as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)).collect())
    }

    pub(super) fn shaped(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, Problem> {
        let (found, values) = self.f32(name, shape.len())?;
        if found == shape {
            Ok(values)
        } else {
            Err(format!("tensor `{name}` should be {shape:?}, but is {found:?}"))
        }
    }

    pub(super) fn rows<const C: usize>(&self, name: &str, n: usize) -> Result<Vec<[f32; C]>, Problem> {
        let values = self.shaped(name, &[n, C])?;
        Ok(values.as_chunks::<C>().0.to_vec())
    }
}
