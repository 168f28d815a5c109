//! Times of what a window waits for: from Gaussians to the picture, and to the scores of prompts.

use super::timing::{ROUNDS, Timing, time};
use crate::engine::{Ask, Engine, SceneView};
use std::collections::BTreeMap;
use surgtpgs_core::{Result, camera::Camera, scene::Scene};
use surgtpgs_render::{PassCost, Wanted};

const PICTURE: Wanted = Wanted { picture: true, depth: false, scores: false };
const SCORES: Wanted = Wanted { picture: false, depth: false, scores: true };

/// A way to show frames, with what is asked for and what comes back from the device.
pub(super) struct Way {
    pub(super) name: &'static str,
    pub(super) views: Vec<SceneView>,
    ask: Ask,
    wanted: Wanted,
}

/// Returns the ways in which a window shows frames. Features are rendered with the picture, as they are while
/// there are prompts.
pub(super) fn ways(views: &[SceneView]) -> [Way; 3] {
    let again: Vec<SceneView> = views.iter().take(1).cycle().take(views.len()).copied().collect();
    let way = |name, views: &[SceneView], ask, wanted| Way { name, views: views.to_vec(), ask, wanted };
    [
        way("Gaussians to the picture", views, Ask::Later, PICTURE),
        way("Gaussians to the scores", views, Ask::Now, SCORES),
        way("a rendered frame to the scores", &again, Ask::Now, SCORES),
    ]
}

impl Way {
    /// Shows every frame once.
    pub(super) fn show(&self, engine: &mut Engine) -> Result<()> {
        self.views.iter().try_for_each(|view| engine.show(view, self.ask, self.wanted).map(drop))
    }

    /// Returns the milliseconds of every frame after a round to warm up.
    pub(super) fn time(&self, engine: &mut Engine) -> Result<Vec<f64>> {
        time(&self.views, ROUNDS, |view| engine.show(view, self.ask, self.wanted).map(drop))
    }
}

/// Returns at most so many frames of a scene, evenly spread.
pub(super) fn spread(scene: &Scene, num_frames: usize) -> Vec<usize> {
    let (n, wanted) = (scene.num_frames(), num_frames.min(scene.num_frames()));
    (0..wanted).map(|k| k * n / wanted).collect()
}

/// Returns views at these times, limited to the field of view as recorded frames are.
pub(super) fn views(cameras: &[(f32, Camera)]) -> Vec<SceneView> {
    cameras.iter().map(|&(time, camera)| SceneView { time, camera, recorded: Some(0) }).collect()
}

/// Returns the cost of each pass, its time the median of all frames; nothing where the device cannot time.
pub(super) fn pass_costs(engine: &mut Engine, views: &[SceneView]) -> Result<Vec<PassCost>> {
    if !engine.gpu().is_some_and(|gpu| gpu.time_passes()) {
        return Ok(Vec::new());
    }
    let mut by_pass: BTreeMap<usize, Vec<PassCost>> = BTreeMap::new();
    for view in views {
        engine.show(view, Ask::Now, Wanted::ALL)?;
        let costs = engine.gpu().map(|gpu| gpu.pass_costs()).transpose()?;
        for (k, cost) in costs.into_iter().flatten().enumerate() {
            by_pass.entry(k).or_default().push(cost);
        }
    }
    let median = |mut costs: Vec<PassCost>| {
        costs.sort_by(|a, b| a.ms.total_cmp(&b.ms));
        costs[costs.len() / 2]
    };
    Ok(by_pass.into_values().map(median).collect())
}

/// Times the engine's first prompt on every frame, with the transfer of the results; on a GPU each
/// pass by itself, too.
pub(super) fn rows(engine: &mut Engine, cameras: &[(f32, Camera)]) -> Result<Vec<Timing>> {
    // One prompt, as a user asks.
    let words: Vec<String> = engine.queries().iter().take(1).map(|q| q.prompt.clone()).collect();
    engine.set_prompts(&words)?;
    let views = views(cameras);
    let mut rows = Vec::new();
    for way in ways(&views) {
        rows.push(Timing::of("shown", format!("from {}", way.name), way.time(engine)?));
    }
    let costs = pass_costs(engine, &views)?;
    rows.extend(costs.iter().map(|c| Timing::of(c.name, "by the device's own clock", vec![c.ms])));
    Ok(rows)
}
