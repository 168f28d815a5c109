//! Tests of the complete way from a grid of points to masks, with a segmenter that compares colours.

use super::*;
use crate::{grid::Mask, mask, progress::unobserved};
use image::Rgb;
use std::ops::ControlFlow;

/// A segmenter that answers with the pixels whose colour is similar to that at the first point, for
/// three distances.
pub(crate) struct ByColour {
    image: RgbImage,
    pub(crate) images_seen: usize,
    prompts_seen: usize,
    rating: fn(Rgb<u8>, usize) -> f32,
}

const MAP: usize = 64;

impl ByColour {
    pub(crate) fn new(rating: fn(Rgb<u8>, usize) -> f32) -> Self {
        Self { image: RgbImage::new(1, 1), images_seen: 0, prompts_seen: 0, rating }
    }
}

impl PointSegmenter for ByColour {
    fn set_image(&mut self, image: &RgbImage) -> Result<()> {
        self.image = image.clone();
        self.images_seen += 1;
        Ok(())
    }

    fn predict(&mut self, prompts: &[Vec<[f32; 2]>], _: Option<&[f32]>) -> Result<Prediction> {
        let (mut logits, mut predicted_iou) = (Vec::new(), Vec::new());
        let (width, height) = self.image.dimensions();
        for prompt in prompts {
            self.prompts_seen += 1;
            let asked = *self.image.get_pixel(prompt[0][0] as u32, prompt[0][1] as u32);
            for (answer, reach) in [10.0, 40.0, 90.0].into_iter().enumerate() {
                predicted_iou.push((self.rating)(asked, prompt.len()));
                logits.extend((0..MAP * MAP).map(|i| {
                    let at = |k: usize, n: u32| ((2 * k + 1) as u32 * n / (2 * MAP) as u32).min(n - 1);
                    let there = self.image.get_pixel(at(i % MAP, width), at(i / MAP, height));
                    let apart: f32 = (0..3).map(|c| f32::from(asked[c].abs_diff(there[c]))).sum();
                    (reach - apart + answer as f32).clamp(-8.0, 8.0)
                }));
            }
        }
        Ok(Prediction { masks_per_prompt: 3, size: [MAP; 2], extent: [1.0; 2], logits, predicted_iou })
    }

    fn earlier_size(&self) -> Option<[usize; 2]> {
        Some([MAP; 2])
    }

    fn features(&self) -> Option<DenseMap> {
        None
    }

    fn batch(&self) -> usize {
        7
    }
}

const WALL: Rgb<u8> = Rgb([200, 120, 120]);
const LIVER: Rgb<u8> = Rgb([100, 20, 20]);
const TOOL: Rgb<u8> = Rgb([120, 130, 140]);

/// Draws wall on the left, liver on the right, and a tool across both.
fn picture() -> RgbImage {
    RgbImage::from_fn(128, 96, |x, y| match (x, y) {
        (20..108, 40..56) => TOOL,
        (0..64, _) => WALL,
        _ => LIVER,
    })
}

fn pixels_of(colour: Rgb<u8>) -> Mask {
    let picture = picture();
    Grid::from_vec(128, 96, picture.pixels().map(|p| *p == colour).collect())
}

fn best_iou(masks: &FrameMasks, level: Level, colour: Rgb<u8>) -> f64 {
    let truth = pixels_of(colour);
    let ious = masks.level(level).iter().filter_map(|f| mask::iou(&f.mask.to_mask(), &truth));
    ious.fold(0.0, f64::max)
}

fn everything() -> Mask {
    Grid::filled(128, 96, true)
}

fn run(segmenter: &mut ByColour, keep: &Mask, settings: &MaskSettings) -> FrameMasks {
    automatic_masks(segmenter, &picture(), keep, settings, &mut unobserved).unwrap()
}

#[test]
fn every_thing_becomes_one_mask_of_each_level() {
    let mut segmenter = ByColour::new(|_, _| 0.95);
    let masks = run(&mut segmenter, &everything(), &MaskSettings::of_grid(8));
    assert_eq!(segmenter.images_seen, 1);
    for level in Level::ALL {
        // The tool is 16 pixels high, and a value of the network's map 1.5.
        for colour in [WALL, LIVER, TOOL] {
            assert!(best_iou(&masks, level, colour) > 0.85, "{level:?} {colour:?}");
        }
        assert_eq!(masks.level(level).len(), 3, "{level:?}");
    }
    let areas: Vec<_> = masks.level(Level::Default).iter().map(|f| f.mask.area_px()).collect();
    assert!(areas.is_sorted_by(|a, b| a >= b), "small ones are painted last: {areas:?}");
    let painted = masks.painted(Level::Default);
    // Along the borders, a coarse map leaves a few pixels without a mask.
    let bare = painted.data.iter().filter(|p| p.is_none()).count();
    assert!(bare * 30 < painted.data.len(), "{bare} pixels");
    assert_ne!(painted.at(3, 3), painted.at(120, 90));
}

#[test]
fn crops_are_asked_too_and_cut_masks_go() {
    let mut segmenter = ByColour::new(|_, _| 0.95);
    let settings = MaskSettings { points_per_side: 5, ..MaskSettings::paper() };
    let masks = run(&mut segmenter, &everything(), &settings);
    assert_eq!((segmenter.images_seen, segmenter.prompts_seen), (5, 5 * 25));
    assert_eq!(masks.level(Level::Default).len(), 3, "every crop cuts the tool");
    for colour in [WALL, LIVER, TOOL] {
        assert!(best_iou(&masks, Level::Default, colour) > 0.85, "{colour:?}");
    }
}

#[test]
fn low_ratings_go_and_points_that_look_alike_are_asked_together() {
    // The network is unsure of the liver at one point, less so at several.
    let mut segmenter = ByColour::new(|c, points| if c == LIVER && points == 1 { 0.3 } else { 0.8 });
    let without = MaskSettings { alike_prompts: 0, ..MaskSettings::of_grid(8) };
    let masks = run(&mut segmenter, &everything(), &without);
    assert!(best_iou(&masks, Level::Default, LIVER) < 0.1);
    let masks = run(&mut segmenter, &everything(), &MaskSettings::of_grid(8));
    assert!(best_iou(&masks, Level::Default, LIVER) > 0.95);
    // Surfaces that the network does not find from several points either stay without a mask.
    let mut blind = ByColour::new(|c, _| if c == LIVER { 0.3 } else { 0.8 });
    let masks = run(&mut blind, &everything(), &MaskSettings::of_grid(8));
    assert!(best_iou(&masks, Level::Default, LIVER) < 0.1);
    assert!(blind.prompts_seen <= 64 + 2 * 60, "{}", blind.prompts_seen);
}

#[test]
fn a_mask_of_everything_takes_nothing_with_it() {
    /// A segmenter like [`ByColour`] whose last answer is always the whole picture.
    struct WithWhole(ByColour);
    impl PointSegmenter for WithWhole {
        fn set_image(&mut self, image: &RgbImage) -> Result<()> {
            self.0.set_image(image)
        }
        fn predict(&mut self, prompts: &[Vec<[f32; 2]>], earlier: Option<&[f32]>) -> Result<Prediction> {
            let mut prediction = self.0.predict(prompts, earlier)?;
            for answers in prediction.logits.chunks_exact_mut(3 * MAP * MAP) {
                answers[2 * MAP * MAP..].fill(8.0);
            }
            Ok(prediction)
        }
        fn earlier_size(&self) -> Option<[usize; 2]> {
            self.0.earlier_size()
        }
        fn features(&self) -> Option<DenseMap> {
            self.0.features()
        }
        fn batch(&self) -> usize {
            self.0.batch()
        }
    }
    let found = |settings: &MaskSettings| {
        let mut segmenter = WithWhole(ByColour::new(|_, _| 0.95));
        automatic_masks(&mut segmenter, &picture(), &everything(), settings, &mut unobserved).unwrap()
    };
    let masks = found(&MaskSettings::of_grid(8));
    for colour in [WALL, LIVER, TOOL] {
        assert!(best_iou(&masks, Level::Default, colour) > 0.85, "{colour:?}");
    }
    // By the authors' rules this single mask remains alone.
    let theirs = found(&MaskSettings { crop_layers: 0, points_per_side: 8, ..MaskSettings::paper() });
    assert_eq!(theirs.level(Level::Default).len(), 1);
}

#[test]
fn answers_to_several_points_are_bettered() {
    /// A segmenter that is vague until it gets its own best answer.
    struct Vague {
        inner: ByColour,
        bettered: usize,
    }
    impl PointSegmenter for Vague {
        fn set_image(&mut self, image: &RgbImage) -> Result<()> {
            self.inner.set_image(image)
        }
        fn predict(&mut self, prompts: &[Vec<[f32; 2]>], earlier: Option<&[f32]>) -> Result<Prediction> {
            let mut prediction = self.inner.predict(prompts, None)?;
            match earlier {
                Some(earlier) => {
                    assert_eq!(
                        earlier,
                        vec![-2.0; prompts.len() * MAP * MAP],
                        "the second of the three answers"
                    );
                    self.bettered += prompts.len();
                }
                None => {
                    let answers = prediction.logits.chunks_exact_mut(MAP * MAP).enumerate();
                    answers.for_each(|(i, logits)| logits.fill([-40.0, -2.0, -3.0][i % 3]));
                    prediction.predicted_iou.iter_mut().skip(1).step_by(3).for_each(|rating| *rating = 0.99);
                }
            }
            Ok(prediction)
        }
        fn earlier_size(&self) -> Option<[usize; 2]> {
            self.inner.earlier_size()
        }
        fn features(&self) -> Option<DenseMap> {
            None
        }
        fn batch(&self) -> usize {
            self.inner.batch()
        }
    }
    let mut vague = Vague { inner: ByColour::new(|_, _| 0.8), bettered: 0 };
    let settings = MaskSettings::of_grid(8);
    let masks = automatic_masks(&mut vague, &picture(), &everything(), &settings, &mut unobserved).unwrap();
    assert!(vague.bettered > 0);
    for colour in [WALL, LIVER, TOOL] {
        assert!(best_iou(&masks, Level::Default, colour) > 0.85, "{colour:?}");
    }
}

#[test]
fn nothing_is_asked_outside_the_supervision_mask() {
    let left = Grid::from_vec(128, 96, (0..128 * 96).map(|i| i % 128 < 64).collect());
    let mut segmenter = ByColour::new(|_, _| 0.95);
    let settings = MaskSettings { alike_prompts: 0, ..MaskSettings::of_grid(8) };
    let masks = run(&mut segmenter, &left, &settings);
    assert_eq!(segmenter.prompts_seen, 32);
    assert!(best_iou(&masks, Level::Default, LIVER) < 0.1);
    let mut segmenter = ByColour::new(|_, _| 0.95);
    let masks = run(&mut segmenter, &Grid::filled(128, 96, false), &MaskSettings::of_grid(8));
    assert_eq!((segmenter.prompts_seen, masks.levels.iter().map(Vec::len).sum::<usize>()), (0, 0));
}

#[test]
fn a_request_to_stop_is_heard() {
    let mut segmenter = ByColour::new(|_, _| 0.95);
    let mut told = Vec::new();
    let stopped =
        automatic_masks(&mut segmenter, &picture(), &everything(), &MaskSettings::of_grid(8), &mut |p| {
            told.push((p.done, p.total));
            if p.done > 20 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
    assert!(matches!(stopped, Err(crate::Error::Cancelled)));
    assert_eq!(told, [(7, 124), (14, 124), (21, 124)]);
}

#[test]
fn answers_of_the_wrong_length_are_an_error() {
    struct Short(ByColour);
    impl PointSegmenter for Short {
        fn set_image(&mut self, image: &RgbImage) -> Result<()> {
            self.0.set_image(image)
        }
        fn predict(&mut self, prompts: &[Vec<[f32; 2]>], earlier: Option<&[f32]>) -> Result<Prediction> {
            let prediction = self.0.predict(prompts, earlier)?;
            Ok(Prediction { masks_per_prompt: 4, ..prediction })
        }
        fn earlier_size(&self) -> Option<[usize; 2]> {
            self.0.earlier_size()
        }
        fn features(&self) -> Option<DenseMap> {
            self.0.features()
        }
        fn batch(&self) -> usize {
            4
        }
    }
    let mut short = Short(ByColour::new(|_, _| 0.9));
    let settings = MaskSettings::of_grid(4);
    let result = automatic_masks(&mut short, &picture(), &everything(), &settings, &mut unobserved);
    assert!(result.unwrap_err().to_string().contains("12 ratings for 4 prompts with 4 masks of 64×64"));
}

#[test]
fn masks_come_back_from_their_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("masks/frame.json");
    let masks = run(&mut ByColour::new(|_, _| 0.95), &everything(), &MaskSettings::of_grid(8));
    assert_eq!(FrameMasks::load(&path, "a").unwrap(), None);
    masks.save(&path, "a").unwrap();
    assert_eq!(FrameMasks::load(&path, "a").unwrap(), Some(masks));
    assert_eq!(FrameMasks::load(&path, "b").unwrap(), None, "made from something else");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"width\":128", "\"width\":127")).unwrap();
    assert!(FrameMasks::load(&path, "a").unwrap_err().to_string().contains("size of the image"));
    std::fs::write(&path, &text[..text.len() / 2]).unwrap();
    assert!(FrameMasks::load(&path, "a").unwrap_err().to_string().contains("cannot be understood"));
}
