//! Parts of a file that are read as if they were one.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::Arc,
};

/// A part of a file, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Piece {
    pub(crate) offset: u64,
    pub(crate) len: u64,
}

/// Parts of a file, one after the other.
#[derive(Clone, Debug)]
pub(crate) struct Pieces {
    path: PathBuf,
    pieces: Arc<[Piece]>,
    /// Position of each piece in the whole.
    starts: Arc<[u64]>,
    len: u64,
}

impl Pieces {
    /// Returns a whole file.
    pub(crate) fn whole(path: &Path) -> io::Result<Self> {
        let len = std::fs::metadata(path)?.len();
        Ok(Self::of(path, &[Piece { offset: 0, len }]))
    }

    pub(crate) fn of(path: &Path, pieces: &[Piece]) -> Self {
        let mut len = 0_u64;
        let start = |piece: &Piece| {
            let start = len;
            len = len.saturating_add(piece.len);
            start
        };
        let starts = pieces.iter().map(start).collect();
        Self { path: path.to_owned(), pieces: pieces.into(), starts, len }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the number of bytes in all pieces.
    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    pub(crate) fn open(&self) -> io::Result<PiecesReader> {
        Ok(PiecesReader { file: File::open(&self.path)?, pieces: self.clone(), position: 0 })
    }

    /// Returns all bytes; memory for them is taken as they come.
    pub(crate) fn read(&self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.open()?.read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

/// A reader of [`Pieces`].
#[derive(Debug)]
pub(crate) struct PiecesReader {
    file: File,
    pieces: Pieces,
    position: u64,
}

impl Read for PiecesReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Pieces { pieces, starts, .. } = &self.pieces;
        let Some(i) = starts.partition_point(|start| *start <= self.position).checked_sub(1) else {
            return Ok(0);
        };
        let inside = self.position - starts[i];
        let left = pieces[i].len.saturating_sub(inside);
        if left == 0 {
            return Ok(0);
        }
        self.file.seek(SeekFrom::Start(pieces[i].offset.saturating_add(inside)))?;
        let most = buffer.len().min(usize::try_from(left).unwrap_or(usize::MAX));
        let read = self.file.read(&mut buffer[..most])?;
        self.position += read as u64;
        Ok(read)
    }
}

impl Seek for PiecesReader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let (from, by) = match to {
            SeekFrom::Start(position) => (position, 0),
            SeekFrom::End(by) => (self.pieces.len, by),
            SeekFrom::Current(by) => (self.position, by),
        };
        let outside = || io::Error::new(io::ErrorKind::InvalidInput, "a place before the beginning");
        self.position = from.checked_add_signed(by).ok_or_else(outside)?;
        Ok(self.position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_read_as_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, b"0123456789").unwrap();
        let piece = |offset, len| Piece { offset, len };
        let pieces = Pieces::of(&path, &[piece(1, 2), piece(5, 0), piece(7, 3)]);
        assert_eq!((pieces.read().unwrap().as_slice(), pieces.len()), (&b"12789"[..], 5));
        let mut reader = pieces.open().unwrap();
        reader.seek(SeekFrom::End(-2)).unwrap();
        let mut rest = String::new();
        reader.read_to_string(&mut rest).unwrap();
        assert_eq!(rest, "89");
        assert_eq!(Pieces::whole(&path).unwrap().read().unwrap(), b"0123456789");
    }
}
