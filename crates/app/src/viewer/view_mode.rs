//! What the viewport shows.

/// One picture, or two compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ViewMode {
    /// The frame as it was recorded.
    Original,
    /// The frame as it was reconstructed.
    #[default]
    Reconstruction,
    /// Both beside each other.
    SideBySide,
    /// Both with a line between them.
    Wipe,
    /// One after the other, in turns.
    Blink,
    /// How much they differ.
    Difference,
    /// Distance from the endoscope.
    Depth,
    /// The reconstruction beside its depth.
    DepthBeside,
}

impl ViewMode {
    pub(crate) const ALL: [Self; 8] = [
        Self::Original,
        Self::Reconstruction,
        Self::SideBySide,
        Self::Wipe,
        Self::Blink,
        Self::Difference,
        Self::Depth,
        Self::DepthBeside,
    ];

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
        }
    }

    pub(crate) fn needs_original(self) -> bool {
        matches!(self, Self::Original | Self::SideBySide | Self::Wipe | Self::Blink | Self::Difference)
    }

    /// The reconstruction's colours.
    pub(crate) fn needs_reconstruction(self) -> bool {
        !matches!(self, Self::Original | Self::Depth)
    }

    pub(crate) fn needs_depth(self) -> bool {
        matches!(self, Self::Depth | Self::DepthBeside)
    }

    /// Whether it can be shown of what is open.
    pub(crate) fn is_possible(self, info: &super::source::Info) -> bool {
        (info.has_original || !self.needs_original())
            && (info.has_reconstruction || !(self.needs_reconstruction() || self.needs_depth()))
    }
}
