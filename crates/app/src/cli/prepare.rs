//! `surgtpgs prepare`: features and codec in a folder beside the recording.

use super::{
    args::{HideArgs, MaskDensity, encoder_choice},
    console::{self, ProgressView, say},
    verb::{Exit, Run},
};
use crate::{
    jobs::{self, FeatureSource, PrepareOptions},
    memory::{Work, require_for},
    outputs,
};
use clap::{ArgGroup, Args, ValueEnum, ValueHint};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Result,
    codec::{CodecKind, CodecSettings},
    prepare::{BACKGROUND, Prepared, write_langsplat},
    segment::Level,
    sequence::Sequence,
};

/// Write features and codec into a folder beside the recording, which is never modified
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("source").required(true).args(["labels", "labels_from", "marks", "masks_model", "dense_encoder", "features"])))]
pub(super) struct PrepareArgs {
    /// A recording (folder or video file)
    sequence: PathBuf,
    /// Folder to write
    #[arg(short, long, value_name = "PREP")]
    output: PathBuf,
    /// Parts of the frames to hide
    #[command(flatten)]
    hide: HideArgs,
    /// Take features from the recording's label masks: each pixel gets the embedding of its class name
    #[arg(long)]
    labels: bool,
    /// As --labels, with the labels of a file of annotations instead of the recording's own: COCO, CVAT, Label
    /// Studio, .seg.nrrd or a DICOM segmentation
    #[arg(long, value_name = "FILE")]
    labels_from: Option<PathBuf>,
    /// Take features from marks by hand: a file of marks on some frames, or of annotations as for
    /// --labels-from. Training carries them to all frames, once the motion is learned. Marks that correct labels
    /// or masks are for query, export and eval
    #[arg(long, value_name = "MARKS")]
    marks: Option<PathBuf>,
    /// A folder with a Segment Anything: clicks and boxes of the marks become the masks that it finds there
    #[arg(long, value_name = "DIR", requires = "marks")]
    #[arg(conflicts_with_all = ["labels", "labels_from", "masks_model", "dense_encoder", "features"])]
    marks_model: Option<PathBuf>,
    /// Take features from automatic masks: a folder with encoder and decoder of a Segment Anything
    /// (.onnx, .ort)
    #[arg(long, value_name = "DIR", requires = "image_encoder")]
    masks_model: Option<PathBuf>,
    /// A folder with one model (.onnx, .ort) that embeds what masks show: the other half of the text encoder
    #[arg(long, value_name = "DIR", requires = "masks_model")]
    image_encoder: Option<PathBuf>,
    /// Take features from maps of whole pictures: a folder with one model (.onnx, .ort), images [1,3,n,n] in,
    /// maps [1,dim,rows,columns] out
    #[arg(long, value_name = "DIR")]
    dense_encoder: Option<PathBuf>,
    /// A network that estimates depth from single pictures, for a recording without depth: its .onnx
    /// file, or its folder
    #[arg(long, value_name = "DIR|FILE")]
    depth_model: Option<PathBuf>,
    /// Take features that another program made: a folder with LangSplat's NAME_f.npy and NAME_s.npy, or with
    /// dense maps NAME_agg.npy, for each frame
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Also write the features as LangSplat's and the paper's scripts read them
    #[arg(long, value_name = "DIR")]
    langsplat: Option<PathBuf>,
    /// Density of the points at which masks are asked for
    #[arg(long, value_enum, default_value_t = MaskDensity::Medium)]
    mask_density: MaskDensity,
    /// Masks that become regions
    #[arg(long, value_enum, default_value_t = LevelArg::Default)]
    mask_level: LevelArg,
    /// `builtin`, or a folder with model.onnx and tokenizer.json
    #[arg(long, value_name = "DIR|builtin", value_hint = ValueHint::DirPath, default_value = "builtin")]
    text_encoder: String,
    /// Hold every eighth frame out of everything, for evaluation
    #[arg(long)]
    eval: bool,
    /// Kind of the codec that compresses features
    #[arg(long, value_enum, default_value_t = CodecArg::Network)]
    codec: CodecArg,
    /// Latent numbers per pixel of the network codec
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=16))]
    latent_dim: u32,
    /// Seed of the codec's weights and batches
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Replace an earlier prepared folder; its masks are used again where nothing they depend on has changed
    #[arg(long)]
    pub(super) force: bool,
}

/// Choice among the masks of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum LevelArg {
    /// All of them
    Default,
    /// Parts
    S,
    /// Larger parts
    M,
    /// Wholes
    L,
}

impl From<LevelArg> for Level {
    fn from(level: LevelArg) -> Self {
        match level {
            LevelArg::Default => Self::Default,
            LevelArg::S => Self::Small,
            LevelArg::M => Self::Medium,
            LevelArg::L => Self::Large,
        }
    }
}

impl Run for PrepareArgs {
    fn run(&self) -> Result<Exit> {
        let sequence = Sequence::open_with(&self.sequence, self.labels_from.as_deref(), &self.hide.hide)?;
        require_for(&Work::Reading(&sequence))?;
        sequence.cautions().iter().for_each(|caution| say(&format!("note: {caution}")));
        if Prepared::is_unfinished(&self.output) {
            say("going on with an unfinished preparation");
        }
        if self.runs_models() {
            say(&format!("models run on {}", surgtpgs_clip::backend_name()));
            console::say_backend_notes();
        }
        console::watch_interrupts();
        let options = self.options();
        let mut view = ProgressView::default();
        let inputs = options.inputs().with_recording(&sequence).with("the prepared folder", &self.output);
        let langsplat = self.langsplat.as_ref();
        let langsplat = langsplat
            .map(|folder| outputs::folder(folder, outputs::LANGSPLAT, &inputs, self.force))
            .transpose()?;
        let mark_notes = options.mark_notes(&sequence)?;
        let prepared =
            jobs::prepare_folder(sequence, &self.output, &options, self.force, &mut |p| view.show(p))?;
        if let Some(output) = langsplat {
            write_langsplat(&prepared, output.path(), &mut |p| view.show(p))?;
            output.finish()?;
        }
        drop(view);
        let notes = mark_notes.into_iter().chain(prepared.cautions());
        notes.for_each(|note| say(&format!("note: {note}")));
        tell_result(&prepared, &self.output);
        Ok(Exit::Done)
    }

    fn output(&self) -> Option<&Path> {
        Some(&self.output)
    }
}

/// Kind of the codec.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CodecArg {
    /// A network with few latent numbers per pixel, trained here
    Network,
    /// One latent number for each of up to 16 different features, without training; scores take longer
    Codebook,
}

impl PrepareArgs {
    fn options(&self) -> PrepareOptions {
        PrepareOptions {
            source: self.source(),
            eval: self.eval,
            encoder: encoder_choice(&self.text_encoder),
            codec: CodecSettings {
                kind: match self.codec {
                    CodecArg::Network => CodecKind::Network,
                    CodecArg::Codebook => CodecKind::Codebook,
                },
                latent_dim: self.latent_dim as usize,
                seed: self.seed,
                ..CodecSettings::default()
            },
            depth_model: self.depth_model.clone(),
            labels_from: self.labels_from.clone(),
        }
    }

    fn runs_models(&self) -> bool {
        let models = [&self.masks_model, &self.marks_model, &self.dense_encoder, &self.depth_model];
        models.into_iter().any(Option::is_some)
    }

    /// Returns the source of features; the command line allows no other combination.
    fn source(&self) -> FeatureSource {
        let level = self.mask_level.into();
        if let Some(network) = &self.dense_encoder {
            return FeatureSource::Dense { network: network.clone() };
        }
        if let Some(marks) = &self.marks {
            return FeatureSource::Marks { file: marks.clone(), model: self.marks_model.clone() };
        }
        match (&self.masks_model, &self.image_encoder, &self.features) {
            (_, _, Some(folder)) => FeatureSource::LangSplat { folder: folder.clone(), level },
            (Some(model), Some(image_encoder), _) => FeatureSource::Masks {
                model: model.clone(),
                image_encoder: image_encoder.clone(),
                settings: self.mask_density.into(),
                level,
            },
            _ => FeatureSource::Labels,
        }
    }
}

fn tell_result(prepared: &Prepared, output: &Path) {
    if let Some(depth) = prepared.sequence.estimated_depth() {
        say(&format!(
            "estimated depth; the scales of single frames differed by a factor of {:.2}",
            depth.drift
        ));
        depth.notes.iter().for_each(|note| say(note));
    }
    if prepared.merged_frames > 0 {
        say(&format!(
            "merged regions of {} frames with nearly the same embeddings: a recording has at most 65,534",
            prepared.merged_frames
        ));
    }
    let what = match prepared.classes.len() {
        0 => format!("{} regions", prepared.num_rows()),
        classes if prepared.classes.iter().any(|(class, _)| class.name == BACKGROUND) => {
            format!("{} classes and the background", classes - 1)
        }
        classes => format!("{classes} classes"),
    };
    say(&format!(
        "prepared {what} of {} frames with the text encoder \"{}\"{} in {}",
        prepared.sequence.num_frames(),
        prepared.encoder.name,
        if prepared.eval { ", test frames held out," } else { "" },
        output.display()
    ));
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        _args: PrepareArgs,
    }

    #[test]
    fn features_come_from_labels_or_from_masks_with_an_image_encoder() {
        let parses = |args: &str| {
            let line = format!("prepare rec -o prep {args}");
            Line::try_parse_from(line.split_whitespace()).is_ok()
        };
        assert!(parses("--labels") && parses("--masks-model sam --image-encoder clip --mask-level l"));
        assert!(!parses("") && !parses("--masks-model sam") && !parses("--image-encoder clip"));
        assert!(!parses("--labels --masks-model sam --image-encoder clip"));
        assert!(parses("--marks m.json --marks-model sam") && !parses("--labels --marks-model sam"));
        assert!(parses("--labels-from tasks.json") && !parses("--labels --labels-from tasks.json"));
        assert!(parses("--marks marks.json") && !parses("--labels --marks marks.json"));
        assert!(
            parses("--dense-encoder net --depth-model depth.onnx") && !parses("--depth-model depth.onnx")
        );
        assert!(
            parses("--features dir --mask-level s --langsplat out") && !parses("--labels --features dir")
        );
    }
}
