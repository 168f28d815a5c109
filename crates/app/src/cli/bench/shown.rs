//! Times of a frame as a window shows it: from Gaussians to the picture with its overlay.

use super::timing::{ROUNDS, Timing, time};
use crate::engine::{Ask, Engine, SceneView};
use std::collections::BTreeMap;
use surgtpgs_core::{Result, camera::Camera, overlay::OverlayLook};
use surgtpgs_render::{Mark, Marking, Wanted};

/// Times the engine's first prompt on every frame, with the transfer of the results; on a GPU each
/// pass by itself, too.
pub(super) fn rows(engine: &mut Engine, cameras: &[(f32, Camera)]) -> Result<Vec<Timing>> {
    // One prompt, as a user asks.
    let words: Vec<String> = engine.queries().iter().take(1).map(|q| q.prompt.clone()).collect();
    engine.set_prompts(&words)?;
    let marks = [Mark { threshold: engine.settings().threshold, colour: [0, 200, 80], is_dashed: false }];
    let marking = Marking { marks: &marks, look: OverlayLook::default(), base: None };
    let views: Vec<SceneView> =
        cameras.iter().map(|&(time, camera)| SceneView { time, camera, recorded: true }).collect();
    let ask = Ask::Now(Some(marking));
    let ways = [
        ("Gaussians to pictures, depth and scores", Wanted { pictures: true, values: true }),
        ("Gaussians to the picture with its outline", Wanted { pictures: true, values: false }),
        ("Gaussians to what was found, in numbers", Wanted::default()),
    ];
    let mut rows = Vec::new();
    for (way, wanted) in ways {
        let ms = time(&views, ROUNDS, |view| engine.show(view, ask, wanted).map(drop))?;
        rows.push(Timing::of("shown", format!("from {way}"), ms));
    }
    let still = &views[..1];
    let ms = time(still, 20, |view| engine.show(view, ask, Wanted::default()).map(drop))?;
    rows.push(Timing::of("shown", "a view that was there, asked again", ms));
    rows.extend(pass_rows(engine, &views, ask)?);
    Ok(rows)
}

/// Times each pass by the device's own clock.
fn pass_rows(engine: &mut Engine, views: &[SceneView], ask: Ask<'_>) -> Result<Vec<Timing>> {
    if !engine.gpu().is_some_and(|gpu| gpu.time_passes()) {
        return Ok(Vec::new());
    }
    let mut ms: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    for view in views {
        engine.show(view, ask, Wanted::default())?;
        let times = engine.gpu().map(|gpu| gpu.pass_times_ms()).transpose()?;
        for (pass, time) in times.into_iter().flatten() {
            ms.entry(pass).or_default().push(time);
        }
    }
    Ok(ms.into_iter().map(|(pass, ms)| Timing::of(pass, "by the device's own clock", ms)).collect())
}
