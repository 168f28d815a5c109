//! Features and codec of a recording.

use super::{Observer, Progress};
use crate::{
    engine::{EncoderChoice, open_text_encoder},
    memory::{Work, require_for},
    outputs,
};
use half::f16;
use image::RgbImage;
use std::path::{Path, PathBuf};
use surgtpgs_clip::{DepthNetwork, FeatureNetwork, ImageEncoder, SegmentAnything, TextEncoder};
use surgtpgs_core::{
    Error, Remedy, Result,
    codec::CodecSettings,
    files::{Claim, Earlier, Inputs, OutputFolder, full_path},
    marks::Marks,
    meaning::{Calibration, ClassWords, EncoderIdentity, Space, Vocabulary},
    prepare::{
        BACKGROUND, DEPTH_ESTIMATES, Estimator, FrameFeatures, MASKS_AND_EMBEDDINGS, MarkedNames, MaskStore,
        Origin, Prepared, estimate_depth, holds_langsplat, prepare_from_features, prepare_from_labels,
        prepare_from_marks, read_langsplat, require_few_frames, require_labels, require_marks,
    },
    segment::{BitMask, Level, MaskSettings},
    sequence::Sequence,
};

/// Number of words of the vocabulary that are encoded between two reports of progress.
const WORDS_AT_ONCE: usize = 64;

/// Options to prepare a recording with.
#[derive(Clone, Debug, Default)]
pub struct PrepareOptions {
    /// Source of the features.
    pub source: FeatureSource,
    /// `true` to hold test frames out.
    pub eval: bool,
    /// Text encoder that embeds the class names, or the prompts that image embeddings are compared with.
    pub encoder: EncoderChoice,
    /// Settings of the codec.
    pub codec: CodecSettings,
    /// A depth network, or a folder with one, for recordings without depth.
    pub depth_model: Option<PathBuf>,
    /// The file of annotations that the recording was opened with, if its labels are from one.
    pub labels_from: Option<PathBuf>,
}

/// Source of the features.
#[derive(Clone, Debug, Default)]
pub enum FeatureSource {
    /// Label masks and class names.
    #[default]
    Labels,
    /// Marks by hand, which training carries to all frames.
    Marks {
        /// File of the marks.
        file: PathBuf,
        /// Folder with a Segment Anything that makes masks of clicks and boxes.
        model: Option<PathBuf>,
    },
    /// Automatic masks and the embeddings of what they show.
    Masks {
        /// Folder with a Segment Anything.
        model: PathBuf,
        /// Folder with an image encoder.
        image_encoder: PathBuf,
        /// Settings of the automatic masks.
        settings: MaskSettings,
        /// Level of the masks that become regions.
        level: Level,
    },
    /// Maps that a network makes of whole pictures.
    Dense {
        /// Folder with the network.
        network: PathBuf,
    },
    /// Files of LangSplat's kind, see [`read_langsplat`].
    LangSplat {
        /// Folder with the files.
        folder: PathBuf,
        /// Level of the maps that are used.
        level: Level,
    },
}

/// Makes the prepared folder `path` from a recording. An earlier one is replaced if `replace` says so, except
/// for masks and estimates that can be used again. An unfinished one is gone on with.
pub fn prepare_folder(
    sequence: Sequence,
    path: &Path,
    options: &PrepareOptions,
    replace: bool,
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    let inputs = options.inputs().with_recording(&sequence);
    let claim = Claim::new(outputs::PREPARATION, &inputs, replace);
    let output = OutputFolder::claim(path, Claim { unfinished: Earlier::GoOn, ..claim })?;
    if matches!(options.source, FeatureSource::Masks { .. }) {
        MASKS_AND_EMBEDDINGS.iter().try_for_each(|name| output.take_over(name))?;
    }
    if options.depth_model.is_some() {
        output.take_over(DEPTH_ESTIMATES)?;
    }
    let prepared = prepare(sequence, output.path(), options, observer)?;
    let target = output.target().to_owned();
    output.finish()?;
    Ok(prepared.moved_to(&target))
}

impl PrepareOptions {
    /// Names the marks that show nothing, if features come from marks, see [`Marks::notes`].
    pub fn mark_notes(&self, sequence: &Sequence) -> Result<Vec<String>> {
        let FeatureSource::Marks { file, .. } = &self.source else { return Ok(Vec::new()) };
        let is_used = |frame: usize| !(self.eval && Sequence::is_test_frame(frame));
        Ok(read_marks(file, sequence)?.notes(&sequence.canvas(), sequence.field_of_view(), is_used))
    }

    /// Returns the files and folders that are read besides the recording.
    pub(crate) fn inputs(&self) -> Inputs {
        let folder =
            if let EncoderChoice::Folder(folder) = &self.encoder { Some(folder.as_path()) } else { None };
        let inputs = Inputs::none()
            .with_some("the text encoder", folder)
            .with_some("the depth network", self.depth_model.as_deref())
            .with_some("the labels", self.labels_from.as_deref());
        match &self.source {
            FeatureSource::Labels => inputs,
            FeatureSource::Marks { file, model } => {
                inputs.with("the marks", file).with_some("the network for marks", model.as_deref())
            }
            FeatureSource::Masks { model, image_encoder, .. } => {
                inputs.with("the mask network", model).with("the image encoder", image_encoder)
            }
            FeatureSource::Dense { network } => inputs.with("the feature network", network),
            FeatureSource::LangSplat { folder, .. } => inputs.with("the features", folder),
        }
    }
}

/// Makes a prepared folder from a recording, in a folder of the caller's.
pub fn prepare(
    sequence: Sequence,
    folder: &Path,
    options: &PrepareOptions,
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    require_for(&Work::Reading(&sequence))?;
    let has_classes = !sequence.classes().is_empty();
    if matches!(options.source, FeatureSource::Labels) && !has_classes {
        let (path, what) = match &options.labels_from {
            Some(file) => (file.as_path(), "this file labels nothing to take features from"),
            None => (sequence.path(), "the recording has no label masks to take features from"),
        };
        return Err(Error::input_at(path, what, Remedy::OtherFeatures));
    }
    let mut text = match &options.encoder {
        EncoderChoice::Folder(folder) => open_text_encoder(folder)?,
        EncoderChoice::Builtin | EncoderChoice::OfScene => TextEncoder::builtin()?,
    };
    // What can fail early does so before hours of work begin.
    let features = Features::open(options, &mut text, &sequence, observer)?;
    let sequence = match &options.depth_model {
        Some(model) => with_depth(sequence, folder, model, options.eval, observer)?,
        None => sequence,
    };
    let preparation = Preparation { sequence, folder, options, encoder: text.identity().clone() };
    let mut prepared = match features {
        Features::Labels { embeddings } => preparation.by_labels(&embeddings, observer),
        Features::Marks { marks, embeddings } => preparation.by_marks(&marks, &embeddings, observer),
        Features::Masks { model, image, settings, level } => {
            preparation.by_masks(*model, image, settings, level, observer)
        }
        Features::Dense(network) => preparation.by_maps(network, observer),
        Features::LangSplat { folder, level } => preparation.by_langsplat(folder, level, observer),
    }?;
    calibrate(&mut prepared, &mut text, observer)?;
    Ok(prepared)
}

/// Measures how far the text encoder tells words apart, and keeps that in the prepared folder. An encoder
/// that cannot read the vocabulary is not measured; of its scenes only listed words are understood.
fn calibrate(prepared: &mut Prepared, text: &mut TextEncoder, observer: &mut Observer<'_>) -> Result<()> {
    let sha256 = text.identity().sha256.clone();
    let mut vectors = Vec::new();
    let mut encode = |words: &[&str]| {
        let mut rows = Vec::with_capacity(words.len());
        for part in words.chunks(WORDS_AT_ONCE) {
            Progress::new("encoding words", rows.len(), words.len()).tell(observer)?;
            rows.extend(text.encode_prompts(part)?);
        }
        vectors.extend(rows.iter().flatten().map(|v| f16::from_f32(*v)));
        Ok(rows)
    };
    let space = match Space::new(Vocabulary::standard(), &sha256, &mut encode) {
        Err(Error::Cancelled) => return Err(Error::Cancelled),
        Err(_) => return Ok(()),
        Ok(space) => space,
    };
    let classes: Vec<ClassWords> =
        prepared.classes.iter().map(|(class, row)| ClassWords::seen(&class.name, row)).collect();
    prepared.keep_words(Calibration::measure(&space, &classes), vectors)
}

/// Estimates depth, which is kept beside the features.
fn with_depth(
    sequence: Sequence,
    folder: &Path,
    model: &Path,
    eval: bool,
    observer: &mut Observer<'_>,
) -> Result<Sequence> {
    let mut network = DepthNetwork::open(model)?;
    let (sha256, kind) = (network.sha256().to_owned(), network.kind());
    let estimator = Estimator { network: &sha256, kind, estimate: &mut |picture| network.estimate(picture) };
    estimate_depth(&sequence, estimator, eval, folder, observer)
}

/// A [`FeatureSource`] with its models opened, and names embedded, one row each.
enum Features<'a> {
    Labels { embeddings: Vec<Vec<f32>> },
    Marks { marks: Marks, embeddings: Vec<Vec<f32>> },
    Masks { model: Box<SegmentAnything>, image: ImageEncoder, settings: &'a MaskSettings, level: Level },
    Dense(FeatureNetwork),
    LangSplat { folder: &'a Path, level: Level },
}

impl<'a> Features<'a> {
    /// Opens the models and embeds names. Fails if embeddings of texts and images cannot be compared, or if
    /// there is nothing to take features from, or too much.
    fn open(
        options: &'a PrepareOptions,
        text: &mut TextEncoder,
        sequence: &Sequence,
        observer: &mut Observer<'_>,
    ) -> Result<Self> {
        if !matches!(options.source, FeatureSource::Labels | FeatureSource::Marks { .. }) {
            require_few_frames(sequence, options.eval)?;
        }
        Ok(match &options.source {
            FeatureSource::Labels => {
                require_labels(sequence, options.eval, observer)?;
                let names = sequence.classes().iter().map(|class| &*class.name);
                Self::Labels { embeddings: embedded(text, names.chain([BACKGROUND]))? }
            }
            FeatureSource::Marks { file, model } => {
                let mut marks = read_marks(file, sequence)?;
                if let Some(folder) = model {
                    let mut network = SegmentAnything::open(folder)?;
                    let field_of_view = sequence.field_of_view();
                    marks = marks.with_masks(&mut network, field_of_view, |i| sequence.frame(i))?;
                }
                require_marks(sequence, &marks, options.eval, observer)?;
                let names = marks.names();
                let embeddings = embedded(text, names.iter().map(String::as_str).chain([BACKGROUND]))?;
                Self::Marks { marks, embeddings }
            }
            FeatureSource::Masks { model, image_encoder, settings, level } => {
                let image = ImageEncoder::open(image_encoder)?;
                check_halves(text, image.dim(), image_encoder)?;
                Self::Masks { model: Box::new(SegmentAnything::open(model)?), image, settings, level: *level }
            }
            FeatureSource::Dense { network: folder } => {
                let network = FeatureNetwork::open(folder)?;
                check_halves(text, network.dim(), folder)?;
                Self::Dense(network)
            }
            FeatureSource::LangSplat { folder, level } => {
                require_langsplat(folder, sequence)?;
                Self::LangSplat { folder, level: *level }
            }
        })
    }
}

/// Reads marks; names that differ in spelling alone are one.
fn read_marks(path: &Path, sequence: &Sequence) -> Result<Marks> {
    let marks = Marks::read_for(path, &sequence.canvas(), || Some(sequence.clone()))?;
    Ok(marks.joined(|_| None))
}

fn embedded<'a>(text: &mut TextEncoder, names: impl Iterator<Item = &'a str>) -> Result<Vec<Vec<f32>>> {
    text.encode_prompts(&names.collect::<Vec<_>>())
}

/// Fails if a folder holds no features for the recording.
fn require_langsplat(folder: &Path, sequence: &Sequence) -> Result<()> {
    if holds_langsplat(folder, sequence) {
        return Ok(());
    }
    let what = format!(
        "the folder has no features for this recording: {0}_f.npy and {0}_s.npy, or {0}_agg.npy, for example",
        sequence.frame_name(0)
    );
    Err(Error::input_at(folder, what, "Name the files like the pictures of the frames."))
}

/// Opens the networks of [`FeatureSource::Masks`] and the text encoder, and returns what is wrong with each:
/// mask network, image encoder, text encoder. That halves do not belong together is a fault of the last.
pub fn faults_of_models(model: &Path, image_encoder: &Path, text: &EncoderChoice) -> [Option<Error>; 3] {
    let masks = SegmentAnything::open(model).err();
    let images = ImageEncoder::open(image_encoder);
    let text = match text {
        EncoderChoice::Folder(folder) => open_text_encoder(folder),
        EncoderChoice::Builtin | EncoderChoice::OfScene => TextEncoder::builtin(),
    };
    let halves = match (&images, &text) {
        (Ok(images), Ok(text)) => check_halves(text, images.dim(), image_encoder).err(),
        _ => None,
    };
    [masks, images.err(), text.err().or(halves)]
}

/// Fails if embeddings of texts and images cannot be compared.
fn check_halves(text: &TextEncoder, dim: usize, folder: &Path) -> Result<()> {
    let text = text.identity();
    if dim == text.dim {
        return Ok(());
    }
    let what =
        format!("Image embeddings have {dim} values; the text encoder \"{}\" makes {}", text.name, text.dim);
    let hint =
        Remedy::OtherEncoder.after("They come from different models: give the text half of the same one.");
    Err(Error::input_at(folder, what, hint))
}

/// Everything that each way of preparing needs.
struct Preparation<'a> {
    sequence: Sequence,
    folder: &'a Path,
    options: &'a PrepareOptions,
    encoder: EncoderIdentity,
}

impl Preparation<'_> {
    fn by_labels(self, embeddings: &[Vec<f32>], observer: &mut Observer<'_>) -> Result<Prepared> {
        let (eval, codec) = (self.options.eval, &self.options.codec);
        prepare_from_labels(self.sequence, self.encoder, embeddings, eval, codec, self.folder, observer)
    }

    fn by_marks(
        self,
        marks: &Marks,
        embeddings: &[Vec<f32>],
        observer: &mut Observer<'_>,
    ) -> Result<Prepared> {
        let named = MarkedNames { marks, encoder: self.encoder, embeddings };
        let (eval, codec) = (self.options.eval, &self.options.codec);
        prepare_from_marks(self.sequence, named, eval, codec, self.folder, observer)
    }

    fn by_masks(
        self,
        mut segmenter: SegmentAnything,
        mut image: ImageEncoder,
        settings: &MaskSettings,
        level: Level,
        observer: &mut Observer<'_>,
    ) -> Result<Prepared> {
        let (sequence, folder) = (self.sequence.clone(), self.folder);
        let (model, encoder) = (segmenter.sha256().to_owned(), image.sha256().to_owned());
        let store = MaskStore { sequence: &sequence, folder, settings, model: &model };
        store.make_masks(&mut segmenter, self.options.eval, observer)?;
        // Makes room for the next network.
        drop(segmenter);
        let mut embed = |picture: &RgbImage, masks: &[&BitMask]| image.embed(picture, masks);
        let mut features = |i: usize| store.features(i, level, &encoder, &mut embed);
        let origin = Origin::Masks {
            mask_model: model.clone(),
            settings: settings.clone(),
            level,
            image_encoder: encoder.clone(),
        };
        self.by_features(origin, &mut features, observer)
    }

    fn by_maps(self, mut network: FeatureNetwork, observer: &mut Observer<'_>) -> Result<Prepared> {
        let sequence = self.sequence.clone();
        let origin = Origin::Dense { network: network.sha256().to_owned() };
        let mut features = |i: usize| Ok(Some(network.map(&sequence.frame(i)?)?.into_features(&sequence)));
        self.by_features(origin, &mut features, observer)
    }

    fn by_langsplat(self, from: &Path, level: Level, observer: &mut Observer<'_>) -> Result<Prepared> {
        let sequence = self.sequence.clone();
        let origin = Origin::LangSplat { folder: full_path(from), level };
        let mut features = |i: usize| read_langsplat(from, &sequence, i, level);
        self.by_features(origin, &mut features, observer)
    }

    /// Prepares from any source of regions with embeddings; the observer may stop it between two frames.
    fn by_features(
        self,
        origin: Origin,
        features: &mut dyn FnMut(usize) -> Result<Option<FrameFeatures>>,
        observer: &mut Observer<'_>,
    ) -> Result<Prepared> {
        let (eval, codec) = (self.options.eval, &self.options.codec);
        let (sequence, encoder) = (self.sequence, self.encoder);
        prepare_from_features(sequence, encoder, origin, features, eval, codec, self.folder, observer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use surgtpgs_core::{
        demo::{self, DemoSettings},
        progress::unobserved,
    };

    /// Returns the error of preparing a demo, after `change`, with a depth network that is not there.
    fn error(source: FeatureSource, change: impl Fn(&Path)) -> String {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("recording");
        let small = DemoSettings { width: 48, height: 32, frames: 8, ..DemoSettings::default() };
        demo::write(&small, &recording, &mut unobserved).unwrap();
        std::fs::remove_dir_all(recording.join("depth")).unwrap();
        change(&recording);
        let depth_model = Some(folder.path().join("depth.onnx"));
        let options = PrepareOptions { source, depth_model, ..Default::default() };
        let sequence = Sequence::open(&recording).unwrap();
        prepare(sequence, &folder.path().join("prep"), &options, &mut unobserved).unwrap_err().to_string()
    }

    #[test]
    fn spellings_of_a_marked_name_are_prepared_as_one() {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("recording");
        let small = DemoSettings { width: 48, height: 32, frames: 8, ..DemoSettings::default() };
        demo::write(&small, &recording, &mut unobserved).unwrap();
        let click = |name: &str| {
            let points_px = [[9, 9]];
            serde_json::json!({ "frame": 0, "name": name, "kind": "click", "points_px": points_px })
        };
        let marks = ["gallbladder", "fat", "Gall Bladder"].map(click);
        let file = folder.path().join("marks.json");
        std::fs::write(&file, serde_json::json!({ "marks": marks }).to_string()).unwrap();
        let marks = read_marks(&file, &Sequence::open(&recording).unwrap()).unwrap();
        assert_eq!(marks.names(), ["fat", "gall bladder"]);
    }

    #[test]
    fn nothing_to_take_features_from_is_told_before_depth_is_estimated() {
        let network = error(FeatureSource::Labels, |_| {});
        assert!(network.contains("depth.onnx"), "{network}");
        let unlabelled = error(FeatureSource::Labels, |recording| {
            for entry in std::fs::read_dir(recording.join("labels")).unwrap().flatten() {
                image::GrayImage::from_pixel(48, 32, image::Luma([255])).save(entry.path()).unwrap();
            }
        });
        assert!(unlabelled.contains("no pixel of the training frames has a label"), "{unlabelled}");
        let long = error(FeatureSource::Labels, |recording| {
            let classes = recording.join("labels.json");
            let text = std::fs::read_to_string(&classes).unwrap();
            std::fs::write(&classes, text.replacen("liver", &"liver ".repeat(200), 1)).unwrap();
        });
        assert!(long.contains("tokens"), "{long}");
        let features = tempfile::tempdir().unwrap();
        let source = FeatureSource::LangSplat { folder: features.path().to_owned(), level: Level::Default };
        let unnamed = error(source, |_| {});
        assert!(unnamed.contains("the folder has no features for this recording"), "{unnamed}");
    }
}
