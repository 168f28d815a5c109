//! The frames of a recording, by which it is told from others wherever it lies.

use std::path::Path;

/// Facts about the frames of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Frames<'a> {
    /// Hash of their names and sizes.
    pub(crate) outline: &'a str,
    /// Hash of the content of a few of them; `None` where it is not known.
    pub(crate) spots: Option<&'a str>,
    /// Path of the recording; `None` where it is not known.
    pub(crate) place: Option<&'a Path>,
}

impl Frames<'_> {
    /// Returns `true` if both have the same names and sizes and, where it is known of both, the same content.
    pub(crate) fn are_like(self, other: Frames<'_>) -> bool {
        self.outline == other.outline && self.spots.zip(other.spots).is_none_or(|(a, b)| a == b)
    }

    /// Returns `true` if both are of one recording. Uncompressed frames of two recordings may have the same
    /// sizes: where content is not known, two recordings that are both there are two.
    pub(crate) fn are_of_one(self, other: Frames<'_>) -> bool {
        let has_content = self.spots.is_some() && other.spots.is_some();
        self.are_like(other) && (has_content || !self.is_apart(other))
    }

    /// Returns `true` if there is a recording in both places, which are two.
    fn is_apart(self, other: Frames<'_>) -> bool {
        let places = self.place.zip(other.place);
        places.is_some_and(|(a, b)| a != b && a.exists() && b.exists())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_of_equal_sizes_are_one_by_their_content_or_if_one_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let [here, there, gone] = ["here", "there", "gone"].map(|name| folder.path().join(name));
        [&here, &there].iter().for_each(|path| std::fs::write(path, "").unwrap());
        let frames = |place, spots| Frames { outline: "names", spots, place: Some(place) };
        let unread = frames(&*here, None);
        assert!(unread.are_of_one(unread) && unread.are_of_one(frames(&gone, None)));
        assert!(!unread.are_of_one(frames(&there, None)), "both are there");
        let read = frames(&*here, Some("content"));
        assert!(read.are_of_one(frames(&there, Some("content"))), "a copy");
        assert!(!read.are_of_one(frames(&gone, Some("other"))));
        assert!(!read.are_of_one(Frames { outline: "other", ..read }));
    }
}
