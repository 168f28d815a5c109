//! The names of pictures, and those of frames to find them among. A name counts whole, with an ending on one
//! side alone, or with another ending, in this order. Folders do not count.

use super::Canvas;
use std::collections::BTreeMap;

/// Endings of the names of pictures.
const PICTURES: [&str; 16] = [
    "png", "jpg", "jpeg", "jpe", "jfif", "jp2", "bmp", "gif", "tif", "tiff", "webp", "avif", "heic", "ppm",
    "pgm", "tga",
];
/// Words before the numbers of pictures, in the names that programs give to those of a video.
const WORDS: [&str; 3] = ["frame", "image", "img"];

/// Returns a name without its folders.
pub(super) fn last_part(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

/// Returns the name of a picture without its ending. What follows other dots is part of the name.
pub(super) fn stem(name: &str) -> &str {
    let is_of_picture = |ending: &str| PICTURES.iter().any(|known| ending.eq_ignore_ascii_case(known));
    let parts = name.rsplit_once('.').filter(|(_, ending)| is_of_picture(ending));
    parts.map_or(name, |(stem, _)| stem)
}

/// Returns `true` for a name that ends as those of pictures do.
pub(super) fn is_picture(name: &str) -> bool {
    stem(name) != name
}

/// The names of all frames of a recording.
#[derive(Default)]
pub(super) struct FrameNames<'a> {
    /// Frames by their whole names.
    whole: BTreeMap<&'a str, Vec<usize>>,
    /// Frames by their names without endings.
    stems: BTreeMap<&'a str, Vec<usize>>,
    /// Of the latter that are numbers, one of every length, with and without a zero at its beginning.
    numbers: BTreeMap<(usize, bool), &'a str>,
    /// `true` if all of them are numbers, as those of a video are.
    are_numbers: bool,
}

impl<'a> FrameNames<'a> {
    pub(super) fn of(canvas: &'a Canvas) -> Self {
        let mut names = Self { are_numbers: true, ..Self::default() };
        for (frame, name) in canvas.frame_names.iter().enumerate() {
            let plain = stem(name);
            names.whole.entry(name).or_default().push(frame);
            names.stems.entry(plain).or_default().push(frame);
            if is_number(plain) {
                names.numbers.insert((plain.len(), plain.starts_with('0')), plain);
            } else {
                names.are_numbers = false;
            }
        }
        names
    }

    /// Returns the one frame that has this name.
    pub(super) fn frame_named(&self, name: &str) -> Option<usize> {
        match self.frames_named(name)[..] {
            [only] => Some(only),
            _ => None,
        }
    }

    /// Returns the frames that have this name in the best way in which any has it.
    fn frames_named(&self, name: &str) -> Vec<usize> {
        let name = last_part(name);
        let whole = |name: &str| self.whole.get(name).cloned().unwrap_or_default();
        let stems = |name: &str| self.stems.get(name).cloned().unwrap_or_default();
        let ways = [whole(name), [whole(stem(name)), stems(name)].concat(), stems(stem(name))];
        ways.into_iter().find(|frames| !frames.is_empty()).unwrap_or_default()
    }

    /// Returns `true` if a name is that of a picture which is no frame. A number tells nothing where frames
    /// are not numbered like it.
    pub(super) fn is_another(&self, name: &str) -> bool {
        if last_part(name).is_empty() || self.whole.is_empty() || !self.frames_named(name).is_empty() {
            return false;
        }
        let number = stem(last_part(name));
        !is_number(number) || self.numbers.values().any(|known| are_numbered_alike(known, number))
    }

    /// Returns `true` if a name is a number after `frame_` or another such word, and frames have mere numbers
    /// for names: so programs call the pictures of a video that they take apart.
    pub(super) fn is_numbered(&self, name: &str) -> bool {
        let is_word = |word: &str| WORDS.iter().any(|known| word.eq_ignore_ascii_case(known));
        let parts = stem(last_part(name)).rsplit_once('_');
        self.are_numbers && parts.is_some_and(|(word, number)| is_word(word) && is_number(number))
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
    fn endings_of_pictures_alone_are_cut_off() {
        for (name, expected) in [
            ("shot 1.png", "shot 1"),
            ("shot 1.JPeG", "shot 1"),
            ("case.1.frame", "case.1.frame"),
            ("case.1.frame.tif", "case.1.frame"),
            ("case.7", "case.7"),
            ("plain", "plain"),
        ] {
            assert_eq!(stem(name), expected);
            assert_eq!(is_picture(name), name != expected);
        }
    }

    #[test]
    fn names_with_dots_are_found_by_their_best_match() {
        let named = |names: &[&str], name: &str| {
            let frame_names = names.iter().map(|name| (*name).to_owned()).collect();
            let canvas = Canvas { width: 8, height: 6, frame_names, num_frames: names.len() };
            FrameNames::of(&canvas).frame_named(name)
        };
        let stems = ["case.7", "case.8", "a.color", "plain"];
        let files = stems.map(|stem| format!("{stem}.png"));
        let files = files.each_ref().map(String::as_str);
        for (i, stem) in stems.into_iter().enumerate() {
            for name in [stem.to_owned(), format!("{stem}.png"), format!("deep/{stem}.png")] {
                assert_eq!((named(&stems, &name), named(&files, &name)), (Some(i), Some(i)), "{name}");
            }
            assert_eq!(named(&files, &format!("{stem}.jpg")), Some(i));
        }
        assert_eq!((named(&stems, "case.9"), named(&["case.1.frame"], "case.1.other")), (None, None));
        assert_eq!(named(&["1.jpg", "1.png"], "1.png"), Some(1));
    }

    #[test]
    fn numbers_of_one_list_are_told_from_others() {
        for (a, b) in [("000004", "000012"), ("4", "12"), ("999999", "1000000")] {
            assert!(are_numbered_alike(a, b) && are_numbered_alike(b, a), "{a} {b}");
        }
        for (a, b) in [("000004", "0004"), ("4", "04"), ("4", "shot 4"), ("4", "")] {
            assert!(!are_numbered_alike(a, b) && !are_numbered_alike(b, a), "{a} {b}");
        }
    }
}
