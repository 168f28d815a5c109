//! Bookmarks: frames to come back to, with notes and flags.

use crate::viewer::state::{
    content::Bookmark,
    document::{Document, Joint},
};

impl Document {
    pub(crate) fn bookmarks(&self) -> &[Bookmark] {
        &self.content().bookmarks
    }

    /// Adds a bookmark to a frame, or removes it.
    pub(crate) fn toggle_bookmark(&mut self, frame: usize) {
        let number = frame + 1;
        match self.bookmarks().binary_search_by_key(&frame, |b| b.frame) {
            Ok(at) => {
                let name = format!("deleting the bookmark at frame {number}");
                self.edit(name, None, |content| drop(content.bookmarks.remove(at)));
            }
            Err(at) => {
                let bookmark = Bookmark { frame, ..Bookmark::default() };
                let name = format!("a bookmark at frame {number}");
                self.edit(name, None, |content| content.bookmarks.insert(at, bookmark));
            }
        }
    }

    /// Sets the note of a bookmark; a frame without a bookmark is left alone.
    pub(crate) fn set_note(&mut self, frame: usize, note: &str) {
        self.change(frame, Some(Joint::Note(frame)), "the note at", |b| b.note = note.to_owned());
    }

    /// Flags a bookmark for another look, or removes the flag.
    pub(crate) fn toggle_flag(&mut self, frame: usize) {
        self.change(frame, None, "the flag at", |b| b.is_flagged ^= true);
    }

    /// Gives a bookmark a colour of its own, or none.
    pub(crate) fn set_bookmark_colour(&mut self, frame: usize, colour: Option<[u8; 3]>) {
        self.change(frame, None, "the colour of the bookmark at", |b| b.colour = colour);
    }

    /// Returns the nearest bookmarked frame before (`-1`) or after (`1`) `frame`.
    pub(crate) fn bookmark_beside(&self, frame: usize, direction: isize) -> Option<usize> {
        let mut frames = self.bookmarks().iter().map(|b| b.frame);
        if direction < 0 { frames.rev().find(|f| *f < frame) } else { frames.find(|f| *f > frame) }
    }

    fn change(&mut self, frame: usize, joins: Option<Joint>, what: &str, change: impl FnOnce(&mut Bookmark)) {
        let Ok(at) = self.bookmarks().binary_search_by_key(&frame, |b| b.frame) else { return };
        let mut changed = self.bookmarks()[at].clone();
        change(&mut changed);
        if changed != self.bookmarks()[at] {
            let name = format!("{what} frame {}", frame + 1);
            self.edit(name, joins, |content| content.bookmarks[at] = changed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use surgtpgs_core::overlay::OverlayLook;

    #[test]
    fn bookmarks_are_in_order_and_the_next_one_is_never_the_present_one() {
        let mut document = Document::new(OverlayLook::default(), 0.4);
        [30, 10, 20].into_iter().for_each(|f| document.toggle_bookmark(f));
        assert_eq!(document.bookmarks().iter().map(|b| b.frame).collect::<Vec<_>>(), [10, 20, 30]);
        assert_eq!((document.bookmark_beside(20, -1), document.bookmark_beside(20, 1)), (Some(10), Some(30)));
        assert_eq!((document.bookmark_beside(10, -1), document.bookmark_beside(30, 1)), (None, None));
        assert_eq!(document.bookmark_beside(25, -1), Some(20));
        document.toggle_bookmark(20);
        assert_eq!(document.bookmark_beside(10, 1), Some(30));
    }

    #[test]
    fn typing_a_note_is_one_edit() {
        let mut document = Document::new(OverlayLook::default(), 0.4);
        document.toggle_bookmark(4);
        ["b", "bl", "bleeding"].into_iter().for_each(|note| document.set_note(4, note));
        document.set_note(5, "no bookmark here");
        assert_eq!(document.bookmarks()[0].note, "bleeding");
        document.undo();
        assert_eq!(document.bookmarks()[0].note, "");
        assert_eq!(document.undo_name(), Some("a bookmark at frame 5"));
    }
}
