//! Parts of an engine that serve any scene.

use super::{BackendChoice, Engine, Machine};
use surgtpgs_clip::TextEncoder;
use surgtpgs_core::Result;

/// Machine that renders, and text encoder. To open a graphics device, or a network, takes longer than a
/// picture, so an engine may take over those of an earlier one.
pub(crate) struct Tools {
    pub(super) machine: Machine,
    /// `true` if the CPU stands in for a GPU that could not do the earlier engine's scene.
    pub(super) stands_in: bool,
    /// The text encoder, if words needed it.
    pub(super) encoder: Option<TextEncoder>,
}

impl Tools {
    /// Opens the machine of choice.
    pub(super) fn open(backend: BackendChoice) -> Result<Self> {
        Ok(Self { machine: Machine::open(backend)?, stands_in: false, encoder: None })
    }

    /// Returns `false` if the graphics device was lost, or could not do the earlier engine's scene.
    pub(super) fn work(&self) -> bool {
        self.machine.loss().is_none() && !self.stands_in
    }
}

impl Engine {
    /// Gives its tools away at its end. Pictures that are still asked for come from the CPU.
    pub(crate) fn give_tools(&mut self) -> Tools {
        let machine = std::mem::replace(&mut self.machine, Machine::Cpu(Box::default()));
        Tools { machine, stands_in: self.stands_in, encoder: self.asking.give_encoder() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{EngineOptions, Recorded, asking_tests::adapter};
    use std::sync::Arc;
    use surgtpgs_core::{raster::Renderer, stress};

    #[test]
    fn an_engine_takes_over_machine_and_encoder_of_an_earlier_one() {
        if adapter().is_none() {
            return;
        }
        let engine = |backend| {
            let options = EngineOptions { backend, ..EngineOptions::default() };
            Engine::new(Arc::new(stress::ordinary(5)), None, options).unwrap()
        };
        let mut earlier = engine(BackendChoice::Gpu);
        let name = earlier.machine.name();
        let tools = earlier.give_tools();
        assert!(tools.machine.is_gpu() && !earlier.machine.is_gpu());
        let options = EngineOptions { backend: BackendChoice::Cpu, ..EngineOptions::default() };
        let recording = Recorded::Missing(String::new());
        let later = Engine::with(earlier.scene.clone(), recording, options, Some(tools)).unwrap();
        assert_eq!(later.machine.name(), name);
    }
}
