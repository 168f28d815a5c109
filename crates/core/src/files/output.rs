//! Folders for results.

use super::{
    lock::{Lock, short_hash},
    place::{Inputs, real_place, require_outside_of_outputs},
    record::{RECORD_FILE, Record, is_free_folder, is_own},
    temporary::TEMPORARY,
    whole::sync_parent,
};
use crate::{Error, Remedy, Result};
use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
};
use walkdir::WalkDir;

/// A request for an output folder: the result to write, and the earlier results that may be in its place.
#[derive(Clone, Copy)]
pub struct Claim<'a> {
    /// Kind of output, e.g. "export"; only the same kind is continued or replaced.
    pub kind: &'a str,
    /// Inputs of the run.
    pub inputs: &'a Inputs,
    /// `true` if a finished result of the same kind may be replaced.
    pub replace: bool,
    /// Treatment of an unfinished result.
    pub unfinished: Earlier,
    /// Tells if a folder holds, finished or not, this very result.
    pub is_same: &'a dyn Fn(&Path) -> bool,
    /// `true` if this very result is completed in its place.
    pub completes_same: bool,
}

impl<'a> Claim<'a> {
    /// Creates a claim for a result that is written in one go, and begun again if it was not finished.
    pub fn new(kind: &'a str, inputs: &'a Inputs, replace: bool) -> Self {
        Self {
            kind,
            inputs,
            replace,
            unfinished: Earlier::BeginAgain,
            is_same: &|_| false,
            completes_same: false,
        }
    }
}

/// Treatment of an unfinished result of the same kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Earlier {
    /// Its files are removed.
    BeginAgain,
    /// Its files stay, so that the new run can use them again.
    GoOn,
    /// It counts as finished.
    Keep,
}

/// A folder that a result is written into: new or unfinished, locked, with a record of its files. If it
/// replaces an earlier result, it is made beside that and takes its place in [`OutputFolder::finish`].
/// Until then, and if anything fails, the earlier one stays as it is.
#[derive(Debug)]
pub struct OutputFolder {
    /// Final place of the result.
    target: PathBuf,
    /// Folder in which it is made.
    work: PathBuf,
    /// Locks of both folders.
    locks: Vec<Lock>,
    /// `true` if the folder to write into was created for this result.
    is_made: bool,
    /// `true` if an unfinished result is of use to the next run.
    goes_on: bool,
    finished: bool,
}

impl OutputFolder {
    /// Takes the folder `path`, which must be new, empty, or hold a result that the claim may continue or
    /// replace; links are followed. Returns an error, and changes nothing, if the folder is or touches an
    /// input, lies in another result, holds anything else, or is being written to by another program.
    pub fn claim(path: &Path, claim: Claim<'_>) -> Result<Self> {
        let target = real_place(path)?;
        if target.is_file() {
            return Err(Error::input_at(path, "this is a file, a folder is needed", "Choose another name."));
        }
        claim.inputs.require_apart(&target)?;
        require_outside_of_outputs(&target)?;
        put_back_old(&target)?;
        if is_free_folder(&target)? {
            return Self::begin(target, &claim);
        }
        let earlier = || Record::read(&target).filter(|record| record.kind == claim.kind);
        if earlier().is_none() {
            return Err(foreign(path, &target, claim.kind));
        }
        let lock = Lock::of_folder(&target)?;
        // Another program may have finished or replaced it in the meantime.
        let record = earlier().ok_or_else(|| foreign(path, &target, claim.kind))?;
        let goes_on = claim.unfinished == Earlier::GoOn && !record.complete;
        let is_completed = goes_on || claim.completes_same && (claim.is_same)(&target);
        let begins_again = claim.unfinished == Earlier::BeginAgain && !record.complete;
        if !is_completed && !begins_again && !claim.replace {
            let what = format!("the folder holds another {}", claim.kind);
            return Err(Error::input_at(path, what, Remedy::Replace.after("Choose a new folder.")));
        }
        require_own_files(&record, &target)?;
        if !is_completed && begins_again {
            remove_contents(&target, &record)?;
            Record::new(claim.kind).write(&target)?;
        }
        if is_completed || begins_again {
            return Ok(Self::taken(target.clone(), target, vec![lock], &claim));
        }
        Self::begin_beside(target, lock, &claim)
    }

    fn taken(target: PathBuf, work: PathBuf, locks: Vec<Lock>, claim: &Claim<'_>) -> Self {
        let goes_on = claim.unfinished != Earlier::BeginAgain;
        Self { target, work, locks, is_made: false, goes_on, finished: false }
    }

    /// Takes a folder that does not exist or is empty.
    fn begin(target: PathBuf, claim: &Claim<'_>) -> Result<Self> {
        let is_made = !target.exists();
        make_folder(&target)?;
        let lock = Lock::of_folder(&target)?;
        // Another program may have been quicker.
        if !is_free_folder(&target)? {
            return Err(foreign(&target, &target, claim.kind));
        }
        let mut output = Self::taken(target.clone(), target, vec![lock], claim);
        output.is_made = is_made;
        Record::new(claim.kind).write(&output.work)?;
        Ok(output)
    }

    /// Takes a folder beside a result that is to be replaced.
    fn begin_beside(target: PathBuf, lock: Lock, claim: &Claim<'_>) -> Result<Self> {
        require_replaceable(&target)?;
        let aside = beside(&target, "old");
        if Record::read(&aside).is_some() {
            // Left by a program that was killed after the new result was in its place.
            remove_tree(&aside)?;
        }
        let work = beside(&target, "new");
        let there = Record::read(&work);
        if there.is_none() && work.symlink_metadata().is_ok() && !is_free_folder(&work)? {
            let what = "something of somebody else's has the name of the new result while it is made";
            return Err(Error::input_at(&work, what, "Move it away."));
        }
        let unfinished = there.filter(|record| record.kind == claim.kind && !record.complete);
        let is_of_use = claim.unfinished == Earlier::GoOn || (claim.is_same)(&work);
        if unfinished.is_none() || !is_of_use {
            remove_tree(&work)?;
        }
        make_folder(&work)?;
        let locks = vec![lock, Lock::of_folder(&work)?];
        let output = Self::taken(target, work, locks, claim);
        if Record::read(&output.work).is_none() {
            Record::new(claim.kind).write(&output.work)?;
        }
        Ok(output)
    }

    /// Returns the folder to write into.
    pub fn path(&self) -> &Path {
        &self.work
    }

    /// Returns the path of the folder once it is finished.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Copies the files in the subfolder `name` of the replaced result into the new folder, but for those that
    /// are there: an earlier run copied or made them, and a file is whole or not there at all.
    pub fn take_over(&self, name: &str) -> Result<()> {
        let (from, to) = (self.target.join(name), self.work.join(name));
        if self.work == self.target || !from.is_dir() {
            return Ok(());
        }
        let fail = |e| Error::io("take over files of the earlier result", &from, e);
        for entry in from.read_dir().map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            let place = to.join(path.file_name().unwrap_or_default());
            if path.is_file() && !place.exists() {
                let mut source = std::fs::File::open(&path).map_err(fail)?;
                super::write_whole_with(&place, |file| std::io::copy(&mut source, file).map(drop))?;
            }
        }
        Ok(())
    }

    /// Marks the result as complete and puts it in its place; an earlier one is removed. If that fails,
    /// the earlier one is still there.
    pub fn finish(mut self) -> Result<()> {
        let mut record = Record::read(&self.work).ok_or_else(|| {
            Error::input_at(&self.work, "the folder was changed while it was written", "Do it again.")
        })?;
        record.files.retain(|name| self.work.join(name).symlink_metadata().is_ok());
        remove_temporary_files(&self.work);
        record.complete = true;
        record.write(&self.work)?;
        if self.work != self.target {
            self.finished = true;
            self.replace_earlier()?;
        }
        self.finished = true;
        Ok(())
    }

    /// Swaps the complete new result with the earlier one, and removes the earlier one.
    fn replace_earlier(&mut self) -> Result<()> {
        let is_at = |e| match e {
            Error::Input { what, hint, path } => Error::Input {
                what: format!("{what}; the new result is in {}", self.work.display()),
                hint,
                path,
            },
            Error::Io { doing, source, path } => {
                let doing = format!("{doing} (the new result is in {})", self.work.display());
                Error::Io { doing, source, path }
            }
            other => other,
        };
        if let Some(earlier) = Record::read(&self.target) {
            require_own_files(&earlier, &self.target).map_err(is_at)?;
        }
        if cfg!(not(unix)) {
            // Folders with open files cannot be moved here.
            self.locks.clear();
        }
        exchange(&self.work, &self.target).map_err(is_at)?;
        sync_parent(&self.target);
        if let [old, new] = &mut self.locks[..] {
            old.change_places(new);
        }
        self.locks.drain(..self.locks.len().min(1));
        // The new result is in its place; remains of the old one are removed with the next replacement.
        let _ = remove_tree(&self.work);
        Ok(())
    }
}

impl Drop for OutputFolder {
    /// Removes an output that was never begun, and a failed replacement that is of no use to the next run.
    fn drop(&mut self) {
        if self.finished {
            return;
        }
        let is_beside = self.work != self.target;
        if is_beside && !self.goes_on {
            let _ = remove_tree(&self.work);
        }
        if Record::read(&self.work).is_some_and(|record| record.files.is_empty() && !record.complete)
            && is_free_folder(&self.work).unwrap_or(false)
        {
            let _ = std::fs::remove_file(self.work.join(RECORD_FILE));
            self.locks.clear();
            if self.is_made || is_beside {
                let _ = std::fs::remove_dir(&self.work);
            }
        }
    }
}

/// Takes the folder `path` for outputs of a run that are made one by one, each with a claim of its own.
/// It must be new, hold no file, or be such a folder of the same kind already. Returns its path without
/// links. Fails as [`OutputFolder::claim`] does.
pub fn claim_collection(path: &Path, kind: &str, inputs: &Inputs) -> Result<PathBuf> {
    let target = real_place(path)?;
    if target.is_file() {
        return Err(Error::input_at(path, "this is a file, a folder is needed", "Choose another name."));
    }
    inputs.require_apart(&target)?;
    require_outside_of_outputs(&target)?;
    match Record::read(&target) {
        Some(record) if record.kind == kind && record.holds_outputs => {}
        // Workflow engines make folders for results beforehand.
        _ if !holds_file(&target) => {
            make_folder(&target)?;
            Record { holds_outputs: true, ..Record::new(kind) }.write(&target)?;
        }
        _ => return Err(foreign(path, &target, kind)),
    }
    Ok(target)
}

/// Returns the folder beside `target` in which a replacement is made, or the replaced result is
/// kept for a moment.
pub(super) fn beside(target: &Path, what: &str) -> PathBuf {
    target.with_file_name(format!(".surgtpgs-{}.{what}", short_hash(target)))
}

/// Returns `true` if there is a file anywhere under `folder`, or an entry that cannot be read.
fn holds_file(folder: &Path) -> bool {
    let mut entries = WalkDir::new(folder).min_depth(1).into_iter();
    let is_nobodys = |e: walkdir::DirEntry| e.file_type().is_dir() || is_own(e.path());
    folder.exists() && entries.any(|entry| !entry.is_ok_and(is_nobodys))
}

fn foreign(path: &Path, target: &Path, kind: &str) -> Error {
    let what = match Record::read(target) {
        Some(other) => format!("the folder holds another kind of result ({}, not {kind})", other.kind),
        None => format!(
            "the folder is not empty, and what is in it was not written as this kind of result ({kind})"
        ),
    };
    Error::input_at(path, what, "Choose a new or empty folder.")
}

/// Returns an error if a folder of ours holds files that this program did not write: replacing it
/// would lose them.
fn require_own_files(record: &Record, folder: &Path) -> Result<()> {
    match record.foreign_file(folder)? {
        None => Ok(()),
        Some(name) => Err(Error::input_at(
            folder,
            format!("the folder also holds \"{name}\", which this program did not write"),
            "Move that away, or choose a new folder.",
        )),
    }
}

/// Returns an error if a folder cannot change places with one beside it.
fn require_replaceable(target: &Path) -> Result<()> {
    let whole = || {
        Error::input_at(
            target,
            "the folder cannot be replaced as a whole: it is a place of its own in the system (a mount)",
            "Choose a folder inside it.",
        )
    };
    let Some(parent) = target.parent() else { return Err(whole()) };
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let device = |path: &Path| path.metadata().map(|data| data.dev()).ok();
        if device(parent) != device(target) {
            return Err(whole());
        }
    }
    let _ = parent;
    Ok(())
}

/// Removes the files of an unfinished result and the folders that are then empty.
fn remove_contents(folder: &Path, record: &Record) -> Result<()> {
    for name in &record.files {
        let path = folder.join(name);
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != ErrorKind::NotFound => {
                return Err(Error::io("remove the old file", path, e));
            }
            _ => {}
        }
        let mut above = Path::new(name).parent();
        while let Some(inner) = above.filter(|inner| !inner.as_os_str().is_empty()) {
            // Only empty folders are removed.
            if std::fs::remove_dir(folder.join(inner)).is_err() {
                break;
            }
            above = inner.parent();
        }
    }
    Ok(())
}

/// Removes what killed writers left.
fn remove_temporary_files(folder: &Path) {
    let is_temporary = |e: &walkdir::DirEntry| e.file_name().to_string_lossy().starts_with(TEMPORARY);
    for entry in WalkDir::new(folder).into_iter().flatten().filter(is_temporary) {
        // It is in nobody's way.
        let _ = std::fs::remove_file(entry.path());
    }
}

fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io("make the folder", folder, e))
}

fn remove_tree(folder: &Path) -> Result<()> {
    let fail = |e| Error::io("remove the old folder", folder, e);
    // The record goes last: the remains of a removal that was cut short are known by it.
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let entry = entry.map_err(fail)?;
        if entry.file_type().map_err(fail)?.is_dir() {
            std::fs::remove_dir_all(entry.path()).map_err(fail)?;
        } else if entry.file_name() != RECORD_FILE {
            std::fs::remove_file(entry.path()).map_err(fail)?;
        }
    }
    match std::fs::remove_dir_all(folder) {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(fail(e)),
        _ => Ok(()),
    }
}

/// Swaps two folders: in one step if the system can, else by way of a third name.
fn exchange(new: &Path, old: &Path) -> Result<()> {
    #[cfg(any(target_os = "linux", target_vendor = "apple"))]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        if renameat_with(CWD, new, CWD, old, RenameFlags::EXCHANGE).is_ok() {
            return Ok(());
        }
    }
    exchange_in_steps(new, old)
}

/// Renames the old folder away, the new one into its place, and the old one to the new one's former name.
/// If the second step fails, the first is undone. After a kill in between, [`put_back_old`] undoes it.
pub(super) fn exchange_in_steps(new: &Path, old: &Path) -> Result<()> {
    let fail = |e| Error::io("put the new result in its place", old, e);
    let aside = beside(old, "old");
    std::fs::rename(old, &aside).map_err(fail)?;
    if let Err(e) = std::fs::rename(new, old) {
        std::fs::rename(&aside, old).map_err(fail)?;
        return Err(fail(e));
    }
    std::fs::rename(&aside, new).map_err(fail)
}

/// Puts back a result that was being replaced when the program was killed.
fn put_back_old(target: &Path) -> Result<()> {
    let aside = beside(target, "old");
    if target.symlink_metadata().is_ok() || Record::read(&aside).is_none() {
        return Ok(());
    }
    // A program between the two steps holds this lock.
    let mut lock = Lock::of_folder(&aside)?;
    std::fs::rename(&aside, target).map_err(|e| Error::io("put the earlier result back", target, e))?;
    lock.move_to(target);
    Ok(())
}
