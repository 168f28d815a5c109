//! Identifiers of the files that a recording comes from. They are read when a segmentation, which refers to
//! them, is written or read, and kept nowhere else.

use super::object::Object;
use crate::{
    Result,
    annotations::References,
    dicom::{
        read,
        tag::{self, Tag},
    },
};
use std::path::PathBuf;

const WANTED: [Tag; 7] = [
    tag::SOP_CLASS,
    tag::SOP_INSTANCE,
    tag::STUDY_INSTANCE,
    tag::SERIES_INSTANCE,
    tag::LOSSY,
    tag::LOSSY_RATIO,
    tag::LOSSY_METHOD,
];

/// The files that a recording comes from, and the frame of a file for each of its own.
#[derive(Clone, Debug)]
pub(in crate::sequence) struct Origin {
    files: Vec<PathBuf>,
    frames: Vec<SourceFrame>,
    pub spacing_mm: Option<[f64; 2]>,
}

/// A frame of a DICOM file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceFrame {
    /// Place of the file among [`SourceReferences::instances`].
    pub instance: usize,
    /// Number of the frame in the file, from 1; `None` if it holds a single one.
    pub number: Option<u32>,
}

/// Identifiers of a DICOM file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceInstance {
    /// Its SOP class.
    pub class_uid: String,
    /// Its SOP instance.
    pub instance_uid: String,
}

/// Identifiers of the DICOM files that a recording comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceReferences {
    /// The study.
    pub study_uid: Option<String>,
    /// The series.
    pub series_uid: String,
    /// The files.
    pub instances: Vec<SourceInstance>,
    /// The frame of a file for each frame of the recording.
    pub frames: Vec<SourceFrame>,
    /// Distance of pixel centres in millimetres, of rows and of columns.
    pub spacing_mm: Option<[f64; 2]>,
    /// Ratio and method of the compression that lost something, if the files say so.
    pub lossy: Option<(String, String)>,
}

impl SourceReferences {
    /// Returns the SHA-256 over everything in it, hexadecimal.
    pub fn digest(&self) -> String {
        crate::hash::sha256(format!("{self:?}").as_bytes())
    }

    /// Returns the frames of the recording by the files that they come from. The only frame of a file is found
    /// without a number, and as the first one.
    pub(crate) fn by_file(&self) -> References {
        let names = |(i, source): (usize, &SourceFrame)| {
            let instance = &self.instances[source.instance].instance_uid;
            [source.number, source.number.or(Some(1))].map(|number| ((instance.clone(), number), i))
        };
        self.frames.iter().enumerate().flat_map(names).collect()
    }
}

impl Origin {
    pub(super) fn of(series: &[Object]) -> Self {
        let frames = series.iter().enumerate().flat_map(|(instance, object)| {
            let number = |i: usize| (object.num_frames > 1).then_some(i as u32 + 1);
            (0..object.num_frames).map(move |i| SourceFrame { instance, number: number(i) })
        });
        let files = series.iter().map(|object| object.path.clone()).collect();
        Self { files, frames: frames.collect(), spacing_mm: None }
    }

    /// Returns the origin of frames of a video, given by their numbers from 0.
    pub(super) fn of_video(object: &Object, numbers: Vec<u32>) -> Self {
        let frame = |number: u32| SourceFrame { instance: 0, number: Some(number + 1) };
        let frames = numbers.into_iter().map(frame).collect();
        Self { files: vec![object.path.clone()], frames, spacing_mm: None }
    }

    /// Keeps only some frames.
    pub(in crate::sequence) fn select(&mut self, indices: &[usize]) {
        self.frames = indices.iter().filter_map(|&i| self.frames.get(i).copied()).collect();
    }

    /// Returns the files.
    pub(in crate::sequence) fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Reads the identifiers; `None` if the files do not have those that a reference needs.
    pub(in crate::sequence) fn references(&self) -> Result<Option<SourceReferences>> {
        let mut references = SourceReferences {
            study_uid: None,
            series_uid: String::new(),
            instances: Vec::with_capacity(self.files.len()),
            frames: self.frames.clone(),
            spacing_mm: self.spacing_mm,
            lossy: None,
        };
        for file in &self.files {
            let set = read(file, &WANTED)?.set;
            let uid = |tag| set.text(tag).filter(|uid| is_uid(uid));
            let (class, instance) = (uid(tag::SOP_CLASS), uid(tag::SOP_INSTANCE));
            let (Some(class_uid), Some(instance_uid), Some(series_uid)) =
                (class, instance, uid(tag::SERIES_INSTANCE))
            else {
                return Ok(None);
            };
            references.study_uid = uid(tag::STUDY_INSTANCE);
            references.series_uid = series_uid;
            references.lossy = set.text(tag::LOSSY_RATIO).zip(set.text(tag::LOSSY_METHOD));
            references.lossy.take_if(|_| set.text(tag::LOSSY).as_deref() != Some("01"));
            references.instances.push(SourceInstance { class_uid, instance_uid });
        }
        Ok(Some(references))
    }
}

/// Returns `true` for a text of the form of an identifier (PS3.5, 9.1).
fn is_uid(text: &str) -> bool {
    text.len() <= 64 && text.bytes().all(|b| b.is_ascii_digit() || b == b'.')
}
