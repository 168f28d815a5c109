//! The file of a scene in chapters: a safetensors file whose tensors are scene files. `chapter.K` holds the
//! Gaussians and the motion of a chapter, `index` everything else. A list of the chapters is in the metadata.

use super::{MOST_HEADER, from_bytes, memory_bytes, to_bytes};
use crate::{
    Error, Result,
    scene::{
        Chapter, Chapters, Problem, Provenance, Scene,
        part::{Part, wrong},
    },
};
use std::{
    collections::BTreeMap,
    fs::File,
    io::{Read, Seek, SeekFrom, Write},
    path::Path,
    sync::{Arc, Mutex},
};

const METADATA_KEY: &str = "surgtpgs_chapters";
/// Version of the layout; a reader refuses a newer one.
const VERSION: u32 = 1;
/// Bytes of the header for each tensor, and for everything else.
const HEADER_BYTES: [usize; 2] = [512, 1024];

#[derive(serde::Serialize, serde::Deserialize)]
struct List {
    version: u32,
    chapters: Vec<Chapter>,
}

#[derive(serde::Serialize, serde::Deserialize)]
struct Header {
    #[serde(rename = "__metadata__")]
    metadata: BTreeMap<String, String>,
    #[serde(flatten)]
    tensors: BTreeMap<String, Entry>,
}

#[derive(serde::Serialize, serde::Deserialize)]
struct Entry {
    dtype: String,
    shape: Vec<u64>,
    data_offsets: [u64; 2],
}

/// An opened file of a scene in chapters.
pub(in crate::scene) struct ChapterFile {
    index: Part,
    chapters: Vec<(Chapter, Part)>,
}

impl ChapterFile {
    /// Reads the list of a file; `None` if it holds no chapters.
    pub(in crate::scene) fn open(path: &Path, mut file: File) -> Result<Option<Self>> {
        let fail = |e| Error::io("read the scene file", path, e);
        let len = file.metadata().map_err(fail)?.len();
        let mut header = [0; 8];
        if file.read_exact(&mut header).is_err() {
            return Ok(None);
        }
        let header_len = u64::from_le_bytes(header);
        if header_len > MOST_HEADER || header_len.saturating_add(8) > len {
            return Ok(None);
        }
        let mut header = Vec::new();
        Read::by_ref(&mut file).take(header_len).read_to_end(&mut header).map_err(fail)?;
        let Ok(header) = serde_json::from_slice::<Header>(&header) else { return Ok(None) };
        let Some(list) = header.metadata.get(METADATA_KEY) else { return Ok(None) };
        Self::parts(path, file, list, &header.tensors, [header_len + 8, len])
            .map(Some)
            .map_err(|what| wrong(path, what))
    }

    fn parts(
        path: &Path,
        file: File,
        list: &str,
        tensors: &BTreeMap<String, Entry>,
        [start, end]: [u64; 2],
    ) -> Result<Self, Problem> {
        let list: List =
            serde_json::from_str(list).map_err(|e| format!("the list of chapters is damaged: {e}"))?;
        if list.version > VERSION {
            return Err(format!(
                "the scene file has version {} of chapters, this program reads up to {VERSION}",
                list.version
            ));
        }
        let file = Arc::new(Mutex::new(file));
        let part = |name: &str| {
            let entry = tensors.get(name).ok_or_else(|| format!("the scene file lacks `{name}`"))?;
            let [from, to] = entry.data_offsets;
            let is_inside = from <= to && start.checked_add(to).is_some_and(|to| to <= end);
            is_inside
                .then(|| Part::new(path, &file, [start + from, to - from]))
                .ok_or_else(|| format!("this is not a complete scene file: `{name}` ends after it"))
        };
        let mut next = 0;
        for chapter in &list.chapters {
            if chapter.shown.start < next || chapter.shown.is_empty() {
                return Err(format!("the list of chapters is damaged at chapter {}", chapter.index));
            }
            next = chapter.shown.end;
        }
        let index = part("index")?;
        let chapters = list.chapters.into_iter().map(|c| Ok((c.clone(), part(&name(&c))?)));
        Ok(Self { index, chapters: chapters.collect::<Result<_, Problem>>()? })
    }

    /// Reads the scene, with the Gaussians of its first chapter.
    pub(in crate::scene) fn scene(self) -> Result<Scene> {
        let mut scene = self.index.scene()?;
        scene.chapters = Chapters::of_parts(self.chapters, scene.provenance.steps);
        if scene.chapters.iter().any(|chapter| chapter.shown.end > scene.num_frames()) {
            return Err(Error::input("a chapter of the scene ends after its frames", ""));
        }
        let first = scene.chapters.iter().next().map(|chapter| chapter.index);
        first.map_or(Ok(scene.clone()), |first| scene.of_chapter(first))
    }

    /// Reads the record of the scene; `None` if it cannot be read.
    pub(in crate::scene) fn provenance(&self) -> Option<Provenance> {
        self.index.scene().ok().map(|scene| scene.provenance)
    }

    /// Returns `true` if the scene has a codec.
    pub(in crate::scene) fn has_codec(&self) -> bool {
        self.index.scene().is_ok_and(|scene| scene.codec.is_some())
    }

    /// Returns the number of bytes of the largest chapter.
    pub(in crate::scene) fn largest_bytes(&self) -> u64 {
        self.chapters.iter().map(|(_, part)| part.len()).max().unwrap_or(0)
    }

    /// Estimates the memory that the scene takes with its largest chapter; none if that cannot be read.
    pub(in crate::scene) fn memory_bytes(&self) -> u64 {
        let largest = self.chapters.iter().map(|(_, part)| part).max_by_key(|part| part.len());
        let of = |part: &Part| part.bytes().ok().and_then(|bytes| memory_bytes(&bytes)).unwrap_or(0);
        largest.map_or(0, of).saturating_add(of(&self.index))
    }
}

fn name(chapter: &Chapter) -> String {
    format!("chapter.{}", chapter.index)
}

/// Writes a scene with all its chapters, one after the other.
pub(in crate::scene) fn write(scene: &Scene, to: &mut (impl Write + Seek), compact: bool) -> Result<()> {
    let chapters: Vec<Chapter> = scene.chapters.iter().cloned().collect();
    let header_len = HEADER_BYTES[0] * (chapters.len() + 1) + HEADER_BYTES[1];
    let fail = |e: std::io::Error| Error::io("write the scene", Path::new(""), e);
    to.seek(SeekFrom::Start(8 + header_len as u64)).map_err(fail)?;
    let (mut tensors, mut at) = (BTreeMap::new(), 0);
    let mut put = |name: String, bytes: &[u8]| {
        let end = at + bytes.len() as u64;
        let entry = Entry { dtype: "U8".into(), shape: vec![bytes.len() as u64], data_offsets: [at, end] };
        tensors.insert(name, entry);
        at = end;
        to.write_all(bytes).map_err(fail)
    };
    for chapter in &chapters {
        put(name(chapter), &part_bytes(scene.of_chapter(chapter.index)?, chapter, compact)?)?;
    }
    put("index".into(), &to_bytes(&scene.without_gaussians(), compact)?)?;
    let list = serde_json::to_string(&List { version: VERSION, chapters });
    let list = list.map_err(|e| Error::input(format!("the scene could not be written: {e}"), ""))?;
    let header = Header { metadata: BTreeMap::from([(METADATA_KEY.to_owned(), list)]), tensors };
    let mut header = serde_json::to_vec(&header)
        .map_err(|e| Error::input(format!("the scene could not be written: {e}"), ""))?;
    if header.len() > header_len {
        return Err(Error::input("the scene could not be written: the list of its chapters is too long", ""));
    }
    // Spaces at the end of a header are allowed.
    header.resize(header_len, b' ');
    to.seek(SeekFrom::Start(0)).map_err(fail)?;
    to.write_all(&(header.len() as u64).to_le_bytes()).map_err(fail)?;
    to.write_all(&header).map_err(fail)
}

/// Returns the scene file of a chapter, without what the index holds.
fn part_bytes(scene: Scene, chapter: &Chapter, compact: bool) -> Result<Vec<u8>> {
    let scene = Scene {
        cameras: vec![scene.cameras[chapter.shown.start]],
        times: Vec::new(),
        codec: None,
        classes: Vec::new(),
        encoder: None,
        words: crate::meaning::WordFacts::default(),
        provenance: Provenance::default(),
        ..scene
    };
    let bytes = to_bytes(&scene, compact)?;
    // As with a scene that is one whole, the compact form may be too small to be believed.
    if compact && from_bytes(&bytes).is_err() { to_bytes(&scene, false) } else { Ok(bytes) }
}
