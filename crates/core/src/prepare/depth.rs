//! Depth that a network estimates from single pictures. It is checked, brought to one scale over time,
//! and kept in the prepared folder as `depth/frame_000000.npy`, z in scene units at the network's size.

use super::{
    drift::{SAMPLES, log_scales},
    finish::clear_folder,
    kept::{self, digest},
};
use crate::{
    Error, Result,
    files::write_whole_with,
    grid::Grid,
    num::{percentile, spread},
    progress::{Observer, Progress},
    sequence::{DepthKind, EstimatedDepth, MONOCULAR_BASELINE, Sequence, depth_file, name_frames, npy_map},
};
use image::RgbImage;
use ndarray::ArrayView2;
use ndarray_npy::WriteNpyExt;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::Arc,
};

/// The subfolder of a prepared folder with what the network gave for each frame. Each file is stored with a
/// key of everything it was made from.
pub const DEPTH_ESTIMATES: &str = "estimates";
/// Stage of the estimation in its progress.
const STAGE: &str = "estimating depth";
/// Number of frames, spread over the recording, that are estimated first: they tell if the network is of use.
const TRIED: usize = 8;
/// Smallest usable share of a frame's values.
const MIN_USABLE: f64 = 0.5;
/// Smallest and largest factor that the depth of a frame may span, the extremes left out.
const SPAN: [f32; 2] = [1.001, 1e4];
/// Correlation of brightness with depth above which something is wrong: endoscopes light near surfaces more.
const MAX_CORRELATION: f64 = 0.3;

/// An estimator of depth: `estimate` gives depth or disparity (`kind`) of a picture, at any size.
pub struct Estimator<'a> {
    /// SHA-256 of the network.
    pub network: &'a str,
    /// Kind of values that `estimate` gives.
    pub kind: DepthKind,
    /// Returns the depth or disparity of a picture.
    pub estimate: &'a mut dyn FnMut(&RgbImage) -> Result<Grid<f32>>,
}

impl Estimator<'_> {
    /// Returns the depth or disparity of frame `i`, which is kept in the prepared folder `folder`.
    fn of_frame(
        &mut self,
        sequence: &Sequence,
        i: usize,
        image: &RgbImage,
        folder: &Path,
    ) -> Result<Grid<f32>> {
        let path = folder.join(DEPTH_ESTIMATES).join(format!("frame_{i:06}.safetensors"));
        let size = format!("{}×{}", image.width(), image.height());
        let key = digest(&[b"depth 1", self.network.as_bytes(), size.as_bytes(), image.as_raw()]);
        if let Some(table) = kept::load(&path, &key, DEPTH_ESTIMATES)?.filter(|table| !table.is_empty()) {
            return Ok(Grid::from_vec(table.ncols(), table.nrows(), table.iter().copied().collect()));
        }
        let map = (self.estimate)(image).map_err(|e| on_frame(e, &sequence.frame_name(i)))?;
        kept::save(&path, &key, DEPTH_ESTIMATES, as_table(&map, &path)?)?;
        Ok(map)
    }
}

/// Estimates the depth of all frames (`eval` leaves out those held out) into the prepared folder
/// `folder`. The returned sequence takes its depth from there and is the one to prepare. Disparity
/// becomes z = focal length · 1.0877 / disparity, as the paper's authors have it. The frames' scales are
/// fitted to one another where the camera stands still, and to its path where that is estimated. Where the
/// camera moves by known poses, and where neither explains what is seen, they are left as they are. What the
/// network gave stays in the folder, and is used again for the same pictures.
///
/// A frame has no depth if most of its values are unusable, if they are all the same, or if they span more
/// than any scene: it may be black, or fogged.
///
/// Fails if the recording has depth, if most frames would have none, or if the observer asks to stop.
pub fn estimate_depth(
    sequence: &Sequence,
    estimator: Estimator<'_>,
    eval: bool,
    folder: &Path,
    observer: &mut Observer<'_>,
) -> Result<Sequence> {
    if sequence.has_depth() {
        let what = "the recording has depth already";
        return Err(Error::input_at(sequence.path(), what, "Leave the depth network out."));
    }
    clear_folder(folder, sequence)?;
    let frames = sequence.used_frames(eval);
    let (network, kind) = (estimator.network.to_owned(), estimator.kind);
    let Found { log_depth, unusable, light, .. } = Found::of(sequence, estimator, &frames, folder, observer)?;
    let mut notes = Vec::new();
    if !unusable.is_empty() {
        let unusable: Vec<usize> = unusable.into_iter().collect();
        notes.push(format!("No depth for {}: the network gives nothing usable", name_frames(&unusable)));
    }
    if light.value() > MAX_CORRELATION {
        notes.push(
            "What is far is brighter than what is near, though an endoscope lights what is near: the network's depth may be \
             disparity, or the reverse (kind in depth.toml)"
                .to_owned(),
        );
    }
    let drift = if sequence.camera_moves() {
        notes.push("The camera moves: the scale of estimated depth was left as it is".to_owned());
        1.0
    } else {
        let (frames, log_depth): (Vec<usize>, Vec<Vec<f32>>) = log_depth.into_iter().unzip();
        let scales = log_scales(sequence, &frames, &log_depth, observer)?;
        notes.extend(scales.notes());
        equalise(folder, &frames, &scales.logs)?
    };
    Progress::new(STAGE, frames.len(), frames.len()).tell(observer)?;
    let about = EstimatedDepth { network, kind, drift, notes };
    Ok(sequence.clone().with_estimated_depth(folder, about, Arc::default()))
}

/// Findings about the depth of frames that were estimated one by one.
#[derive(Default)]
struct Found {
    /// Logarithms of depth at a grid of places, of frames that have usable depth.
    log_depth: BTreeMap<usize, Vec<f32>>,
    /// Frames that have none, and the error of the first one.
    unusable: BTreeSet<usize>,
    first_error: Option<Error>,
    /// Correlation of brightness with depth.
    light: Correlation,
}

impl Found {
    /// Estimates the depth of `frames` into `folder`. Fails as [`estimate_depth`] does.
    fn of(
        sequence: &Sequence,
        mut estimator: Estimator<'_>,
        frames: &[usize],
        folder: &Path,
        observer: &mut Observer<'_>,
    ) -> Result<Self> {
        let mut found = Self::default();
        for (done, i) in spread_first(frames).into_iter().enumerate() {
            Progress::new(STAGE, done, frames.len()).tell(observer)?;
            found.take(sequence, i, &mut estimator, folder)?;
            let done = done + 1;
            let is_useless = [TRIED, frames.len()].contains(&done) && 2 * found.unusable.len() > done;
            if let Some(error) = found.first_error.take_if(|_| is_useless) {
                return Err(error);
            }
        }
        Ok(found)
    }

    fn take(
        &mut self,
        sequence: &Sequence,
        i: usize,
        estimator: &mut Estimator<'_>,
        folder: &Path,
    ) -> Result<()> {
        let image = sequence.frame(i)?;
        let focal = f64::from(sequence.camera(i).fx);
        let values = estimator.of_frame(sequence, i, &image, folder)?;
        let depth = as_depth(&values, estimator.kind, focal);
        if let Err(error) = check(sequence, i, &depth) {
            self.unusable.insert(i);
            self.first_error.get_or_insert(error);
            return Ok(());
        }
        self.log_depth.insert(i, sampled(sequence, i, &depth, &image, &mut self.light)?);
        write(&depth_file(folder, i), &depth)
    }
}

/// Returns frames in the order in which they are estimated: those that are tried come first.
fn spread_first(frames: &[usize]) -> Vec<usize> {
    let tried: Vec<usize> = spread(frames.len(), TRIED).map(|k| frames[k]).collect();
    let others = frames.iter().copied().filter(|i| !tried.contains(i));
    tried.iter().copied().chain(others).collect()
}

/// Adds the name of the frame to an error of the network.
fn on_frame(error: Error, name: &str) -> Error {
    match error {
        Error::Input { what, hint, path } => {
            Error::Input { what: format!("{what}, on frame {name}"), hint, path }
        }
        other => other,
    }
}

/// Converts the network's values to z in scene units, 0 where they are unusable.
fn as_depth(map: &Grid<f32>, kind: DepthKind, focal: f64) -> Grid<f32> {
    map.map(|&v| {
        let z = match kind {
            DepthKind::Depth => v,
            DepthKind::Disparity => (focal * MONOCULAR_BASELINE / f64::from(v)) as f32,
        };
        if v > 0.0 && z.is_finite() && z > 0.0 { z } else { 0.0 }
    })
}

fn check(sequence: &Sequence, i: usize, depth: &Grid<f32>) -> Result<()> {
    let name = sequence.frame_name(i);
    let wrong = |what: String, hint: &str| Err(Error::input_at(sequence.path(), what, hint));
    let mut known: Vec<f32> = depth.data.iter().copied().filter(|z| *z > 0.0).collect();
    let usable = known.len() as f64 / depth.data.len().max(1) as f64;
    if usable < MIN_USABLE {
        let what = format!(
            "The depth network gives {:.0} % of frame {name} no usable value (not a number, zero or negative)",
            100.0 * (1.0 - usable)
        );
        return wrong(what, "Check kind, mean and std in depth.toml beside the model.");
    }
    let edges = [1.0, 99.0].map(|q| percentile(&mut known, q).unwrap_or(1.0));
    let span = edges[1] / edges[0];
    if span < SPAN[0] {
        let what = format!("The depth network gives all of frame {name} the same depth");
        return wrong(what, "Check mean, std and output in depth.toml beside the model.");
    }
    if span > SPAN[1] {
        let what = format!("The depth network's values on frame {name} span a factor of {span:.0}");
        return wrong(
            what,
            "Give range = [nearest, farthest] in depth.toml beside the model, or correct kind there.",
        );
    }
    Ok(())
}

/// Returns the logarithms of depth at a grid of places, NaN where unknown or outside the supervision mask.
fn sampled(
    sequence: &Sequence,
    i: usize,
    depth: &Grid<f32>,
    image: &RgbImage,
    light: &mut Correlation,
) -> Result<Vec<f32>> {
    let keep = sequence.mask(i)?;
    let mut values = Vec::with_capacity(SAMPLES * SAMPLES);
    for k in 0..SAMPLES * SAMPLES {
        let at = |width: usize, height: usize| {
            let inside = |place: usize, n: usize| (2 * place + 1) * n / (2 * SAMPLES);
            (inside(k % SAMPLES, width), inside(k / SAMPLES, height))
        };
        let ((x, y), (column, row)) = (at(keep.width, keep.height), at(depth.width, depth.height));
        let z = depth.at(column, row);
        let is_known = keep.at(x, y) && z > 0.0;
        values.push(if is_known { z.ln() } else { f32::NAN });
        if is_known {
            let [r, g, b] = image.get_pixel(x as u32, y as u32).0.map(f64::from);
            light.add(f64::from(z.ln()), (1.0 + r + g + b).ln());
        }
    }
    Ok(values)
}

/// Divides each frame's depth by its scale; returns the largest scale divided by the smallest.
fn equalise(folder: &Path, frames: &[usize], log_scales: &[f32]) -> Result<f32> {
    for (&i, log_scale) in frames.iter().zip(log_scales) {
        let file = depth_file(folder, i);
        let factor = (-log_scale).exp();
        write(&file, &npy_map(&file)?.map(|z| z * factor))?;
    }
    let edge = |pick: fn(f32, f32) -> f32| log_scales.iter().copied().fold(0.0, pick);
    Ok((edge(f32::max) - edge(f32::min)).exp())
}

fn write(file: &Path, depth: &Grid<f32>) -> Result<()> {
    let view = as_table(depth, file)?;
    write_whole_with(file, |out| view.write_npy(out).map_err(std::io::Error::other))
}

/// Returns the values of a map that is written into a file, [h, w].
fn as_table<'a>(map: &'a Grid<f32>, file: &Path) -> Result<ArrayView2<'a, f32>> {
    ArrayView2::from_shape((map.height, map.width), &map.data)
        .map_err(|e| Error::input_at(file, e.to_string(), ""))
}

/// Pearson's correlation of pairs that are added one by one.
#[derive(Default)]
struct Correlation {
    n: f64,
    sums: [f64; 2],
    products: [f64; 3],
}

impl Correlation {
    fn add(&mut self, a: f64, b: f64) {
        self.n += 1.0;
        self.sums = [self.sums[0] + a, self.sums[1] + b];
        self.products = [self.products[0] + a * a, self.products[1] + b * b, self.products[2] + a * b];
    }

    /// Returns the correlation; 0 if one of the two does not vary.
    fn value(&self) -> f64 {
        let [a, b] = self.sums.map(|s| s / self.n);
        let [aa, bb, ab] = self.products.map(|p| p / self.n);
        let r = (ab - a * b) / ((aa - a * a) * (bb - b * b)).sqrt();
        if r.is_finite() { r } else { 0.0 }
    }
}
