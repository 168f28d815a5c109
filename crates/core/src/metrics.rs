//! Picture and mask quality: PSNR, SSIM, depth error, IoU in the paper's protocol and in a strict one.

use crate::{
    Error, Result,
    grid::{Grid, Mask},
    mask,
};
use image::RgbImage;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Peak signal-to-noise ratio in dB over 8-bit RGB; `mask` (true = counted) or all pixels.
/// Identical images give infinity; an empty mask or differing sizes give `None`.
pub fn psnr_db(image: &RgbImage, truth: &RgbImage, mask: Option<&Mask>) -> Option<f64> {
    let [r, g, b] = squared_errors(image, truth, mask)?;
    Some(decibels((r + g + b) / 3.0))
}

/// PSNR as the paper's code computes it: of each colour channel by itself, then the mean of the three
/// (method §9.5); never below [`psnr_db`].
pub fn psnr_per_channel_db(image: &RgbImage, truth: &RgbImage, mask: Option<&Mask>) -> Option<f64> {
    let channels = squared_errors(image, truth, mask)?;
    Some(channels.map(decibels).iter().sum::<f64>() / 3.0)
}

fn decibels(mean_squared_error: f64) -> f64 {
    10.0 * (255.0 * 255.0 / mean_squared_error).log10()
}

/// Mean squared error of each channel, in 8-bit levels squared.
fn squared_errors(image: &RgbImage, truth: &RgbImage, mask: Option<&Mask>) -> Option<[f64; 3]> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let fits = |m: &Mask| (m.width, m.height) == (width, height);
    if image.dimensions() != truth.dimensions() || !mask.is_none_or(fits) {
        return None;
    }
    let (mut sums, mut count) = ([0_u64; 3], 0_u64);
    for (i, (a, b)) in image.pixels().zip(truth.pixels()).enumerate() {
        if mask.is_none_or(|m| m.data[i]) {
            count += 1;
            for (sum, (a, b)) in sums.iter_mut().zip(a.0.iter().zip(b.0)) {
                *sum += u64::from(a.abs_diff(b)).pow(2);
            }
        }
    }
    (count > 0).then(|| sums.map(|s| s as f64 / count as f64))
}

/// Structural similarity, 11×11 Gaussian window of σ 1.5 (zero outside the image, as in the 3DGS code
/// family), mean over pixels and channels; 1 for identical images. NaN if sizes differ or are zero.
pub fn ssim(image: &RgbImage, truth: &RgbImage) -> f64 {
    if image.dimensions() != truth.dimensions() {
        return f64::NAN;
    }
    let channel = |picture: &RgbImage, c: usize| -> Grid<f32> {
        let data = picture.pixels().map(|p| f32::from(p.0[c]) / 255.0).collect();
        Grid::from_vec(picture.width() as usize, picture.height() as usize, data)
    };
    (0..3).map(|c| ssim_of_channel(&channel(image, c), &channel(truth, c))).sum::<f64>() / 3.0
}

fn ssim_of_channel(a: &Grid<f32>, b: &Grid<f32>) -> f64 {
    const C1: f32 = 0.01 * 0.01;
    const C2: f32 = 0.03 * 0.03;
    let product = |a: &Grid<f32>, b: &Grid<f32>| {
        let data = a.data.iter().zip(&b.data).map(|(x, y)| x * y).collect();
        window_mean(&Grid::from_vec(a.width, a.height, data))
    };
    let (mean_a, mean_b) = (window_mean(a), window_mean(b));
    let (aa, bb, ab) = (product(a, a), product(b, b), product(a, b));
    let total: f64 = (0..a.data.len())
        .map(|i| {
            let (ma, mb) = (mean_a.data[i], mean_b.data[i]);
            let (va, vb, cov) = (aa.data[i] - ma * ma, bb.data[i] - mb * mb, ab.data[i] - ma * mb);
            let likeness = (2.0 * ma * mb + C1) * (2.0 * cov + C2);
            f64::from(likeness / ((ma * ma + mb * mb + C1) * (va + vb + C2)))
        })
        .sum();
    total / a.data.len() as f64
}

/// Gaussian-weighted mean around each pixel: one pass along rows, one along columns.
fn window_mean(image: &Grid<f32>) -> Grid<f32> {
    const RADIUS: usize = 5;
    let weights: [f32; 2 * RADIUS + 1] = {
        let raw: [f64; 2 * RADIUS + 1] =
            std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / (2.0 * 1.5 * 1.5)).exp());
        raw.map(|w| (w / raw.iter().sum::<f64>()) as f32)
    };
    let (width, height) = (image.width, image.height);
    if width == 0 || height == 0 {
        return image.clone();
    }
    let mut rows = vec![0.0_f32; width * height];
    rows.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        let mut padded = vec![0.0; width + 2 * RADIUS];
        padded[RADIUS..RADIUS + width].copy_from_slice(image.row(y));
        for (k, &weight) in weights.iter().enumerate() {
            out.iter_mut().zip(&padded[k..]).for_each(|(o, v)| *o += weight * v);
        }
    });
    let mut both = vec![0.0_f32; width * height];
    both.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, &weight) in weights.iter().enumerate() {
            if let Some(source) = (y + k).checked_sub(RADIUS).filter(|&s| s < height) {
                let row = &rows[source * width..(source + 1) * width];
                out.iter_mut().zip(row).for_each(|(o, v)| *o += weight * v);
            }
        }
    });
    Grid::from_vec(width, height, both)
}

/// Root mean square error of depth (scene units) over pixels where both are known (finite, > 0) and `mask`
/// is true; `None` where there is no such pixel or sizes differ.
pub fn depth_rmse(depth: &Grid<f32>, truth: &Grid<f32>, mask: Option<&Mask>) -> Option<f64> {
    let size = (depth.width, depth.height);
    if size != (truth.width, truth.height) || mask.is_some_and(|m| (m.width, m.height) != size) {
        return None;
    }
    let known = |d: f32| d.is_finite() && d > 0.0;
    let (mut sum, mut count) = (0.0_f64, 0_usize);
    for (i, (&a, &b)) in depth.data.iter().zip(&truth.data).enumerate() {
        if known(a) && known(b) && mask.is_none_or(|m| m.data[i]) {
            sum += f64::from(a - b).powi(2);
            count += 1;
        }
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}

/// Mean IoU per class and over everything.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct IouReport {
    /// Mean over all counted (frame, class) pairs, 0–1; `None` if none was counted.
    pub mean: Option<f64>,
    /// Mean over the counted frames of each class, 0–1.
    pub classes: BTreeMap<String, f64>,
}

/// Collects one IoU per (frame, class) and averages them by two protocols.
///
/// - *paper* (method §9.5): only classes that are present in a frame's truth count; the prediction is
///   multiplied by the keep mask, the truth is not.
/// - *strict*: besides, a class that is absent from the truth but predicted anywhere counts as IoU 0, so
///   that false finds cost something. Absent and not predicted is not counted.
#[derive(Clone, Debug, Default)]
pub struct MiouAccumulator {
    pairs: Vec<Pair>,
}

#[derive(Clone, Debug)]
struct Pair {
    class: String,
    iou: f64,
    present: bool,
}

impl MiouAccumulator {
    /// Adds one class of one frame: its `prediction`, its `truth`, and where predictions count (`keep`).
    pub fn add(&mut self, class: &str, prediction: &Mask, truth: &Mask, keep: &Mask) -> Result<()> {
        let size = (truth.width, truth.height);
        if size != (prediction.width, prediction.height) || size != (keep.width, keep.height) {
            return Err(Error::input(
                format!(
                    "masks of the class \"{class}\" differ in size: predicted {}×{}, labelled {}×{}, kept {}×{}",
                    prediction.width, prediction.height, truth.width, truth.height, keep.width, keep.height
                ),
                "Evaluate a scene on the recording it was trained on.",
            ));
        }
        let data = prediction.data.iter().zip(&keep.data).map(|(p, k)| *p && *k).collect();
        let predicted = Mask::from_vec(size.0, size.1, data);
        if let Some(iou) = mask::iou(&predicted, truth) {
            self.pairs.push(Pair { class: class.to_owned(), iou, present: truth.count() > 0 });
        }
        Ok(())
    }

    /// The paper's protocol.
    pub fn paper(&self) -> IouReport {
        report(self.pairs.iter().filter(|p| p.present))
    }

    /// The strict protocol.
    pub fn strict(&self) -> IouReport {
        report(self.pairs.iter())
    }
}

fn report<'a>(pairs: impl Iterator<Item = &'a Pair>) -> IouReport {
    let mut sums: BTreeMap<String, (f64, usize)> = BTreeMap::new();
    for pair in pairs {
        let (sum, count) = sums.entry(pair.class.clone()).or_default();
        *sum += pair.iou;
        *count += 1;
    }
    let (total, count) = sums.values().fold((0.0, 0), |(t, n), (sum, count)| (t + sum, n + count));
    IouReport {
        mean: (count > 0).then(|| total / count as f64),
        classes: sums.into_iter().map(|(class, (sum, count))| (class, sum / count as f64)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn noise(width: u32, height: u32, seed: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let mix = (x * 7919 + y * 104_729 + seed * 15_485_863).wrapping_mul(2_654_435_761);
            Rgb([(mix >> 8) as u8, (mix >> 16) as u8, (mix >> 24) as u8])
        })
    }

    #[test]
    fn psnr_of_known_errors() {
        let truth = RgbImage::from_pixel(4, 2, Rgb([100, 100, 100]));
        let mut image = truth.clone();
        assert_eq!(psnr_db(&image, &truth, None), Some(f64::INFINITY));
        image.pixels_mut().for_each(|p| p.0 = [110, 90, 101]);
        let mse = (100.0 + 100.0 + 1.0) / 3.0;
        assert!((psnr_db(&image, &truth, None).unwrap() - 10.0 * (65025.0_f64 / mse).log10()).abs() < 1e-9);
        let per_channel = (2.0 * 10.0 * 650.25_f64.log10() + 10.0 * 65025_f64.log10()) / 3.0;
        assert!((psnr_per_channel_db(&image, &truth, None).unwrap() - per_channel).abs() < 1e-9);
    }

    #[test]
    fn psnr_counts_only_the_mask() {
        let truth = RgbImage::from_pixel(2, 1, Rgb([0, 0, 0]));
        let mut image = truth.clone();
        image.put_pixel(0, 0, Rgb([255, 255, 255]));
        let left = Mask::from_vec(2, 1, vec![true, false]);
        assert_eq!(psnr_db(&image, &truth, Some(&left)), Some(0.0));
        assert_eq!(psnr_db(&image, &truth, Some(&left.map(|v| !v))), Some(f64::INFINITY));
        assert_eq!(psnr_db(&image, &truth, Some(&left.map(|_| false))), None);
        assert_eq!(psnr_db(&image, &noise(3, 1, 0), None), None);
    }

    /// The definition without any shortcut: an 11×11 window around each pixel, zeros outside.
    fn ssim_by_definition(a: &RgbImage, b: &RgbImage) -> f64 {
        let at = |p: &RgbImage, x: i64, y: i64, c: usize| {
            let inside = x >= 0 && y >= 0 && x < i64::from(p.width()) && y < i64::from(p.height());
            if inside { f64::from(p.get_pixel(x as u32, y as u32).0[c]) / 255.0 } else { 0.0 }
        };
        let weight = |d: i64| (-(d * d) as f64 / 4.5).exp();
        let norm: f64 = (-5..=5).map(weight).sum::<f64>().powi(2);
        let mut total = 0.0;
        for (x, y, c) in (0..a.width() as i64)
            .flat_map(|x| (0..a.height() as i64).flat_map(move |y| (0..3).map(move |c| (x, y, c))))
        {
            let mut m = [0.0; 5];
            for (dx, dy) in (-5..=5).flat_map(|dx| (-5..=5).map(move |dy| (dx, dy))) {
                let w = weight(dx) * weight(dy) / norm;
                let (p, q) = (at(a, x + dx, y + dy, c), at(b, x + dx, y + dy, c));
                for (sum, v) in m.iter_mut().zip([p, q, p * p, q * q, p * q]) {
                    *sum += w * v;
                }
            }
            let [ma, mb, aa, bb, ab] = m;
            total += (2.0 * ma * mb + 1e-4) * (2.0 * (ab - ma * mb) + 9e-4)
                / ((ma * ma + mb * mb + 1e-4) * (aa - ma * ma + bb - mb * mb + 9e-4));
        }
        total / f64::from(a.width() * a.height() * 3)
    }

    #[test]
    fn ssim_agrees_with_its_definition() {
        let (a, b) = (noise(17, 13, 1), noise(17, 13, 2));
        assert!((ssim(&a, &b) - ssim_by_definition(&a, &b)).abs() < 1e-5);
        assert!((ssim(&a, &a) - 1.0).abs() < 1e-6);
        assert!(ssim(&a, &b) < 0.5);
        assert!(ssim(&a, &noise(3, 3, 1)).is_nan());
        assert!(ssim(&RgbImage::new(0, 0), &RgbImage::new(0, 0)).is_nan());
    }

    #[test]
    fn depth_error_ignores_unknown_pixels() {
        let depth = Grid::from_vec(5, 1, vec![10.0, 20.0, 0.0, f32::NAN, 50.0]);
        let truth = Grid::from_vec(5, 1, vec![13.0, 16.0, 9.0, 1.0, 0.0]);
        assert!((depth_rmse(&depth, &truth, None).unwrap() - 12.5_f64.sqrt()).abs() < 1e-9);
        let first = Mask::from_vec(5, 1, vec![true, false, true, true, true]);
        assert_eq!(depth_rmse(&depth, &truth, Some(&first)), Some(3.0));
        assert_eq!(depth_rmse(&depth, &truth, Some(&first.map(|_| false))), None);
    }

    #[test]
    fn absent_classes_cost_nothing_in_the_paper_and_something_when_strict() {
        let grid = |v: [u8; 4]| Mask::from_vec(4, 1, v.iter().map(|&b| b == 1).collect());
        let keep = grid([1, 1, 1, 0]);
        let mut sums = MiouAccumulator::default();
        // Half right; the truth outside the keep mask still counts against the prediction.
        sums.add("liver", &grid([1, 0, 0, 1]), &grid([1, 0, 0, 1]), &keep).unwrap();
        sums.add("liver", &grid([1, 1, 0, 0]), &grid([1, 1, 0, 0]), &keep).unwrap();
        sums.add("blood", &grid([0, 0, 1, 0]), &grid([0, 0, 0, 0]), &keep).unwrap();
        sums.add("fat", &grid([0, 0, 0, 1]), &grid([0, 0, 0, 0]), &keep).unwrap();
        let (paper, strict) = (sums.paper(), sums.strict());
        assert_eq!(paper.mean, Some(0.75));
        assert_eq!(paper.classes, BTreeMap::from([("liver".to_owned(), 0.75)]));
        assert_eq!(strict.mean, Some(0.5));
        assert_eq!(strict.classes["blood"], 0.0);
        assert!(!strict.classes.contains_key("fat"), "absent and not predicted is not counted");
        assert_eq!(MiouAccumulator::default().paper().mean, None);
        assert!(sums.add("fat", &Mask::filled(1, 1, true), &keep, &keep).is_err());
    }

    #[test]
    fn the_mean_is_over_pairs_not_over_classes() {
        let (yes, no) = (Mask::filled(1, 1, true), Mask::filled(1, 1, false));
        let mut sums = MiouAccumulator::default();
        for found in [&yes, &yes, &yes] {
            sums.add("liver", found, &yes, &yes).unwrap();
        }
        sums.add("blood", &no, &yes, &yes).unwrap();
        assert_eq!(sums.paper().mean, Some(0.75));
    }
}
