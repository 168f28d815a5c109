//! Reads files of other programs. It never waits for a file, and takes no more memory than a
//! file's size justifies.

mod npy;
mod number;
mod picture;
mod pieces;
mod weights;

pub use npy::npy;
pub(crate) use npy::npy_f32;
pub(crate) use number::NumberType;
pub use picture::{Values, picture, picture_size, values};
pub(crate) use picture::{jpeg, opacity};
pub(crate) use pieces::{Piece, Pieces, PiecesReader};
pub(crate) use weights::weights_beside;

use std::{
    fs::File,
    io::{Error, ErrorKind, Read, Result},
    path::Path,
};

/// Largest size of a text in bytes: enough for a list of 50,000 frames with their cameras.
pub const MOST_TEXT: u64 = 32 << 20;

/// Largest size in bytes of a file that is read as a whole.
pub const MOST_BYTES: u64 = 8 << 30;

/// The limit for scenes and unfinished trainings, which have none: what this program wrote it also reads.
/// Memory is taken for as many bytes as a file has.
pub(crate) const ANY_SIZE: u64 = u64::MAX;

/// Returns `true` if there is anything at `path`, even a link that leads nowhere. Existing things are
/// read or refused, never ignored.
pub fn is_present(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

/// Opens a file, following links. Pipes, sockets and devices are refused at once: opening one
/// may wait forever.
pub fn open_regular(path: &Path) -> Result<File> {
    let kind = std::fs::metadata(path)?;
    if kind.is_file() {
        return File::open(path);
    }
    let what = if kind.is_dir() { "a folder" } else { "a pipe, socket or device" };
    Err(Error::new(ErrorKind::InvalidInput, format!("this is {what}, not a file")))
}

/// Returns the bytes of a file that [`open_regular`] opens; more than `most_bytes` are an error.
pub fn read_regular(path: &Path, most_bytes: u64) -> Result<Vec<u8>> {
    let file = open_regular(path)?;
    let len = file.metadata()?.len();
    let too_large = || {
        let what = format!("the file has more than {most_bytes} bytes, which no such file needs");
        Err(Error::new(ErrorKind::FileTooLarge, what))
    };
    if len > most_bytes {
        return too_large();
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(len as usize)?;
    // Files under /proc and growing files have more bytes than their size says.
    file.take(most_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most_bytes { too_large() } else { Ok(bytes) }
}

/// Returns the text of a file that [`open_regular`] opens, of at most [`MOST_TEXT`] bytes.
pub fn read_text(path: &Path) -> Result<String> {
    let bytes = read_regular(path, MOST_TEXT)?;
    String::from_utf8(bytes).map_err(|e| {
        Error::new(ErrorKind::InvalidData, format!("this is not a text in UTF-8: {}", e.utf8_error()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_read_up_to_a_size() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "four").unwrap();
        for most in [4, ANY_SIZE] {
            assert_eq!(read_regular(&path, most).unwrap(), b"four");
        }
        assert!(read_regular(&path, 3).unwrap_err().to_string().contains("more than 3 bytes"));
        assert_eq!(read_text(&path).unwrap(), "four");
        std::fs::write(&path, [0xff]).unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("not a text"));
        assert_eq!(read_text(&folder.path().join("none")).unwrap_err().kind(), ErrorKind::NotFound);
        assert!(read_text(folder.path()).unwrap_err().to_string().contains("a folder"));
        // A large file without content takes no memory.
        File::create(&path).unwrap().set_len(MOST_BYTES + 1).unwrap();
        assert!(read_regular(&path, MOST_BYTES).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn pipes_are_not_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let [pipe, link] = ["pipe", "link"].map(|name| folder.path().join(name));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        std::os::unix::fs::symlink(&pipe, &link).unwrap();
        for path in [&pipe, &link, Path::new("/dev/zero")] {
            assert!(open_regular(path).unwrap_err().to_string().contains("a pipe"), "{}", path.display());
        }
    }
}
