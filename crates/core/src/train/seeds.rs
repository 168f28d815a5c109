//! The frames that the first Gaussians come from (method §2.1). One that shows nothing tells of no colour,
//! and has another one in its place.

use crate::{
    Result,
    camera::Camera,
    gaussian::init::SeedFrame,
    grid::Mask,
    num,
    poses::ScopePath,
    sequence::{Sequence, shots},
};
use image::RgbImage;
use std::collections::BTreeSet;

/// Number of frames that the first Gaussians are taken from.
const SEED_FRAMES: usize = 8;

/// Chooses those of `frames` that Gaussians begin with.
fn seed_frames(frames: &[usize]) -> Vec<usize> {
    spread(frames, SEED_FRAMES)
}

/// Chooses at most `count` of `frames`, evenly spread, the middle one first.
pub(super) fn spread(frames: &[usize], count: usize) -> Vec<usize> {
    let mut picked: Vec<usize> = num::spread(frames.len(), count).map(|k| frames[k]).collect();
    let middle = picked.len() / 2;
    if !picked.is_empty() {
        picked.swap(0, middle);
    }
    picked
}

/// Returns `true` if masks and field of view leave something of a frame to learn from.
pub(super) fn has_pixels(sequence: &Sequence, frame: usize) -> Result<bool> {
    Ok(sequence.mask(frame)?.count() > 0)
}

/// Reads the frames that Gaussians begin with, the middle one first. In the place of one that shows nothing
/// is the nearest of `frames` that shows something and has no place yet. If all are dark, those are read that
/// something is left of.
pub(super) fn read(sequence: &Sequence, path: &ScopePath, frames: &[usize]) -> Result<Vec<SeedFrame>> {
    let reader = Reader { sequence, path };
    let wanted = seed_frames(frames);
    let (mut taken, mut dark) = (BTreeSet::new(), BTreeSet::new());
    let mut seeds = Vec::new();
    for i in wanted.iter().filter_map(|i| frames.iter().position(|frame| frame == i)) {
        if taken.contains(&frames[i]) {
            continue;
        }
        for frame in outwards(i, frames.len()).map(|k| frames[k]) {
            if taken.contains(&frame) || dark.contains(&frame) {
                continue;
            }
            let (colour, mask) = reader.look_at(frame)?;
            if shots::shows_something(&colour, &mask) {
                taken.insert(frame);
                seeds.push(reader.seed(frame, colour, mask)?);
                break;
            }
            dark.insert(frame);
        }
    }
    if !seeds.is_empty() {
        return Ok(seeds);
    }
    let mut left = Vec::new();
    for &frame in frames {
        if has_pixels(sequence, frame)? {
            left.push(frame);
        }
    }
    let read = |frame: usize| {
        let (colour, mask) = reader.look_at(frame)?;
        reader.seed(frame, colour, mask)
    };
    seed_frames(if left.is_empty() { frames } else { &left }).into_iter().map(read).collect()
}

/// Returns the numbers below `n` by their distance from `at`, the lower of two first.
fn outwards(at: usize, n: usize) -> impl Iterator<Item = usize> {
    let both = move |d: usize| [at.checked_sub(d), Some(at + d).filter(|k| d > 0 && *k < n)];
    (0..n).flat_map(both).flatten()
}

struct Reader<'a> {
    sequence: &'a Sequence,
    path: &'a ScopePath,
}

impl Reader<'_> {
    /// Reads the colours of a frame, and the pixels that are supervised.
    fn look_at(&self, frame: usize) -> Result<(RgbImage, Mask)> {
        Ok((self.sequence.frame(frame)?, self.sequence.mask(frame)?))
    }

    /// Adds the camera, which has the pose to the tissue, and the depth.
    fn seed(&self, frame: usize, colour: RgbImage, mask: Mask) -> Result<SeedFrame> {
        let recorded = self.sequence.camera(frame);
        let pose = self.path.pose_to_tissue(frame, recorded.camera_from_world);
        let camera = Camera { camera_from_world: pose, ..recorded };
        let depth = match self.sequence.depth(frame)? {
            Some(depth) => Some(depth),
            None => self.path.depth(&camera, frame),
        };
        Ok(SeedFrame { camera, colour, mask, depth })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        demo::{self, DemoSettings},
        progress::unobserved,
    };
    use image::GrayImage;

    #[test]
    fn numbers_go_outwards_from_one() {
        let all = |at, n| outwards(at, n).collect::<Vec<_>>();
        assert_eq!(all(2, 5), [2, 1, 3, 0, 4]);
        assert_eq!((all(0, 3), all(3, 4)), (vec![0, 1, 2], vec![3, 2, 1, 0]));
    }

    #[test]
    fn frames_that_show_nothing_are_passed_over() {
        let folder = tempfile::tempdir().unwrap();
        let small = DemoSettings::of_size(64, 48, 8);
        demo::write(&small, folder.path(), &mut unobserved).unwrap();
        let sequence = Sequence::open(folder.path()).unwrap();
        let all: Vec<usize> = (0..8).collect();
        let chosen = |frames: &[usize]| -> Vec<usize> {
            let seeds = read(&sequence, &ScopePath::default(), frames).unwrap();
            let number = |seed: &SeedFrame| {
                all.iter().copied().find(|i| sequence.frame(*i).unwrap() == seed.colour).unwrap()
            };
            seeds.iter().map(number).collect()
        };
        let blacken = |frame: usize| {
            let path = folder.path().join(format!("images/frame_{frame:06}.png"));
            RgbImage::new(64, 48).save(path).unwrap();
        };
        assert_eq!(chosen(&all), [4, 1, 2, 3, 0, 5, 6, 7]);
        [3, 4].into_iter().for_each(blacken);
        assert_eq!(chosen(&all), [5, 1, 2, 0, 6, 7]);
        assert_eq!(chosen(&[0, 3, 4, 7]), [7, 0], "frames that are not learned from are not read");
        (0..8).for_each(blacken);
        assert_eq!(chosen(&all).len(), 8, "there is nothing better");
        let hide = |frame: usize| {
            let path = folder.path().join(format!("masks/frame_{frame:06}.png"));
            GrayImage::new(64, 48).save(path).unwrap();
        };
        (1..8).for_each(hide);
        assert_eq!(chosen(&all).len(), 1, "nothing is left of the others");
    }
}
