//! The images of a file: the clues to their frames, and their places in the recording.

use super::{
    Canvas,
    names::{FrameNames, last_part},
};
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
    /// The name by which it is told from images of other recordings: this one, or one with folders.
    file: &'a str,
    picture: Picture,
    place: Place,
}

impl<'a> Clue<'a> {
    /// Nothing is told.
    pub(super) const NONE: Self =
        Self { name: "", file: "", picture: Picture::Unknown, place: Place::Unknown };

    /// Returns the clue of a name that does not tell the frame.
    pub(super) fn called(name: &'a str) -> Self {
        Self { name, file: name, ..Self::NONE }
    }

    /// Returns what a name tells, or else a number: numbers change with the first frame that is used. `names`
    /// are names that `name` may stand for, the image's own last.
    pub(super) fn of(name: &'a str, names: &[&str], number: Option<usize>, frames: &FrameNames<'_>) -> Self {
        let clue = Self::called(name);
        if let Some(frame) = names.iter().find_map(|name| frames.frame_named(name)) {
            return Self { picture: Picture::Frame, place: Place::Frame(frame), ..clue };
        }
        if names.last().is_some_and(|own| frames.is_another(own)) {
            return Self { picture: Picture::Another, place: Place::LeftOut, ..clue };
        }
        clue.numbered(number)
    }

    /// Returns the same for the name of a file, which may be a mere number in another form, see
    /// [`FrameNames::is_numbered`].
    pub(super) fn of_file(
        name: &'a str,
        names: &[&str],
        number: Option<usize>,
        frames: &FrameNames<'_>,
    ) -> Self {
        let clue = Self::of(name, names, number, frames);
        let is_numbered = names.last().is_some_and(|own| frames.is_numbered(own));
        let counts = number.is_some() && clue.is_another() && is_numbered;
        if counts { Self::called(name).numbered(number) } else { clue }
    }

    /// Returns the clue with a number, which counts where the name tells nothing.
    pub(super) fn numbered(self, number: Option<usize>) -> Self {
        match (self.picture, number) {
            (Picture::Unknown, Some(number)) => Self { place: Place::Frame(number), ..self },
            _ => self,
        }
    }

    /// Returns the clue of an image in this file. If its name has folders, it tells recordings apart.
    pub(super) fn in_file(self, file: Option<&'a str>) -> Self {
        let file = file.filter(|file| last_part(file) != *file);
        Self { file: file.unwrap_or(self.file), ..self }
    }

    /// Returns `true` if the name is that of a frame.
    pub(super) fn names_a_frame(&self) -> bool {
        self.picture == Picture::Frame
    }

    /// Returns `true` if the name is that of a picture which is no frame.
    pub(super) fn is_another(&self) -> bool {
        self.picture == Picture::Another
    }
}

/// Returns the places of the images of a file.
///
/// # Errors
/// Names of which none is that of a frame, whatever the numbers are, and two images that would be the same
/// frame.
pub(super) fn places(clues: &[Clue<'_>], canvas: &Canvas) -> Result<Vec<Place>> {
    let another = clues.iter().find(|clue| clue.is_another());
    if let Some(another) = another
        && !clues.iter().any(Clue::names_a_frame)
    {
        return Err(of_another(another.name, canvas));
    }
    let mut images = Images::default();
    let place = |clue: &Clue<'_>| {
        if let Place::Frame(frame) = clue.place {
            images.add(frame, clue.file)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_several_frames_have_tell_nothing() {
        let frame_names = ["1.jpg", "1.png", "2.png"].map(str::to_owned).to_vec();
        let canvas = Canvas { width: 8, height: 6, frame_names, num_frames: 3 };
        let frames = FrameNames::of(&canvas);
        let found = |name| {
            let Clue { picture, place, .. } = Clue::of(name, &[name], Some(0), &frames);
            (picture, place)
        };
        assert_eq!(found("1.bmp"), (Picture::Unknown, Place::Frame(0)));
        assert_eq!(found("2.bmp"), (Picture::Frame, Place::Frame(2)));
        assert_eq!(found("3.bmp"), (Picture::Another, Place::LeftOut));
    }

    #[test]
    fn a_word_and_a_number_tell_nothing_of_a_video() {
        let clue = |frame_names: &[&str], name: &str, number: Option<usize>| {
            let frame_names = frame_names.iter().map(|name| (*name).to_owned()).collect();
            let canvas = Canvas { width: 8, height: 6, frame_names, num_frames: 3 };
            let frames = FrameNames::of(&canvas);
            let clues =
                [Clue::of_file(name, &[name], number, &frames), Clue::of(name, &[name], number, &frames)];
            clues.map(|clue| clue.place)
        };
        let video = ["000000", "000001", "000002"];
        for name in ["frame_000002.png", "deep/img_7.jpg", "Image_0002"] {
            assert_eq!(clue(&video, name, Some(1)), [Place::Frame(1), Place::LeftOut], "{name}");
            assert_eq!(clue(&video, name, None), [Place::LeftOut; 2], "{name}");
        }
        for name in ["patient_000002.png", "frame_.png", "_000002.png", "a_b_000002.png", "frame.png"] {
            assert_eq!(clue(&video, name, Some(1)), [Place::LeftOut; 2], "{name}");
        }
        assert_eq!(clue(&["shot 0", "shot 1", "shot 2"], "frame_000002.png", Some(1)), [Place::LeftOut; 2]);
    }
}
