//! Similarity of two pictures: PSNR and SSIM.

use crate::{
    grid::{Grid, Mask},
    num::mean,
};
use image::RgbImage;
use rayon::prelude::*;

/// Number of pixels of a window on each side of its middle.
const RADIUS: usize = 5;

/// Mean squared error of rounding to 8 bits, levels²: no picture is told to be nearer than that, and PSNR is
/// at most 58.9 dB. One frame that is exactly right would make every mean infinite.
const ROUNDING_ERROR: f64 = 1.0 / 12.0;

/// Peak signal-to-noise ratio in dB over 8-bit RGB, of at most 58.9 dB; `mask` (true = counted) or all
/// pixels. An empty mask or differing sizes give `None`.
pub fn psnr_db(image: &RgbImage, truth: &RgbImage, mask: Option<&Mask>) -> Option<f64> {
    let [r, g, b] = squared_errors(image, truth, mask)?;
    Some(decibels((r + g + b) / 3.0))
}

/// PSNR as the paper's code computes it: of each colour channel by itself, then the mean of the three
/// (method §9.5), over all pixels; never below [`psnr_db`].
pub fn psnr_per_channel_db(image: &RgbImage, truth: &RgbImage) -> Option<f64> {
    let channels = squared_errors(image, truth, None)?;
    Some(channels.map(decibels).iter().sum::<f64>() / 3.0)
}

/// PSNR as EndoNeRF, Deform3DGS and EndoGaussian print it: pixels outside the mask count as right. It is
/// [`psnr_db`] − 10 log₁₀ f with f the share of the mask.
pub fn psnr_published_db(image: &RgbImage, truth: &RgbImage, mask: &Mask) -> Option<f64> {
    Some(psnr_db(image, truth, Some(mask))? - 10.0 * mask.share().log10())
}

/// Returns the picture with black outside the mask, which has its size.
pub fn masked(image: &RgbImage, mask: &Mask) -> RgbImage {
    let mut masked = image.clone();
    for (pixel, _) in masked.pixels_mut().zip(&mask.data).filter(|(_, is_kept)| !**is_kept) {
        pixel.0 = [0; 3];
    }
    masked
}

fn decibels(mean_squared_error: f64) -> f64 {
    10.0 * (255.0 * 255.0 / mean_squared_error.max(ROUNDING_ERROR)).log10()
}

/// Returns the mean squared error of each channel, in 8-bit levels squared.
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

/// Structural similarity (Wang et al. 2004), 11×11 Gaussian window of σ 1.5, mean over the channels; 1
/// for identical pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ssim {
    /// Mean over all pixels, with zeros outside the picture, as in the 3DGS code family.
    pub padded: f64,
    /// Mean over the pixels whose window lies inside, as in scikit-image; NaN for pictures
    /// smaller than a window.
    pub inside: f64,
}

/// Computes [`Ssim`]; `None` if sizes differ or are zero.
pub fn ssim(image: &RgbImage, truth: &RgbImage) -> Option<Ssim> {
    if image.dimensions() != truth.dimensions() || image.is_empty() {
        return None;
    }
    let channel = |picture: &RgbImage, c: usize| -> Grid<f64> {
        let data = picture.pixels().map(|p| f64::from(p.0[c]) / 255.0).collect();
        Grid::from_vec(picture.width() as usize, picture.height() as usize, data)
    };
    let (mut padded, mut inside) = (0.0, 0.0);
    for likeness in (0..3).map(|c| likeness(&channel(image, c), &channel(truth, c))) {
        padded += mean(likeness.data.iter().copied()).unwrap_or(f64::NAN);
        let rows = RADIUS..likeness.height.saturating_sub(RADIUS);
        let values = rows.flat_map(|y| likeness.row(y).iter().skip(RADIUS).rev().skip(RADIUS));
        inside += mean(values.copied()).unwrap_or(f64::NAN);
    }
    Some(Ssim { padded: padded / 3.0, inside: inside / 3.0 })
}

/// Returns the SSIM at every pixel of one channel.
fn likeness(a: &Grid<f64>, b: &Grid<f64>) -> Grid<f64> {
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    let product = |a: &Grid<f64>, b: &Grid<f64>| {
        let data = a.data.iter().zip(&b.data).map(|(x, y)| x * y).collect();
        window_mean(&Grid::from_vec(a.width, a.height, data))
    };
    let (mean_a, mean_b) = (window_mean(a), window_mean(b));
    let (aa, bb, ab) = (product(a, a), product(b, b), product(a, b));
    let at = |i: usize| {
        let (ma, mb) = (mean_a.data[i], mean_b.data[i]);
        let (va, vb, cov) = (aa.data[i] - ma * ma, bb.data[i] - mb * mb, ab.data[i] - ma * mb);
        (2.0 * ma * mb + C1) * (2.0 * cov + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2))
    };
    Grid::from_vec(a.width, a.height, (0..a.data.len()).map(at).collect())
}

/// Returns the Gaussian-weighted mean around each pixel, zeros outside: one pass along rows,
/// one along columns.
fn window_mean(image: &Grid<f64>) -> Grid<f64> {
    let weights: [f64; 2 * RADIUS + 1] = {
        let raw: [f64; 2 * RADIUS + 1] =
            std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / (2.0 * 1.5 * 1.5)).exp());
        raw.map(|w| w / raw.iter().sum::<f64>())
    };
    let (width, height) = (image.width, image.height);
    let mut rows = vec![0.0; width * height];
    rows.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        let mut padded = vec![0.0; width + 2 * RADIUS];
        padded[RADIUS..RADIUS + width].copy_from_slice(image.row(y));
        for (k, &weight) in weights.iter().enumerate() {
            out.iter_mut().zip(&padded[k..]).for_each(|(o, v)| *o += weight * v);
        }
    });
    let mut both = vec![0.0; width * height];
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
        assert_eq!(psnr_db(&image, &truth, None), Some(decibels(0.0)));
        assert!((decibels(0.0) - 58.92).abs() < 0.01);
        image.pixels_mut().for_each(|p| p.0 = [110, 90, 101]);
        let mse = (100.0 + 100.0 + 1.0) / 3.0;
        assert!((psnr_db(&image, &truth, None).unwrap() - 10.0 * (65025.0_f64 / mse).log10()).abs() < 1e-9);
        let per_channel = (2.0 * 10.0 * 650.25_f64.log10() + 10.0 * 65025_f64.log10()) / 3.0;
        assert!((psnr_per_channel_db(&image, &truth).unwrap() - per_channel).abs() < 1e-9);
    }

    #[test]
    fn psnr_counts_only_the_mask() {
        let truth = RgbImage::from_pixel(2, 1, Rgb([0, 0, 0]));
        let mut image = truth.clone();
        image.put_pixel(0, 0, Rgb([255, 255, 255]));
        let left = Mask::from_vec(2, 1, vec![true, false]);
        assert_eq!(psnr_db(&image, &truth, Some(&left)), Some(0.0));
        assert_eq!(psnr_db(&image, &truth, Some(&left.map(|v| !v))), Some(decibels(0.0)));
        // What lies outside is published as right: half of the picture, 3 dB.
        assert!((psnr_published_db(&image, &truth, &left).unwrap() - 2.0_f64.log10() * 10.0).abs() < 1e-12);
        assert_eq!(masked(&image, &left.map(|v| !v)), truth);
        assert_eq!(psnr_db(&image, &truth, Some(&left.map(|_| false))), None);
        assert_eq!(psnr_db(&image, &noise(3, 1, 0), None), None);
    }

    /// Computes the definition directly: an 11×11 window around each pixel, zeros outside.
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
        let padded = |a, b| ssim(a, b).unwrap().padded;
        assert!((padded(&a, &b) - ssim_by_definition(&a, &b)).abs() < 1e-12);
        assert!((padded(&a, &a) - 1.0).abs() < 1e-12);
        assert!(padded(&a, &b) < 0.5);
        assert!((ssim(&a, &a).unwrap().inside - 1.0).abs() < 1e-12);
        assert!(ssim(&noise(10, 30, 1), &noise(10, 30, 2)).unwrap().inside.is_nan());
        assert_eq!(ssim(&a, &noise(3, 3, 1)), None);
        assert_eq!(ssim(&RgbImage::new(0, 0), &RgbImage::new(0, 0)), None);
    }
}
