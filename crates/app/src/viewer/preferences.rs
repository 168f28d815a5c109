//! What the window remembers from one start to the next, in one small file. Never pixels, never prompts.

use std::path::{Path, PathBuf};
use surgtpgs_core::overlay::OverlayStyle;

/// The remembered choices.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Preferences {
    /// The research-use notice was read.
    pub(crate) is_acknowledged: bool,
    pub(crate) style: OverlayStyle,
    pub(crate) opacity: f32,
    /// What was opened last, newest first.
    pub(crate) recent: Vec<PathBuf>,
    /// Where they are kept; `None` for nowhere.
    #[serde(skip)]
    file: Option<PathBuf>,
}

/// Paths that are remembered.
const MAX_RECENT: usize = 10;

impl Default for Preferences {
    fn default() -> Self {
        Self {
            is_acknowledged: false,
            style: OverlayStyle::Outline,
            opacity: 0.5,
            recent: Vec::new(),
            file: None,
        }
    }
}

impl Preferences {
    /// The user's own file.
    pub(crate) fn user_file() -> Option<PathBuf> {
        dirs::config_dir().map(|dir| dir.join("surgtpgs").join("viewer.json"))
    }

    /// Reads `file`; what cannot be read is as if it were the first start.
    pub(crate) fn load(file: Option<PathBuf>) -> Self {
        let text = file.as_ref().and_then(|f| std::fs::read_to_string(f).ok());
        let mut read: Self = text.and_then(|t| serde_json::from_str(&t).ok()).unwrap_or_default();
        read.opacity = if read.opacity.is_finite() { read.opacity.clamp(0.05, 1.0) } else { 0.5 };
        Self { file, ..read }
    }

    /// Writes them. Not being able to is no reason to bother anyone: they are only lost.
    pub(crate) fn save(&self) {
        let Some(file) = &self.file else { return };
        let written = || -> Option<()> {
            std::fs::create_dir_all(file.parent()?).ok()?;
            std::fs::write(file, serde_json::to_string_pretty(self).ok()?).ok()
        };
        if written().is_none() {
            tracing::warn!("the preferences could not be saved");
        }
    }

    /// Puts a path first in the list.
    pub(crate) fn remember(&mut self, path: &Path) {
        self.recent.retain(|p| p != path);
        self.recent.insert(0, path.to_owned());
        self.recent.truncate(MAX_RECENT);
        self.save();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_come_back_and_damage_is_like_a_first_start() {
        let folder = tempfile::tempdir().unwrap();
        let file = Some(folder.path().join("a").join("viewer.json"));
        let mut preferences = Preferences::load(file.clone());
        assert!(!preferences.is_acknowledged);
        preferences.is_acknowledged = true;
        for i in 0..12 {
            preferences.remember(Path::new(&format!("/scene{i}")));
        }
        preferences.remember(Path::new("/scene5"));
        assert_eq!(preferences.recent.len(), MAX_RECENT);
        assert_eq!(preferences.recent[..2], [PathBuf::from("/scene5"), PathBuf::from("/scene11")]);
        assert_eq!(Preferences::load(file.clone()), preferences);
        std::fs::write(file.as_ref().unwrap(), "{\"opacity\": 1e99").unwrap();
        assert!(!Preferences::load(file).is_acknowledged);
    }
}
