//! Segment Anything: one folder with an image encoder, and a decoder that turns points into masks.
//!
//! Inputs and outputs tell which file is which, and of which generation they are. Supported decoders are
//! those of `segment_anything`'s own export (SAM 1), of SAM 2 with its fine features, and of Hugging
//! Face's exports, which name the points `input_points` and the masks `pred_masks`.

use crate::{
    model_file::{ModelFile, described},
    network::Network,
    tensor::{Input, NOT_FINITE, Outlet, Value, floats},
};
use image::{RgbImage, imageops::FilterType};
use sha2::{Digest, Sha256};
use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};
use surgtpgs_core::{
    Error, Result,
    segment::{DenseMap, PointSegmenter, Prediction},
};

/// Mean and standard deviation of ImageNet's colours, 0–1; every Segment Anything uses them.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const STD: [f32; 3] = [0.229, 0.224, 0.225];
/// Number of prompts decoded at once. More is no faster on a CPU and takes more memory (about 40 MB each).
const BATCH: usize = 8;
/// Labels of points, as the decoder reads them: on the object, the upper left and lower right corner of a box
/// around it, and a point that stands for nothing.
const ON_OBJECT: &[f32] = &[1.0];
const CORNERS: &[f32] = &[2.0, 3.0];
const PADDING: f32 = -1.0;
const HINT: &str =
    "A folder for masks holds the encoder and the decoder of one Segment Anything, as .onnx or .ort.";

/// Value for an input of the decoder.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Feed {
    /// Output of the encoder with this index.
    Feature(usize),
    Points,
    Labels,
    EarlierMask,
    HasEarlierMask,
    ImageSize,
}

/// Calling convention of a decoder, read from its inputs and outputs.
struct Contract {
    /// One feed per input.
    feeds: Vec<Feed>,
    /// `true` if points are `[1, prompts, points, 2]`, not `[prompts, points, 2]`.
    has_outer_axis: bool,
    /// `true` if it takes several prompts at once.
    is_batched: bool,
    /// `true` for SAM 1: images keep their aspect ratio and are padded, and prompts end with a padding point.
    is_padded: bool,
    masks: String,
    ratings: String,
}

/// A loaded Segment Anything.
pub struct SegmentAnything {
    encoder: Network,
    decoder: Network,
    folder: PathBuf,
    contract: Contract,
    /// Pixels along each side of the encoder's input.
    side: usize,
    sha256: String,
    image: Option<Encoded>,
    encoding: Duration,
    decoding: Duration,
}

/// Output of the encoder for an image.
struct Encoded {
    features: Vec<Value>,
    size: [u32; 2],
}

impl SegmentAnything {
    /// Opens a folder with an encoder and a decoder; their file names do not matter.
    pub fn open(folder: &Path) -> Result<Self> {
        let files = ModelFile::list(folder, "models for masks", HINT)?;
        let [a, b] = files.as_slice() else {
            let what = format!(
                "The folder should hold two model files, an encoder and a decoder, not {}",
                files.len()
            );
            return Err(Error::input_at(folder, what, HINT));
        };
        let (a, b) = (ModelFile::open(a)?, ModelFile::open(b)?);
        let (encoder, decoder) = match (encoder_side(a.network.inputs()), encoder_side(b.network.inputs())) {
            (Some(_), None) => (a, b),
            (None, Some(_)) => (b, a),
            (first, _) => {
                let which =
                    if first.is_some() { "Both models read images" } else { "Neither model reads images" };
                let what = format!(
                    "{which}: the one wants {}, the other {}; an encoder takes a float image [1,3,1024,1024]",
                    described(a.network.inputs()),
                    described(b.network.inputs())
                );
                return Err(Error::input_at(folder, what, HINT));
            }
        };
        let side = encoder_side(encoder.network.inputs()).unwrap_or_default();
        let contract = Contract::read(&encoder, &decoder)?;
        let mut hash = Sha256::new();
        hash.update(&encoder.sha256);
        hash.update(&decoder.sha256);
        Ok(Self {
            encoder: encoder.network,
            decoder: decoder.network,
            folder: folder.to_owned(),
            contract,
            side,
            sha256: crate::model_file::hex(hash),
            image: None,
            encoding: Duration::ZERO,
            decoding: Duration::ZERO,
        })
    }

    /// SHA-256 over both models, hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Returns "SAM 1" or "SAM 2".
    pub fn generation(&self) -> &'static str {
        if self.contract.is_padded { "SAM 1" } else { "SAM 2" }
    }

    /// Time spent in the encoder and in the decoder so far.
    pub fn network_time(&self) -> [Duration; 2] {
        [self.encoding, self.decoding]
    }

    /// Pixels of the encoder's square per pixel of an image.
    fn scale(&self, [width, height]: [u32; 2]) -> [f32; 2] {
        let side = self.side as f32;
        match self.contract.is_padded {
            true => [side / width.max(height) as f32; 2],
            false => [side / width as f32, side / height as f32],
        }
    }

    /// Asks the decoder about points that have these labels, one after the other; the last one stands for all
    /// that follow.
    fn ask(
        &mut self,
        prompts: &[Vec<[f32; 2]>],
        labels: &[f32],
        earlier: Option<&[f32]>,
    ) -> Result<Prediction> {
        let started = Instant::now();
        let Some(image) = &self.image else {
            return Err(Error::input("the mask decoder was asked before it had an image", ""));
        };
        let size = image.size;
        let scale = self.scale(size);
        let failed = |cause| failed("decoder", cause, &self.folder);
        let outlets = self.decoder.inputs().to_vec();
        let inputs = self.contract.inputs(&outlets, (prompts, labels), earlier, image, scale);
        let outputs = self.decoder.run(inputs).map_err(failed)?;
        let (shape, logits) = floats(&outputs, &self.contract.masks).map_err(failed)?;
        let (_, ratings) = floats(&outputs, &self.contract.ratings).map_err(failed)?;
        if !logits.iter().chain(ratings).all(|v| v.is_finite()) {
            return Err(Error::input_at(&self.folder, "The mask decoder returned not-a-number", NOT_FINITE));
        }
        let used = [0, 1].map(|i| (size[i] as f32 * scale[i] / self.side as f32).min(1.0));
        let prediction = prediction(&shape, logits.to_vec(), ratings.to_vec(), prompts.len(), size, used);
        self.decoding += started.elapsed();
        prediction
    }

    /// An image in the form that the encoder reads, [1, 3, side, side].
    fn tensor(&self, image: &RgbImage) -> Vec<f32> {
        let size = [image.width(), image.height()];
        let scale = self.scale(size);
        let scaled = |i: usize| ((size[i] as f32 * scale[i]).round() as usize).clamp(1, self.side);
        let (width, height) = (scaled(0), scaled(1));
        let resized = image::imageops::resize(image, width as u32, height as u32, FilterType::Triangle);
        let plane = self.side * self.side;
        // The padding is 0 after normalisation.
        let mut values = vec![0.0; 3 * plane];
        for (x, y, pixel) in resized.enumerate_pixels() {
            let at = y as usize * self.side + x as usize;
            for c in 0..3 {
                values[c * plane + at] = (f32::from(pixel[c]) / 255.0 - MEAN[c]) / STD[c];
            }
        }
        values
    }
}

impl PointSegmenter for SegmentAnything {
    fn set_image(&mut self, image: &RgbImage) -> Result<()> {
        let started = Instant::now();
        let values = self.tensor(image);
        let side = self.side;
        let failed = |cause| failed("encoder", cause, &self.folder);
        let input = self.encoder.inputs()[0].name.clone();
        let names: Vec<String> = self.encoder.outputs().iter().map(|o| o.name.clone()).collect();
        let values = Input::F32(vec![1, 3, side, side], values);
        let mut outputs = self.encoder.run(vec![(&input, values)]).map_err(failed)?;
        let take =
            |name: &String| outputs.remove(name).ok_or_else(|| format!("the output `{name}` is missing"));
        let features = names.iter().map(take).collect::<Result<_, _>>().map_err(failed)?;
        self.image = Some(Encoded { features, size: [image.width(), image.height()] });
        self.encoding += started.elapsed();
        Ok(())
    }

    fn predict(&mut self, prompts: &[Vec<[f32; 2]>], earlier: Option<&[f32]>) -> Result<Prediction> {
        self.ask(prompts, ON_OBJECT, earlier)
    }

    fn predict_box(&mut self, [a, b]: [[f32; 2]; 2]) -> Result<Prediction> {
        let low = [a[0].min(b[0]), a[1].min(b[1])];
        let high = [a[0].max(b[0]), a[1].max(b[1])];
        if self.contract.has_outer_axis {
            // These take boxes by an input of their own, if at all.
            return self.ask(&[vec![[0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])]]], ON_OBJECT, None);
        }
        self.ask(&[vec![low, high]], CORNERS, None)
    }

    fn earlier_size(&self) -> Option<[usize; 2]> {
        let at = self.contract.feeds.iter().position(|feed| *feed == Feed::EarlierMask)?;
        let [.., rows, columns] = self.decoder.inputs()[at].shape[..] else { return None };
        Some([usize::try_from(columns).ok()?, usize::try_from(rows).ok()?])
    }

    /// Returns the encoder's output with the most channels. The others are finer, but carry less meaning.
    fn features(&self) -> Option<DenseMap> {
        let image = self.image.as_ref()?;
        let scale = self.scale(image.size);
        let maps = self.encoder.outputs().iter().zip(&image.features).filter_map(|(outlet, value)| {
            let (shape, values) = value.floats().ok()?;
            let [1, dim, height, width] = shape[..] else { return None };
            let is_map = dim * height * width > 0 && !outlet.name.contains("positional");
            is_map.then_some((dim, height, width, values))
        });
        let (dim, height, width, values) = maps.max_by_key(|(dim, ..)| *dim)?;
        let covered = |i: usize, places: usize| {
            let share = image.size[i] as f32 * scale[i] / self.side as f32;
            ((share * places as f32).round() as usize).clamp(1, places)
        };
        Some(DenseMap::of_planes(width, height, dim, values).cropped(covered(0, width), covered(1, height)))
    }

    fn batch(&self) -> usize {
        if self.contract.is_batched { BATCH } else { 1 }
    }
}

/// Sorts the decoder's answers. `used` is the share of the encoder's square that the image covers.
fn prediction(
    shape: &[usize],
    logits: Vec<f32>,
    ratings: Vec<f32>,
    num_prompts: usize,
    size: [u32; 2],
    used: [f32; 2],
) -> Result<Prediction> {
    let wrong = || {
        let what = format!("the mask decoder gave masks {shape:?} with {} ratings", ratings.len());
        Error::input(what, "Encoder and decoder may not belong together.")
    };
    let [.., height, width] = *shape else { return Err(wrong()) };
    let (size_of_map, len) = ([width, height], width * height);
    let answers = ratings.len() / num_prompts.max(1);
    if len == 0
        || answers == 0
        || logits.len() != ratings.len() * len
        || ratings.len() != num_prompts * answers
    {
        return Err(wrong());
    }
    // Masks that have the size of the image have no padding.
    let is_whole = size_of_map == size.map(|n| n as usize);
    let extent = if is_whole { [1.0; 2] } else { used };
    // The first of four answers is for prompts of many points. The others are part, more, and whole.
    let skipped = usize::from(answers == 4);
    let kept = |i: usize| i % answers >= skipped;
    let keep = |values: &[f32], len: usize| -> Vec<f32> {
        let items = values.chunks_exact(len).enumerate().filter(|(i, _)| kept(*i));
        items.flat_map(|(_, item)| item.iter().copied()).collect()
    };
    Ok(Prediction {
        masks_per_prompt: answers - skipped,
        size: size_of_map,
        extent,
        logits: if skipped == 0 { logits } else { keep(&logits, len) },
        predicted_iou: if skipped == 0 { ratings } else { keep(&ratings, 1) },
    })
}

/// Returns the number of pixels along a side if the inputs are those of an image encoder.
fn encoder_side(inputs: &[Outlet]) -> Option<usize> {
    let [image] = inputs else { return None };
    match image.shape[..] {
        [1 | -1, 3, h, w] if h == w || h < 0 || w < 0 => {
            // A size that the file leaves open is 1024, with which all checkpoints were trained.
            let side = h.max(w);
            Some(if side > 0 { side as usize } else { 1024 })
        }
        _ => None,
    }
}

impl Contract {
    fn read(encoder: &ModelFile, decoder: &ModelFile) -> Result<Self> {
        let (features, inputs) = (encoder.network.outputs(), decoder.network.inputs());
        let mut feeds = Vec::new();
        for input in inputs {
            let feed = named_feed(&input.name).or_else(|| matching_feature(input, features, &feeds));
            let Some(feed) = feed else {
                let what = format!(
                    "The mask decoder wants {}, and nothing the encoder makes ({}) fits `{}`",
                    described(inputs),
                    described(features),
                    input.name
                );
                return Err(Error::input_at(&decoder.path, what, HINT));
            };
            feeds.push(feed);
        }
        let outputs = decoder.network.outputs();
        let named = |words: &[&str]| {
            let fits = |word: &&str| outputs.iter().find(|o| o.name.to_lowercase().contains(*word));
            words.iter().find_map(fits).map(|o| o.name.clone())
        };
        let points = feeds.iter().position(|f| *f == Feed::Points).map(|i| inputs[i].shape.clone());
        let (Some(points), Some(masks), Some(ratings)) =
            (points, named(&["low_res", "mask"]), named(&["iou", "score"]))
        else {
            let what = format!(
                "The mask decoder takes {} and gives {}; expected are points in, masks and iou_predictions out",
                described(inputs),
                described(outputs)
            );
            return Err(Error::input_at(&decoder.path, what, HINT));
        };
        let num_features = feeds.iter().filter(|f| matches!(f, Feed::Feature(_))).count();
        let has_positions = inputs.iter().any(|i| i.name.contains("positional"));
        let has_outer_axis = points.len() == 4;
        Ok(Self {
            is_batched: if has_outer_axis { points[1] < 0 } else { points.first() == Some(&-1) },
            has_outer_axis,
            // SAM 2 has fine features beside the embedding. SAM 1 has at most the constant positions.
            is_padded: num_features == 1 || has_positions,
            feeds,
            masks,
            ratings,
        })
    }

    /// Inputs of the decoder for prompts of points, whose labels are given as in [`SegmentAnything::ask`]. The
    /// points are multiplied by `scale`. `earlier` holds masks to refine.
    fn inputs<'a>(
        &self,
        outlets: &'a [Outlet],
        (prompts, labels): (&[Vec<[f32; 2]>], &[f32]),
        earlier: Option<&[f32]>,
        image: &'a Encoded,
        scale: [f32; 2],
    ) -> Vec<(&'a str, Input<'a>)> {
        let n = prompts.len();
        // SAM 1 was trained with a last point that means "no box".
        let padding = usize::from(self.is_padded && !self.has_outer_axis && labels != CORNERS);
        let num_points = prompts.first().map_or(0, Vec::len) + padding;
        let outer =
            |axes: &[usize]| if self.has_outer_axis { [&[1][..], axes].concat() } else { axes.to_vec() };
        let input = |(outlet, feed): (&'a Outlet, &Feed)| {
            let fixed = |axis: usize| outlet.shape.get(axis).and_then(|n| usize::try_from(*n).ok());
            let input = match feed {
                Feed::Feature(k) => Input::Given(&image.features[*k]),
                Feed::Points => {
                    let with_padding = |p: &Vec<[f32; 2]>| {
                        let scaled: Vec<f32> =
                            p.iter().flat_map(|p| [p[0] * scale[0], p[1] * scale[1]]).collect();
                        [scaled, vec![0.0; 2 * padding]].concat()
                    };
                    Input::F32(outer(&[n, num_points, 2]), prompts.iter().flat_map(with_padding).collect())
                }
                Feed::Labels => {
                    let last = labels.len() - 1;
                    let one = |i: usize| match i % num_points {
                        k if k < num_points - padding => labels[k.min(last)],
                        _ => PADDING,
                    };
                    Input::F32(outer(&[n, num_points]), (0..n * num_points).map(one).collect())
                }
                Feed::EarlierMask => {
                    let axes = vec![n, 1, fixed(2).unwrap_or(256), fixed(3).unwrap_or(256)];
                    let values = earlier.map(<[f32]>::to_vec);
                    let none = || vec![0.0; axes.iter().product()];
                    Input::F32(axes.clone(), values.unwrap_or_else(none))
                }
                Feed::HasEarlierMask => {
                    let len = fixed(0).filter(|len| *len > 0).unwrap_or(n);
                    Input::F32(vec![len], vec![f32::from(u8::from(earlier.is_some())); len])
                }
                Feed::ImageSize => {
                    let [width, height] = image.size.map(|v| v as f32);
                    Input::F32(vec![2], vec![height, width])
                }
            };
            (outlet.name.as_str(), input)
        };
        outlets.iter().zip(&self.feeds).map(input).collect()
    }
}

/// Feed of an input, judged by its name.
fn named_feed(name: &str) -> Option<Feed> {
    let name = name.to_lowercase();
    let has = |word: &str| name.contains(word);
    match () {
        () if has("has_mask") => Some(Feed::HasEarlierMask),
        () if has("mask") => Some(Feed::EarlierMask),
        () if has("label") => Some(Feed::Labels),
        () if has("point") || has("coord") => Some(Feed::Points),
        () if has("orig") || has("im_size") => Some(Feed::ImageSize),
        () => None,
    }
}

/// Returns the encoder's output of the same name, else the only unused one of the same shape.
fn matching_feature(input: &Outlet, features: &[Outlet], used: &[Feed]) -> Option<Feed> {
    let by_name = features.iter().position(|f| f.name == input.name);
    let is_free = |k: &usize| !used.contains(&Feed::Feature(*k));
    let mut by_shape = (0..features.len()).filter(is_free).filter(|k| features[*k].shape == input.shape);
    let only = by_shape.next().filter(|_| by_shape.next().is_none());
    by_name.or(only).map(Feed::Feature)
}

fn failed(part: &str, cause: String, folder: &Path) -> Error {
    let what = format!("The mask {part} failed ({cause})");
    Error::input_at(folder, what, "Encoder and decoder may not belong together, or be damaged.")
}
