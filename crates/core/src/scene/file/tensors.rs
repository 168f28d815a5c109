//! Collects and writes named tensors, looks them up and checks them.

use super::compact::{self, Steps};
use crate::{Error, Result, scene::Problem};
use half::f16;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use sha2::{Digest, Sha256};
use std::{cell::Cell, collections::HashMap};

/// Largest number of basis functions; more are taken for damage.
pub(super) const MOST_PLAUSIBLE_BASES: usize = 1024;

/// Tensors that are collected for writing.
pub(super) struct Writer {
    tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)>,
    /// Rounding steps of tensors; `None` forbids rounding.
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

    /// Adds values whose first axis is time. If rounding is allowed, their cosine transform
    /// over time is stored.
    pub(super) fn over_time(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        if self.steps.is_none() || values.is_empty() {
            return self.f32(name, shape, values);
        }
        let matrix = compact::cosines(shape[0]);
        self.raw_f32(&format!("{name}.mix"), &[shape[0]; 2], &compact::transposed(&matrix, shape[0]));
        let mut mixed = values.to_vec();
        compact::mix(&matrix, shape[0], &mut mixed);
        self.f32(name, shape, &mixed);
    }

    /// Adds weights of a network: in half precision if rounding is allowed.
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

    /// Returns the bytes of the file, with `metadata` under `key`.
    pub(super) fn finish(self, key: &str, metadata: String) -> Result<Vec<u8>> {
        let metadata = HashMap::from([(key.to_owned(), metadata)]);
        safetensors::serialize(self.views()?, Some(metadata)).map_err(not_written)
    }

    /// Returns the SHA-256 over all tensors so far, hexadecimal.
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

/// Returns the SHA-256 over names, kinds, shapes and values, hexadecimal, independent of their
/// order in the file.
fn checksum(mut tensors: Vec<(impl AsRef<str> + Ord, TensorView<'_>)>) -> String {
    tensors.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut hash = Sha256::new();
    for (name, view) in &tensors {
        hash.update(format!("{} {:?} {:?}\n", name.as_ref(), view.dtype(), view.shape()));
        hash.update(view.data());
    }
    format!("{:x}", hash.finalize())
}

/// Number of values that a file of any size may hold beyond its own bytes.
const FREE_VALUES: usize = 1 << 24;
/// Number of further values that it may hold for each of its bytes. The demo's quantised scene has 2.6.
/// A scene with little motion has tens, as bases are kept for all Gaussians in memory. Deflated zeros
/// could reach 258.
const VALUES_PER_BYTE: usize = 64;

/// Tensors of a file.
pub(super) struct Reader<'a> {
    tensors: SafeTensors<'a>,
    /// Number of values that may still be made from deflated or left-out data: memory is at most 64 MB
    /// and 256 times the file.
    left: Cell<usize>,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self, safetensors::SafeTensorError> {
        let left = bytes.len().saturating_mul(VALUES_PER_BYTE).saturating_add(FREE_VALUES);
        Ok(Self { tensors: SafeTensors::deserialize(bytes)?, left: Cell::new(left) })
    }

    /// Reserves memory for an array of this shape that the file does not hold in this form;
    /// returns its length.
    pub(super) fn set_aside(&self, name: &str, shape: &[usize]) -> Result<usize, Problem> {
        let len = shape.iter().try_fold(1_usize, |len, n| len.checked_mul(*n));
        let left = len.and_then(|len| self.left.get().checked_sub(len));
        match (len, left) {
            (Some(len), Some(left)) => {
                self.left.set(left);
                Ok(len)
            }
            _ => Err(format!("tensor `{name}` is said to be {shape:?}, more than a file of this size holds")),
        }
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// Returns the number of axes of a tensor, however it is stored; `None` if it does not exist.
    pub(super) fn rank(&self, name: &str) -> Option<usize> {
        match self.tensors.tensor(&format!("{name}.shape")) {
            Ok(shape) => shape.shape().first().copied(),
            Err(_) => self.tensors.tensor(name).ok().map(|t| t.shape().len()),
        }
    }

    /// Returns all tensors.
    pub(super) fn tensors(&self) -> Vec<(String, TensorView<'_>)> {
        self.tensors.tensors()
    }

    /// Returns the same hash as [`Writer::checksum`].
    pub(super) fn checksum(&self) -> String {
        checksum(self.tensors())
    }

    /// Returns the values and shape of a tensor of finite numbers with `rank` dimensions,
    /// however it is stored.
    pub(super) fn f32(&self, name: &str, rank: usize) -> Result<(Vec<usize>, Vec<f32>), Problem> {
        let is_packed = self.has(&format!("{name}.shape"));
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
        let len = self.set_aside(name, &shape)?;
        let mut values = compact::unpack(self.view(name)?.data(), len, &step, &offset)
            .map_err(|what| format!("tensor `{name}` is damaged: {what}"))?;
        let mix = format!("{name}.mix");
        if !self.has(&mix) {
            return Ok((shape, values));
        }
        let (size, matrix) = self.plain(&mix)?;
        match (&shape[..], &size[..]) {
            ([n, ..], [a, b]) if a == n && b == n && *n <= MOST_PLAUSIBLE_BASES => {
                compact::mix(&matrix, *n, &mut values);
                Ok((shape, values))
            }
            _ => Err(format!("tensor `{mix}` is {size:?} for values of {shape:?}")),
        }
    }

    pub(super) fn view(&self, name: &str) -> Result<TensorView<'_>, Problem> {
        self.tensors.tensor(name).map_err(|_| format!("the scene file lacks the tensor `{name}`"))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_file_does_not_become_large() {
        const VALUES: [f32; 6] = [1.0, -1.0, 0.5, 0.0, 2.0, 1.0];
        let file = |shape: &[u32]| {
            let mut w = Writer::new(None);
            w.raw_f32("a.step", &[1], &[0.5]);
            w.raw_f32("a.offset", &[1], &[0.0]);
            w.u32("a.shape", shape);
            // Values of both signs, so that the offset is 0.
            let packed = compact::pack(&VALUES, &[0.5]).bytes;
            w.bytes("a", &[packed.len()], packed);
            w.finish("key", String::new()).unwrap()
        };
        let read = |shape: &[u32]| Reader::new(&file(shape)).unwrap().f32("a", shape.len());
        assert_eq!(read(&[2, 3]).unwrap(), (vec![2, 3], VALUES.to_vec()));
        for shape in [&[1 << 15, 1 << 15][..], &[u32::MAX; 4]] {
            let what = read(shape).unwrap_err();
            assert!(what.contains("more than a file of this size holds"), "{what}");
        }
        let bytes = file(&[2, 3]);
        let reader = Reader::new(&bytes).unwrap();
        assert_eq!((reader.rank("a"), reader.rank("a.step"), reader.rank("b")), (Some(2), Some(1), None));
        // The limit holds for all arrays together, not for each.
        assert!(reader.set_aside("a", &[FREE_VALUES]).is_ok());
        assert!(reader.set_aside("b", &[FREE_VALUES]).is_err());
    }
}
