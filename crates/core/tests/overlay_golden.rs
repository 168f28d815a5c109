//! Compares each overlay style with stored pictures. `UPDATE_GOLDEN=1` writes them anew; look at them
//! before you keep them.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use image::RgbImage;
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    demo::{Demo, DemoSettings},
    grid::Grid,
    overlay::{OverlayLook, OverlayPrompt, OverlayStyle, overlay},
};

const SIZE: (usize, usize) = (128, 96);

/// Scores that fall from 0.95 to 0.05 across the border of a disc, given in shares of the picture.
fn disc(x: f32, y: f32, radius: f32) -> Grid<f32> {
    let (width, height) = SIZE;
    let score = |i: usize| {
        let [dx, dy] =
            [(i % width) as f32 + 0.5 - x * width as f32, (i / width) as f32 + 0.5 - y * height as f32];
        (0.5 + (radius * height as f32 - dx.hypot(dy)) / 24.0).clamp(0.05, 0.95)
    };
    Grid::from_vec(width, height, (0..width * height).map(score).collect())
}

fn drawn(style: OverlayStyle) -> RgbImage {
    let settings = DemoSettings::of_size(SIZE.0, SIZE.1, 4);
    let frame = Demo::new(&settings).unwrap().frame(1).colour;
    let (left, right) = (disc(0.35, 0.45, 0.3), disc(0.65, 0.6, 0.25));
    let prompt = |scores, colour| OverlayPrompt::new(scores, 0.5, colour);
    let prompts = [(prompt(&left, [61, 214, 255]), false), (prompt(&right, [255, 122, 224]), false)];
    overlay(&frame, &prompts, None, OverlayLook { style, ..OverlayLook::default() }, frame.dimensions())
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

#[test]
fn every_overlay_style_looks_as_it_did() {
    for style in OverlayStyle::ALL {
        let (name, picture) = (format!("{}.png", style.name()), drawn(style));
        if std::env::var_os("UPDATE_GOLDEN").is_some() {
            picture.save(golden(&name)).unwrap();
        }
        let stored = image::open(golden(&name)).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), stored.dimensions());
        let largest = picture.as_raw().iter().zip(stored.as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
        // exp and sin in the demo's frame may differ in the last bit on other systems.
        assert!(largest <= Some(1), "{name} differs by up to {largest:?} of 255");
    }
}
