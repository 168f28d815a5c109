//! Writing of data elements in the transfer syntax Explicit VR Little Endian (PS3.5, 7.1 and 7.5).

use super::{UNDEFINED, tag, tag::Tag, uid};
use std::io::{self, Write};

/// Type of a value (PS3.5, 6.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Vr {
    At,
    Cs,
    Da,
    Ds,
    Is,
    Lo,
    Lt,
    Pn,
    Sh,
    Tm,
    Ui,
}

impl Vr {
    fn name(self) -> &'static [u8; 2] {
        match self {
            Self::At => b"AT",
            Self::Cs => b"CS",
            Self::Da => b"DA",
            Self::Ds => b"DS",
            Self::Is => b"IS",
            Self::Lo => b"LO",
            Self::Lt => b"LT",
            Self::Pn => b"PN",
            Self::Sh => b"SH",
            Self::Tm => b"TM",
            Self::Ui => b"UI",
        }
    }

    /// Returns the byte that makes values even.
    fn padding(self) -> u8 {
        if self == Self::Ui { 0 } else { b' ' }
    }
}

/// First identifier of what wrote a file; the version follows.
const IMPLEMENTATION: &str = "SURGTPGS";

/// A data set that is being written.
pub(crate) struct Writer<W> {
    out: W,
}

impl<W: Write> Writer<W> {
    pub(crate) fn new(out: W) -> Self {
        Self { out }
    }

    pub(crate) fn into_inner(self) -> W {
        self.out
    }

    /// Begins a file: preamble and meta information.
    pub(crate) fn begin_file(&mut self, sop_class: &str, sop_instance: &str) -> io::Result<()> {
        self.out.write_all(&[0; 128])?;
        self.out.write_all(b"DICM")?;
        let mut meta = Writer::new(Vec::new());
        meta.head(tag::META_VERSION, b"OB", 2)?;
        meta.out.extend([0, 1]);
        meta.text(tag::MEDIA_SOP_CLASS, Vr::Ui, sop_class)?;
        meta.text(tag::MEDIA_SOP_INSTANCE, Vr::Ui, sop_instance)?;
        meta.text(tag::TRANSFER_SYNTAX, Vr::Ui, uid::EXPLICIT)?;
        meta.text(tag::IMPLEMENTATION_CLASS, Vr::Ui, &uid::of_hash(&[IMPLEMENTATION.as_bytes()]))?;
        meta.text(tag::IMPLEMENTATION_VERSION, Vr::Sh, IMPLEMENTATION)?;
        self.head(tag::META_LENGTH, b"UL", 4)?;
        self.out.write_all(&(meta.out.len() as u32).to_le_bytes())?;
        self.out.write_all(&meta.out)
    }

    /// Writes a text of a type; it must not hold what its type forbids.
    pub(crate) fn text(&mut self, tag: Tag, vr: Vr, text: &str) -> io::Result<()> {
        let length = text.len().next_multiple_of(2);
        self.head(tag, vr.name(), length as u32)?;
        self.out.write_all(text.as_bytes())?;
        if length > text.len() { self.out.write_all(&[vr.padding()]) } else { Ok(()) }
    }

    /// Writes 16-bit numbers.
    pub(crate) fn shorts(&mut self, tag: Tag, values: &[u16]) -> io::Result<()> {
        self.head(tag, b"US", 2 * values.len() as u32)?;
        values.iter().try_for_each(|v| self.out.write_all(&v.to_le_bytes()))
    }

    /// Writes 32-bit numbers.
    pub(crate) fn longs(&mut self, tag: Tag, values: &[u32]) -> io::Result<()> {
        self.head(tag, b"UL", 4 * values.len() as u32)?;
        values.iter().try_for_each(|v| self.out.write_all(&v.to_le_bytes()))
    }

    /// Writes a tag as the value of an attribute.
    pub(crate) fn pointer(&mut self, tag: Tag, to: Tag) -> io::Result<()> {
        self.head(tag, Vr::At.name(), 4)?;
        self.out.write_all(&to.0.to_le_bytes())?;
        self.out.write_all(&to.1.to_le_bytes())
    }

    /// Writes a sequence; `items` writes its items, see [`Writer::item`].
    pub(crate) fn sequence(
        &mut self,
        tag: Tag,
        items: impl FnOnce(&mut Self) -> io::Result<()>,
    ) -> io::Result<()> {
        self.head(tag, b"SQ", UNDEFINED)?;
        items(self)?;
        self.mark(tag::SEQUENCE_END, 0)
    }

    /// Writes an item of a sequence.
    pub(crate) fn item(&mut self, content: impl FnOnce(&mut Self) -> io::Result<()>) -> io::Result<()> {
        self.mark(tag::ITEM, UNDEFINED)?;
        content(self)?;
        self.mark(tag::ITEM_END, 0)
    }

    /// Writes a sequence of one item.
    pub(crate) fn one(
        &mut self,
        tag: Tag,
        content: impl FnOnce(&mut Self) -> io::Result<()>,
    ) -> io::Result<()> {
        self.sequence(tag, |w| w.item(content))
    }

    /// Writes the head of pixel data of `length` bytes, which must be even; the caller writes them to
    /// [`Writer::into_inner`].
    pub(crate) fn begin_pixels(&mut self, length: u32) -> io::Result<()> {
        self.head(tag::PIXEL_DATA, b"OB", length)
    }

    fn head(&mut self, tag: Tag, vr: &[u8; 2], length: u32) -> io::Result<()> {
        self.out.write_all(&tag.0.to_le_bytes())?;
        self.out.write_all(&tag.1.to_le_bytes())?;
        self.out.write_all(vr)?;
        if [b"OB", b"SQ"].contains(&vr) {
            self.out.write_all(&[0; 2])?;
            return self.out.write_all(&length.to_le_bytes());
        }
        let length = u16::try_from(length).map_err(|_| io::Error::other(format!("{tag} is too long")))?;
        self.out.write_all(&length.to_le_bytes())
    }

    fn mark(&mut self, tag: Tag, length: u32) -> io::Result<()> {
        self.out.write_all(&tag.0.to_le_bytes())?;
        self.out.write_all(&tag.1.to_le_bytes())?;
        self.out.write_all(&length.to_le_bytes())
    }
}
