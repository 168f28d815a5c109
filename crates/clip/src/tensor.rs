//! Inputs and outputs of models, independent of the backend that runs them.

use ort::value::DynValue;
use std::collections::BTreeMap;

/// Hint for a model that gives numbers that are not finite.
pub(crate) const NOT_FINITE: &str =
    "The model file may be damaged, or its precision too low; try a float32 export.";

/// Returns the first line of a backend's message, which can be pages long.
pub(crate) fn short(message: &str) -> String {
    let line = message.lines().next().unwrap_or_default().trim_end_matches('.');
    line.chars().take(200).collect()
}

/// Type of a tensor's elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Element {
    F32,
    I32,
    I64,
    /// Anything else, or no tensor at all.
    Other,
}

/// An input or output of a model.
#[derive(Clone, Debug)]
pub(crate) struct Outlet {
    pub name: String,
    pub element: Element,
    /// Length of each axis; -1 if an axis has any length. Empty if nothing is known.
    pub shape: Vec<i64>,
}

impl Outlet {
    /// Returns `true` if it holds whole numbers.
    pub(crate) fn is_integer(&self) -> bool {
        matches!(self.element, Element::I32 | Element::I64)
    }
}

/// Value for an input: axes and numbers, or an output of another model.
pub(crate) enum Input<'a> {
    F32(Vec<usize>, Vec<f32>),
    I32(Vec<usize>, Vec<i32>),
    I64(Vec<usize>, Vec<i64>),
    Given(&'a Value),
}

impl Input<'_> {
    /// Converts the numbers to the type that the input takes. Other types than those above are left for
    /// the backend to refuse.
    pub(crate) fn fitted(self, element: Element) -> Self {
        match (self, element) {
            (Self::F32(axes, values), Element::I32) => {
                Self::I32(axes, values.iter().map(|v| *v as i32).collect())
            }
            (Self::F32(axes, values), Element::I64) => {
                Self::I64(axes, values.iter().map(|v| *v as i64).collect())
            }
            (Self::I64(axes, values), Element::I32) => {
                Self::I32(axes, values.iter().map(|v| *v as i32).collect())
            }
            (other, _) => other,
        }
    }
}

/// An output of a model, in the form of its backend.
pub(crate) enum Value {
    Library(DynValue),
    Tract(tract_onnx::prelude::Tensor),
}

/// All outputs of a run, by name.
pub(crate) type Outputs = BTreeMap<String, Value>;

impl Value {
    /// Axes and values; the error says why they cannot be read.
    pub(crate) fn floats(&self) -> Result<(Vec<usize>, &[f32]), String> {
        match self {
            Self::Library(value) => {
                let (shape, values) = value.try_extract_tensor::<f32>().map_err(|e| short(e.message()))?;
                Ok((shape.iter().map(|n| usize::try_from(*n).unwrap_or(0)).collect(), values))
            }
            Self::Tract(tensor) => {
                let values = tensor.try_as_plain_ram().and_then(|plain| plain.as_slice());
                Ok((tensor.shape().to_vec(), values.map_err(|e| short(&e.to_string()))?))
            }
        }
    }
}

/// Axes and values of one output of a run.
pub(crate) fn floats<'a>(outputs: &'a Outputs, name: &str) -> Result<(Vec<usize>, &'a [f32]), String> {
    outputs.get(name).ok_or_else(|| format!("the output `{name}` is missing"))?.floats()
}
