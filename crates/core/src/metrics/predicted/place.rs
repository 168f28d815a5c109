//! Frame and class of a predicted mask, by the name of its file or by the record of an export.

use super::Prediction;
use crate::{
    export::{ExportedFile, Format, slugs},
    meaning::{ClassWords, Interpreter, Meaning, Vocabulary},
    sequence::{Class, Sequence, plain_words},
};
use std::{collections::HashMap, path::Path};

/// Formats of exports that are masks. Other pictures of an export are passed over.
const MASKS: [Format; 3] = [Format::Binary, Format::Cutout, Format::Index];

/// Returns the format of a file of an export, by the folder that the export wrote it to; `None` if it is no
/// mask.
pub(super) fn mask_format(file: &ExportedFile) -> Option<Format> {
    let (folder, _) = file.name.split_once('/')?;
    MASKS.into_iter().find(|format| format.name() == folder)
}

/// Returns the frame and class of a mask that the record of an export lists.
pub(super) fn place_exported(
    path: &Path,
    file: &ExportedFile,
    format: Format,
    names: &Names<'_>,
) -> Option<(usize, Prediction)> {
    let frame = file.frame.filter(|frame| *frame < names.num_frames)?;
    let path = path.to_owned();
    let prediction = match &file.prompt {
        Some(prompt) if format == Format::Cutout => Prediction::Cutout(names.class(prompt)?, path),
        Some(prompt) => Prediction::OfClass(names.class(prompt)?, path),
        None => Prediction::Labels(path),
    };
    Some((frame, prediction))
}

/// Returns the frame and class of a picture by its name.
pub(super) fn place(path: &Path, root: &Path, names: &Names<'_>) -> Option<(usize, Prediction)> {
    let stem = path.file_stem()?.to_str()?;
    let parent = path.parent().filter(|p| *p != root).and_then(|p| p.file_name()).and_then(|n| n.to_str());
    let of_class = |id: u8| Prediction::OfClass(id, path.to_owned());
    let class = |name: &str| names.class(name);
    if let (Some(k), Some(id)) = (parent.and_then(|p| p.parse::<usize>().ok()), class(stem)) {
        let frame = (0..names.num_frames).filter(|&i| Sequence::is_test_frame(i)).nth(k)?;
        return Some((frame, of_class(id)));
    }
    if let Some(id) = parent.and_then(class) {
        return Some((names.frame(stem)?, of_class(id)));
    }
    for (class, slug) in names.classes.iter().zip(&names.slugs) {
        if let Some(frame) = stem.strip_suffix(slug).and_then(|stem| stem.strip_suffix('_')) {
            return Some((names.frame(frame)?, of_class(class.id)));
        }
    }
    if let Some(frame) = names.frame(stem) {
        return Some((frame, Prediction::Labels(path.to_owned())));
    }
    let (frame, words) = stem.rsplit_once('_')?;
    Some((names.frame(frame)?, of_class(class(words)?)))
}

/// The classes of a recording, by their names and by other words for them, and its frames.
pub(super) struct Names<'a> {
    classes: &'a [Class],
    /// Names of the classes as they stand in names of files.
    slugs: Vec<String>,
    interpreter: Interpreter<'static>,
    /// The first frame of each name.
    frames: HashMap<String, usize>,
    num_frames: usize,
}

impl<'a> Names<'a> {
    pub(super) fn of(sequence: &'a Sequence) -> Self {
        let classes = sequence.classes();
        let words: Vec<ClassWords> = classes.iter().map(|class| ClassWords::seen(&class.name, &[])).collect();
        let num_frames = sequence.num_frames();
        Self {
            classes,
            slugs: slugs(classes.iter().map(|class| class.name.as_str())),
            interpreter: Interpreter::new(Vocabulary::standard(), &words, None),
            frames: (0..num_frames).rev().map(|i| (sequence.frame_name(i), i)).collect(),
            num_frames,
        }
    }

    /// Returns the id of the one class that a name means.
    pub(super) fn class(&self, name: &str) -> Option<u8> {
        let words = plain_words(name);
        if let Some(class) = self.classes.iter().find(|class| class.name == words) {
            return Some(class.id);
        }
        let meaning = self.interpreter.by_words(&words).filter(Meaning::is_found)?;
        match meaning.classes[..] {
            [only] => Some(self.classes[only].id),
            _ => None,
        }
    }

    /// Returns the frame that is called so, or whose number, counted from 0, the name ends in.
    fn frame(&self, name: &str) -> Option<usize> {
        let digits = name.len() - name.bytes().rev().take_while(u8::is_ascii_digit).count();
        let by_number = || name[digits..].parse().ok().filter(|i| *i < self.num_frames);
        self.frames.get(name).copied().or_else(by_number)
    }
}
