//! Small pictures of recorded frames for the time bar.

use crate::viewer::picture::texture::Texture;
use egui::ColorImage;
use image::{RgbImage, imageops};
use std::collections::BTreeMap;

/// Height of a small picture, px.
pub(crate) const HEIGHT_PX: u32 = 40;
/// Largest number of small pictures that are kept.
const MAX_KEPT: usize = 160;

/// The small pictures that there are, by frame.
#[derive(Default)]
pub(crate) struct Thumbnails {
    textures: BTreeMap<usize, Texture>,
}

impl Thumbnails {
    /// Adds a picture. If there are too many, the one farthest from this frame goes.
    pub(crate) fn take(&mut self, frame: usize, image: ColorImage) {
        self.textures.insert(frame, Texture::new(image));
        while self.textures.len() > MAX_KEPT {
            let farthest = self.textures.keys().copied().max_by_key(|other| other.abs_diff(frame));
            farthest.and_then(|other| self.textures.remove(&other));
        }
    }

    /// Returns the picture of a frame, if it is there.
    pub(crate) fn texture(&self, frame: usize) -> Option<&Texture> {
        self.textures.get(&frame)
    }

    /// Returns those frames of `wanted` that have no picture yet.
    pub(crate) fn missing(&self, wanted: &[usize]) -> Vec<usize> {
        wanted.iter().copied().filter(|frame| !self.textures.contains_key(frame)).collect()
    }
}

/// Makes the small picture of a frame.
pub(crate) fn small(frame: &RgbImage) -> ColorImage {
    let width = (frame.width() * HEIGHT_PX / frame.height().max(1)).max(1);
    let small = imageops::thumbnail(frame, width, HEIGHT_PX);
    ColorImage::from_rgb([width as usize, HEIGHT_PX as usize], small.as_raw())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_are_kept_than_there_is_memory_for() {
        let mut thumbnails = Thumbnails::default();
        for frame in 0..MAX_KEPT + 20 {
            thumbnails.take(frame, small(&RgbImage::new(32, 24)));
        }
        assert_eq!(thumbnails.textures.len(), MAX_KEPT);
        assert_eq!(thumbnails.missing(&[0, 19, 20, 100]), [0, 19], "the farthest went");
        assert!(thumbnails.texture(100).is_some() && thumbnails.texture(0).is_none());
        assert_eq!(small(&RgbImage::new(854, 480)).size, [71, 40]);
    }
}
