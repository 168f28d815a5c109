//! Automatic masks: everything on an image that a network finds when it is asked at a grid of points (method §8, after
//! Segment Anything's mask generator and LangSplat's four levels).
//!
//! Points on the image and on crops of it are put to a [`PointSegmenter`]; its coarse logits become [`BitMask`]s
//! (`upsample`), poor and repeated ones go (`nms`), small holes and islands are mended (`regions`). Points that look alike
//! are asked together as well (`alike`).

mod alike;
mod bit_mask;
mod generate;
mod grid;
mod nms;
mod regions;
mod store;
mod upsample;

pub use bit_mask::BitMask;
pub use generate::automatic_masks;

use crate::{Result, grid::Grid, prepare::DenseMap};
use image::RgbImage;

/// A network that finds what lies at a point of a picture.
pub trait PointSegmenter {
    /// Reads a picture; the next questions are about it.
    fn set_image(&mut self, image: &RgbImage) -> Result<()>;

    /// Asks once per item of `prompts`, each some points (x, y) in pixels of the picture that one thing covers. All
    /// prompts have the same number of points. `earlier` are answers to the same prompts that should be bettered,
    /// [prompts][rows × columns] logits of the size that [`Self::earlier_size`] says.
    fn predict(&mut self, prompts: &[Vec<[f32; 2]>], earlier: Option<&[f32]>) -> Result<Prediction>;

    /// Columns and rows of the earlier answers it can better; `None` if it cannot.
    fn earlier_size(&self) -> Option<[usize; 2]>;

    /// What its encoder made of the picture, place by place; `None` if that is not to be had.
    fn features(&self) -> Option<DenseMap>;

    /// How many prompts are best asked at once.
    fn batch(&self) -> usize;
}

/// A network's answers.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// Answers per prompt: usually three, from a part to the whole.
    pub masks_per_prompt: usize,
    /// Columns and rows of an answer.
    pub size: [usize; 2],
    /// The share of its columns and rows that the picture covers, from the upper left; the rest is padding.
    pub extent: [f32; 2],
    /// [prompts × answers][rows × columns]; above 0 is inside.
    pub logits: Vec<f32>,
    /// What the network thinks of each answer, [prompts × answers], 0–1.
    pub predicted_iou: Vec<f32>,
}

/// How masks are made.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MaskSettings {
    /// Points along each side of the grid.
    pub points_per_side: usize,
    /// Layers of crops that are asked about as well: 0 is the image alone, 1 adds 2×2 crops.
    pub crop_layers: u32,
    /// Overlap of the crops of the first layer as a share of the image's shorter side.
    pub crop_overlap: f32,
    /// The grid of layer i has this to the power of i fewer points along a side.
    pub crop_points_divisor: usize,
    /// Masks that the network itself rates lower (or equal) go.
    pub min_predicted_iou: f32,
    /// Masks that change more than this when their cut-off does go.
    pub min_stability: f32,
    /// How far the cut-off is moved for that, as a logit.
    pub stability_offset: f32,
    /// Of two masks of a crop whose boxes overlap more than this, the one rated lower goes.
    pub box_nms_iou: f32,
    /// As much between crops, where the one from the smaller crop stays.
    pub crop_nms_iou: f32,
    /// Holes and islands below this many pixels are mended.
    pub min_region_px: usize,
    /// Which masks stay in the end.
    pub mask_nms: MaskNms,
    /// Whether points outside the supervision mask, and masks that lie there mostly, are left out.
    pub inside_only: bool,
    /// A mask that covers more than this share of the pixels that matter says nothing and goes, unless all do.
    pub max_share: f32,
    /// At most so many groups of points that look alike are asked about, too; each answer is then bettered once.
    pub alike_prompts: usize,
    /// Whether smaller masks are painted over larger ones, instead of in the order of the list.
    pub small_on_top: bool,
}

/// Which of many overlapping masks stay (LangSplat's thresholds).
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MaskNms {
    /// Of two masks that overlap more than this, the one of lower score (stability × predicted IoU) goes.
    pub iou: f32,
    /// Masks with a lower (or equal) score go.
    pub score: f32,
    /// A mask that lies inside a larger one goes if 1 minus the product of both shares is above this; 1 keeps all.
    pub containment: f32,
}

impl MaskSettings {
    /// What the paper's authors run, made for a data-centre GPU.
    pub fn paper() -> Self {
        Self {
            points_per_side: 32,
            crop_layers: 1,
            crop_overlap: 512.0 / 1500.0,
            crop_points_divisor: 1,
            min_predicted_iou: 0.7,
            min_stability: 0.85,
            stability_offset: 1.0,
            box_nms_iou: 0.7,
            crop_nms_iou: 0.7,
            min_region_px: 100,
            mask_nms: MaskNms { iou: 0.8, score: 0.7, containment: 0.5 },
            inside_only: false,
            max_share: 1.0,
            alike_prompts: 0,
            small_on_top: false,
        }
    }

    /// One grid of `points_per_side` points along a side, without crops, and groups of points that look alike.
    ///
    /// The rules are looser than the authors': by theirs one mask of the whole view takes everything else with it, and
    /// dim surfaces, of whose borders a network is never sure, are left out. Smaller masks lie on larger ones in the end,
    /// so that a poor large one shows only where nothing better is.
    pub fn of_grid(points_per_side: usize) -> Self {
        Self {
            points_per_side,
            crop_layers: 0,
            min_predicted_iou: 0.35,
            min_stability: 0.2,
            box_nms_iou: 1.0,
            mask_nms: MaskNms { iou: 0.9, score: 0.0, containment: 1.0 },
            inside_only: true,
            max_share: 0.95,
            alike_prompts: 60,
            small_on_top: true,
            ..Self::paper()
        }
    }
}

impl Default for MaskSettings {
    /// Bearable on an ordinary computer.
    fn default() -> Self {
        Self::of_grid(16)
    }
}

/// Which answers of the network a list of masks was made from.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// All of them.
    #[default]
    Default,
    /// The first: parts.
    Small,
    /// The second.
    Medium,
    /// The third: wholes.
    Large,
}

impl Level {
    /// Every level, in the order of files.
    pub const ALL: [Self; 4] = [Self::Default, Self::Small, Self::Medium, Self::Large];
}

/// A mask with what the network said about it.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundMask {
    /// The pixels.
    pub mask: BitMask,
    /// The network's own rating, 0–1.
    pub predicted_iou: f32,
    /// Share of it that stays when the cut-off rises, 0–1.
    pub stability: f32,
}

/// All masks of one image.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameMasks {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// By [`Level::ALL`], each in the order in which they are painted.
    pub levels: [Vec<FoundMask>; 4],
}

impl FrameMasks {
    /// The masks of a level.
    pub fn level(&self, level: Level) -> &[FoundMask] {
        &self.levels[level as usize]
    }

    /// The number of the mask of `level` that is painted last at each pixel; `None` where there is none.
    pub fn painted(&self, level: Level) -> Grid<Option<u16>> {
        let mut map = Grid::filled(self.width, self.height, None);
        for (number, found) in (0_u16..u16::MAX).zip(self.level(level)) {
            found.mask.pixels().for_each(|(x, y)| map.set(x, y, Some(number)));
        }
        map
    }
}

#[cfg(test)]
pub(crate) mod tests;
