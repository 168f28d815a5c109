//! Choices that the window remembers between starts, in one small file. It never holds pixels or prompts.

use crate::viewer::backend::Models;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use surgtpgs_core::{files::write_whole, overlay::OverlayLook, reading::read_text};

/// Chosen keys: names of commands, and texts such as "Ctrl+Shift+Z".
pub(crate) type Keymap = BTreeMap<String, String>;

/// The remembered choices.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Preferences {
    /// `true` if the user has read the research-use notice.
    pub(crate) is_acknowledged: bool,
    #[serde(flatten)]
    pub(crate) overlay: OverlayLook,
    /// Size of text and buttons, percent.
    pub(crate) scale_percent: u32,
    /// Width of the side panel, points.
    pub(crate) panel_width: f32,
    /// Size of the window, in points of text at its normal size; `None` before it was ever closed.
    pub(crate) window_size: Option<[f32; 2]>,
    /// Duration of a step of training per pixel of a frame on this computer, seconds, once it is known.
    pub(crate) seconds_per_step_and_pixel: Option<f64>,
    /// Networks that were chosen last to make recordings searchable.
    pub(crate) models: Models,
    /// `true` if clicks and boxes become the masks that the network for regions finds.
    pub(crate) finds_borders: bool,
    /// Paths that were opened last, newest first.
    pub(crate) recent: Vec<PathBuf>,
    /// `true` if [`Preferences::recent`] is kept. Paths may hold names of patients.
    pub(crate) remembers_files: bool,
    /// Keys that were chosen instead of the default ones.
    pub(crate) keys: Keymap,
    /// File of the preferences; `None` if they are kept nowhere.
    #[serde(skip)]
    file: Option<PathBuf>,
}

/// Width of the side panel before anybody changed it, points.
const USUAL_PANEL_WIDTH: f32 = 340.0;
/// Least and largest size of the window that is remembered, points.
const WINDOW_SIZES: [f32; 2] = [400.0, 8000.0];
/// Number of paths that are remembered.
const MAX_RECENT: usize = 10;
/// Sizes of text and buttons to choose from, percent.
const SCALES: [u32; 7] = [75, 90, 100, 120, 140, 170, 200];

impl Default for Preferences {
    fn default() -> Self {
        Self {
            is_acknowledged: false,
            overlay: OverlayLook::default(),
            scale_percent: 100,
            panel_width: USUAL_PANEL_WIDTH,
            window_size: None,
            seconds_per_step_and_pixel: None,
            models: Models::default(),
            finds_borders: false,
            recent: Vec::new(),
            remembers_files: true,
            keys: Keymap::new(),
            file: None,
        }
    }
}

impl Preferences {
    /// Returns the file of the current user.
    pub(crate) fn user_file() -> Option<PathBuf> {
        dirs::config_dir().map(|dir| dir.join("surgtpgs").join("viewer.json"))
    }

    /// Reads `file`. If it cannot be read, the preferences are those of a first start.
    pub(crate) fn load(file: Option<PathBuf>) -> Self {
        let text = file.as_ref().and_then(|f| read_text(f).ok());
        let mut read: Self = text.and_then(|t| serde_json::from_str(&t).ok()).unwrap_or_default();
        read.overlay = read.overlay.mended();
        let is_panel = (100.0..=4000.0).contains(&read.panel_width);
        read.panel_width = if is_panel { read.panel_width } else { USUAL_PANEL_WIDTH };
        let is_size = |v: &f32| (WINDOW_SIZES[0]..=WINDOW_SIZES[1]).contains(v);
        read.window_size = read.window_size.filter(|size| size.iter().all(is_size));
        let pace = &mut read.seconds_per_step_and_pixel;
        *pace = pace.filter(|pace| (0.0..1.0).contains(pace));
        read.scale_percent = read.scale_percent.clamp(SCALES[0], SCALES[SCALES.len() - 1]);
        Self { file, ..read }
    }

    /// Writes the preferences. A failure is said on standard error only, because no work is lost.
    pub(crate) fn save(&self) {
        let Some(file) = &self.file else { return };
        let text = serde_json::to_string_pretty(self).map_err(|e| e.to_string());
        let written = text.and_then(|text| write_whole(file, text.as_bytes()).map_err(|e| e.to_string()));
        if let Err(e) = written {
            crate::text::say(&format!("the preferences could not be saved: {e}"));
        }
    }

    /// Selects the next larger (`1`) or smaller (`-1`) size of text and buttons, or the normal one (`0`).
    pub(crate) fn scale_by(&mut self, step: isize) {
        let now = SCALES.partition_point(|s| *s < self.scale_percent);
        let next = now.saturating_add_signed(step).min(SCALES.len() - 1);
        self.scale_percent = if step == 0 { 100 } else { SCALES[next] };
        self.save();
    }

    /// Forgets the opened paths, and sets whether paths are remembered from then on.
    pub(crate) fn forget_files(&mut self, remembers_files: bool) {
        self.recent.clear();
        self.remembers_files = remembers_files;
        self.save();
    }

    /// Puts a path first in the list, if paths are remembered.
    pub(crate) fn remember(&mut self, path: &Path) {
        if !self.remembers_files {
            return;
        }
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
    fn text_grows_and_shrinks_between_75_and_200_percent() {
        let mut preferences = Preferences::load(None);
        (0..20).for_each(|_| preferences.scale_by(1));
        assert_eq!(preferences.scale_percent, 200);
        (0..20).for_each(|_| preferences.scale_by(-1));
        assert_eq!(preferences.scale_percent, 75);
        preferences.scale_by(1);
        assert_eq!(preferences.scale_percent, 90);
        preferences.scale_by(0);
        assert_eq!(preferences.scale_percent, 100);
    }

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
        // A failed write does no harm.
        Preferences { file: Some(file.as_ref().unwrap().join("no folder")), ..preferences.clone() }.save();
        assert_eq!(Preferences::load(file.clone()), preferences);
        preferences.forget_files(false);
        preferences.remember(Path::new("/secret"));
        assert!(!std::fs::read_to_string(file.as_ref().unwrap()).unwrap().contains("/s"));
        let damaged = r#"{"panel_width": -3, "window_size": [1e9, 2]}"#;
        std::fs::write(file.as_ref().unwrap(), damaged).unwrap();
        let mended = Preferences::load(file.clone());
        assert_eq!((mended.panel_width, mended.window_size), (USUAL_PANEL_WIDTH, None));
        std::fs::write(file.as_ref().unwrap(), "{\"opacity\": 1e99").unwrap();
        assert!(!Preferences::load(file).is_acknowledged);
    }
}
