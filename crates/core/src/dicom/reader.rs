//! Reading of data sets (PS3.5, chapter 7; PS3.10, chapter 7). Values that nobody asked for are skipped, so
//! that memory depends on what is kept. What is kept is never larger than the file.

use super::{
    LeftUnread, UNDEFINED,
    set::{Set, Value},
    tag::{self, Tag},
    uid,
};
use crate::{
    Error, Result,
    reading::{Piece, open_regular},
};
use std::{
    fs::File,
    io::{BufReader, Read},
    path::Path,
};

/// Bytes before the mark of a file, and the mark.
const PREAMBLE: usize = 128;
const MAGIC: &[u8; 4] = b"DICM";
/// Most sequences within each other.
const DEEPEST: usize = 16;

/// The part of a file that was asked for.
#[derive(Clone, Debug)]
pub(crate) struct DicomFile {
    /// UID of the transfer syntax.
    pub(crate) syntax: String,
    pub(crate) set: Set,
    pub(crate) left_unread: LeftUnread,
}

/// Returns `true` if a file is one of DICOM, by its mark or by its first data elements. Also `false` if it
/// cannot be read.
pub(crate) fn is_dicom(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = open_regular(path).and_then(|f| f.take(PREAMBLE as u64 + 4).read_to_end(&mut head));
    read.is_ok() && beginning(&head).is_some()
}

/// Reads the attributes `wanted` of a file, at any depth. Sequences are looked into only if they are wanted.
///
/// # Errors
/// A file that is cut off or damaged, and one in a rare transfer syntax; the message says which.
pub(crate) fn read(path: &Path, wanted: &[Tag]) -> Result<DicomFile> {
    let fail = |e| Error::io("read the DICOM file", path, e);
    let file = open_regular(path).map_err(fail)?;
    let len = file.metadata().map_err(fail)?.len();
    let reader = Reader {
        source: BufReader::new(file),
        at: 0,
        len,
        is_explicit: true,
        wanted,
        left_unread: LeftUnread::default(),
    };
    reader.file().map_err(|problem| match problem {
        Problem::Io(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => fail(e),
        Problem::Io(_) => damaged(path, "it ends too early"),
        Problem::Damage(what) => damaged(path, &what),
        Problem::Syntax(what) => {
            let hint =
                "Convert it to the transfer syntax Explicit VR Little Endian, for instance by dcmconv.";
            Error::input_at(path, format!("this DICOM file is {what}, which is not read"), hint)
        }
    })
}

fn damaged(path: &Path, what: &str) -> Error {
    let hint = "It may be cut off or damaged. Copy it once more from where it was recorded.";
    Error::input_at(path, format!("this DICOM file cannot be read: {what}"), hint)
}

/// Form of a file's beginning.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Beginning {
    /// The mark after the preamble.
    Marked,
    /// A data element: of the meta information, with explicit types, or with implicit ones.
    Meta,
    Explicit,
    Implicit,
}

fn beginning(head: &[u8]) -> Option<Beginning> {
    if head.get(PREAMBLE..PREAMBLE + 4) == Some(MAGIC) {
        return Some(Beginning::Marked);
    }
    let first: &[u8; 8] = head.first_chunk()?;
    let tag = Tag(u16::from_le_bytes([first[0], first[1]]), u16::from_le_bytes([first[2], first[3]]));
    let is_early = tag.1 <= 0x0018 || (tag.0 == 0x0002 && tag.1 <= 0x0100);
    let has_type = [b"UL", b"OB", b"UI", b"SH", b"CS"].contains(&&[first[4], first[5]]);
    let length = u32::from_le_bytes([first[4], first[5], first[6], first[7]]);
    match tag.0 {
        0x0002 if is_early && has_type => Some(Beginning::Meta),
        0x0008 if is_early && has_type => Some(Beginning::Explicit),
        // Its first value is a group length, a character set, an image type or a date.
        0x0008 if is_early && length > 0 && length <= 64 && length.is_multiple_of(2) => {
            Some(Beginning::Implicit)
        }
        _ => None,
    }
}

enum Problem {
    Io(std::io::Error),
    Damage(String),
    Syntax(&'static str),
}

impl From<std::io::Error> for Problem {
    fn from(e: std::io::Error) -> Self {
        Self::Io(e)
    }
}

/// The head of a data element or an item.
struct Head {
    tag: Tag,
    vr: Option<[u8; 2]>,
    length: u32,
}

/// The end of a data set: a place in the file, and if a mark may come before it.
#[derive(Clone, Copy)]
struct End {
    at: u64,
    is_marked: bool,
}

struct Reader<'a> {
    source: BufReader<File>,
    at: u64,
    len: u64,
    is_explicit: bool,
    wanted: &'a [Tag],
    left_unread: LeftUnread,
}

impl Reader<'_> {
    fn file(mut self) -> Result<DicomFile, Problem> {
        let mut head = Vec::new();
        self.source.by_ref().take(PREAMBLE as u64 + 4).read_to_end(&mut head)?;
        let beginning = beginning(&head).ok_or_else(|| Problem::Damage("it has no mark of DICOM".into()))?;
        let start = if beginning == Beginning::Marked { head.len() } else { 0 };
        self.source.seek_relative(start as i64 - head.len() as i64)?;
        self.at = start as u64;
        let syntax = match beginning {
            Beginning::Marked | Beginning::Meta => self.meta()?,
            Beginning::Explicit => uid::EXPLICIT.to_owned(),
            Beginning::Implicit => uid::IMPLICIT.to_owned(),
        };
        match syntax.as_str() {
            uid::BIG_ENDIAN => return Err(Problem::Syntax("stored with the high bytes first")),
            uid::DEFLATED => return Err(Problem::Syntax("deflated as a whole")),
            _ => self.is_explicit = syntax != uid::IMPLICIT,
        }
        let set = self.set(End { at: self.len, is_marked: false }, 0)?;
        Ok(DicomFile { syntax, set, left_unread: self.left_unread })
    }

    /// Reads the meta information and returns the transfer syntax.
    fn meta(&mut self) -> Result<String, Problem> {
        let mut syntax = None;
        loop {
            let mut group = Vec::new();
            self.source.by_ref().take(2).read_to_end(&mut group)?;
            self.source.seek_relative(-(group.len() as i64))?;
            if group != tag::TRANSFER_SYNTAX.0.to_le_bytes() {
                break;
            }
            let head = self.head(self.len)?;
            if head.tag == tag::TRANSFER_SYNTAX {
                let value = Value::Bytes(self.bytes(head.length, self.len, head.tag)?);
                syntax = Set { elements: vec![(head.tag, value)] }.text(head.tag);
            } else {
                self.skip(head.length, self.len, head.tag)?;
            }
        }
        syntax.ok_or_else(|| Problem::Damage("it does not say its transfer syntax".into()))
    }

    /// Reads a data set up to its end.
    fn set(&mut self, end: End, depth: usize) -> Result<Set, Problem> {
        if depth > DEEPEST {
            return Err(Problem::Damage(format!("its sequences are nested more than {DEEPEST} deep")));
        }
        let mut set = Set::default();
        while self.at < end.at {
            let head = self.head(end.at)?;
            if head.tag == tag::ITEM_END && end.is_marked {
                return Ok(set);
            }
            if head.tag.0 == tag::ITEM.0 {
                return Err(Problem::Damage("a sequence ends where none is open".into()));
            }
            if let Some(value) = self.value(&head, end.at, depth)? {
                set.elements.push((head.tag, value));
            }
        }
        if end.is_marked {
            return Err(Problem::Damage("it ends within a sequence".into()));
        }
        Ok(set)
    }

    /// Reads or skips the value of a data element.
    fn value(&mut self, head: &Head, end: u64, depth: usize) -> Result<Option<Value>, Problem> {
        let &Head { tag, vr, length } = head;
        let is_wanted = self.wanted.contains(&tag);
        if !is_wanted {
            self.left_unread.count(tag, vr);
        }
        if tag == tag::PIXEL_DATA && depth == 0 {
            let value = match length {
                UNDEFINED => Value::Fragments(self.fragments(end)?),
                _ => Value::Stored(Piece { offset: self.at, len: self.skip(length, end, tag)? }),
            };
            return Ok(is_wanted.then_some(value));
        }
        let is_sequence = match vr {
            Some(vr) => &vr == b"SQ" || (length == UNDEFINED && &vr == b"UN"),
            None => length == UNDEFINED || (is_wanted && SEQUENCES.contains(&tag)),
        };
        if is_sequence && (is_wanted || length == UNDEFINED) {
            // A sequence of unknown type has implicit types inside (PS3.5, 6.2.2).
            let outside = self.is_explicit;
            self.is_explicit &= vr != Some(*b"UN");
            let items = self.items(length, end, depth, is_wanted);
            self.is_explicit = outside;
            return Ok(items?.map(Value::Items));
        }
        if !is_wanted {
            self.skip(length, end, tag)?;
            return Ok(None);
        }
        Ok(Some(Value::Bytes(self.bytes(length, end, tag)?)))
    }

    /// Reads the items of a sequence; `None` if they are not kept.
    fn items(
        &mut self,
        length: u32,
        end: u64,
        depth: usize,
        keep: bool,
    ) -> Result<Option<Vec<Set>>, Problem> {
        let is_marked = length == UNDEFINED;
        let end = if is_marked { end } else { self.end_of(length, end, tag::ITEM)? };
        let mut items = Vec::new();
        let (wanted, counted) = (self.wanted, self.left_unread);
        if !keep {
            self.wanted = &[];
        }
        while self.at < end {
            let head = self.head(end)?;
            match head.tag {
                tag::SEQUENCE_END if is_marked => {
                    self.wanted = wanted;
                    if !keep {
                        // A sequence counts as one.
                        self.left_unread = counted;
                    }
                    return Ok(keep.then_some(items));
                }
                tag::ITEM => {
                    let inner = match head.length {
                        UNDEFINED => End { at: end, is_marked: true },
                        length => End { at: self.end_of(length, end, tag::ITEM)?, is_marked: false },
                    };
                    let item = self.set(inner, depth + 1)?;
                    if keep {
                        items.push(item);
                    }
                }
                other => return Err(Problem::Damage(format!("{other} is where an item should be"))),
            }
        }
        if is_marked {
            return Err(Problem::Damage("it ends within a sequence".into()));
        }
        Ok(keep.then_some(items))
    }

    /// Returns the places of the fragments of pixel data; the first is the table of offsets.
    fn fragments(&mut self, end: u64) -> Result<Vec<Piece>, Problem> {
        let mut fragments = Vec::new();
        while self.at < end {
            let head = self.head(end)?;
            match head.tag {
                tag::SEQUENCE_END => return Ok(fragments),
                tag::ITEM => {
                    let offset = self.at;
                    fragments.push(Piece { offset, len: self.skip(head.length, end, tag::PIXEL_DATA)? });
                }
                other => return Err(Problem::Damage(format!("{other} is among its pictures"))),
            }
        }
        Err(Problem::Damage("it ends within its pictures".into()))
    }

    /// Reads the head of a data element that begins before `end`.
    fn head(&mut self, end: u64) -> Result<Head, Problem> {
        let mut bytes = [0; 8];
        if end - self.at < bytes.len() as u64 {
            return Err(Problem::Damage("it ends within the head of a data element".into()));
        }
        self.source.read_exact(&mut bytes)?;
        self.at += bytes.len() as u64;
        let [g0, g1, e0, e1, a, b, c, d] = bytes;
        let tag = Tag(u16::from_le_bytes([g0, g1]), u16::from_le_bytes([e0, e1]));
        let is_meta = tag.0 == tag::TRANSFER_SYNTAX.0;
        if tag.0 == tag::ITEM.0 || !(self.is_explicit || is_meta) {
            return Ok(Head { tag, vr: None, length: u32::from_le_bytes([a, b, c, d]) });
        }
        let vr = [a, b];
        if !vr.iter().all(u8::is_ascii_uppercase) {
            return Err(Problem::Damage(format!("the data element {tag} has no type")));
        }
        let length = if LONG.contains(&&vr) {
            let mut four = [0; 4];
            self.source.read_exact(&mut four)?;
            self.at += four.len() as u64;
            u32::from_le_bytes(four)
        } else {
            u32::from(u16::from_le_bytes([c, d]))
        };
        Ok(Head { tag, vr: Some(vr), length })
    }

    /// Returns the end of a value that begins here.
    fn end_of(&self, length: u32, end: u64, tag: Tag) -> Result<u64, Problem> {
        let own = self.at + u64::from(length);
        if length == UNDEFINED || own > end {
            let left = end.saturating_sub(self.at);
            let claim = if length == UNDEFINED { "no end".to_owned() } else { format!("{length} bytes") };
            return Err(Problem::Damage(format!("{tag} claims {claim} where {left} bytes are left")));
        }
        Ok(own)
    }

    /// Skips a value and returns its length.
    fn skip(&mut self, length: u32, end: u64, tag: Tag) -> Result<u64, Problem> {
        let own = self.end_of(length, end, tag)?;
        self.source.seek_relative(i64::from(length))?;
        self.at = own;
        Ok(u64::from(length))
    }

    fn bytes(&mut self, length: u32, end: u64, tag: Tag) -> Result<Vec<u8>, Problem> {
        let own = self.end_of(length, end, tag)?;
        let mut bytes = Vec::new();
        self.source.by_ref().take(u64::from(length)).read_to_end(&mut bytes)?;
        self.at = own;
        Ok(bytes)
    }
}

/// Types with lengths of 32 bits (PS3.5, table 7.1-1).
const LONG: [&[u8; 2]; 13] =
    [b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"];

/// The sequences that may be wanted; in files with implicit types nothing else tells them.
const SEQUENCES: [Tag; 10] = [
    tag::DIRECTORY_RECORDS,
    tag::SOURCE_IMAGES,
    tag::DERIVATION_IMAGES,
    tag::FRAME_CONTENT,
    tag::PIXEL_MEASURES,
    tag::SEGMENTS,
    tag::SEGMENT_IDENTIFICATION,
    tag::TYPE_CODE,
    tag::SHARED_GROUPS,
    tag::PER_FRAME_GROUPS,
];
