//! `surgtpgs export`: masked frames with a record of how they were made.

use super::{
    args::{FrameArgs, MarkArgs, PromptArgs, RelevancyArgs, SceneArgs, unit_number},
    console::{self, ProgressView, print_report, say},
    verb::{Exit, Run},
};
use crate::{
    engine::Engine,
    jobs::{self, ExportQuestion, ExportRequest},
};
use clap::{
    Args, ValueEnum,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    export::{ExportOptions, ExportSummary, Format, PictureSource, SegType, VideoFault, num_files},
    mask::{CleanUp, MAX_SMOOTH},
    overlay::{OverlayLook, OverlayStyle},
    palette::Palette,
};

/// Write masked frames with a record of how they were made
#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// The scene
    #[command(flatten)]
    scene: SceneArgs,
    /// Prompts to look for
    #[command(flatten)]
    pub(super) prompts: PromptArgs,
    /// Marks by hand
    #[command(flatten)]
    marks: MarkArgs,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Files to write
    #[arg(long, visible_alias = "formats", value_parser = named(Format::ALL, Format::name, Some(Format::about)), value_delimiter = ',', default_value = "cutout,overlay")]
    format: Vec<Format>,
    /// Kind of DICOM segmentation
    #[arg(long, value_parser = named(SegType::ALL, SegType::name, Some(SegType::about)), default_value = SegType::default().name())]
    seg_type: SegType,
    /// Frames to work on
    #[command(flatten)]
    pub(super) frames: FrameArgs,
    /// Pictures to mask
    #[arg(long, value_enum, default_value_t = SourceArg::Original)]
    source: SourceArg,
    /// Path of the recording, if it is not where it was when training
    #[arg(long, value_name = "SEQ")]
    sequence: Option<PathBuf>,
    /// Give a pixel to the best prompt only
    #[arg(long, conflicts_with = "overlapping")]
    exclusive: bool,
    /// Let prompts share pixels (the default)
    #[arg(long)]
    overlapping: bool,
    /// Style of overlays, videos and sheets
    #[arg(long, value_parser = named(OverlayStyle::ALL, OverlayStyle::name, Some(OverlayStyle::about)), default_value = OverlayStyle::Outline.name())]
    style: OverlayStyle,
    /// Opacity of fills in overlays
    #[arg(long, default_value_t = OverlayLook::default().opacity, value_parser = unit_number)]
    opacity: f32,
    /// Opacity of heatmaps
    #[arg(long, default_value_t = OverlayLook::default().heat_opacity, value_parser = unit_number)]
    heat_opacity: f32,
    /// Colours of heatmaps
    #[arg(long, value_parser = named(Palette::ALL, Palette::name, None), default_value = Palette::default().name())]
    palette: Palette,
    /// Opacity of outlines
    #[arg(long, default_value_t = 1.0, value_parser = unit_number)]
    outline_opacity: f32,
    /// Draw over instruments as well, not below them
    #[arg(long)]
    above_instruments: bool,
    /// Columns of overlays and videos; masks and data keep the size of the recording
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(64..=7680))]
    width: Option<u32>,
    /// Leave names, frame number and time out of overlays, videos and animations
    #[arg(long)]
    no_captions: bool,
    /// Changes made to masks
    #[command(flatten)]
    clean_up: CleanUpArgs,
    /// For words that mean no class of the recording and look like one ("looks like" in `query`), write that
    /// class, under its own name and dashed. For words that look like none, nothing is written
    #[arg(long)]
    nearest: bool,
    /// Leave the research-use stamp out of overlays, outlines and videos; the record says so
    #[arg(long)]
    no_stamp: bool,
    /// Replace an earlier export, once the new one is whole
    #[arg(long)]
    pub(super) force: bool,
    /// Options for answering prompts
    #[command(flatten)]
    relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Changes made to masks before they are written. Unless any is given, specks go, small holes are filled, and
/// borders are rounded, as in the window.
#[derive(Debug, Args)]
struct CleanUpArgs {
    /// Leave masks as they are [default: without any of the five options below, parts and holes below a
    /// thousandth of the picture go, and borders are rounded; with one of them, nothing else is done]
    #[arg(long, conflicts_with_all = ["smooth", "fill_holes", "min_area", "round", "grow"])]
    raw: bool,
    /// Smooth scores over time: the mean over a frame and this many frames before and after it, of the same shot
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u16).range(..=MAX_SMOOTH as i64))]
    smooth: Option<u16>,
    /// Fill holes of masks up to this area
    #[arg(long, value_name = "PX")]
    fill_holes: Option<usize>,
    /// Leave out parts of masks that are smaller than this area
    #[arg(long, value_name = "PX")]
    min_area: Option<usize>,
    /// Round the border of masks over this distance
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u16).range(..=100))]
    round: Option<u16>,
    /// Move the border of masks outwards, or inwards where negative
    #[arg(long, value_name = "PX", allow_negative_numbers = true)]
    grow: Option<i32>,
}

/// Reads one of `all` by its name; names and explanations are its own.
fn named<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [T; N],
    name: fn(T) -> &'static str,
    about: Option<fn(T) -> &'static str>,
) -> impl TypedValueParser<Value = T> {
    let value = |one: T| {
        let value = PossibleValue::new(name(one));
        match about {
            Some(about) => value.help(about(one)),
            None => value,
        }
    };
    PossibleValuesParser::new(all.map(value)).try_map(move |given| {
        let found = all.into_iter().find(|one| name(*one) == given);
        found.ok_or_else(|| format!("there is no {given}"))
    })
}

impl CleanUpArgs {
    /// The clean-up for pictures of a size.
    fn clean_up(&self, width: usize, height: usize) -> CleanUp {
        let &Self { raw, smooth, fill_holes, min_area, round, grow } = self;
        if let (false, None, None, None, None, None) = (raw, smooth, fill_holes, min_area, round, grow) {
            return CleanUp::usual(width, height);
        }
        CleanUp {
            smooth_frames: smooth.unwrap_or(0).into(),
            fill_holes_px: fill_holes.unwrap_or(0),
            min_area_px: min_area.unwrap_or(0),
            round_px: round.unwrap_or(0).into(),
            grow_px: grow.unwrap_or(0),
        }
    }
}

/// Pictures that an export masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SourceArg {
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

impl Run for ExportArgs {
    fn run(&self) -> Result<Exit> {
        let (_, summary) = export(self, !self.force)?;
        let folder = self.output.display();
        let text = match (summary.frames, summary.files, summary.skipped_frames) {
            (0, ..) => format!("nothing to export; the record in {folder} says why\n"),
            (frames, files, skipped) => {
                format!("{files} files in {folder} ({frames} frames, {skipped} of them were there already)\n")
            }
        };
        print_report(&summary, &text, self.json)?;
        if summary.complete {
            Ok(Exit::Done)
        } else {
            say("run the same command again to go on");
            Err(Error::Cancelled)
        }
    }

    fn output(&self) -> Option<&Path> {
        Some(&self.output)
    }
}

/// Writes the files; `completes_same` as in [`ExportRequest`]. An export that is not complete was stopped by
/// the user. The returned engine still has the prompts.
pub(super) fn export(args: &ExportArgs, completes_same: bool) -> Result<(Engine, ExportSummary)> {
    let mut engine = args.scene.open(&args.relevancy, args.sequence.clone())?;
    let options = args.options(&engine)?;
    args.marks.give_to(&mut engine)?;
    let questions = args.prompts.questions(engine.settings())?;
    let request = ExportRequest {
        scene: args.scene.scene.clone(),
        folder: args.output.clone(),
        frames: args.frames.of(engine.scene().num_frames())?,
        questions: ExportQuestion::with_standard_look(questions, engine.settings().threshold),
        marks: Vec::new(),
        options,
        replace: args.force,
        completes_same,
    };
    let num_shown = request.frames.iter().filter(|f| engine.scene().shows_frame(**f)).count();
    let num_written = jobs::num_written(&mut engine, &request)?;
    say(&format!(
        "exporting {} frames, {} prompts, {} files to {}",
        request.frames.len(),
        num_written,
        num_files(&request.options.formats, num_shown, num_written),
        args.output.display()
    ));
    console::watch_interrupts();
    let mut view = ProgressView::default();
    let summary = jobs::export(&mut engine, &request, &mut |p| view.show(p))?;
    drop(view);
    for words in &summary.left_out {
        say(&format!("note: {words}"));
    }
    Ok((engine, summary))
}

impl ExportArgs {
    /// Returns the options for what an engine shows; fails if a video cannot be written with them.
    fn options(&self, engine: &Engine) -> Result<ExportOptions> {
        let camera = engine.view(0)?.camera;
        let (width, height) = (camera.width as usize, camera.height as usize);
        let options = ExportOptions {
            formats: self.format.clone(),
            source: self.source.into(),
            exclusive: self.exclusive,
            stamp: !self.no_stamp,
            captions: !self.no_captions,
            width_px: self.width,
            look: OverlayLook {
                style: self.style,
                opacity: self.opacity,
                heat_opacity: self.heat_opacity,
                palette: self.palette,
                outline_opacity: self.outline_opacity,
                below_instruments: !self.above_instruments,
            },
            nearest: self.nearest,
            seg_type: self.seg_type,
            clean_up: self.clean_up.clean_up(width, height),
        };
        let Some(fault) = VideoFault::of(&options, (width, height)) else { return Ok(options) };
        let hint = match fault.fitting {
            Some(columns) => format!("Give `--width {columns}`."),
            None => "Leave the format `video` out.".into(),
        };
        Err(Error::input(fault.to_string(), hint))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::asking_tests::unfinished_engine;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: ExportArgs,
    }

    #[test]
    fn a_video_that_would_be_too_large_is_refused_with_the_width_that_fits() {
        let engine = unfinished_engine();
        let options = |width: &str, format: &str| {
            let line = ["export", "s", "--prompt", "liver", "-o", "out"];
            let more = ["--width", width, "--format", format];
            Line::parse_from(line.iter().chain(&more)).args.options(&engine).map_err(|e| e.to_string())
        };
        let error = options("7680", "csv,video").unwrap_err();
        assert!(error.contains("a video has at most 3840×2160 pixels"), "{error}");
        assert!(error.contains("Give `--width 2880`."), "{error}");
        assert_eq!(options("2880", "csv,video").unwrap().width_px, Some(2880));
        options("7680", "csv,overlay").unwrap();
    }

    #[test]
    fn every_format_has_a_name_on_the_command_line() {
        let line = |format| {
            Line::try_parse_from(["export", "s", "--prompt", "liver", "-o", "out", "--format", format])
        };
        for format in Format::ALL {
            assert_eq!(line(format.name()).unwrap_or_else(|e| panic!("{e}")).args.format, [format]);
        }
        assert!(line("mpeg").err().unwrap().to_string().contains("sheet"));
    }

    #[test]
    fn masks_are_cleaned_up_unless_they_are_to_stay_raw() {
        let clean_up = |words: &[&str]| {
            let line = ["export", "s", "--prompt", "liver", "-o", "out"];
            Line::parse_from(line.iter().chain(words)).args.clean_up.clean_up(854, 480)
        };
        assert_eq!(clean_up(&[]), CleanUp::usual(854, 480));
        assert!(clean_up(&["--raw"]).is_off());
        for none in ["--min-area", "--fill-holes", "--round", "--grow", "--smooth"] {
            assert!(clean_up(&[none, "0"]).is_off(), "{none}");
        }
        assert_eq!(clean_up(&["--round", "2"]), CleanUp { round_px: 2, ..Default::default() });
        assert_eq!(clean_up(&["--smooth", "5"]), CleanUp { smooth_frames: MAX_SMOOTH, ..Default::default() });
        for wrong in [["--raw", "--grow=1"], ["--smooth", "6"]] {
            let line = ["export", "s", "--prompt", "liver", "-o", "out"];
            assert!(Line::try_parse_from(line.iter().chain(&wrong)).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn every_style_has_a_name_on_the_command_line() {
        for style in OverlayStyle::ALL {
            let line = ["export", "s", "--prompt", "liver", "-o", "out", "--style", style.name()];
            assert_eq!(Line::parse_from(line).args.style, style);
        }
    }
}
