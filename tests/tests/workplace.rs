//! A folder with a recording, the folder prepared from it, a scene and a chapter of one, for tests that
//! write.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};
use surgtpgs_tests::{flow, run_in};

/// Jobs file of the batch.
const JOBS: &str = "[defaults]\nlabels = true\niterations = 2\nbackend = \"cpu\"\nprompts = [\"liver\"]\n\
    formats = [\"csv\"]\n[[recording]]\npath = \"recording\"\n";

/// Returns `true` for files that a killed writer leaves.
fn is_temporary(path: &Path) -> bool {
    path.file_name()
        .is_some_and(|name| name == ".surgtpgs.lock" || name.to_string_lossy().starts_with(".part-"))
}

/// Returns all files of a folder except temporary ones. Files that vanish meanwhile are left out.
pub(crate) fn contents(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if let (false, Ok(bytes)) = (is_temporary(&path), fs::read(&path)) {
                files.insert(path.strip_prefix(root).unwrap().to_owned(), bytes);
            }
        }
    }
    files
}

/// Creates a folder with everything that the writers read.
pub(crate) fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["recording", "prepared"] {
        for (file, bytes) in contents(&flow().path().join(name)) {
            let to = folder.path().join(name).join(file);
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            fs::write(to, bytes).unwrap();
        }
    }
    // With its record, the recording would be out of bounds as a result already; without, it is an
    // ordinary one.
    fs::remove_file(folder.path().join("recording/.surgtpgs")).unwrap();
    fs::copy(flow().at("scene.safetensors"), folder.path().join("scene.safetensors")).unwrap();
    fs::write(folder.path().join("jobs.toml"), JOBS).unwrap();
    let chapter = ["--chapter", "0", "--chapter-frames", "5", "--iterations", "2", "--backend", "cpu"];
    let train = [&["train", "prepared", "-o", "chapter.safetensors"][..], &chapter].concat();
    run_in(folder.path(), &train).ok();
    folder
}
