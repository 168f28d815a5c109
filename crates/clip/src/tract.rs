//! Models that run on the backend inside the program: tract, on one thread. Its panics become errors.

use crate::{
    caught::caught,
    model_source::ModelSource,
    tensor::{Element, Input, Outlet, Outputs, Value},
};
use std::sync::Arc;
use tract_onnx::{
    model::ParseResult,
    prelude::*,
    tract_core::{model::IntoRunnable, plan::SimplePlan},
};

/// A model made ready to run.
pub(crate) struct Tract {
    plan: Arc<SimplePlan<TypedFact, Box<dyn TypedOp>>>,
    pub inputs: Vec<Outlet>,
    pub outputs: Vec<Outlet>,
}

impl Tract {
    /// Loads a model; the error is in tract's own words.
    pub(crate) fn open(source: &ModelSource) -> Result<Self, String> {
        caught(|| load(source))?.map_err(|e| e.to_string())
    }

    /// Runs the model once; every input is given once.
    pub(crate) fn run(&self, mut inputs: Vec<(&str, Input<'_>)>) -> Result<Outputs, String> {
        let in_order = |outlet: &Outlet| {
            let at = inputs.iter().position(|(name, _)| *name == outlet.name);
            tensor(inputs.swap_remove(at.ok_or_else(|| format!("`{}` is missing", outlet.name))?).1)
        };
        let tensors = self.inputs.iter().map(in_order).collect::<Result<_, _>>()?;
        let outputs = caught(|| self.plan.run(tensors))?.map_err(|e| e.to_string())?;
        let named = self.outputs.iter().map(|outlet| outlet.name.clone());
        Ok(named.zip(outputs.into_iter().map(|value| Value::Tract(value.into_tensor()))).collect())
    }
}

fn load(source: &ModelSource) -> TractResult<Tract> {
    let onnx = tract_onnx::onnx();
    let (proto, folder) = match source {
        ModelSource::File(file) => (onnx.proto_model_for_path(file)?, file.parent().and_then(|f| f.to_str())),
        ModelSource::Memory(bytes) => (onnx.proto_model_for_read(&mut &bytes[..])?, None),
    };
    let ParseResult { model, unresolved_inputs, .. } = onnx.parse(&proto, folder)?;
    if let Some(name) = unresolved_inputs.first() {
        return Err(TractError::msg(format!("nothing makes `{name}`")));
    }
    // The graph is three times slower before optimisation.
    let model = model.into_optimized()?;
    let mut inputs = Vec::new();
    for outlet in model.input_outlets()? {
        inputs.push(described(&model.node(outlet.node).name, model.outlet_fact(*outlet)?));
    }
    let names = proto.graph.iter().flat_map(|graph| &graph.output);
    let mut outputs = Vec::new();
    for (info, outlet) in names.zip(model.output_outlets()?) {
        outputs.push(described(&info.name, model.outlet_fact(*outlet)?));
    }
    Ok(Tract { inputs, outputs, plan: model.into_runnable()? })
}

fn described(name: &str, fact: &TypedFact) -> Outlet {
    let element = match fact.datum_type {
        DatumType::F32 => Element::F32,
        DatumType::I32 => Element::I32,
        DatumType::I64 => Element::I64,
        _ => Element::Other,
    };
    let axis = |length: &TDim| length.to_i64().unwrap_or(-1);
    Outlet { name: name.to_owned(), element, shape: fact.shape.iter().map(axis).collect() }
}

fn tensor(input: Input<'_>) -> Result<TValue, String> {
    let tensor = match input {
        Input::F32(axes, values) => Tensor::from_shape(&axes, &values),
        Input::I32(axes, values) => Tensor::from_shape(&axes, &values),
        Input::I64(axes, values) => Tensor::from_shape(&axes, &values),
        Input::Given(Value::Tract(tensor)) => Ok(tensor.clone()),
        Input::Given(Value::Library(_)) => Err(TractError::msg("a value of another backend")),
    };
    tensor.map(TValue::from).map_err(|e| e.to_string())
}
