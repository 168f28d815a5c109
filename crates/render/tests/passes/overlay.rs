//! Compares overlays on the GPU with those of core.

use crate::{compare, fixture::gpu};
use image::{Rgb, RgbImage};
use surgtpgs_core::{
    grid::Grid,
    overlay::{OverlayLook, OverlayPrompt, OverlayStyle, overlay},
};
use surgtpgs_render::ShownPasses;

/// Smooth scores with islands, straits and a few NaN, different for each phase.
fn scores(width: usize, height: usize, phase: f32) -> Grid<f32> {
    let score = |i: usize| {
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        let wave = (0.21 * x + phase).sin() * (0.17 * y - phase).cos() + 0.3 * (0.9 * x + 0.7 * y).sin();
        if i % 997 == 500 { f32::NAN } else { 0.5 + 0.45 * wave }
    };
    Grid::from_vec(width, height, (0..width * height).map(score).collect())
}

fn frame(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        Rgb([(3 * x % 256) as u8, (200 - y % 200) as u8, (x * y % 256) as u8])
    })
}

#[test]
fn overlays_equal_those_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let passes = ShownPasses::new(&gpu).unwrap();
    for (width, height) in [(150, 101), (16, 3), (1, 1)] {
        let frame = frame(width, height);
        let [first, second] = [0.3, 2.1].map(|phase| scores(width as usize, height as usize, phase));
        let misfit = Grid::filled(2, 2, 0.9);
        let prompt = |scores, threshold, colour| OverlayPrompt::new(scores, threshold, colour);
        let prompts = [
            prompt(&first, 0.4, [0, 114, 178]),
            prompt(&misfit, 0.1, [255; 3]),
            prompt(&second, 0.6, [204, 121, 167]),
        ];
        for style in OverlayStyle::ALL {
            for drawn in [&prompts[..], &prompts[..1], &[]] {
                let look = OverlayLook { style, outline_opacity: 0.7, ..Default::default() };
                let expected = overlay(&frame, drawn, look);
                compare::pictures(&passes.overlay(&frame, drawn, look).unwrap(), &expected).unwrap();
            }
        }
    }
}

#[test]
fn an_empty_frame_stays_empty() {
    let Some(gpu) = gpu() else { return };
    let passes = ShownPasses::new(&gpu).unwrap();
    let nothing = RgbImage::new(0, 7);
    assert_eq!(passes.overlay(&nothing, &[], OverlayLook::default()).unwrap(), nothing);
}
