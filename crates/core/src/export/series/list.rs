//! A JSON list that is written item by item, by itself or as the last member of an object.

use crate::files::WholeFile;
use std::io::{self, BufWriter, Write};

pub(super) struct JsonList {
    file: BufWriter<WholeFile>,
    is_empty: bool,
    end: &'static [u8],
}

impl JsonList {
    /// Begins the file. `head` is an object; the list becomes its member `name`.
    pub(super) fn begin(file: WholeFile, head: &serde_json::Value, name: &str) -> io::Result<Self> {
        let mut file = BufWriter::new(file);
        write!(file, "{{")?;
        for (key, value) in head.as_object().into_iter().flatten() {
            writeln!(file, "{}: {value},", serde_json::Value::from(key.as_str()))?;
        }
        write!(file, "\"{name}\": [")?;
        Ok(Self { file, is_empty: true, end: b"\n]}\n" })
    }

    /// Begins a file that is nothing but the list.
    pub(super) fn bare(file: WholeFile) -> io::Result<Self> {
        let mut file = BufWriter::new(file);
        file.write_all(b"[")?;
        Ok(Self { file, is_empty: true, end: b"\n]\n" })
    }

    pub(super) fn push(&mut self, item: &impl serde::Serialize) -> io::Result<()> {
        self.file.write_all(if self.is_empty { b"\n" } else { b",\n" })?;
        self.is_empty = false;
        Ok(serde_json::to_writer(&mut self.file, item)?)
    }

    pub(super) fn finish(mut self) -> io::Result<WholeFile> {
        self.file.write_all(self.end)?;
        Ok(self.file.into_inner()?)
    }
}
