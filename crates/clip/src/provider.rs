//! The processor or accelerator that ONNX Runtime computes on; accelerators need a library that was built
//! for them.

use ort::ep::{CUDA, CoreML, DirectML, ExecutionProvider, ExecutionProviderDispatch};
use std::sync::OnceLock;
use surgtpgs_core::{Error, Result};

/// An execution provider of ONNX Runtime.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Provider {
    /// The processor.
    #[default]
    Cpu,
    /// NVIDIA's CUDA.
    Cuda,
    /// DirectML of Windows.
    DirectMl,
    /// Core ML of Apple.
    CoreMl,
}

static CHOSEN: OnceLock<Provider> = OnceLock::new();

/// Makes every model of this process use `provider`; only the first call has an effect.
pub(crate) fn choose(provider: Provider) {
    CHOSEN.get_or_init(|| provider);
}

/// The provider in use.
pub(crate) fn chosen() -> Provider {
    CHOSEN.get().copied().unwrap_or_default()
}

impl Provider {
    /// Its name in words.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Cpu => "the processor",
            Self::Cuda => "CUDA",
            Self::DirectMl => "DirectML",
            Self::CoreMl => "CoreML",
        }
    }

    /// Provider for a session; operations that it does not know are left to the processor.
    pub(crate) fn dispatch(self) -> Option<ExecutionProviderDispatch> {
        let provider = match self {
            Self::Cpu => return None,
            Self::Cuda => CUDA::default().build(),
            Self::DirectMl => DirectML::default().build(),
            Self::CoreMl => CoreML::default().build(),
        };
        Some(provider.error_on_failure())
    }

    /// Returns `true` if the library that is loaded has it.
    pub(crate) fn is_in_library(self) -> bool {
        match self {
            Self::Cpu => true,
            Self::Cuda => CUDA::is_available().unwrap_or(false),
            Self::DirectMl => DirectML::is_available().unwrap_or(false),
            Self::CoreMl => CoreML::is_available().unwrap_or(false),
        }
    }

    /// Fails with what would have it, unless `has_it`.
    pub(crate) fn require(self, has_it: bool, backend: &str) -> Result<()> {
        let package = match self {
            _ if has_it => return Ok(()),
            Self::Cpu | Self::Cuda => "one built for CUDA (the Python package onnxruntime-gpu holds it)",
            Self::DirectMl => "one built for DirectML (the Python package onnxruntime-directml holds it)",
            Self::CoreMl => "Apple's (the Python package onnxruntime for macOS holds it)",
        };
        Err(Error::Missing {
            what: format!("Models were to run on {}, which {backend} does not have", self.name()),
            hint: format!(
                "Set ORT_DYLIB_PATH to an ONNX Runtime library, {package}, or leave the choice out"
            )
            .into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_provider_is_named_with_what_would_have_it() {
        assert!(Provider::Cuda.require(true, "ONNX Runtime 1.31").is_ok());
        for (provider, package) in [
            (Provider::Cuda, "onnxruntime-gpu"),
            (Provider::DirectMl, "onnxruntime-directml"),
            (Provider::CoreMl, "onnxruntime for macOS"),
        ] {
            let error = provider.require(false, "tract (built in)").unwrap_err();
            assert!(matches!(error, Error::Missing { .. }));
            let error = error.to_string();
            assert!(
                error.contains("which tract (built in) does not have") && error.contains(package),
                "{error}"
            );
        }
    }
}
