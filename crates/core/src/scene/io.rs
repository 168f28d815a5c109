//! Scenes in files: reads and writes them whole.

use super::{
    Provenance, Scene, file, file::chapters::ChapterFile, gltf, ply, ply::ReferenceWeights, spz, web,
};
use crate::{
    Error, Result,
    codec::Codec,
    files::WholeFile,
    reading::{ANY_SIZE, open_regular, read_regular},
};
use std::{io::Read, path::Path};

/// Number of bytes at the beginning of a `.ply`, `.spz`, `.glb` or page within which it names the program
/// that wrote it.
const OWN_BYTES: u64 = 1 << 16;

impl Scene {
    /// Returns `true` if the file at `path` was written by this program: a scene, or a conversion of one.
    pub fn is_own_file(path: &Path) -> bool {
        let mut start = Vec::new();
        let read = open_regular(path).and_then(|file| file.take(OWN_BYTES).read_to_end(&mut start));
        read.is_ok()
            && (ply::is_own(&start)
                || gltf::is_own(&start)
                || spz::is_own(&start)
                || web::is_own(&start)
                || file::is_own(path))
    }
    /// Reads the record of how the scene in a file was made, without its Gaussians; `None` if there is none.
    pub fn provenance_of(path: &Path) -> Option<Provenance> {
        match ChapterFile::open(path, open_regular(path).ok()?).ok()? {
            Some(chapters) => chapters.provenance(),
            None => file::provenance(path),
        }
    }
    /// Tells, without reading Gaussians, if the scene in a file has a codec, so that words are found in it.
    pub fn has_codec_in(path: &Path) -> bool {
        let Ok(file) = open_regular(path) else { return false };
        match ChapterFile::open(path, file) {
            Ok(Some(chapters)) => chapters.has_codec(),
            Ok(None) => file::has_codec(path),
            Err(_) => false,
        }
    }
    /// Returns the bytes of the scene file.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        file::to_bytes(self, false)
    }
    /// Returns the bytes of the scene file in its compact form: pictures change by about 0.1 dB or less,
    /// and it is read like any other. If the result is so small that readers would refuse its size, the
    /// exact form is returned.
    pub fn to_quantized_bytes(&self) -> Result<Vec<u8>> {
        let bytes = file::to_bytes(self, true)?;
        if file::from_bytes(&bytes).is_ok() { Ok(bytes) } else { self.to_bytes() }
    }
    /// Writes the complete file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let mut file = WholeFile::create(path)?;
        self.write(&mut file, false)?;
        file.commit()
    }
    /// Returns the number of bytes of a scene file that are read at once: all, or those of its largest chapter.
    pub fn read_bytes(path: &Path) -> u64 {
        let Ok(file) = open_regular(path) else { return 0 };
        let len = file.metadata().map_or(0, |about| about.len());
        ChapterFile::open(path, file).ok().flatten().map_or(len, |chapters| chapters.largest_bytes())
    }
    /// Estimates the memory in bytes that [`Self::load`] takes: small files may hold large scenes. An
    /// unreadable file takes none.
    pub fn memory_bytes(path: &Path) -> u64 {
        let chapters = open_regular(path).ok().and_then(|file| ChapterFile::open(path, file).ok().flatten());
        if let Some(chapters) = chapters {
            return chapters.memory_bytes();
        }
        let Ok(bytes) = read_regular(path, ANY_SIZE) else { return 0 };
        let read = match &bytes[..] {
            bytes if bytes.starts_with(ply::MAGIC) => None,
            bytes if bytes.starts_with(spz::MAGIC) => spz::memory_bytes(bytes),
            bytes => file::memory_bytes(bytes),
        };
        bytes.len() as u64 + read.unwrap_or(4 * bytes.len() as u64)
    }
    /// Reads and validates a file: a scene, or a `.ply` or `.spz` of Gaussians, recognised by its content.
    /// Networks of a `.ply` are in files beside it: that of deforming features in [`LANG_DEFORMATION_FILE`],
    /// and the codec in [`AUTOENCODER_FILE`].
    pub fn load(path: &Path) -> Result<Self> {
        let file = open_regular(path).map_err(|e| Error::io("read the scene file", path, e))?;
        if let Some(chapters) = ChapterFile::open(path, file)? {
            return chapters.scene();
        }
        let bytes = read_regular(path, ANY_SIZE).map_err(|e| Error::io("read the scene file", path, e))?;
        let hint = "Choose another scene file, or train the recording again.";
        let wrong = |what| Error::input_at(path, what, hint);
        let read = match &bytes[..] {
            bytes if bytes.starts_with(ply::MAGIC) => {
                ply::from_bytes(bytes, || ReferenceWeights::beside(path))
            }
            bytes if bytes.starts_with(spz::MAGIC) => spz::from_bytes(bytes),
            bytes => return file::from_bytes(bytes).map(Self::as_chapter).map_err(wrong),
        };
        let mut scene = read.map_err(wrong)?;
        if scene.gaussians.latent_dim > 0 {
            let codec = Codec::beside(path).map_err(wrong)?;
            let of_scene = |codec: Codec| codec.of_latents(scene.gaussians.latent_dim);
            scene.codec = codec.map(of_scene).transpose().map_err(wrong)?;
        }
        scene.provenance.made_by = format!("imported by SurgTPGS {}", env!("CARGO_PKG_VERSION"));
        scene.provenance.sequence_name =
            path.file_stem().map_or(String::new(), |name| name.to_string_lossy().into_owned());
        Ok(scene)
    }
}
