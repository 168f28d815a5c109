//! `surgtpgs export`.

use super::{FrameRange, PromptArgs, RelevancyArgs, SceneArgs, frame_range, unit_number};
use clap::{
    Args, ValueEnum,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use std::path::PathBuf;
use surgtpgs_core::{
    export::{Format, PictureSource},
    mask::CleanUp,
    overlay::OverlayStyle,
};

/// `surgtpgs export`
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Prompts to look for
    #[command(flatten)]
    pub prompts: PromptArgs,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Files to write
    #[arg(long, visible_alias = "formats", value_parser = format_parser(), value_delimiter = ',', default_value = "cutout,overlay")]
    pub format: Vec<Format>,
    /// Frames, e.g. 12 or 10..20 (the end is not included)
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub frames: Option<FrameRange>,
    /// Pictures to mask
    #[arg(long, value_enum, default_value_t = SourceArg::Original)]
    pub source: SourceArg,
    /// Path of the recording, if it is not where it was when training
    #[arg(long, value_name = "SEQ")]
    pub sequence: Option<PathBuf>,
    /// Give a pixel to the best prompt only
    #[arg(long, conflicts_with = "overlapping")]
    pub exclusive: bool,
    /// Let prompts share pixels (the default)
    #[arg(long)]
    pub overlapping: bool,
    /// Style of overlays, videos and sheets
    #[arg(long, value_parser = style_parser(), default_value = OverlayStyle::Outline.name())]
    pub style: OverlayStyle,
    /// Opacity of fills and heatmaps in overlays
    #[arg(long, default_value_t = 0.35, value_parser = unit_number)]
    pub opacity: f32,
    /// Opacity of outlines
    #[arg(long, default_value_t = 1.0, value_parser = unit_number)]
    pub outline_opacity: f32,
    /// Draw over instruments as well, not below them
    #[arg(long)]
    pub above_instruments: bool,
    /// Changes made to masks
    #[command(flatten)]
    pub clean_up: CleanUpArgs,
    /// Leave the research-use stamp out of overlays, outlines and videos; the record says so
    #[arg(long)]
    pub no_stamp: bool,
    /// Replace an earlier export, once the new one is whole
    #[arg(long)]
    pub force: bool,
    /// Options for answering prompts
    #[command(flatten)]
    pub relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Changes made to masks before they are written; none unless asked for.
#[derive(Debug, Args)]
pub struct CleanUpArgs {
    /// Smooth scores over time: the mean over a frame and this many frames before and after it
    #[arg(long, default_value_t = 0, value_name = "FRAMES")]
    pub smooth: usize,
    /// Fill holes of masks up to this area
    #[arg(long, default_value_t = 0, value_name = "PX")]
    pub fill_holes: usize,
    /// Leave out parts of masks that are smaller than this area
    #[arg(long, default_value_t = 0, value_name = "PX")]
    pub min_area: usize,
    /// Move the border of masks outwards, or inwards where negative
    #[arg(long, default_value_t = 0, value_name = "PX", allow_negative_numbers = true)]
    pub grow: i32,
}

impl CleanUpArgs {
    /// Returns the same settings as the library's type.
    pub fn clean_up(&self) -> CleanUp {
        let &Self { smooth, fill_holes, min_area, grow } = self;
        CleanUp { smooth_frames: smooth, fill_holes_px: fill_holes, min_area_px: min_area, grow_px: grow }
    }
}

/// Reads the name of a format; the names and their explanations are the formats' own.
fn format_parser() -> impl TypedValueParser<Value = Format> {
    let value = |format: Format| PossibleValue::new(format.name()).help(format.about());
    PossibleValuesParser::new(Format::ALL.map(value)).try_map(|name| {
        Format::ALL.into_iter().find(|f| f.name() == name).ok_or_else(|| format!("there is no format {name}"))
    })
}

/// Reads the name of a style; the names and their explanations are the styles' own.
fn style_parser() -> impl TypedValueParser<Value = OverlayStyle> {
    let value = |style: OverlayStyle| PossibleValue::new(style.name()).help(style.about());
    PossibleValuesParser::new(OverlayStyle::ALL.map(value)).try_map(|name| {
        OverlayStyle::ALL
            .into_iter()
            .find(|s| s.name() == name)
            .ok_or_else(|| format!("there is no style {name}"))
    })
}

/// Pictures that an export masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SourceArg {
    /// The recorded frames
    Original,
    /// The frames as the scene renders them
    Reconstruction,
}

impl From<SourceArg> for PictureSource {
    fn from(arg: SourceArg) -> Self {
        match arg {
            SourceArg::Original => Self::Original,
            SourceArg::Reconstruction => Self::Reconstruction,
        }
    }
}
