//! Frames of a video that ffmpeg decodes as they are asked for.

use super::{
    Shared, Unread,
    command::{WHOLE_PICTURES, add_filters},
    listing::Listing,
    messages::{Shown, Told},
};
use crate::{
    Error, Result,
    sequence::{decoding::Position, h264::other_size},
};
use image::RgbImage;
use std::{
    io::{BufRead, BufReader, Read},
    path::Path,
    process::{Child, ChildStderr, ChildStdout, Stdio},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
        mpsc::{Receiver, Sender, channel},
    },
};

/// Number of frames before the first one that are decoded, too: a picture that is made of two fields is
/// guessed from those around it.
const RUN_IN: usize = 2;
/// Number of frames up to which it is quicker to go on than to begin at a key.
const NEAR: usize = 24;

/// A video whose frames are decoded on request, in any order.
///
/// The time of every frame that comes is compared with the listed one, so that a frame is never taken for
/// another.
#[derive(Debug)]
pub(in super::super) struct Stream {
    video: Unread,
    listing: Listing,
    /// Number of columns and rows.
    size: (usize, usize),
    shared: Shared,
    /// The first of [`Listing::seeks`] that led to a right place before. Some files cannot be entered at
    /// once where they say.
    first_seek: AtomicUsize,
    /// The first complaint about the contents of frames that were decoded.
    complaint: Arc<Mutex<Option<String>>>,
}

/// ffmpeg in the middle of a video.
#[derive(Debug)]
pub(in super::super) struct Process {
    child: Child,
    pixels: ChildStdout,
    shown: Receiver<Shown>,
    /// The frame that comes next.
    next_frame: usize,
}

impl Position for Process {
    fn next_frame(&self) -> usize {
        self.next_frame
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Stream {
    pub(super) fn new(video: Unread, listing: Listing, size: (usize, usize), shared: Shared) -> Self {
        Self { video, listing, size, shared, first_seek: AtomicUsize::new(0), complaint: Arc::default() }
    }

    /// Returns the video file.
    pub(in super::super) fn path(&self) -> &Path {
        &self.video.path
    }

    /// Returns a frame up to `index` that is reached as quickly as any.
    pub(in super::super) fn entry_before(&self, index: usize) -> usize {
        index.min(self.listing.key_before(index) + RUN_IN)
    }

    /// Returns the first complaint of ffmpeg about the contents of frames that were decoded.
    pub(in super::super) fn complaint(&self) -> Option<String> {
        self.complaint.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns frame `index` in the order of showing.
    pub(in super::super) fn frame(&self, index: usize) -> Result<RgbImage> {
        let mut state = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        let earliest = self.listing.key_before(index).min(index.saturating_sub(NEAR));
        let frame = state.frame(
            &self.video.path,
            (earliest, index),
            || self.start_at(index),
            |process, cache| {
                let next = process.next_frame;
                cache.insert(next, self.next(process)?, index);
                Ok(())
            },
        )?;
        frame.ok_or_else(|| self.damaged(index, "it did not come"))
    }

    /// Starts ffmpeg so that frame `index` comes next.
    fn start_at(&self, index: usize) -> Result<Process> {
        let first = index.saturating_sub(RUN_IN);
        let seeks = self.listing.seeks(first);
        let tried = self.first_seek.load(Ordering::Relaxed).min(seeks.len() - 1);
        let mut failure = self.damaged(index, "it did not come");
        for (k, from) in seeks.iter().enumerate().skip(tried) {
            let mut process = self.spawn(*from, first)?;
            match (first..index).try_for_each(|_| self.next(&mut process).map(drop)) {
                Ok(()) if from.is_none() => return Ok(process),
                Ok(()) => {
                    self.first_seek.store(k, Ordering::Relaxed);
                    return Ok(process);
                }
                // It was entered too late, or cannot be decoded from there on.
                Err(e) => failure = e,
            }
        }
        Err(failure)
    }

    fn spawn(&self, from: Option<f64>, first: usize) -> Result<Process> {
        let mut command = self.video.reading(from);
        command.arg("-copyts");
        let begin = self.listing.ticks[first];
        add_filters(&mut command, &format!("select='gte(pts,{begin})',showinfo,{WHOLE_PICTURES}"));
        command.args(["-pix_fmt", "rgb24", "-f", "rawvideo", "-"]).stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|e| self.video.missing(&e))?;
        let (Some(pixels), Some(messages)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(self.damaged(first, "ffmpeg gives nothing back"));
        };
        let (tell, shown) = channel();
        let complaint = Arc::clone(&self.complaint);
        std::thread::spawn(move || listen(messages, &tell, &complaint));
        Ok(Process { child, pixels, shown, next_frame: first })
    }

    /// Reads the next frame, and makes sure that it is the listed one.
    fn next(&self, process: &mut Process) -> Result<RgbImage> {
        let index = process.next_frame;
        let ended = || self.damaged(index, "the video ends before it");
        let shown = process.shown.recv().map_err(|_| ended())?;
        if self.listing.ticks.get(index).copied() != shown.ticks {
            return Err(self.damaged(index, "another one comes at its time"));
        }
        if let Some(size) = shown.size.filter(|size| *size != self.size) {
            return Err(other_size(self.path(), index, size, self.size));
        }
        let mut frame = RgbImage::new(self.size.0 as u32, self.size.1 as u32);
        process.pixels.read_exact(frame.as_mut()).map_err(|_| ended())?;
        process.next_frame += 1;
        Ok(frame)
    }

    fn damaged(&self, index: usize, why: &str) -> Error {
        Error::input_at(self.path(), format!("frame {index} of the video cannot be decoded: {why}"), "")
    }
}

/// Passes on what ffmpeg says of frames. Complaints before the first one are of frames that nobody asked for.
fn listen(messages: ChildStderr, tell: &Sender<Shown>, complaint: &Mutex<Option<String>>) {
    let (mut is_begun, mut told) = (false, Told::default());
    for line in BufReader::new(messages).split(b'\n') {
        let Ok(line) = line else { return };
        let line = String::from_utf8_lossy(&line);
        if let Some(shown) = Shown::of(line.trim()) {
            is_begun = true;
            if tell.send(shown).is_err() {
                return;
            }
        } else if is_begun {
            told.hear(line.trim());
            if let Some(what) = told.complaint.take() {
                complaint.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(what);
            }
        }
    }
}

#[cfg(test)]
#[path = "../tests/streams.rs"]
mod tests;
