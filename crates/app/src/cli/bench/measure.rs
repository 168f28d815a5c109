//! The interface of a measurement, and the folder that it writes.

use crate::{cli::verb::Exit, outputs};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Result,
    files::{Claim, Earlier, Inputs, OutputFolder, write_whole},
};

/// Arguments of a measurement, which make it.
pub(super) trait Measure {
    /// Makes the measurement. An earlier one in its folder is replaced if `force` says so.
    fn run(&self, force: bool) -> Result<Exit>;
}

/// Folder of a measurement, if its files are wanted.
pub(super) struct Files(Option<OutputFolder>);

impl Files {
    /// Takes the folder. An unfinished measurement in it is kept, because its rows took long, too.
    pub(super) fn claim(folder: Option<&PathBuf>, inputs: &Inputs, force: bool) -> Result<Self> {
        let claim = || Claim { unfinished: Earlier::Keep, ..Claim::new(outputs::BENCHMARK, inputs, force) };
        folder.map(|folder| OutputFolder::claim(folder, claim())).transpose().map(Self)
    }

    /// Returns the folder that is written, until it is finished.
    pub(super) fn folder(&self) -> Option<&Path> {
        self.0.as_ref().map(OutputFolder::path)
    }

    /// Writes a file, if files are wanted.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        self.folder().map_or(Ok(()), |folder| write_whole(&folder.join(name), bytes))
    }

    /// Puts the folder in its place.
    pub(super) fn finish(self) -> Result<()> {
        self.0.map_or(Ok(()), OutputFolder::finish)
    }
}
