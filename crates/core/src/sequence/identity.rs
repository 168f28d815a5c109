//! The identity of a recording, wherever it lies: the name, the size and the content of every frame.
//!
//! All results made from a recording keep its identity, and with it the parts of the frames that are hidden.
//! Names and sizes are known as soon as a recording is open. Content is hashed before a result is made from
//! it. Masks, labels and depth are not part of the identity.

use super::{
    dicom::DicomPictures,
    h264::H264,
    hidden::HiddenRectangle,
    read,
    recording::{FrameFiles, Picture, Recording},
    settings_file::settings_name,
};
use crate::{Error, Result, num::spread};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::{
    collections::{HashMap, HashSet},
    fmt::Display,
    fs::File,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Number of frames of a video, evenly spread, whose content is read when the video is opened. At most
/// [`MOST_SPOT_BYTES`] of them are read.
const SPOTS: usize = 32;
const MOST_SPOT_BYTES: u64 = 64 << 20;

/// The frames of a recording; see [`super::Sequence::identity`].
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Identity {
    frames: Vec<FileIdentity>,
    /// The video, or all of them together, if frames have no bytes of their own there.
    #[serde(default)]
    file: Option<FileIdentity>,
    /// The rectangles that are black in every frame.
    #[serde(default)]
    hidden: Vec<HiddenRectangle>,
}

/// A frame, or a whole file. It is written as one line of text.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(into = "String", try_from = "String")]
struct FileIdentity {
    name: String,
    bytes: u64,
    /// `None` if the content was not read.
    sha256: Option<[u8; 32]>,
}

/// The difference between a recording and its earlier state; in words, without a full stop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    words: String,
    /// `true` if other settings of the same recording may be the reason.
    is_of_settings: bool,
}

impl Difference {
    /// Returns advice on the recording `path` that differs: `hint`, and to look at its settings if these may
    /// be the reason.
    pub fn hint(&self, hint: &str, path: &Path) -> String {
        if !self.is_of_settings {
            return hint.to_owned();
        }
        let settings = format!("`[frames]`, `[time]` or `[[hidden]]` in {}", settings_name(path));
        format!("{hint} If its settings ({settings}) were lost or changed, put them back.")
    }
}

impl Display for Difference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.words)
    }
}

impl Identity {
    /// Returns what opening a recording tells: names and sizes, and for a video the content of a few frames.
    pub(super) fn opened(recording: &Recording) -> Result<Self> {
        let spots = spread(recording.frames.len(), SPOTS);
        let mut bytes = 0;
        // In a long video, even a few frames can stand for many bytes: those coded between them count too.
        let coded = coded_pictures(&recording.frames);
        let is_read = |spot: &usize| match &recording.frames[*spot].picture {
            Picture::Video { video, .. } => {
                bytes += video.coded_bytes(&coded[*spot]);
                bytes <= MOST_SPOT_BYTES
            }
            Picture::Dicom { frames, index } => {
                bytes += frames.coded_bytes(*index);
                bytes <= MOST_SPOT_BYTES
            }
            Picture::File(_) | Picture::Stream { .. } => false,
        };
        let spots: HashSet<usize> = spots.filter(is_read).collect();
        let sizes = recording.read_by_ffmpeg.iter().map(|path| Ok(std::fs::metadata(path)?.len()));
        // Whoever reads it next says why a file cannot be read.
        let is_small = sizes.sum::<std::io::Result<u64>>().is_ok_and(|bytes| bytes <= MOST_SPOT_BYTES);
        Self::of(recording, |i| spots.contains(&i), is_small)
    }

    /// Returns the complete identity; every frame is read.
    pub(super) fn complete(recording: &Recording) -> Result<Self> {
        Self::of(recording, |_| true, true)
    }

    /// `is_hashed` says of which frames the content is read; `is_file_hashed`, if that of files is whose frames
    /// have no bytes of their own.
    fn of(
        recording: &Recording,
        is_hashed: impl Fn(usize) -> bool + Sync,
        is_file_hashed: bool,
    ) -> Result<Self> {
        let (frames, hidden) = (&recording.frames, recording.hidden.clone());
        let coded = coded_pictures(frames);
        let part = |i: usize| match &frames[i].picture {
            Picture::Stream { .. } => Ok(FileIdentity::without_bytes(&frames[i].name)),
            Picture::File(_) if !recording.read_by_ffmpeg.is_empty() => {
                Ok(FileIdentity::without_bytes(&frames[i].name))
            }
            Picture::File(path) => FileIdentity::of_file(path, is_hashed(i)),
            Picture::Video { video, .. } => {
                FileIdentity::of_coded(&frames[i].name, video, &coded[i], is_hashed(i))
            }
            Picture::Dicom { frames: pictures, index } => {
                FileIdentity::of_dicom(&frames[i].name, pictures, *index, is_hashed(i))
            }
        };
        let frames = (0..frames.len()).into_par_iter().map(part).collect::<Result<_>>()?;
        let file = FileIdentity::of_videos(&recording.read_by_ffmpeg, is_file_hashed)?;
        Ok(Self { frames, file, hidden })
    }

    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        self.frames.len()
    }

    /// Returns the file names of the frames (or their numbers, for a video).
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.frames.iter().map(|frame| frame.name.as_str())
    }

    /// Returns the SHA-256 over everything known, hexadecimal: equal recordings have equal digests.
    pub fn digest(&self) -> String {
        self.hashed(FileIdentity::to_string)
    }

    /// Returns the digest of names and sizes alone; see [`Self::digest`].
    pub fn outline_digest(&self) -> String {
        self.hashed(|part| FileIdentity { sha256: None, ..part.clone() }.to_string())
    }

    /// Returns the SHA-256, hexadecimal, over the content that opening a video or DICOM reads: that of a few
    /// frames, or of a file whose frames have no bytes of their own. A complete identity has the same one.
    /// `None` where that content is not known.
    pub fn spots_digest(&self) -> Option<String> {
        let mut bytes = 0;
        let is_read = |frame: &&FileIdentity| {
            bytes += frame.bytes;
            frame.bytes > 0 && bytes <= MOST_SPOT_BYTES
        };
        let spots = spread(self.frames.len(), SPOTS).map(|spot| &self.frames[spot]);
        let frames: Vec<FileIdentity> = spots.filter(is_read).cloned().collect();
        let read = Self { frames, file: self.file.clone(), hidden: Vec::new() };
        let mut parts = read.frames.iter().chain(&read.file).peekable();
        let is_known = parts.peek().is_some() && parts.all(|part| part.sha256.is_some());
        is_known.then(|| read.digest())
    }

    /// Returns the rectangles that are black in every frame.
    pub fn hidden(&self) -> &[HiddenRectangle] {
        &self.hidden
    }

    /// Returns the digest without what is hidden, by which a recording can be named.
    pub(super) fn content_digest(&self) -> String {
        Self { hidden: Vec::new(), ..self.clone() }.digest()
    }

    fn hashed(&self, line: impl Fn(&FileIdentity) -> String) -> String {
        let mut hash = Sha256::new();
        self.frames.iter().chain(&self.file).for_each(|part| hash.update(line(part) + "\n"));
        self.hidden.iter().for_each(|rectangle| hash.update(format!("hidden {rectangle}\n")));
        format!("{:x}", hash.finalize())
    }

    /// Returns the number of frames in both: by content if both know it, else by name and size.
    pub fn frames_in_common(&self, other: &Self) -> usize {
        if let (Some(file), Some(others)) = (&self.file, &other.file) {
            let is_same = file.is_like(others);
            return if is_same { self.frames.len().min(other.frames.len()) } else { 0 };
        }
        let contents = |of: &Self| of.frames.iter().map(|f| f.sha256).collect::<Option<Vec<_>>>();
        if let (Some(mine), Some(theirs)) = (contents(self), contents(other)) {
            let theirs: HashSet<_> = theirs.into_iter().collect();
            return mine.iter().filter(|hash| theirs.contains(*hash)).count();
        }
        let by_name: HashMap<&str, &FileIdentity> =
            other.frames.iter().map(|f| (f.name.as_str(), f)).collect();
        let is_there = |f: &FileIdentity| by_name.get(f.name.as_str()).is_some_and(|o| o.is_like(f));
        let moved =
            |i: usize, f: &FileIdentity| other.frames.get(i).is_some_and(|o| o.bytes > 0 && o.is_like(f));
        self.frames.iter().enumerate().filter(|(i, f)| is_there(f) || moved(*i, f)).count()
    }

    /// Returns the first difference from the earlier state `then`. Content counts if both know it.
    pub fn difference(&self, then: &Self) -> Option<Difference> {
        let is_same =
            |(now, then): (&FileIdentity, &FileIdentity)| now.name == then.name && now.is_like(then);
        let files = match (&self.file, &then.file) {
            (Some(now), Some(then)) => now.is_like(then),
            (now, then) => now.is_some() == then.is_some(),
        };
        let (count, earlier) = (self.frames.len(), then.frames.len());
        if files && count == earlier && self.frames.iter().zip(&then.frames).all(is_same) {
            let is_hidden = self.hidden == then.hidden;
            let words = "other parts of its frames are hidden".to_owned();
            return (!is_hidden).then_some(Difference { words, is_of_settings: true });
        }
        let is_other = self.frames_in_common(then) == 0;
        let words = if is_other {
            "it is another one, no frame is the same".to_owned()
        } else if count != earlier {
            let number = |n: usize| if n == 1 { "1 frame".to_owned() } else { format!("{n} frames") };
            format!("it has {} instead of {earlier}{}", number(count), self.stray(then))
        } else if let Some(i) = (0..count).find(|&i| !is_same((&self.frames[i], &then.frames[i]))) {
            self.change(i, then)
        } else {
            "the video is another file".to_owned()
        };
        Some(Difference { words, is_of_settings: !is_other && count != earlier })
    }

    /// Names the frame that is missing or new, if there are fewer or more.
    fn stray(&self, then: &Self) -> String {
        let first = |of: &Self, without: &Self, what: &str| {
            let known: HashSet<&str> = without.names().collect();
            let stray = of.names().enumerate().find(|(_, name)| !known.contains(name));
            stray.map(|(i, name)| format!(", frame {i} \"{name}\" is {what}"))
        };
        let missing = || first(then, self, "missing");
        let new = || first(self, then, "new");
        if self.frames.len() < then.frames.len() { missing().or_else(new) } else { new().or_else(missing) }
            .unwrap_or_default()
    }

    /// Describes the change of frame `i`, if there are equally many frames.
    fn change(&self, i: usize, then: &Self) -> String {
        let (now, was) = (&self.frames[i], &then.frames[i]);
        if now.name != was.name {
            return if then.names().any(|name| name == now.name) && !self.names().any(|name| name == was.name)
            {
                format!("frame {i} \"{}\" is missing", was.name)
            } else {
                format!("frame {i} is called \"{}\" but was \"{}\"", now.name, was.name)
            };
        }
        let what = if now.bytes == was.bytes { "content" } else { "size" };
        format!("frame {i} \"{}\" has another {what}", now.name)
    }

    /// Returns an error if the recording differs from its earlier state `then`. `made` says what it was
    /// used for, as in "the scene was trained on".
    pub fn require(&self, then: &Self, path: &Path, made: &str) -> Result<()> {
        let Some(difference) = self.difference(then) else { return Ok(()) };
        let what = format!("this is not the recording that {made}: {difference}");
        let hint = "Give the recording as it was, or make everything anew from this one.";
        Err(Error::input_at(path, what, difference.hint(hint, path)))
    }
}

/// Returns for each frame of a video the coded pictures that it stands for, by their places in decoding
/// order: its own, and those decoded before it that no frame of the recording shows. Frames in files have
/// none.
fn coded_pictures(frames: &[FrameFiles]) -> Vec<Vec<usize>> {
    let is_same_video = |a: &FrameFiles, b: &FrameFiles| match (&a.picture, &b.picture) {
        (Picture::Video { video: a, .. }, Picture::Video { video: b, .. }) => Arc::ptr_eq(a, b),
        (Picture::File(_), Picture::File(_)) => true,
        _ => false,
    };
    frames.chunk_by(is_same_video).flat_map(coded_pictures_of_one).collect()
}

/// Does the same for frames of one video.
fn coded_pictures_of_one(frames: &[FrameFiles]) -> Vec<Vec<usize>> {
    let own = |frame: &FrameFiles| match &frame.picture {
        Picture::Video { video, index } => Some((video.sample_of(*index), video.start_of(*index))),
        Picture::File(_) | Picture::Stream { .. } | Picture::Dicom { .. } => None,
    };
    let shown: HashSet<usize> = frames.iter().filter_map(own).map(|(sample, _)| sample).collect();
    let mut known = 0;
    let pictures = frames.iter().map(|frame| {
        let Some((sample, start)) = own(frame) else { return Vec::new() };
        let since = known.max(start);
        known = known.max(sample + 1);
        (since..sample).filter(|other| !shown.contains(other)).chain([sample]).collect()
    });
    pictures.collect()
}

impl FileIdentity {
    fn of_file(path: &Path, is_hashed: bool) -> Result<Self> {
        let fail = |e| Error::io("read the frame", path, e);
        let bytes = std::fs::metadata(path).map_err(fail)?.len();
        let hash = || {
            let mut hash = Sha256::new();
            std::io::copy(&mut File::open(path)?, &mut hash)?;
            Ok(hash.finalize().into())
        };
        let sha256 = is_hashed.then(hash).transpose().map_err(fail)?;
        Ok(Self { name: read::file_name(path), bytes, sha256 })
    }

    /// Creates the part of a frame that has no bytes of its own.
    fn without_bytes(name: &str) -> Self {
        Self { name: name.to_owned(), bytes: 0, sha256: None }
    }

    /// Creates the part of videos whose frames have no bytes of their own; `None` without any.
    fn of_videos(paths: &[PathBuf], is_hashed: bool) -> Result<Option<Self>> {
        let files = paths.iter().map(|path| Self::of_file(path, is_hashed)).collect::<Result<Vec<_>>>()?;
        Ok(match &files[..] {
            [] => None,
            [only] => Some(Self { name: String::new(), ..only.clone() }),
            several => {
                let mut hash = Sha256::new();
                several.iter().filter_map(|file| file.sha256).for_each(|sha256| hash.update(sha256));
                let bytes = several.iter().map(|file| file.bytes).sum();
                let sha256 = is_hashed.then(|| hash.finalize().into());
                Some(Self { name: String::new(), bytes, sha256 })
            }
        })
    }

    /// Creates the part of a video frame from the coded pictures that it stands for.
    fn of_coded(name: &str, video: &H264, pictures: &[usize], is_hashed: bool) -> Result<Self> {
        let bytes = video.coded_bytes(pictures);
        let hash = || {
            let mut hash = Sha256::new();
            video.read_coded(pictures, |bytes| hash.update(bytes))?;
            Ok(hash.finalize().into())
        };
        Ok(Self { name: name.to_owned(), bytes, sha256: is_hashed.then(hash).transpose()? })
    }

    /// Creates the part of a frame that is decoded from a DICOM file.
    fn of_dicom(name: &str, pictures: &DicomPictures, index: usize, is_hashed: bool) -> Result<Self> {
        let hash = || Ok::<_, Error>(Sha256::digest(pictures.read_coded(index)?).into());
        let sha256 = is_hashed.then(hash).transpose()?;
        Ok(Self { name: name.to_owned(), bytes: pictures.coded_bytes(index), sha256 })
    }

    /// Returns `true` if the sizes are equal and, where both are known, the contents too.
    fn is_like(&self, other: &Self) -> bool {
        let content = self.sha256.zip(other.sha256).is_none_or(|(mine, theirs)| mine == theirs);
        self.bytes == other.bytes && content
    }
}

impl Display for FileIdentity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.sha256 {
            Some(hash) => hash.iter().try_for_each(|byte| write!(f, "{byte:02x}"))?,
            None => f.write_str("-")?,
        }
        write!(f, " {} {}", self.bytes, self.name)
    }
}

impl From<FileIdentity> for String {
    fn from(part: FileIdentity) -> Self {
        part.to_string()
    }
}

impl TryFrom<String> for FileIdentity {
    type Error = String;

    fn try_from(line: String) -> Result<Self, String> {
        let wrong = || format!("\"{line}\" is not a hash, a size and a name");
        let mut words = line.splitn(3, ' ');
        let (Some(hash), Some(bytes), Some(name)) = (words.next(), words.next(), words.next()) else {
            return Err(wrong());
        };
        let sha256 = if hash == "-" { None } else { Some(of_hex(hash).ok_or_else(wrong)?) };
        Ok(Self { name: name.to_owned(), bytes: bytes.parse().map_err(|_| wrong())?, sha256 })
    }
}

fn of_hex(text: &str) -> Option<[u8; 32]> {
    let digit = |c: u8| char::from(c).to_digit(16);
    let pairs = text.as_bytes().as_chunks::<2>();
    let bytes: Option<Vec<u8>> =
        pairs.0.iter().map(|&[a, b]| Some((digit(a)? << 4 | digit(b)?) as u8)).collect();
    bytes.filter(|_| pairs.1.is_empty())?.try_into().ok()
}

/// Serialisation of a shared identity.
pub(crate) mod shared {
    use super::Identity;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::sync::Arc;

    pub(crate) fn serialize<S: Serializer>(
        identity: &Option<Arc<Identity>>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        identity.as_deref().serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Arc<Identity>>, D::Error> {
        Ok(Option::<Identity>::deserialize(from)?.map(Arc::new))
    }
}
