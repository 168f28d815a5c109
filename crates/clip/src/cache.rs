//! Cache of embeddings: in memory, and on disk if a folder is given.
//!
//! The key of an entry is a hash of the encoder and the text. Entries hold numbers only, so that no words
//! can be read from the folder.

use crate::model_file::hex;
use sha2::{Digest, Sha256};
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};
use surgtpgs_core::{
    files::write_whole,
    num,
    reading::{MOST_TEXT, read_regular},
};

/// Largest number of embeddings kept in memory; a session of typing stays far below it.
const MAX_IN_MEMORY: usize = 4096;

/// Unit embeddings, keyed by the text as it reaches the tokenizer.
#[derive(Debug, Default)]
pub(crate) struct EmbeddingCache {
    memory: HashMap<String, Vec<f32>>,
    /// Folder of one encoder's embeddings on disk.
    folder: Option<PathBuf>,
}

impl EmbeddingCache {
    /// Keeps embeddings in memory and in a subfolder of `folder` for the encoder with this SHA-256.
    pub(crate) fn on_disk(folder: &Path, encoder: &str) -> Self {
        Self { memory: HashMap::new(), folder: Some(folder.join(encoder)) }
    }

    /// Returns the known embedding of a text; damaged files are ignored.
    pub(crate) fn get(&mut self, text: &str) -> Option<Vec<f32>> {
        if let Some(known) = self.memory.get(text) {
            return Some(known.clone());
        }
        let embedding = read(&self.file(text)?)?;
        self.remember(text, &embedding);
        Some(embedding)
    }

    /// Keeps an embedding. Errors of writing are ignored: the embedding is then computed again the next time.
    pub(crate) fn put(&mut self, text: &str, embedding: &[f32]) {
        self.remember(text, embedding);
        if let Some(file) = self.file(text) {
            let bytes: Vec<u8> = embedding.iter().flat_map(|v| v.to_le_bytes()).collect();
            let _ = write_whole(&file, &bytes);
        }
    }

    fn remember(&mut self, text: &str, embedding: &[f32]) {
        if self.memory.len() >= MAX_IN_MEMORY {
            self.memory.clear();
        }
        self.memory.insert(text.to_owned(), embedding.to_vec());
    }

    fn file(&self, text: &str) -> Option<PathBuf> {
        let name = format!("{}.f32", hex(Sha256::new_with_prefix(text)));
        self.folder.as_ref().map(|folder| folder.join(name))
    }
}

/// Reads a file of little-endian numbers; `None` unless they form a unit vector.
fn read(file: &Path) -> Option<Vec<f32>> {
    let bytes = read_regular(file, MOST_TEXT).ok()?;
    let (numbers, rest) = bytes.as_chunks::<4>();
    let embedding: Vec<f32> = numbers.iter().map(|b| f32::from_le_bytes(*b)).collect();
    (rest.is_empty() && (num::norm(&embedding) - 1.0).abs() < 1e-3).then_some(embedding)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn embeddings_outlive_the_program_and_belong_to_one_encoder() {
        let folder = tempfile::tempdir().unwrap();
        let open = |encoder: &str| EmbeddingCache::on_disk(folder.path(), encoder);
        open("a").put("liver", &[0.6, 0.8]);
        assert_eq!(open("a").get("liver"), Some(vec![0.6, 0.8]));
        assert_eq!((open("a").get("fat"), open("b").get("liver")), (None, None));
        let kept: Vec<_> = std::fs::read_dir(folder.path().join("a")).unwrap().flatten().collect();
        let [file] = &kept[..] else { panic!("one file") };
        assert!(!file.file_name().to_string_lossy().contains("liver"));
    }

    #[test]
    fn damaged_files_are_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let mut cache = EmbeddingCache::on_disk(folder.path(), "a");
        cache.put("liver", &[0.6, 0.8]);
        for damaged in [&b""[..], b"123", &f32::NAN.to_le_bytes(), &5.0_f32.to_le_bytes()] {
            std::fs::write(cache.file("liver").unwrap(), damaged).unwrap();
            assert_eq!(EmbeddingCache::on_disk(folder.path(), "a").get("liver"), None);
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_no_hindrance() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut cache = EmbeddingCache::on_disk(file.path(), "a");
        cache.put("liver", &[1.0]);
        assert_eq!(cache.get("liver"), Some(vec![1.0]));
    }
}
