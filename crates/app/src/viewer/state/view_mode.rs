//! View modes of the viewport.

use crate::viewer::backend::Info;

/// Message where there is no reconstruction.
pub(crate) const NO_RECONSTRUCTION: &str = "Reconstruct the recording first";
/// Message where recorded frames cannot be shown.
pub(crate) const NO_ORIGINAL: &str = "The recorded frames are not at hand";

/// Mode of the viewport: one picture, or two compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ViewMode {
    /// The frame as it was recorded.
    #[default]
    Original,
    /// The frame as it was reconstructed.
    Reconstruction,
    /// Both side by side.
    SideBySide,
    /// Both with a line between them.
    Wipe,
    /// One after the other, in turns.
    Blink,
    /// The difference between both.
    Difference,
    /// Distance from the endoscope.
    Depth,
    /// The reconstruction beside its depth.
    DepthBeside,
    /// Distance that things move.
    Motion,
    /// Opacity of the reconstruction.
    Opacity,
}

/// Layer of values of a view that are shown as colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Layer {
    /// Distance from the endoscope, scene units.
    Depth,
    /// Distance moved over the whole recording, pixels.
    Motion,
    /// Opacity, 0–1.
    Opacity,
}

impl ViewMode {
    /// Modes of the toolbar; the others are in the menu.
    pub(crate) const MAIN: [Self; 8] = [
        Self::Original,
        Self::Reconstruction,
        Self::SideBySide,
        Self::Wipe,
        Self::Blink,
        Self::Difference,
        Self::Depth,
        Self::DepthBeside,
    ];

    /// Returns the mode to begin with: the recorded frame, which is sharpest, where it is at hand.
    pub(crate) fn usual(info: &Info) -> Self {
        if info.has_original || !info.has_reconstruction { Self::Original } else { Self::Reconstruction }
    }

    pub(crate) fn label(self) -> &'static str {
        match self {
            Self::Original => "Recorded",
            Self::Reconstruction => "Reconstruction",
            Self::SideBySide => "Side by side",
            Self::Wipe => "Wipe",
            Self::Blink => "Blink",
            Self::Difference => "Difference",
            Self::Depth => "Depth",
            Self::DepthBeside => "With depth",
            Self::Motion => "Moving",
            Self::Opacity => "Opacity",
        }
    }

    pub(crate) fn needs_original(self) -> bool {
        matches!(self, Self::Original | Self::SideBySide | Self::Wipe | Self::Blink | Self::Difference)
    }

    /// Returns `true` if the mode shows the reconstruction's colours.
    pub(crate) fn needs_reconstruction(self) -> bool {
        !matches!(self, Self::Original | Self::Depth | Self::Motion | Self::Opacity)
    }

    pub(crate) fn layer(self) -> Option<Layer> {
        match self {
            Self::Depth | Self::DepthBeside => Some(Layer::Depth),
            Self::Motion => Some(Layer::Motion),
            Self::Opacity => Some(Layer::Opacity),
            _ => None,
        }
    }

    /// Returns `true` if the mode's picture may be turned: no recorded frame is compared with it.
    pub(crate) fn may_orbit(self) -> bool {
        self.layer().is_some() || self == Self::Reconstruction
    }

    /// Says why the mode cannot be shown for the open scene or recording; `None` if it can.
    pub(crate) fn obstacle(self, info: &Info) -> Option<&'static str> {
        let is_made = self.needs_reconstruction() || self.layer().is_some();
        if is_made && !info.has_reconstruction {
            Some(NO_RECONSTRUCTION)
        } else {
            (self.needs_original() && !info.has_original).then_some(NO_ORIGINAL)
        }
    }

    /// Returns `true` if the mode can be shown for the open scene or recording.
    pub(crate) fn is_possible(self, info: &Info) -> bool {
        self.obstacle(info).is_none()
    }
}
