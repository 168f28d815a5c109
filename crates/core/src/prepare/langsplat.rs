//! Features in the files of LangSplat and the authors' scripts. `NAME_f.npy` [n, dim] holds the
//! embeddings of a frame's masks. `NAME_s.npy` [4, h, w] holds the number of the mask at each pixel, one
//! plane per level, -1 where there is none. The authors' newer scripts write `NAME_agg.npy` [1, h, w,
//! dim] instead, with an embedding for every place.

use super::{FrameFeatures, NO_REGION, Prepared, RegionMap, files::Manifest};
use crate::{
    Error, Result,
    files::write_whole_with,
    progress::{Observer, Progress},
    reading::npy_f32,
    segment::{DenseMap, Level},
    sequence::Sequence,
};
use ndarray::{Array2, Array3, ArrayView2, Axis};
use ndarray_npy::WriteNpyExt;
use std::path::{Path, PathBuf};

const HINT: &str = "Features are pairs NAME_f.npy [n, dim] and NAME_s.npy [4, h, w], or maps NAME_agg.npy [1, h, w, dim], NAME being that of \
                    the frame's picture.";

/// Returns `true` if a folder holds features of this kind for at least one frame.
pub fn holds_langsplat(folder: &Path, sequence: &Sequence) -> bool {
    let pair = |i: usize| files(folder, sequence, i).iter().all(|f| f.is_file());
    (0..sequence.num_frames()).any(|i| pair(i) || dense_file(folder, sequence, i).is_file())
}

/// Reads the features of frame `i` from `folder`; `None` if it has no files. Maps of another size than the
/// frames are resampled to it by the nearest value, as the authors do. `level` is ignored for dense maps.
///
/// Fails if shapes are wrong or a pixel points beyond the embeddings.
pub fn read_langsplat(
    folder: &Path,
    sequence: &Sequence,
    i: usize,
    level: Level,
) -> Result<Option<FrameFeatures>> {
    let [embeddings, maps] = files(folder, sequence, i);
    if !embeddings.is_file() && !maps.is_file() {
        let dense = dense_file(folder, sequence, i);
        let map = dense.is_file().then(|| read_dense(&dense)).transpose()?;
        return Ok(map.map(|map| map.into_features(sequence)));
    }
    let (shape, values) = npy_f32(&embeddings)?;
    let wrong = |path: &Path, what: String| Err(Error::input_at(path, what, HINT));
    let [n, dim] = shape[..] else {
        return wrong(&embeddings, format!("expected embeddings [n, dim], found the shape {shape:?}"));
    };
    if (n > 0 && dim == 0) || n > usize::from(NO_REGION) {
        let what = format!("{n} embeddings of {dim} numbers are not those of a frame's masks");
        return wrong(&embeddings, what);
    }
    let rows: Vec<Vec<f32>> = values.chunks_exact(dim.max(1)).map(<[f32]>::to_vec).collect();
    let (shape, values) = npy_f32(&maps)?;
    let (height, width) = match shape[..] {
        [4, height, width] if !values.is_empty() => (height, width),
        _ => return wrong(&maps, format!("expected maps [4, h, w], found the shape {shape:?}")),
    };
    let plane = &values[level as usize * height * width..][..height * width];
    let number = |&v: &f32| match v {
        -1.0 => Some(NO_REGION),
        _ if v >= 0.0 && v.fract() == 0.0 && v < n as f32 => Some(v as u16),
        _ => None,
    };
    let Some(data) = plane.iter().map(number).collect::<Option<Vec<u16>>>() else {
        return wrong(&maps, format!("a pixel does not point to one of the {n} embeddings of its frame"));
    };
    let regions = RegionMap::from_vec(width, height, data).sampled(sequence.width(), sequence.height());
    Ok(Some(FrameFeatures { regions, rows }))
}

/// Writes the features of a prepared folder into `folder`: `language_features` with the embeddings and
/// `language_features_dim3` with their latents (whatever their number D). All levels are the same. Frames
/// are named like their pictures.
pub fn write_langsplat(prepared: &Prepared, folder: &Path, observer: &mut Observer<'_>) -> Result<()> {
    let table = Manifest::read(&prepared.folder)?.read_tensors(&prepared.folder)?.1;
    let latent_dim = prepared.codec.latent_dim();
    let latents = ArrayView2::from_shape((prepared.num_rows(), latent_dim), &prepared.latents)
        .map_err(|e| Error::input_at(&prepared.folder, e.to_string(), "Prepare the recording again."))?;
    let n = prepared.sequence.num_frames();
    let mut tell = |done| Progress::new("writing .npy files", done, n).tell(observer);
    for i in 0..n {
        tell(i)?;
        let Some(regions) = prepared.regions(i)? else { continue };
        let mut rows: Vec<usize> =
            regions.data.iter().filter(|r| **r != NO_REGION).map(|r| usize::from(*r)).collect();
        rows.sort_unstable();
        rows.dedup();
        let number = |row: &u16| rows.binary_search(&usize::from(*row)).map_or(-1.0, |k| k as f32);
        let plane: Vec<f32> = regions.data.iter().map(number).collect();
        let maps = Array3::from_shape_fn((4, regions.height, regions.width), |(_, y, x)| {
            plane[y * regions.width + x]
        });
        let wanted: [(&str, Array2<f32>); 2] = [
            ("language_features", table.select(Axis(0), &rows)),
            ("language_features_dim3", latents.select(Axis(0), &rows)),
        ];
        for (name, embeddings) in wanted {
            let [to_embeddings, to_maps] = files(&folder.join(name), &prepared.sequence, i);
            write(&to_embeddings, |file| embeddings.write_npy(file))?;
            write(&to_maps, |file| maps.write_npy(file))?;
        }
    }
    tell(n)
}

/// Largest number of values per place in maps that the authors' autoencoder has compressed.
const COMPRESSED: usize = 16;

fn read_dense(file: &Path) -> Result<DenseMap> {
    let (shape, values) = npy_f32(file)?;
    let wrong = |what: String, hint: &str| Err(Error::input_at(file, what, hint));
    let (height, width, dim) = match shape[..] {
        [height, width, dim] | [1, height, width, dim] if !values.is_empty() => (height, width, dim),
        _ => return wrong(format!("expected a dense map [1, h, w, dim], found the shape {shape:?}"), HINT),
    };
    if dim <= COMPRESSED {
        let what = format!(
            "the map has {dim} numbers a place: it was compressed, and what would undo that is not here"
        );
        return wrong(what, "Give the maps from before the authors' autoencoder.");
    }
    Ok(DenseMap { width, height, dim, values })
}

fn dense_file(folder: &Path, sequence: &Sequence, i: usize) -> PathBuf {
    folder.join(format!("{}_agg.npy", sequence.frame_name(i)))
}

/// Returns the paths of the embeddings and maps of frame `i`.
fn files(folder: &Path, sequence: &Sequence, i: usize) -> [PathBuf; 2] {
    ["f", "s"].map(|kind| folder.join(format!("{}_{kind}.npy", sequence.frame_name(i))))
}

fn write(
    path: &Path,
    array: impl FnOnce(&mut std::fs::File) -> std::result::Result<(), ndarray_npy::WriteNpyError>,
) -> Result<()> {
    write_whole_with(path, |file| array(file).map_err(std::io::Error::other))
}
