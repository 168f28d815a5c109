//! Models that run on ONNX Runtime's shared library.

use crate::{
    model_source::ModelSource,
    provider,
    tensor::{Element, Input, Outlet, Outputs, Value},
};
use ort::{
    Error,
    environment::Environment,
    session::{Session, SessionInputValue, builder::GraphOptimizationLevel},
    value::{Tensor, TensorElementType},
};

/// A loaded model.
pub(crate) struct Library {
    session: Session,
    pub inputs: Vec<Outlet>,
    pub outputs: Vec<Outlet>,
}

impl Library {
    /// Loads a model to run on `threads` threads.
    pub(crate) fn open(
        source: &ModelSource,
        threads: usize,
        environment: &Environment,
    ) -> Result<Self, Error> {
        let mut builder =
            Session::builder(environment)?.with_optimization_level(GraphOptimizationLevel::Level3)?;
        builder = builder.with_intra_threads(threads).unwrap_or_else(|e| e.recover());
        if let Some(provider) = provider::chosen().dispatch() {
            builder = builder.with_execution_providers([provider])?;
        }
        let session = match source {
            ModelSource::File(file) => builder.commit_from_file(file)?,
            ModelSource::Memory(bytes) => builder.commit_from_memory(bytes)?,
        };
        let outlets = |all: &[ort::value::Outlet]| all.iter().map(outlet).collect();
        let (inputs, outputs) = (outlets(session.inputs()), outlets(session.outputs()));
        Ok(Self { session, inputs, outputs })
    }

    /// Runs the model once.
    pub(crate) fn run(&mut self, inputs: Vec<(&str, Input<'_>)>) -> Result<Outputs, Error> {
        let mut named = Vec::with_capacity(inputs.len());
        for (name, input) in inputs {
            let value: SessionInputValue<'_> = match input {
                Input::F32(axes, values) => Tensor::from_array((axes, values))?.into(),
                Input::I32(axes, values) => Tensor::from_array((axes, values))?.into(),
                Input::I64(axes, values) => Tensor::from_array((axes, values))?.into(),
                Input::Given(Value::Library(value)) => value.into(),
                Input::Given(Value::Tract(_)) => return Err(Error::new("a value of another backend")),
            };
            named.push((name, value));
        }
        let outputs = self.session.run(named)?;
        Ok(outputs.into_iter().map(|(name, value)| (name.to_owned(), Value::Library(value))).collect())
    }
}

fn outlet(outlet: &ort::value::Outlet) -> Outlet {
    let element = match outlet.dtype().tensor_type() {
        Some(TensorElementType::Float32) => Element::F32,
        Some(TensorElementType::Int32) => Element::I32,
        Some(TensorElementType::Int64) => Element::I64,
        _ => Element::Other,
    };
    let shape = outlet.dtype().tensor_shape().map(|shape| shape.to_vec()).unwrap_or_default();
    Outlet { name: outlet.name().to_owned(), element, shape }
}
