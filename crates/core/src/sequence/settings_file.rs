//! Places and names of the settings files of a recording.

use super::{decided, layouts, read};
use crate::{dicom::is_dicom, reading::is_present};
use std::path::{Path, PathBuf};

/// Name of the settings file in a recording's folder.
pub const SETTINGS_FILE: &str = "sequence.toml";

/// Returns the settings file of the recording `path`: inside a folder, beside a video file. A folder of only
/// one video that has none inside has that of the video.
pub(super) fn own_file(path: &Path) -> PathBuf {
    let beside = |file: &Path| file.with_file_name(format!("{}.toml", read::file_name(file)));
    if path.is_file() {
        return beside(path);
    }
    let inside = path.join(SETTINGS_FILE);
    if is_present(&inside) {
        return inside;
    }
    let of_video = layouts::only_video(path).map(|video| beside(&video));
    of_video.filter(|file| is_present(file)).unwrap_or(inside)
}

/// Names the settings file of the recording `path` as messages do. Names of DICOM files may be those of
/// patients.
pub(crate) fn settings_name(path: &Path) -> String {
    match path.is_file() {
        true if is_dicom(path) => "the file of its name with .toml added, beside it".into(),
        true => format!("{} beside it", read::file_name(&own_file(path))),
        false => read::file_name(&own_file(path)),
    }
}

/// Returns the settings files of the recording `path`, existing or not: the user's, and the
/// program's beside it.
pub fn settings_files(path: &Path) -> [PathBuf; 2] {
    [own_file(path), decided::file(path)]
}
