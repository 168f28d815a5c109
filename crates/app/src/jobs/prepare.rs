//! Features and codec of a recording.

use super::{Observer, Progress};
use crate::engine::{EncoderChoice, open_text_encoder};
use std::{
    cell::Cell,
    path::{Path, PathBuf},
};
use surgtpgs_clip::{ImageEncoder, SegmentAnything, TextEncoder};
use surgtpgs_core::{
    Error, Result,
    codec::CodecSettings,
    files::full_path,
    prepare::{
        MaskStore, Origin, Prepared, holds_langsplat, prepare_from_features, prepare_from_labels,
        read_langsplat,
    },
    segment::{Level, MaskSettings},
    sequence::Sequence,
};

/// How to prepare a recording.
#[derive(Clone, Debug, Default)]
pub struct PrepareOptions {
    /// Where features come from.
    pub source: FeatureSource,
    /// Hold test frames out.
    pub eval: bool,
    /// Text encoder that embeds the class names, or whose prompts image embeddings are compared with.
    pub encoder: EncoderChoice,
    /// The codec.
    pub codec: CodecSettings,
}

/// Where features come from.
#[derive(Clone, Debug, Default)]
pub enum FeatureSource {
    /// Label masks and class names.
    #[default]
    Labels,
    /// Automatic masks and what they show.
    Masks {
        /// Folder with a Segment Anything.
        model: PathBuf,
        /// Folder with an image encoder.
        image_encoder: PathBuf,
        /// How masks are made.
        settings: MaskSettings,
        /// Which masks become regions.
        level: Level,
    },
    /// Files of LangSplat's kind, see [`read_langsplat`].
    LangSplat {
        /// Where they are.
        folder: PathBuf,
        /// Which of their maps is used.
        level: Level,
    },
}

/// Makes a prepared folder from a recording.
pub fn prepare(
    sequence: Sequence,
    folder: &Path,
    options: &PrepareOptions,
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    let has_classes = !sequence.classes().is_empty();
    if matches!(options.source, FeatureSource::Labels) && !has_classes {
        return Err(Error::input_at(
            sequence.path(),
            "the recording has no label masks to take features from",
            "Use automatic masks (`--masks-model`), or train on it without features.",
        ));
    }
    let text = match &options.encoder {
        EncoderChoice::Folder(folder) => open_text_encoder(folder)?,
        EncoderChoice::Builtin | EncoderChoice::OfScene => TextEncoder::builtin()?,
    };
    match &options.source {
        FeatureSource::Labels => from_labels(sequence, folder, options, text, observer),
        FeatureSource::Masks { model, image_encoder, settings, level } => {
            // All models are opened before hours of work begin.
            let image = ImageEncoder::open(image_encoder)?;
            check_halves(&text, &image, image_encoder)?;
            let masks = Masks { model, settings, level: *level };
            masks.prepare(sequence, folder, options, &text, image, observer)
        }
        FeatureSource::LangSplat { folder: from, level } => {
            from_langsplat(sequence, folder, options, &text, (from, *level), observer)
        }
    }
}

fn from_langsplat(
    sequence: Sequence,
    folder: &Path,
    options: &PrepareOptions,
    text: &TextEncoder,
    (from, level): (&Path, Level),
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    if !holds_langsplat(from, &sequence) {
        let what = format!(
            "the folder has no features for this recording: {0}_f.npy and {0}_s.npy, for example",
            sequence.frame_name(0)
        );
        return Err(Error::input_at(from, what, "Name the files like the pictures of the frames."));
    }
    let mut features = |i: usize| read_langsplat(from, &sequence, i, level);
    let mut report = |stage: &str, done, total| {
        // Reading takes seconds; it is not interrupted half-way.
        let _ = observer(&Progress { stage, done, total, detail: "" });
    };
    let origin = Origin::LangSplat { folder: full_path(from), level };
    let identity = text.identity().clone();
    let (eval, codec) = (options.eval, &options.codec);
    prepare_from_features(sequence.clone(), identity, origin, &mut features, eval, codec, folder, &mut report)
}

fn from_labels(
    sequence: Sequence,
    folder: &Path,
    options: &PrepareOptions,
    mut encoder: TextEncoder,
    observer: &mut Observer<'_>,
) -> Result<Prepared> {
    let names: Vec<&str> = sequence.classes().iter().map(|c| c.name.as_str()).collect();
    let embeddings = encoder.encode_prompts(&names)?;
    let identity = encoder.identity().clone();
    let mut report = |stage: &str, done, total| {
        // Labels are read in seconds; this is not interrupted half-way.
        let _ = observer(&Progress { stage, done, total, detail: "" });
    };
    prepare_from_labels(sequence, identity, &embeddings, options.eval, &options.codec, folder, &mut report)
}

/// Errs where embeddings of texts and images cannot be compared.
fn check_halves(text: &TextEncoder, image: &ImageEncoder, folder: &Path) -> Result<()> {
    let text = text.identity();
    if image.dim() == text.dim {
        return Ok(());
    }
    let what = format!(
        "Image embeddings have {} values; the text encoder \"{}\" makes {}",
        image.dim(),
        text.name,
        text.dim
    );
    let hint = "They come from different models: give the text half of the same one with `--text-encoder`.";
    Err(Error::input_at(folder, what, hint))
}

/// How masks become regions.
struct Masks<'a> {
    model: &'a Path,
    settings: &'a MaskSettings,
    level: Level,
}

impl Masks<'_> {
    fn prepare(
        &self,
        sequence: Sequence,
        folder: &Path,
        options: &PrepareOptions,
        text: &TextEncoder,
        mut image: ImageEncoder,
        observer: &mut Observer<'_>,
    ) -> Result<Prepared> {
        let mut segmenter = SegmentAnything::open(self.model)?;
        let model = segmenter.sha256().to_owned();
        let store = MaskStore { sequence: &sequence, folder, settings: self.settings, model: &model };
        let mut tell = |done: usize, total: usize, detail: &str| {
            observer(&Progress { stage: "finding masks", done, total, detail })
        };
        store.make_masks(&mut segmenter, options.eval, &mut tell)?;
        drop(segmenter);

        let encoder = image.sha256().to_owned();
        let stopped = Cell::new(false);
        let mut features = |i: usize| match stopped.get() {
            true => Err(Error::Cancelled),
            false => {
                store.features(i, self.level, &encoder, &mut |picture, masks| image.embed(picture, masks))
            }
        };
        let mut report = |stage: &str, done, total| {
            let flow = observer(&Progress { stage, done, total, detail: "" });
            stopped.set(stopped.get() || flow.is_break());
        };
        let origin = Origin::Masks {
            mask_model: model.clone(),
            settings: self.settings.clone(),
            level: self.level,
            image_encoder: encoder.clone(),
        };
        prepare_from_features(
            sequence.clone(),
            text.identity().clone(),
            origin,
            &mut features,
            options.eval,
            &options.codec,
            folder,
            &mut report,
        )
    }
}
