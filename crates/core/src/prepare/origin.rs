//! Origin of features, and the maps that point to them.

use crate::{
    grid::Grid,
    segment::{Level, MaskSettings},
};
use std::path::PathBuf;

/// Source of the features of a prepared folder.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// Label masks and the embeddings of their classes' names.
    #[default]
    Labels,
    /// Marks by hand on some frames, and the embeddings of their names.
    Marks,
    /// Automatic masks and the embeddings of their contents.
    Masks {
        /// SHA-256 of the models that made the masks.
        mask_model: String,
        /// Settings with which they were made.
        settings: MaskSettings,
        /// Level of the masks that are used.
        level: Level,
        /// SHA-256 of the image encoder.
        image_encoder: String,
    },
    /// Feature maps of whole pictures.
    Dense {
        /// SHA-256 of the network that made them.
        network: String,
    },
    /// Files of LangSplat's kind.
    LangSplat {
        /// Folder of the files.
        folder: PathBuf,
        /// Level of the maps that is used.
        level: Level,
    },
}

/// Row of the feature table per pixel; [`NO_REGION`] where there is no feature.
pub type RegionMap = Grid<u16>;

/// A pixel without a feature.
pub const NO_REGION: u16 = u16::MAX;
