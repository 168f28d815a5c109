//! The formats of exported files. Names, help and labels of a format are a row of one table. Its files are
//! made in `pictures` if they are about single frames, else in `series`.

/// Files that a format has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Files {
    /// One per frame.
    PerFrame,
    /// One per frame and prompt.
    PerFrameAndPrompt,
    /// One about all frames.
    Series,
}

/// Purpose of a format: the groups in which the window offers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormatGroup {
    /// A picture of every frame.
    Pictures,
    /// To show.
    Show,
    /// To measure and to compute with.
    Data,
}

impl FormatGroup {
    /// All groups, in the order of the window.
    pub const ALL: [Self; 3] = [Self::Pictures, Self::Show, Self::Data];

    /// Returns the heading of the group.
    pub fn label(self) -> &'static str {
        match self {
            Self::Pictures => "A picture of every frame",
            Self::Show => "To show",
            Self::Data => "To measure and to compute with",
        }
    }

    /// Returns the formats of the group, in the order of the window.
    pub fn formats(self) -> Vec<Format> {
        let mut formats: Vec<_> = Format::ALL.into_iter().filter(|f| f.row().place.0 == self).collect();
        formats.sort_by_key(|f| f.row().place.1);
        formats
    }
}

/// Facts about a format.
struct Row {
    name: &'static str,
    extension: &'static str,
    files: Files,
    about: &'static str,
    /// Group and position in the window.
    place: (FormatGroup, u8),
    label: &'static str,
    tip: &'static str,
}

/// Declares the formats in the order of their files: name on the command line, extension, files, and one line
/// about them; then group and position, label and tip in the window.
macro_rules! formats {
    ($($(#[$doc:meta])* $format:ident $name:literal . $extension:literal $files:ident $about:literal
        [$group:ident $place:literal] $label:literal $tip:literal)*) => {
        /// Format of exported files; each format has its own folder. Some formats have a file per frame (and
        /// prompt), others have one file about all frames of the export.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum Format {
            $($(#[$doc])* $format,)*
        }

        /// One row per format, in the order of the enum.
        const ROWS: [Row; [$($name),*].len()] = [$(Row {
            name: $name,
            extension: $extension,
            files: Files::$files,
            about: $about,
            place: (FormatGroup::$group, $place),
            label: $label,
            tip: $tip,
        }),*];

        impl Format {
            /// All formats, in the order of files.
            pub const ALL: [Self; ROWS.len()] = [$(Self::$format),*];
        }
    };
}

formats! {
    /// RGBA PNG per prompt, straight alpha 0 or 255; pixels that are cut away are black.
    Cutout "cutout"."png" PerFrameAndPrompt "RGBA PNG per frame and prompt: what was found, the rest transparent"
        [Pictures 2] "Cut-outs" "Only what was found, the rest transparent"
    /// RGB PNG of the frame with all prompts drawn over it, and the research-use stamp.
    Overlay "overlay"."png" PerFrame "PNG per frame: all prompts drawn over it"
        [Pictures 1] "Overlay pictures" "The frame with what was found drawn over it, marked for research use"
    /// 8-bit grey PNG per prompt: 255 where found, else 0.
    Binary "binary"."png" PerFrameAndPrompt "PNG per frame and prompt: 255 where found, else 0"
        [Pictures 3] "Masks" "One per prompt, white where found"
    /// 8-bit grey PNG of label ids, 0 = nothing; `labels.json` names them. A pixel has the best prompt's id.
    Index "index"."png" PerFrame "PNG per frame: label ids, named in labels.json"
        [Pictures 4] "Label pictures" "One number per prompt, named in labels.json"
    /// SVG of the border lines of the found regions, along the pixels' edges.
    Outline "outline"."svg" PerFrame "SVG per frame: border lines of what was found"
        [Pictures 5] "Outlines" "The borders as lines that can be scaled and recoloured (SVG)"
    /// 16-bit grey PNG per prompt: the score times 65535, rounded; NaN is 0.
    Score "score"."png" PerFrameAndPrompt "16-bit PNG per frame and prompt: score times 65535"
        [Data 5] "Score pictures" "The similarity score as grey, 16 bits"
    /// NumPy array per prompt: the unchanged scores, f32, rows × columns.
    Npy "npy"."npy" PerFrameAndPrompt "NumPy file per frame and prompt: scores as f32"
        [Data 6] "Score arrays" "The similarity score as numbers (NumPy)"
    /// YOLO's segmentation labels: a polygon per part that was found, in shares of the picture.
    Yolo "yolo"."txt" PerFrame "YOLO labels per frame: polygons in shares of the picture, named in data.yaml"
        [Data 7] "YOLO labels" "Polygons to train YOLO with; masks are not kept to the pixel"
    /// H.264 video of the overlays.
    Video "video"."mp4" Series "one H.264 mp4 of the overlays"
        [Show 1] "Video" "The overlay pictures as a film that plays everywhere (mp4)"
    /// Small animated GIF of the overlays; it skips frames if there are many.
    Gif "gif"."gif" Series "one small animated GIF of the overlays"
        [Show 2] "Animation" "A small film for slides (GIF)"
    /// One PNG with small overlays of evenly spread frames.
    Sheet "sheet"."png" Series "one PNG with small overlays of up to 24 frames"
        [Show 3] "Contact sheet" "Up to 24 frames side by side on one picture"
    /// CSV table: area, scores, centroid and motion per frame and prompt.
    Csv "csv"."csv" Series "one table: area, scores, centroid and motion per frame and prompt"
        [Data 1] "Table" "How much of each frame every prompt covers, where, and how far it moved, for a spreadsheet (CSV)"
    /// The same table as JSON.
    Json "json"."json" Series "the same table as JSON"
        [Data 2] "Table (JSON)" "The same for programs"
    /// COCO annotations: one per frame and prompt that was found on it, compressed column-major run lengths.
    Coco "coco"."json" Series "one COCO JSON: a run-length mask, box and area per frame and prompt"
        [Data 4] "COCO annotations" "Masks as most programs that learn from pictures read them (JSON)"
    /// CVAT for video: one track per mask, run lengths inside its box.
    Cvat "cvat"."xml" Series "one XML of CVAT for video: a mask per frame and prompt"
        [Data 8] "CVAT annotations" "Masks to correct in CVAT (XML for video)"
    /// Label Studio's tasks, one per frame, with brush masks as predictions.
    LabelStudio "label-studio"."json" Series "one JSON of Label Studio's tasks: brush masks as predictions"
        [Data 9] "Label Studio tasks" "Masks to correct in Label Studio (JSON)"
    /// Segmentation of 3-D Slicer: a volume of x, y and frame.
    Nrrd "nrrd"."seg.nrrd" Series "one .seg.nrrd for 3D Slicer: a volume of x, y and frame"
        [Data 3] "3D Slicer segmentation" "One volume of all frames with names and colours (.seg.nrrd)"
    /// Segmentation object of DICOM: a segment per prompt, with references to the recording if that is DICOM.
    DicomSeg "dicom-seg"."dcm" Series "one DICOM segmentation: a segment per prompt, with codes and references"
        [Data 7] "DICOM segmentation" "One object for archives and viewers of hospitals (DICOM SEG)"
}

impl Format {
    fn row(self) -> &'static Row {
        &ROWS[self as usize]
    }

    /// Returns the format's name on the command line, which is also its folder inside the export.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// Describes the format in one line.
    pub fn about(self) -> &'static str {
        self.row().about
    }

    /// Returns the format's name in the window, and an explanation.
    pub fn label(self) -> (&'static str, &'static str) {
        (self.row().label, self.row().tip)
    }

    /// Returns the extension of its files' names.
    pub fn extension(self) -> &'static str {
        self.row().extension
    }

    /// Returns `true` if its files show the pictures that are masked.
    pub fn draws_pictures(self) -> bool {
        matches!(self, Self::Cutout | Self::Overlay | Self::Video | Self::Gif | Self::Sheet)
    }

    /// Returns `true` if there is one file per frame and prompt.
    pub fn is_per_frame_and_prompt(self) -> bool {
        self.row().files == Files::PerFrameAndPrompt
    }

    /// Returns `true` if there is one file about all frames.
    pub fn is_series(self) -> bool {
        self.row().files == Files::Series
    }
}

/// Returns the number of files that an export writes, without `provenance.json` and `labels.json`. Without a
/// prompt, there are none.
pub fn num_files(formats: &[Format], frames: usize, prompts: usize) -> usize {
    if prompts == 0 {
        return 0;
    }
    let of_format = |format: &Format| match (format.is_series(), format.is_per_frame_and_prompt()) {
        (true, _) => 1,
        (false, true) => frames * prompts,
        (false, false) => frames,
    };
    Format::ALL.iter().filter(|f| formats.contains(f)).map(of_format).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_prompt_nothing_is_written() {
        let formats = [Format::Overlay, Format::Binary, Format::Csv];
        assert_eq!([0, 1, 2].map(|prompts| num_files(&formats, 10, prompts)), [0, 21, 31]);
    }

    #[test]
    fn every_format_is_offered_once_under_its_own_name() {
        let mut offered: Vec<Format> = FormatGroup::ALL.into_iter().flat_map(FormatGroup::formats).collect();
        offered.sort();
        assert_eq!(offered, Format::ALL);
        for format in Format::ALL {
            assert_eq!(serde_json::to_value(format).unwrap(), format.name());
            assert!(
                !format.about().is_empty() && !format.label().0.is_empty() && !format.label().1.is_empty()
            );
        }
    }
}
