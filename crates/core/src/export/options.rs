//! Options of an export.

use crate::{mask::CleanUp, overlay::OverlayLook};

/// Format of exported files; each format has its own folder. Some formats have a file per frame (and
/// prompt), others have one file about all frames of the export.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// RGBA PNG per prompt, straight alpha 0 or 255; pixels that are cut away are black.
    Cutout,
    /// RGB PNG of the frame with all prompts drawn over it, and the research-use stamp.
    Overlay,
    /// 8-bit grey PNG per prompt: 255 where found, else 0.
    Binary,
    /// 8-bit grey PNG of label ids, 0 = nothing; `labels.json` names them. A pixel has the best prompt's id.
    Index,
    /// SVG of the border lines of the found regions, along the pixels' edges.
    Outline,
    /// 16-bit grey PNG per prompt: the score times 65535, rounded; NaN is 0.
    Score,
    /// NumPy array per prompt: the unchanged scores, f32, rows × columns.
    Npy,
    /// H.264 video of the overlays.
    Video,
    /// Small animated GIF of the overlays; it skips frames if there are many.
    Gif,
    /// One PNG with small overlays of evenly spread frames.
    Sheet,
    /// CSV table: area, scores, centroid and motion per frame and prompt.
    Csv,
    /// The same table as JSON.
    Json,
    /// COCO annotations: one per frame and prompt that was found on it, compressed column-major run lengths.
    Coco,
    /// Segmentation of 3-D Slicer: a volume of x, y and frame.
    Nrrd,
}

impl Format {
    /// All formats, in the order of files.
    pub const ALL: [Self; 14] = [
        Self::Cutout,
        Self::Overlay,
        Self::Binary,
        Self::Index,
        Self::Outline,
        Self::Score,
        Self::Npy,
        Self::Video,
        Self::Gif,
        Self::Sheet,
        Self::Csv,
        Self::Json,
        Self::Coco,
        Self::Nrrd,
    ];

    /// Returns the format's name on the command line, which is also its folder inside the export.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cutout => "cutout",
            Self::Overlay => "overlay",
            Self::Binary => "binary",
            Self::Index => "index",
            Self::Outline => "outline",
            Self::Score => "score",
            Self::Npy => "npy",
            Self::Video => "video",
            Self::Gif => "gif",
            Self::Sheet => "sheet",
            Self::Csv => "csv",
            Self::Json => "json",
            Self::Coco => "coco",
            Self::Nrrd => "nrrd",
        }
    }

    /// Describes the format in one line.
    pub fn about(self) -> &'static str {
        match self {
            Self::Cutout => "RGBA PNG per frame and prompt: what was found, the rest transparent",
            Self::Overlay => "PNG per frame: all prompts drawn over it",
            Self::Binary => "PNG per frame and prompt: 255 where found, else 0",
            Self::Index => "PNG per frame: label ids, named in labels.json",
            Self::Outline => "SVG per frame: border lines of what was found",
            Self::Score => "16-bit PNG per frame and prompt: score times 65535",
            Self::Npy => "NumPy file per frame and prompt: scores as f32",
            Self::Video => "one H.264 mp4 of the overlays",
            Self::Gif => "one small animated GIF of the overlays",
            Self::Sheet => "one PNG with small overlays of up to 24 frames",
            Self::Csv => "one table: area, scores, centroid and motion per frame and prompt",
            Self::Json => "the same table as JSON",
            Self::Coco => "one COCO JSON: a run-length mask, box and area per frame and prompt",
            Self::Nrrd => "one .seg.nrrd for 3D Slicer: a volume of x, y and frame",
        }
    }

    /// Returns the extension of its files' names.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Cutout | Self::Overlay | Self::Binary | Self::Index | Self::Score | Self::Sheet => "png",
            Self::Outline => "svg",
            Self::Npy => "npy",
            Self::Video => "mp4",
            Self::Gif => "gif",
            Self::Csv => "csv",
            Self::Json | Self::Coco => "json",
            Self::Nrrd => "seg.nrrd",
        }
    }

    /// Returns `true` if there is one file per prompt, not one per frame.
    pub fn is_per_prompt(self) -> bool {
        matches!(self, Self::Cutout | Self::Binary | Self::Score | Self::Npy)
    }

    /// Returns `true` if there is one file about all frames.
    pub fn is_series(self) -> bool {
        matches!(
            self,
            Self::Video | Self::Gif | Self::Sheet | Self::Csv | Self::Json | Self::Coco | Self::Nrrd
        )
    }
}

/// Pictures that the masks are applied to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureSource {
    /// The recorded frames.
    #[default]
    Original,
    /// The frames as the scene renders them.
    Reconstruction,
}

/// Options of an export.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct ExportOptions {
    /// Formats to write.
    pub formats: Vec<Format>,
    /// Pictures that the masks are applied to. This is only recorded: the caller supplies the pictures.
    pub source: PictureSource,
    /// `true` if a pixel belongs to at most one prompt (the one with the best score).
    pub exclusive: bool,
    /// `true` if pictures with prompts drawn over them say "research use only".
    pub stamp: bool,
    /// Style of the overlays.
    #[serde(flatten)]
    pub look: OverlayLook,
    /// Clean-up of masks before anything is written. Scores are written without it, apart from
    /// smoothing over time.
    pub clean_up: CleanUp,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            formats: vec![Format::Cutout, Format::Overlay],
            source: PictureSource::Original,
            exclusive: false,
            stamp: true,
            look: OverlayLook::default(),
            clean_up: CleanUp::default(),
        }
    }
}

/// Returns the number of files that an export writes, without `provenance.json` and `labels.json`.
pub fn num_files(formats: &[Format], frames: usize, prompts: usize) -> usize {
    let of_format = |format: &Format| match (format.is_series(), format.is_per_prompt()) {
        (true, _) => 1,
        (false, true) => frames * prompts,
        (false, false) => frames,
    };
    Format::ALL.iter().filter(|f| formats.contains(f)).map(of_format).sum()
}

/// One prompt of an export.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ExportPrompt {
    /// The words as typed.
    pub text: String,
    /// Score above which a pixel is found.
    pub threshold: f32,
    /// Colour in overlays and `labels.json` (sRGB).
    pub colour: [u8; 3],
    /// Phrases that the prompt was compared with.
    pub negatives: Vec<String>,
    /// `true` if its regions lie over those of the other prompts.
    #[serde(default)]
    pub is_instrument: bool,
}
