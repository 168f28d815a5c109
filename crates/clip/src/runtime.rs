//! The backend that runs the models: ONNX Runtime if its shared library is found, else tract (pure Rust,
//! always there). There is one per process, chosen when the first model is opened.

use crate::{
    library::Library,
    model_source::ModelSource,
    network::Network,
    onnx::ModelProto,
    operators,
    provider::{self, Provider},
    tensor::short,
    tract::Tract,
};
use ort::environment::Environment;
use prost::Message;
use std::{
    path::{Path, PathBuf},
    sync::OnceLock,
};
use surgtpgs_core::{
    Error, Result,
    reading::{MOST_BYTES, read_regular},
};

/// File names of ONNX Runtime's shared library on this system.
#[cfg(target_os = "windows")]
const LIBRARY_NAMES: &[&str] = &["onnxruntime.dll"];
#[cfg(target_os = "macos")]
const LIBRARY_NAMES: &[&str] = &["libonnxruntime.dylib", "libonnxruntime.1.dylib"];
#[cfg(not(any(target_os = "windows", target_os = "macos")))]
const LIBRARY_NAMES: &[&str] = &["libonnxruntime.so", "libonnxruntime.so.1"];

struct Runtime {
    /// Environment of ONNX Runtime, if its library is used.
    library: Option<Environment>,
    name: String,
    notes: Vec<String>,
}

/// Name of the backend, e.g. "ONNX Runtime 1.31 (/usr/lib/libonnxruntime.so)".
pub fn backend_name() -> &'static str {
    match runtime() {
        Ok(runtime) => &runtime.name,
        Err(_) => "none",
    }
}

/// Libraries that were found but not used, with the reasons; none before the first model is opened.
pub fn backend_notes() -> &'static [String] {
    match RUNTIME.get() {
        Some(Ok(runtime)) => &runtime.notes,
        _ => &[],
    }
}

/// Returns `true` if models run on ONNX Runtime, the only backend that reads its `.ort` format.
pub(crate) fn is_onnx_runtime() -> bool {
    runtime().is_ok_and(|runtime| runtime.library.is_some())
}

/// Makes every model of this process use `provider`; only the first call has an effect.
///
/// Fails if the library that runs models does not have it.
pub fn choose_provider(provider: Provider) -> Result<()> {
    if provider != Provider::Cpu {
        provider.require(is_onnx_runtime() && provider.is_in_library(), backend_name())?;
    }
    provider::choose(provider);
    Ok(())
}

/// Number of cores.
pub(crate) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, |n| n.get())
}

/// Loads a model to run on `threads` threads (the built-in backend has one). `path` is only named in errors.
pub(crate) fn open(source: &ModelSource, threads: usize, path: &Path) -> Result<Network> {
    let loaded = match &runtime()?.library {
        Some(environment) => Library::open(source, threads, environment)
            .map(Network::Library)
            .map_err(|e| e.message().to_owned()),
        None => Tract::open(source).map(Network::Tract),
    };
    loaded.map_err(|cause| {
        if let Some((what, hint)) = about_operators(source, &cause) {
            return Error::input_at(path, what, hint);
        }
        let what = format!("{} could not load the model ({})", backend_name(), short(&cause));
        let hint = "Export it with ordinary ONNX operators, or set ORT_DYLIB_PATH to a newer ONNX Runtime.";
        Error::input_at(path, what, hint)
    })
}

/// Explains a refusal, if it is about the model's operators.
fn about_operators(source: &ModelSource, message: &str) -> Option<(String, &'static str)> {
    let model = match source {
        ModelSource::File(file) => ModelProto::decode(&read_regular(file, MOST_BYTES).ok()?[..]),
        ModelSource::Memory(bytes) => ModelProto::decode(*bytes),
    };
    operators::explain(&model.ok()?, message, backend_name())
}

/// The backend, once it was started.
static RUNTIME: OnceLock<Result<Runtime, String>> = OnceLock::new();

fn runtime() -> Result<&'static Runtime> {
    RUNTIME.get_or_init(start).as_ref().map_err(|cause| Error::Missing {
        what: format!("Text prompts and models are off: no ONNX backend could be started ({cause})"),
        hint: "Viewing and exports still work. Unset ORT_DYLIB_PATH to use the built-in backend".into(),
    })
}

fn start() -> Result<Runtime, String> {
    let (found, mut notes) = choose(&candidates(), |path| ort::util::probe(path));
    if let Some((path, minor)) = found {
        match start_library(&path) {
            Ok(environment) => {
                let name = format!("ONNX Runtime 1.{minor} ({})", path.display());
                return Ok(Runtime { library: Some(environment), name, notes });
            }
            // ort takes no other backend once a library is bound to the process.
            Err(Started::AfterBinding(cause)) => return Err(format!("{}: {cause}", path.display())),
            Err(Started::BeforeBinding(cause)) => {
                notes.push(format!("{} could not be started ({cause}) and was not used", path.display()))
            }
        }
    }
    Ok(Runtime { library: None, name: "tract (built in)".into(), notes })
}

enum Started {
    BeforeBinding(String),
    AfterBinding(String),
}

fn start_library(path: &Path) -> Result<Environment, Started> {
    let builder = ort::init_from(path).map_err(|e| Started::BeforeBinding(e.to_string()))?;
    builder.with_name("surgtpgs").build().map_err(|e| Started::AfterBinding(e.to_string()))
}

/// Possible paths of the library, in order of preference: the user's choice, beside the program, the system.
fn candidates() -> Vec<PathBuf> {
    let named = std::env::var_os("ORT_DYLIB_PATH").filter(|p| !p.is_empty()).map(PathBuf::from);
    let program_folder = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.to_owned()));
    let mut candidates = Vec::new();
    match named {
        Some(folder) if folder.is_dir() => {
            candidates.extend(LIBRARY_NAMES.iter().map(|name| folder.join(name)))
        }
        Some(file) => candidates.push(file),
        None => {}
    }
    if let Some(folder) = program_folder {
        candidates.extend(LIBRARY_NAMES.iter().map(|name| folder.join(name)).filter(|path| path.exists()));
    }
    candidates.extend(LIBRARY_NAMES.iter().map(PathBuf::from));
    candidates
}

/// Chooses the first library that is new enough. Returns it with its minor version, and notes on those
/// that were passed over. Libraries are probed first because ort 2.0.0-rc.14 must not be asked to load
/// twice: after a failure the second attempt "succeeds" with an uninitialised handle.
fn choose(
    candidates: &[PathBuf],
    probe: impl Fn(&Path) -> Option<u32>,
) -> (Option<(PathBuf, u32)>, Vec<String>) {
    let mut notes = Vec::new();
    for path in candidates {
        match probe(path) {
            Some(minor) if minor >= ort::MINOR_VERSION => return (Some((path.clone(), minor)), notes),
            Some(minor) => notes.push(format!(
                "{} is ONNX Runtime 1.{minor}, too old (1.{} or newer is needed), and was not used",
                path.display(),
                ort::MINOR_VERSION
            )),
            // A bare name that the system does not know is the ordinary case and gets no note.
            None if path.components().count() > 1 => {
                notes.push(format!("{} is not a loadable ONNX Runtime and was not used", path.display()))
            }
            None => {}
        }
    }
    (None, notes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_and_broken_libraries_are_passed_over_with_a_note() {
        let paths = ["/opt/broken.so", "/opt/old.so", "libonnxruntime.so", "/opt/new.so"].map(PathBuf::from);
        let (found, notes) = choose(&paths, |path| match path.to_str() {
            Some("/opt/old.so") => Some(20),
            Some("/opt/new.so") => Some(ort::MINOR_VERSION),
            _ => None,
        });
        assert_eq!(found, Some((PathBuf::from("/opt/new.so"), ort::MINOR_VERSION)));
        assert_eq!(notes.len(), 2, "{notes:?}");
        assert!(notes[0].contains("broken.so is not a loadable ONNX Runtime"), "{notes:?}");
        assert!(notes[1].contains("1.20, too old"), "{notes:?}");
    }

    #[test]
    fn no_library_gives_nothing_to_say() {
        assert_eq!(choose(&["libonnxruntime.so".into()], |_| None), (None, vec![]));
    }

    #[test]
    fn the_processor_is_always_there() {
        choose_provider(Provider::Cpu).unwrap();
        assert_eq!(provider::chosen(), Provider::Cpu);
        assert!(provider::chosen().dispatch().is_none());
    }

    #[test]
    fn there_is_always_a_backend() {
        assert_ne!(backend_name(), "none");
    }
}
