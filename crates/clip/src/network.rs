//! A loaded model, independent of its backend: its inputs, its outputs, and a run.

use crate::{
    library::Library,
    tensor::{Element, Input, Outlet, Outputs, short},
    tract::Tract,
};

/// A model that can be run.
pub(crate) enum Network {
    /// Runs on ONNX Runtime.
    Library(Library),
    /// Runs on the backend inside the program.
    Tract(Tract),
}

impl Network {
    pub(crate) fn inputs(&self) -> &[Outlet] {
        match self {
            Self::Library(library) => &library.inputs,
            Self::Tract(tract) => &tract.inputs,
        }
    }

    pub(crate) fn outputs(&self) -> &[Outlet] {
        match self {
            Self::Library(library) => &library.outputs,
            Self::Tract(tract) => &tract.outputs,
        }
    }

    /// Runs the model on named inputs and returns its outputs. Numbers are converted to the type that
    /// each input takes. The error is the beginning of the backend's message.
    pub(crate) fn run(&mut self, inputs: Vec<(&str, Input<'_>)>) -> Result<Outputs, String> {
        let element = |name: &str| {
            let outlet = self.inputs().iter().find(|outlet| outlet.name == name);
            outlet.map_or(Element::Other, |outlet| outlet.element)
        };
        let fitted = inputs.into_iter().map(|(name, input)| (name, input.fitted(element(name)))).collect();
        match self {
            Self::Library(library) => library.run(fitted).map_err(|e| short(e.message())),
            Self::Tract(tract) => tract.run(fitted).map_err(|e| short(&e)),
        }
    }
}
