//! The images of a file: the clues to their frames, and their places in the recording.

use super::{Canvas, last_part, stem};
use crate::{Error, Result};
use std::collections::BTreeMap;

/// Place of an image in the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    Frame(usize),
    /// Other images of the file are frames of the recording, this one is none.
    LeftOut,
    Unknown,
}

/// Picture that a name is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Picture {
    Frame,
    /// One that is no frame.
    Another,
    /// Any: the name is missing, or a mere number.
    Unknown,
}

/// Part of a file that tells which frame an image is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Clue<'a> {
    /// The name as it is written there, with folders; may be empty.
    name: &'a str,
    picture: Picture,
    place: Place,
}

impl<'a> Clue<'a> {
    /// Nothing is told.
    pub(super) const NONE: Self = Self { name: "", picture: Picture::Unknown, place: Place::Unknown };

    /// Returns what a name tells, or else a number: numbers change with the first frame that is used. `names`
    /// are names that `name` may stand for, the image's own last.
    pub(super) fn of(name: &'a str, names: &[&str], number: Option<usize>, canvas: &Canvas) -> Self {
        let (picture, place) = match names.iter().find_map(|name| canvas.frame_named(name)) {
            Some(frame) => (Picture::Frame, Place::Frame(frame)),
            None if names.last().is_some_and(|own| canvas.is_another(own)) => {
                (Picture::Another, Place::LeftOut)
            }
            None => (Picture::Unknown, number.map_or(Place::Unknown, Place::Frame)),
        };
        Self { name, picture, place }
    }

    /// Returns the clue with a number that counts whatever the name is.
    pub(super) fn numbered(self, number: usize) -> Self {
        Self { place: Place::Frame(number), ..self }
    }

    /// Returns `true` if the name is that of a frame.
    pub(super) fn names_a_frame(&self) -> bool {
        self.picture == Picture::Frame
    }
}

/// Returns the places of the images of a file.
///
/// # Errors
/// Names of which none is that of a frame, whatever the numbers are, and two images that would be the same
/// frame.
pub(super) fn places(clues: &[Clue<'_>], canvas: &Canvas) -> Result<Vec<Place>> {
    let another = clues.iter().find(|clue| clue.picture == Picture::Another);
    if let Some(another) = another
        && !clues.iter().any(Clue::names_a_frame)
    {
        return Err(of_another(another.name, canvas));
    }
    let mut images = Images::default();
    let place = |clue: &Clue<'_>| {
        if let Place::Frame(frame) = clue.place {
            images.add(frame, clue.name)?;
        }
        Ok(clue.place)
    };
    clues.iter().map(place).collect()
}

/// Returns the error about a file of another recording, or of frames that are left out.
fn of_another(name: &str, canvas: &Canvas) -> Error {
    let what =
        format!("the image \"{name}\" is no frame of the recording, and neither is any other of this file");
    let called = match canvas.frame_names.as_slice() {
        [] => String::new(),
        [only] => format!(": its only frame is called \"{only}\""),
        [first, .., last] => format!(": its frames are called \"{first}\" to \"{last}\""),
    };
    Error::input(what, format!("The annotations must be those of this recording{called}."))
}

/// The images of a file by the frames that they are. Of other recordings, images may have the same names.
#[derive(Default)]
pub(super) struct Images(BTreeMap<usize, String>);

impl Images {
    /// Takes note of an image, and refuses another one that is the same frame.
    pub(super) fn add(&mut self, frame: usize, name: &str) -> Result<()> {
        let known = self.0.entry(frame).or_insert_with(|| name.to_owned());
        if known == name {
            return Ok(());
        }
        let shown = |name: &str| match name {
            "" => "an image without a name".to_owned(),
            name => format!("\"{name}\""),
        };
        let what =
            format!("{} and {} would both be frame {frame} of the recording", shown(known), shown(name));
        Err(Error::input(what, "Leave out the images of other recordings."))
    }
}

impl Canvas {
    /// Returns `true` if a name is that of a picture which is no frame. A number tells nothing where frames
    /// are not numbered like it.
    fn is_another(&self, name: &str) -> bool {
        if last_part(name).is_empty() || self.frame_names.is_empty() || self.has_name(name) {
            return false;
        }
        let number = stem(last_part(name));
        !is_number(number) || self.frame_names.iter().any(|known| are_numbered_alike(stem(known), number))
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// Returns `true` for two numbers that one list may hold: they are equally long, or not filled up with zeros.
fn are_numbered_alike(a: &str, b: &str) -> bool {
    let longer = if a.len() > b.len() { a } else { b };
    is_number(a) && is_number(b) && (a.len() == b.len() || !longer.starts_with('0'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_one_list_are_told_from_others() {
        for (a, b) in [("000004", "000012"), ("4", "12"), ("999999", "1000000")] {
            assert!(are_numbered_alike(a, b) && are_numbered_alike(b, a), "{a} {b}");
        }
        for (a, b) in [("000004", "0004"), ("4", "04"), ("4", "shot 4"), ("4", "")] {
            assert!(!are_numbered_alike(a, b) && !are_numbered_alike(b, a), "{a} {b}");
        }
    }

    #[test]
    fn names_that_several_frames_have_tell_nothing() {
        let frame_names = ["1.jpg", "1.png", "2.png"].map(str::to_owned).to_vec();
        let canvas = Canvas { width: 8, height: 6, frame_names, num_frames: 3 };
        let found = |name| {
            let Clue { picture, place, .. } = Clue::of(name, &[name], Some(0), &canvas);
            (picture, place)
        };
        assert_eq!(found("1.bmp"), (Picture::Unknown, Place::Frame(0)));
        assert_eq!(found("2.bmp"), (Picture::Frame, Place::Frame(2)));
        assert_eq!(found("3.bmp"), (Picture::Another, Place::LeftOut));
    }
}
