//! Comparisons with scikit-image and scikit-learn; `tests/oracle/metrics.py` shows how their
//! numbers were made.

use super::*;
use crate::grid::{Grid, Mask};
use image::RgbImage;

fn bytes_without_pattern(count: usize, seed: u64) -> Vec<u8> {
    let mixed = |i: u64| {
        let x = (i + seed * 1_000_003).wrapping_mul(2_654_435_761) & 0xffff_ffff;
        let x = (x ^ (x >> 15)).wrapping_mul(2_246_822_519) & 0xffff_ffff;
        (x ^ (x >> 13)) as u8
    };
    (0..count as u64).map(mixed).collect()
}

#[test]
fn metrics_are_those_of_scikit_image_and_scikit_learn() {
    let stored: serde_json::Value =
        serde_json::from_str(include_str!("../../../../tests/oracle/metrics.json")).unwrap();
    let cases = stored["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 4);
    for case in cases {
        let number = |name: &str| case[name].as_f64().unwrap();
        let whole = |name: &str| case[name].as_u64().unwrap();
        let (width, height, seed) = (whole("width") as u32, whole("height") as u32, whole("seed"));
        let pixels = (width * height) as usize;
        let bytes = |k: u64| bytes_without_pattern(pixels, seed + k);
        let check = |name: &str, value: Option<f64>| {
            let value = value.unwrap();
            assert!((value - number(name)).abs() < 1e-6, "{name} of {width}×{height}: {value}, {case}");
        };

        let truth = bytes_without_pattern(3 * pixels, seed);
        let noise = bytes_without_pattern(3 * pixels, seed + 1);
        let mixed = truth.iter().zip(noise).map(|(t, n)| ((3 * u16::from(*t) + u16::from(n)) / 4) as u8);
        let image = RgbImage::from_raw(width, height, mixed.collect()).unwrap();
        let truth = RgbImage::from_raw(width, height, truth).unwrap();
        check("psnr_db", psnr_db(&image, &truth, None));
        check("psnr_per_channel_db", psnr_per_channel_db(&image, &truth));
        check("ssim_inside", ssim(&image, &truth).map(|s| s.inside));

        let size = (width as usize, height as usize);
        let mask = |data: Vec<bool>| Mask::from_vec(size.0, size.1, data);
        let labelled: Vec<bool> = bytes(2).iter().map(|b| *b < 100).collect();
        let predicted = labelled.iter().zip(bytes(3)).map(|(l, b)| l ^ (b < 40)).collect();
        let all = Mask::filled(size.0, size.1, true);
        let row = ClassOnFrame::measure(0, "liver", &mask(predicted), &mask(labelled), &all).unwrap();
        check("iou", row.iou);
        check("dice", row.dice);
        check("precision", row.precision);
        check("recall", row.recall);

        let grid = |data: Vec<f32>| Grid::from_vec(size.0, size.1, data);
        let depth: Vec<f32> = bytes(4).iter().map(|b| 1.0 + f32::from(*b) / 15.0).collect();
        let other = depth.iter().zip(bytes(5)).map(|(z, b)| z * (0.75 + f32::from(b) / 512.0)).collect();
        let errors = depth_errors(&grid(other), &grid(depth), None).unwrap();
        check("depth_rmse", Some(errors.rmse));
        check("depth_abs_rel", Some(errors.abs_rel));

        let classes: Vec<u8> = bytes(6).iter().map(|b| b % 3).collect();
        let guess = |(c, b): (&u8, u8)| if b < 180 { *c } else { (c + 1) % 3 };
        let guesses = classes.iter().zip(bytes(7)).map(guess).collect();
        let labels = |data: Vec<u8>| Grid::from_vec(size.0, size.1, data);
        let mut confusion = Confusion::new(["liver", "fat", "blood"].map(String::from).to_vec());
        confusion.add(&labels(guesses), &labels(classes), &all);
        let known: Vec<&[u64]> = confusion.pixels.iter().map(|row| &row[..3]).collect();
        assert_eq!(serde_json::json!(known), case["confusion"]);
    }
}
