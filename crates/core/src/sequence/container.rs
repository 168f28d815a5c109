//! Kinds of files that hold a video, told by their first bytes.

use crate::{Error, Result};
use std::{fs::File, io::Read, path::Path};

/// Kind of file that holds a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Container {
    Mp4,
    Other,
}

/// Returns an error if the first bytes belong to no known kind of video.
pub(super) fn expect_video(path: &Path) -> Result<Container> {
    let mut head = Vec::new();
    let file = File::open(path).map_err(|e| Error::io("open the file", path, e))?;
    file.take(16).read_to_end(&mut head).map_err(|e| Error::io("read the file", path, e))?;
    let starts: [&[u8]; 9] = [
        b"\x1a\x45\xdf\xa3",     // Matroska, WebM
        b"RIFF",                 // AVI
        b"\x00\x00\x01\xba",     // MPEG program stream
        b"\x00\x00\x01\xb3",     // MPEG video
        b"\x00\x00\x00\x01",     // H.264, H.265 elementary stream
        b"\x00\x00\x01",         // the same
        b"\x47",                 // MPEG transport stream
        b"FLV",                  // Flash
        b"\x30\x26\xb2\x75\x8e", // Windows Media
    ];
    if head.get(4..8) == Some(b"ftyp") {
        return Ok(Container::Mp4);
    }
    if starts.iter().any(|start| head.starts_with(start)) {
        return Ok(Container::Other);
    }
    Err(Error::input_at(
        path,
        "this file is not a video",
        "Open a video file, or the folder that holds the frames.",
    ))
}
