//! Everything of a segmentation but its pixels, in the order of tags (PS3.3, A.51).

use super::{
    Content, MOST_FRACTION, SegFrame,
    codes::{self, Code},
};
use crate::{
    dicom::{
        Vr, Writer, colour,
        tag::{self, Tag},
    },
    export::{ExportPrompt, SegType},
};
use std::io::{self, Write};

/// A date and a time must be there, and a clock would make equal exports differ: this is no date of anything.
const NO_DATE: &str = "19700101";
const NO_TIME: &str = "000000";
/// Every segmentation must lie in space, and a video does not: pixels of unknown size and frames are 1 mm
/// apart.
const NO_LENGTH: &str =
    "No length in this object is measured: frames, and pixels of unknown size, count as 1 mm.";
/// Most characters of a long string and of a short one (PS3.5, 6.2).
const LONG: usize = 64;
const SHORT: usize = 16;

pub(super) fn write<W: Write>(w: &mut Writer<W>, content: &Content<'_>) -> io::Result<()> {
    let instance = content.own_uid("instance");
    w.begin_file(content.class_uid(), &instance)?;
    write_general(w, content, &instance)?;
    write_numbers(w, content, &instance)?;
    write_image(w, content)?;
    write_segments(w, content)?;
    w.sequence(tag::SHARED_GROUPS, |w| w.item(|w| shared_groups(w, content)))?;
    w.sequence(tag::PER_FRAME_GROUPS, |w| {
        content.frames.iter().try_for_each(|frame| w.item(|w| frame_groups(w, content, *frame)))
    })
}

/// Writes what comes before the numbers of study and series; of the patient, nothing but empty attributes.
fn write_general<W: Write>(w: &mut Writer<W>, content: &Content<'_>, instance: &str) -> io::Result<()> {
    let version = env!("CARGO_PKG_VERSION");
    w.text(tag::CHARACTER_SET, Vr::Cs, "ISO_IR 192")?;
    w.text(tag::IMAGE_TYPE, Vr::Cs, "DERIVED\\PRIMARY")?;
    w.text(tag::SOP_CLASS, Vr::Ui, content.class_uid())?;
    w.text(tag::SOP_INSTANCE, Vr::Ui, instance)?;
    w.text(tag::STUDY_DATE, Vr::Da, "")?;
    w.text(tag::CONTENT_DATE, Vr::Da, NO_DATE)?;
    w.text(tag::STUDY_TIME, Vr::Tm, "")?;
    w.text(tag::CONTENT_TIME, Vr::Tm, NO_TIME)?;
    w.text(tag::ACCESSION_NUMBER, Vr::Sh, "")?;
    w.text(tag::MODALITY, Vr::Cs, "SEG")?;
    w.text(tag::MANUFACTURER, Vr::Lo, "SurgTPGS")?;
    w.text(tag::REFERRING_PHYSICIAN, Vr::Pn, "")?;
    w.text(tag::SERIES_DESCRIPTION, Vr::Lo, "SurgTPGS segmentation, research use only")?;
    w.text(tag::MODEL_NAME, Vr::Lo, "SurgTPGS")?;
    if let Some(sources) = content.sources {
        w.one(tag::REFERENCED_SERIES, |w| {
            w.sequence(tag::REFERENCED_INSTANCES, |w| {
                sources.instances.iter().try_for_each(|source| {
                    w.item(|w| {
                        w.text(tag::REFERENCED_SOP_CLASS, Vr::Ui, &source.class_uid)?;
                        w.text(tag::REFERENCED_SOP_INSTANCE, Vr::Ui, &source.instance_uid)
                    })
                })
            })?;
            w.text(tag::SERIES_INSTANCE, Vr::Ui, &sources.series_uid)
        })?;
    }
    w.text(tag::PATIENT_NAME, Vr::Pn, "")?;
    w.text(tag::PATIENT_ID, Vr::Lo, "")?;
    w.text(tag::PATIENT_BIRTH_DATE, Vr::Da, "")?;
    w.text(tag::PATIENT_SEX, Vr::Cs, "")?;
    w.text(tag::SERIAL_NUMBER, Vr::Lo, &content.provenance.scene_sha256)?;
    w.text(tag::SOFTWARE_VERSIONS, Vr::Lo, version)
}

/// Writes study, series, number and dimensions.
fn write_numbers<W: Write>(w: &mut Writer<W>, content: &Content<'_>, instance: &str) -> io::Result<()> {
    let study = content.sources.and_then(|sources| sources.study_uid.clone());
    w.text(tag::STUDY_INSTANCE, Vr::Ui, &study.unwrap_or_else(|| content.own_uid("study")))?;
    w.text(tag::SERIES_INSTANCE, Vr::Ui, &content.own_uid("series"))?;
    w.text(tag::STUDY_ID, Vr::Sh, "")?;
    w.text(tag::SERIES_NUMBER, Vr::Is, "1")?;
    w.text(tag::INSTANCE_NUMBER, Vr::Is, "1")?;
    w.text(tag::PATIENT_ORIENTATION, Vr::Cs, "")?;
    w.text(tag::FRAME_OF_REFERENCE, Vr::Ui, &content.own_uid("frame of reference"))?;
    w.text(tag::POSITION_REFERENCE, Vr::Lo, "")?;
    let comments = format!("{} {NO_LENGTH}", content.provenance.intended_use);
    w.text(tag::IMAGE_COMMENTS, Vr::Lt, &comments)?;
    let organisation = content.own_uid(&format!("dimensions of {instance}"));
    w.one(tag::DIMENSION_ORGANIZATION, |w| w.text(tag::DIMENSION_ORGANIZATION_UID, Vr::Ui, &organisation))?;
    let dimension = |w: &mut Writer<W>, (group, to): (Tag, Tag), label: &str| {
        w.item(|w| {
            w.text(tag::DIMENSION_ORGANIZATION_UID, Vr::Ui, &organisation)?;
            w.pointer(tag::DIMENSION_INDEX_POINTER, to)?;
            w.pointer(tag::FUNCTIONAL_GROUP_POINTER, group)?;
            w.text(tag::DIMENSION_LABEL, Vr::Lo, label)
        })
    };
    w.sequence(tag::DIMENSION_INDEX, |w| {
        if content.seg_type() != SegType::Labelmap {
            let segment = (tag::SEGMENT_IDENTIFICATION, tag::REFERENCED_SEGMENT);
            dimension(w, segment, "Segment")?;
        }
        dimension(w, (tag::FRAME_CONTENT, tag::TEMPORAL_POSITION), "Frame of the recording")
    })
}

/// Writes the form of the pixels.
fn write_image<W: Write>(w: &mut Writer<W>, content: &Content<'_>) -> io::Result<()> {
    let bits = if content.seg_type() == SegType::Binary { 1 } else { 8 };
    let (columns, rows) = content.size;
    w.shorts(tag::SAMPLES_PER_PIXEL, &[1])?;
    w.text(tag::PHOTOMETRIC, Vr::Cs, "MONOCHROME2")?;
    w.text(tag::NUMBER_OF_FRAMES, Vr::Is, &content.frames.len().to_string())?;
    w.shorts(tag::ROWS, &[rows as u16])?;
    w.shorts(tag::COLUMNS, &[columns as u16])?;
    w.shorts(tag::BITS_ALLOCATED, &[bits])?;
    w.shorts(tag::BITS_STORED, &[bits])?;
    w.shorts(tag::HIGH_BIT, &[bits - 1])?;
    w.shorts(tag::PIXEL_REPRESENTATION, &[0])?;
    if content.seg_type() == SegType::Labelmap {
        w.shorts(tag::PIXEL_PADDING, &[0])?;
    }
    let lossy = content.sources.and_then(|sources| sources.lossy.as_ref());
    w.text(tag::LOSSY, Vr::Cs, if lossy.is_some() { "01" } else { "00" })?;
    if let Some((ratio, method)) = lossy {
        w.text(tag::LOSSY_RATIO, Vr::Ds, ratio)?;
        w.text(tag::LOSSY_METHOD, Vr::Cs, method)?;
    }
    Ok(())
}

/// Writes the segments, and the facts about all of them.
fn write_segments<W: Write>(w: &mut Writer<W>, content: &Content<'_>) -> io::Result<()> {
    let kind = match content.seg_type() {
        SegType::Binary => "BINARY",
        SegType::Fractional => "FRACTIONAL",
        SegType::Labelmap => "LABELMAP",
    };
    w.text(tag::SEGMENTATION_TYPE, Vr::Cs, kind)?;
    w.sequence(tag::SEGMENTS, |w| {
        if content.seg_type() == SegType::Labelmap {
            w.item(background)?;
        }
        let prompts = content.provenance.prompts.iter().enumerate();
        prompts.map(|(i, p)| (i as u16 + 1, p)).try_for_each(|(n, p)| w.item(|w| segment(w, content, n, p)))
    })?;
    if content.seg_type() == SegType::Fractional {
        w.shorts(tag::MAXIMUM_FRACTION, &[MOST_FRACTION])?;
        w.text(tag::FRACTIONAL_TYPE, Vr::Cs, "PROBABILITY")?;
    }
    let overlap = match content.seg_type() {
        SegType::Binary if content.has_overlap => "YES",
        SegType::Binary | SegType::Labelmap => "NO",
        SegType::Fractional => "UNDEFINED",
    };
    w.text(tag::SEGMENTS_OVERLAP, Vr::Cs, overlap)?;
    w.text(tag::CONTENT_LABEL, Vr::Cs, "SURGTPGS")?;
    w.text(tag::CONTENT_DESCRIPTION, Vr::Lo, &long(&content.provenance.intended_use))?;
    w.text(tag::CONTENT_CREATOR, Vr::Pn, "")
}

/// Writes the segment of pixels in which nothing was found.
fn background<W: Write>(w: &mut Writer<W>) -> io::Result<()> {
    let (value, meaning) = codes::BACKGROUND;
    let code = codes::of(codes::DICOM, value, meaning);
    w.one(tag::CATEGORY_CODE, |w| write_code(w, &code))?;
    w.shorts(tag::SEGMENT_NUMBER, &[0])?;
    w.text(tag::SEGMENT_LABEL, Vr::Lo, meaning)?;
    w.text(tag::SEGMENT_ALGORITHM_TYPE, Vr::Cs, "AUTOMATIC")?;
    w.text(tag::SEGMENT_ALGORITHM_NAME, Vr::Lo, "SurgTPGS")?;
    w.one(tag::TYPE_CODE, |w| write_code(w, &code))
}

fn segment<W: Write>(
    w: &mut Writer<W>,
    content: &Content<'_>,
    number: u16,
    prompt: &ExportPrompt,
) -> io::Result<()> {
    let (category, kind) = codes::of_prompt(prompt);
    let has_marks = content.provenance.marks_sha256.is_some();
    w.one(tag::CATEGORY_CODE, |w| write_code(w, &category))?;
    w.shorts(tag::SEGMENT_NUMBER, &[number])?;
    w.text(tag::SEGMENT_LABEL, Vr::Lo, &long(&prompt.text))?;
    w.one(tag::ALGORITHM_IDENTIFICATION, |w| {
        let family = codes::of(codes::DICOM, "123110", "Artificial Intelligence");
        w.one(tag::ALGORITHM_FAMILY, |w| write_code(w, &family))?;
        w.text(tag::ALGORITHM_VERSION, Vr::Lo, env!("CARGO_PKG_VERSION"))?;
        let (encoder, threshold) = (&content.provenance.encoder, prompt.threshold);
        let parameters = format!("text encoder {encoder}, found above {threshold}");
        w.text(tag::ALGORITHM_PARAMETERS, Vr::Lt, &parameters)?;
        w.text(tag::ALGORITHM_NAME, Vr::Lo, "SurgTPGS")
    })?;
    w.text(tag::SEGMENT_ALGORITHM_TYPE, Vr::Cs, if has_marks { "SEMIAUTOMATIC" } else { "AUTOMATIC" })?;
    w.text(tag::SEGMENT_ALGORITHM_NAME, Vr::Lo, "SurgTPGS")?;
    w.shorts(tag::DISPLAY_COLOUR, &colour::lab(prompt.colour))?;
    w.one(tag::TYPE_CODE, |w| write_code(w, &kind))
}

fn write_code<W: Write>(w: &mut Writer<W>, code: &Code) -> io::Result<()> {
    w.text(tag::CODE_VALUE, Vr::Sh, &limited(&code.value, SHORT))?;
    w.text(tag::CODE_SCHEME, Vr::Sh, code.scheme)?;
    w.text(tag::CODE_MEANING, Vr::Lo, &long(&code.meaning))
}

/// Writes what all frames share: the distance of pixels, and their axes.
fn shared_groups<W: Write>(w: &mut Writer<W>, content: &Content<'_>) -> io::Result<()> {
    let [rows, columns] = content.sources.and_then(|sources| sources.spacing_mm).unwrap_or([1.0; 2]);
    w.one(tag::PLANE_ORIENTATION, |w| w.text(tag::IMAGE_ORIENTATION, Vr::Ds, "1\\0\\0\\0\\1\\0"))?;
    w.one(tag::PIXEL_MEASURES, |w| {
        w.text(tag::SLICE_THICKNESS, Vr::Ds, "1")?;
        w.text(tag::PIXEL_SPACING, Vr::Ds, &format!("{}\\{}", decimal(rows), decimal(columns)))
    })
}

/// Writes what belongs to one frame: the recorded frame that it is about, its place, and its segment.
fn frame_groups<W: Write>(w: &mut Writer<W>, content: &Content<'_>, frame: SegFrame) -> io::Result<()> {
    let source = content.sources.and_then(|s| Some((s, *s.frames.get(frame.frame)?)));
    if source.is_none() {
        w.sequence(tag::DERIVATION_IMAGES, |_| Ok(()))?;
    }
    if let Some((sources, source)) = source {
        let instance = &sources.instances[source.instance];
        let derivation = codes::of(codes::DICOM, "113076", "Segmentation");
        let purpose = codes::of(codes::DICOM, "121322", "Source image for image processing operation");
        w.one(tag::DERIVATION_IMAGES, |w| {
            w.one(tag::SOURCE_IMAGES, |w| {
                w.text(tag::REFERENCED_SOP_CLASS, Vr::Ui, &instance.class_uid)?;
                w.text(tag::REFERENCED_SOP_INSTANCE, Vr::Ui, &instance.instance_uid)?;
                if let Some(number) = source.number {
                    w.text(tag::REFERENCED_FRAME, Vr::Is, &number.to_string())?;
                }
                w.one(tag::PURPOSE_OF_REFERENCE, |w| write_code(w, &purpose))
            })?;
            w.one(tag::DERIVATION_CODE, |w| write_code(w, &derivation))
        })?;
    }
    let position = frame.frame as u32 + 1;
    w.one(tag::FRAME_CONTENT, |w| {
        w.longs(tag::TEMPORAL_POSITION, &[position])?;
        match content.seg_type() {
            SegType::Labelmap => w.longs(tag::DIMENSION_INDEX_VALUES, &[position]),
            _ => w.longs(tag::DIMENSION_INDEX_VALUES, &[u32::from(frame.segment), position]),
        }
    })?;
    let place = format!("0\\0\\{}", frame.frame);
    w.one(tag::PLANE_POSITION, |w| w.text(tag::IMAGE_POSITION, Vr::Ds, &place))?;
    if content.seg_type() == SegType::Labelmap {
        return Ok(());
    }
    w.one(tag::SEGMENT_IDENTIFICATION, |w| w.shorts(tag::REFERENCED_SEGMENT, &[frame.segment]))
}

/// Returns a number of millimetres as a decimal string, which has at most 16 characters.
fn decimal(millimetres: f64) -> String {
    limited(&format!("{millimetres:.8}"), SHORT)
}

/// Returns a text as a long string.
fn long(text: &str) -> String {
    limited(text, LONG)
}

/// Returns a text without what strings of DICOM must not hold, of at most `most` characters.
fn limited(text: &str, most: usize) -> String {
    let plain = |c: char| if c == '\\' || c.is_control() { ' ' } else { c };
    text.chars().map(plain).take(most).collect::<String>().trim().to_owned()
}
