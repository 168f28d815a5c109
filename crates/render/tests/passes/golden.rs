//! Compares whole frames, from Gaussians to what is marked, with stored pictures. `UPDATE_GOLDEN=1` writes
//! them anew with the CPU's passes; look at them before you keep them.

use crate::{
    compare,
    shown::{Stage, disc},
};
use image::RgbImage;
use surgtpgs_core::{
    grid::{Grid, Mask},
    overlay::{OverlayLook, OverlayPrompt, OverlayStyle, overlay},
    raster::{CpuRenderer, Renderer},
    relevancy::Relevancy,
};

/// A frame: the file that stores it, the time, `true` for a field of view, the style.
struct Frame {
    file: &'static str,
    stored: &'static [u8],
    time: f32,
    is_round: bool,
    style: OverlayStyle,
}

macro_rules! frame {
    ($file:literal, $time:literal, $is_round:literal, $style:ident) => {
        Frame {
            file: $file,
            // Inside of the test, so that it runs on machines without the sources.
            stored: include_bytes!(concat!("../golden/", $file)),
            time: $time,
            is_round: $is_round,
            style: OverlayStyle::$style,
        }
    };
}

const FRAMES: [Frame; 3] = [
    frame!("outline.png", 0.2, false, Outline),
    frame!("fill.png", 0.5, true, Fill),
    frame!("heatmap.png", 0.8, true, Heatmap),
];

impl Frame {
    fn stored(&self) -> RgbImage {
        image::load_from_memory(self.stored).unwrap().to_rgb8()
    }

    fn field_of_view(&self) -> Option<Mask> {
        self.is_round.then(disc)
    }

    /// Draws what the prompts found, one of them dashed, over a picture.
    fn drawn(&self, picture: &RgbImage, scores: &[Grid<f32>]) -> RgbImage {
        let prompt = OverlayPrompt::new(&scores[0], 0.5, [0, 114, 178]);
        let dashed =
            OverlayPrompt { is_dashed: true, ..OverlayPrompt::new(&scores[1], 0.3, [204, 121, 167]) };
        let look = OverlayLook { style: self.style, ..Default::default() };
        overlay(picture, &[(prompt, false), (dashed, false)], None, look, picture.dimensions())
    }

    /// The frame by the passes of the CPU alone.
    fn by_cpu(&self, stage: &mut Stage) -> RgbImage {
        let mut planes = CpuRenderer::default().render(&stage.scene, &stage.camera, self.time, true).unwrap();
        if let Some(mask) = self.field_of_view() {
            let inside = mask.sampled(planes.width, planes.height);
            for plane in planes.planes.chunks_exact_mut(inside.data.len()) {
                plane
                    .iter_mut()
                    .zip(&inside.data)
                    .filter(|(_, inside)| !**inside)
                    .for_each(|(v, _)| *v = 0.0);
            }
        }
        let scores = stage.lattice.score(&planes, &stage.queries, &stage.settings);
        self.drawn(&planes.to_rgb(), &scores)
    }
}

#[test]
fn frames_look_as_they_did_on_the_cpu_and_on_the_gpu() {
    let Some(mut stage) = Stage::new() else { return };
    for frame in FRAMES {
        let by_cpu = frame.by_cpu(&mut stage);
        if std::env::var_os("UPDATE_GOLDEN").is_some() {
            by_cpu.save(format!("tests/golden/{}", frame.file)).unwrap();
            continue;
        }
        let say = |machine: &str, reason: String| format!("{} on the {machine}: {reason}", frame.file);
        compare::frames(&by_cpu, &frame.stored()).map_err(|e| say("CPU", e)).unwrap();
        let field_of_view = frame.field_of_view();
        let shown = stage.show(frame.time, field_of_view.as_ref());
        let by_gpu = frame.drawn(&shown.picture.unwrap(), &shown.scores);
        compare::frames(&by_gpu, &frame.stored()).map_err(|e| say("GPU", e)).unwrap();
    }
}
