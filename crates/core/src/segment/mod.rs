//! Automatic masks: everything on an image that a network finds when it is asked at a grid of points
//! (method §8, after Segment Anything's mask generator and LangSplat's four levels).
//!
//! A [`PointSegmenter`] is asked about points on the image and on crops of it. Its coarse logits become
//! [`BitMask`]s (`upsample`). Poor and repeated masks are removed (`nms`), small holes and islands are
//! mended (`regions`). Points that look alike are asked together as well (`alike`). One object can be asked
//! for, too (`pointed`).

mod alike;
mod bit_mask;
mod dense_map;
mod generate;
mod grid;
mod nms;
mod pointed;
mod regions;
mod store;
mod upsample;

pub use bit_mask::BitMask;
pub use dense_map::DenseMap;
pub(crate) use generate::FINDING_MASKS;
pub use generate::automatic_masks;
pub use pointed::{Pointed, pointed_mask};

use crate::{Result, grid::Grid};
use image::RgbImage;

/// A network that finds the object at a point of a picture.
pub trait PointSegmenter {
    /// Reads a picture; the next questions are about it.
    fn set_image(&mut self, image: &RgbImage) -> Result<()>;

    /// Asks once per item of `prompts`. Each consists of points (x, y) in pixels of the picture that lie on
    /// one object; all prompts have the same number of points. `earlier` are answers to the same prompts that
    /// should be improved, [prompts][rows × columns] logits of the size that [`Self::earlier_size`] returns.
    fn predict(&mut self, prompts: &[Vec<[f32; 2]>], earlier: Option<&[f32]>) -> Result<Prediction>;

    /// Asks about the object in a box, which is given by two opposite corners (x, y) in pixels of the picture.
    /// A network that knows no boxes is asked about the middle.
    fn predict_box(&mut self, [a, b]: [[f32; 2]; 2]) -> Result<Prediction> {
        self.predict(&[vec![[0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]]], None)
    }

    /// Returns the columns and rows of earlier answers that it can improve; `None` if it cannot.
    fn earlier_size(&self) -> Option<[usize; 2]>;

    /// Returns the encoder's features of the picture, place by place; `None` if they are not available.
    fn features(&self) -> Option<DenseMap>;

    /// Returns the number of prompts that are best asked at once.
    fn batch(&self) -> usize;
}

/// A network's answers.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// Number of answers per prompt: usually three, from a part to the whole.
    pub masks_per_prompt: usize,
    /// Columns and rows of an answer.
    pub size: [usize; 2],
    /// Share of the columns and rows that the picture covers, from the upper left; the rest is padding.
    pub extent: [f32; 2],
    /// Logits, [prompts × answers][rows × columns]; above 0 is inside.
    pub logits: Vec<f32>,
    /// The network's rating of each answer, [prompts × answers], 0–1.
    pub predicted_iou: Vec<f32>,
}

/// Settings of the mask generation.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MaskSettings {
    /// Number of points along each side of the grid.
    pub points_per_side: usize,
    /// Number of layers of crops that are asked about as well: 0 is the image alone, 1 adds 2×2 crops.
    pub crop_layers: u32,
    /// Overlap of the crops of the first layer as a share of the image's shorter side.
    pub crop_overlap: f32,
    /// Divisor of the points along a side per layer: the grid of layer i has this to the power of i fewer.
    pub crop_points_divisor: usize,
    /// Limit of the network's own rating; masks with a lower or equal one are removed.
    pub min_predicted_iou: f32,
    /// Smallest stability: masks that change more when their cut-off is moved are removed.
    pub min_stability: f32,
    /// Distance by which the cut-off is moved for the test of stability, as a logit.
    pub stability_offset: f32,
    /// Largest overlap of the boxes of two masks of a crop. Above it, the mask rated lower is removed.
    pub box_nms_iou: f32,
    /// Largest overlap of boxes between crops. Above it, the mask from the smaller crop stays.
    pub crop_nms_iou: f32,
    /// Holes and islands below this many pixels are mended.
    pub min_region_px: usize,
    /// Rules for the masks that stay in the end.
    pub mask_nms: MaskNms,
    /// `true` if points outside the supervision mask, and masks that lie mostly there, are left out.
    pub inside_only: bool,
    /// Largest share of the pixels that matter. A mask that covers more says nothing and is removed,
    /// unless all masks do.
    pub max_share: f32,
    /// Largest number of groups of similar points that are asked about in addition; each answer is
    /// then improved once.
    pub alike_prompts: usize,
    /// `true` if smaller masks are painted over larger ones, instead of in the order of the list.
    pub small_on_top: bool,
}

/// Rules by which overlapping masks are removed (LangSplat's thresholds).
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MaskNms {
    /// Largest overlap of two masks. Above it, the one of lower score (stability × predicted
    /// IoU) is removed.
    pub iou: f32,
    /// Limit of the score; masks with a lower or equal one are removed.
    pub score: f32,
    /// A mask inside a larger one is removed if 1 minus the product of both shares is above
    /// this; 1 keeps all.
    pub containment: f32,
}

impl MaskSettings {
    /// Returns the settings of the paper's authors, made for a data-centre GPU.
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

    /// Returns settings with one grid of `points_per_side` points along a side, without crops, and with
    /// groups of points that look alike.
    ///
    /// The rules are looser than the authors'. By theirs, one mask of the whole view would remove all others.
    /// Dim surfaces would also be left out, because a network is never sure of their borders. Smaller masks
    /// lie on larger ones in the end, so that a poor large one is visible only where there is nothing better.
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
    /// Returns settings that are bearable on an ordinary computer.
    fn default() -> Self {
        Self::of_grid(16)
    }
}

/// The answers of the network from which a list of masks was made.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// All answers.
    #[default]
    Default,
    /// The first answer: parts.
    Small,
    /// The second answer.
    Medium,
    /// The third answer: wholes.
    Large,
}

impl Level {
    /// Every level, in the order of files.
    pub const ALL: [Self; 4] = [Self::Default, Self::Small, Self::Medium, Self::Large];
}

/// A mask with the network's rating of it.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundMask {
    /// The pixels.
    pub mask: BitMask,
    /// The network's own rating, 0–1.
    pub predicted_iou: f32,
    /// Share of its pixels that stay when the cut-off rises, 0–1.
    pub stability: f32,
}

/// All masks of one image.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameMasks {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Masks by [`Level::ALL`], each list in the order in which they are painted.
    pub levels: [Vec<FoundMask>; 4],
}

impl FrameMasks {
    /// Returns the masks of a level.
    pub fn level(&self, level: Level) -> &[FoundMask] {
        &self.levels[level as usize]
    }

    /// Returns the number of the mask of `level` that is painted last at each pixel; `None` if there is none.
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
