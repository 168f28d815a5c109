//! Model files on disk: read whole, checked as far as possible without running them, and told apart by
//! content.

use crate::{
    model_source::ModelSource,
    network::Network,
    onnx::{GraphProto, ModelProto},
    operators::wrong_operator_set,
    runtime,
    tensor::Outlet,
};
use prost::{Message, bytes::Bytes};
use sha2::{Digest, Sha256};
use std::{
    collections::BTreeSet,
    io::ErrorKind,
    path::{Component, Path, PathBuf},
};
use surgtpgs_core::{
    Error, Result,
    reading::{MOST_BYTES, read_regular},
};

/// Endings of the names of model files.
const ENDINGS: [&str; 2] = ["onnx", "ort"];

/// A model, loaded.
pub(crate) struct ModelFile {
    pub path: PathBuf,
    pub network: Network,
    /// SHA-256 over the file and the weights beside it, hexadecimal.
    pub sha256: String,
}

impl ModelFile {
    /// Reads and checks an `.onnx` or `.ort` file and loads it to run on all cores.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let bytes = Bytes::from(read(path)?);
        let mut hash = Sha256::new();
        hash.update(&bytes);
        if is_ort_format(&bytes) {
            if !runtime::is_onnx_runtime() {
                return Err(Error::Missing {
                    what: format!(
                        "Models in ONNX Runtime's own format need its library, which was not found ({})",
                        path.display()
                    ),
                    hint: "Set ORT_DYLIB_PATH to it, or use the model's .onnx file".into(),
                });
            }
        } else {
            for file in external_files(&decode(bytes, path)?) {
                hash.update(read_beside(&file, path.parent(), path)?);
            }
        }
        let network = runtime::open(&ModelSource::File(path.to_owned()), runtime::cores(), path)?;
        Ok(Self { path: path.to_owned(), network, sha256: hex(hash) })
    }

    /// Model files of a folder, sorted by name.
    pub(crate) fn list(folder: &Path, what: &str, hint: &str) -> Result<Vec<PathBuf>> {
        if !folder.is_dir() {
            return Err(Error::input_at(folder, format!("There is no such folder with {what}"), hint));
        }
        let fail = |e| Error::io("list the folder", folder, e);
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
            let is_hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
            if ENDINGS.contains(&ending.as_str()) && !is_hidden && path.is_file() {
                files.push(path);
            }
        }
        files.sort();
        Ok(files)
    }
}

/// A hash in hexadecimal.
pub(crate) fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns `true` if the bytes are in ONNX Runtime's own format, which has this mark after the first four
/// bytes.
fn is_ort_format(bytes: &[u8]) -> bool {
    bytes.get(4..8) == Some(b"ORTM")
}

/// Decodes the graph of an ONNX file; for any other file the error says what is wrong.
pub(crate) fn decode(model: Bytes, path: &Path) -> Result<GraphProto> {
    let start: Vec<String> = model.iter().take(8).map(|b| format!("{b:02x}")).collect();
    let unreadable = |cause: &str, hint: &str| {
        let what =
            format!("This file is not a readable ONNX model: {cause} (first bytes {})", start.join(" "));
        Err(Error::input_at(path, what, hint))
    };
    let whole = "Download or export it again, and compare its size with the original's.";
    if model.is_empty() {
        return unreadable("it is empty", whole);
    }
    if model.starts_with(b"version https://git-lfs") {
        return unreadable("it is a Git LFS pointer", "Fetch the real file with `git lfs pull`.");
    }
    let Ok(model) = ModelProto::decode(model) else {
        return unreadable("it is of another kind or was cut short", whole);
    };
    if !model.graph.as_ref().is_some_and(|graph| model.ir_version > 0 && !graph.node.is_empty()) {
        return unreadable("it holds no graph", whole);
    }
    match wrong_operator_set(&model, !runtime::is_onnx_runtime()) {
        Some((what, hint)) => Err(Error::input_at(path, what, hint)),
        None => Ok(model.graph.unwrap_or_default()),
    }
}

/// Files beside the model that hold its weights.
pub(crate) fn external_files(graph: &GraphProto) -> Vec<String> {
    let entries = graph.initializer.iter().flat_map(|tensor| &tensor.external_data);
    let files: BTreeSet<_> = entries.filter(|e| e.key == "location").map(|e| e.value.clone()).collect();
    files.into_iter().collect()
}

/// Reads a file of a model's folder.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    read_regular(path, MOST_BYTES).map_err(|e| match e.kind() {
        ErrorKind::NotFound => {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            Error::input_at(path, format!("There is no {name}"), "The model's folder is incomplete.")
        }
        _ => Error::io("read the model", path, e),
    })
}

/// A weight file that the model names; only files in the same folder are opened.
pub(crate) fn read_beside(file: &str, folder: Option<&Path>, model_path: &Path) -> Result<Vec<u8>> {
    let relative = Path::new(file);
    match folder {
        Some(folder)
            if relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir)) =>
        {
            read(&folder.join(relative))
        }
        _ => {
            let what = format!("The model keeps its weights in \"{file}\", outside of its folder");
            Err(Error::input_at(model_path, what, "Put the weights beside the model and export it again."))
        }
    }
}

/// Inputs or outputs in words, as in `image` [1,3,1024,1024], `points` [?,?,2].
pub(crate) fn described(outlets: &[Outlet]) -> String {
    let axis = |n: i64| if n < 0 { "?".to_owned() } else { n.to_string() };
    let one = |o: &Outlet| {
        let axes: Vec<String> = o.shape.iter().copied().map(axis).collect();
        format!("`{}` [{}]", o.name, axes.join(","))
    };
    outlets.iter().map(one).collect::<Vec<_>>().join(", ")
}
