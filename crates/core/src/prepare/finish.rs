//! The common first and last steps of every way of preparing: an empty folder, and a trained codec.

use super::files::{Manifest, REGIONS};
use crate::{
    Error, Result,
    codec::{Codec, CodecSettings},
    files::{PREPARED_FILE, full_path, is_free_folder, is_prepared, is_taken, write_whole},
    hash::file_sha256,
    progress::Observer,
    sequence::{DEPTH, Sequence, depth_file, depth_name},
};
use ndarray::Array2;
use std::path::Path;

/// Trains the codec on the feature table and writes both; the folder is finished then. `rows` is flat, with
/// one row of the encoder's length per entry of the manifest's `row_pixels`.
pub(super) fn finish(
    mut manifest: Manifest,
    rows: Vec<f32>,
    settings: &CodecSettings,
    folder: &Path,
    observer: &mut Observer<'_>,
) -> Result<()> {
    let table = Array2::from_shape_vec((manifest.row_pixels.len(), manifest.encoder.dim), rows)
        .map_err(|e| Error::input(format!("the embeddings cannot be tabulated: {e}"), ""))?;
    let weights: Vec<f32> = manifest.row_pixels.iter().map(|&p| p as f32).collect();
    let codec = Codec::train(table.view(), &weights, settings, observer)?;
    let latents = codec.encode(table.view());
    manifest.write_tensors(folder, &codec, table.view(), latents.view())?;
    if manifest.depth.is_some() {
        for i in (0..manifest.frames).filter(|&i| depth_file(folder, i).is_file()) {
            manifest.sha256.insert(depth_name(i), file_sha256(&depth_file(folder, i))?);
        }
    }
    manifest.write(folder)
}

/// Creates `folder`, or empties a prepared one: nothing of an earlier preparation may stay behind.
pub(super) fn clear_folder(folder: &Path, sequence: &Sequence) -> Result<()> {
    let fail = |e| Error::io("prepare the folder", folder, e);
    if folder.exists() && full_path(folder) == full_path(sequence.path()) {
        return Err(Error::input_at(
            folder,
            "features cannot be written into the recording itself",
            "Choose another folder.",
        ));
    }
    let ours = is_prepared(folder) || is_unfinished(folder) || is_taken(folder);
    if !ours && !is_free_folder(folder)? {
        return Err(Error::input_at(
            folder,
            "the folder is not empty and was not made by preparing a recording",
            "Choose a new or empty folder.",
        ));
    }
    let manifest = folder.join(PREPARED_FILE);
    if manifest.exists() {
        std::fs::remove_file(&manifest).map_err(fail)?;
    }
    let depth = folder.join(DEPTH);
    if ours && sequence.estimated_depth().is_none() && depth.exists() {
        std::fs::remove_dir_all(&depth).map_err(fail)?;
    }
    let regions = folder.join(REGIONS);
    if regions.exists() {
        std::fs::remove_dir_all(&regions).map_err(fail)?;
    }
    write_whole(&regions.join(MARKER), b"Region maps, written by surgtpgs prepare.\n")
}

/// Returns `true` if a preparation into `folder` was begun and not finished: it has regions but
/// no manifest yet.
pub(super) fn is_unfinished(folder: &Path) -> bool {
    !is_prepared(folder) && folder.join(REGIONS).join(MARKER).is_file()
}

/// File that tells our regions folder from folders of other programs.
const MARKER: &str = "README.txt";
