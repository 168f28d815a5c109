//! Times of a frame as a window shows it: from Gaussians to the picture with its overlay.

use super::timing::{ROUNDS, Timing, time};
use crate::{
    engine::{Ask, Engine, SceneView},
    settings::PROMPT_COLOURS,
};
use std::collections::BTreeMap;
use surgtpgs_core::{Result, camera::Camera, overlay::OverlayLook, scene::Scene};
use surgtpgs_render::{OverlayRequest, PassCost, RegionStyle, Wanted};

/// The picture with its outline, and nothing else.
const PICTURES: Wanted = Wanted { pictures: true, depth: false, scores: false };
/// Nothing but the summaries.
const NUMBERS: Wanted = Wanted { pictures: false, depth: false, scores: false };

/// Ways to show a frame, by what comes back from the device.
pub(super) const WAYS: [(&str, Wanted); 3] = [
    ("Gaussians to pictures, depth and scores", Wanted::ALL),
    ("Gaussians to the picture with its outline", PICTURES),
    ("Gaussians to what was found, in numbers", NUMBERS),
];

/// Way to show a frame that was shown before: only the prompts are answered.
pub(super) const AGAIN: (&str, Wanted) = ("a rendered frame to what was found, in numbers", NUMBERS);

/// Returns at most so many frames of a scene, evenly spread.
pub(super) fn spread(scene: &Scene, num_frames: usize) -> Vec<usize> {
    let (n, wanted) = (scene.num_frames(), num_frames.min(scene.num_frames()));
    (0..wanted).map(|k| k * n / wanted).collect()
}

/// Frames to show, and styles for what an engine's prompts find.
pub(super) struct Show {
    pub(super) views: Vec<SceneView>,
    regions: Vec<RegionStyle>,
}

impl Show {
    /// Shows what the engine's prompts find, outlined.
    pub(super) fn new(engine: &Engine, cameras: &[(f32, Camera)]) -> Self {
        let threshold = engine.settings().threshold;
        let colours = PROMPT_COLOURS.iter().cycle();
        let region = |colour: &[u8; 3]| RegionStyle { threshold, colour: *colour, is_dashed: false };
        Self {
            views: cameras.iter().map(|&(time, camera)| SceneView { time, camera, recorded: true }).collect(),
            regions: colours.map(region).take(engine.queries().len()).collect(),
        }
    }

    /// The first frame again and again.
    pub(super) fn again(&self) -> Self {
        let views = self.views.iter().take(1).cycle().take(self.views.len()).copied().collect();
        Self { views, regions: self.regions.clone() }
    }

    /// Asks for the scores of the prompts and their outlines.
    pub(super) fn ask(&self) -> Ask<'_> {
        Ask::Now(Some(OverlayRequest { regions: &self.regions, look: OverlayLook::default(), base: None }))
    }

    /// Returns the milliseconds of every frame after a round to warm up.
    pub(super) fn time(&self, engine: &mut Engine, wanted: Wanted) -> Result<Vec<f64>> {
        time(&self.views, ROUNDS, |view| engine.show(view, self.ask(), wanted).map(drop))
    }

    /// Returns the cost of each pass, its time the median of all frames; nothing where the device cannot time.
    pub(super) fn pass_costs(&self, engine: &mut Engine) -> Result<Vec<PassCost>> {
        if !engine.gpu().is_some_and(|gpu| gpu.time_passes()) {
            return Ok(Vec::new());
        }
        let mut costs: Vec<Vec<PassCost>> = Vec::new();
        for view in &self.views {
            engine.show(view, self.ask(), Wanted::default())?;
            costs.extend(engine.gpu().map(|gpu| gpu.pass_costs()).transpose()?);
        }
        let mut by_pass: BTreeMap<usize, Vec<PassCost>> = BTreeMap::new();
        for (k, cost) in costs.iter().flat_map(|frame| frame.iter().enumerate()) {
            by_pass.entry(k).or_default().push(*cost);
        }
        let median = |mut costs: Vec<PassCost>| {
            costs.sort_by(|a, b| a.ms.total_cmp(&b.ms));
            costs[costs.len() / 2]
        };
        Ok(by_pass.into_values().map(median).collect())
    }
}

/// Times the engine's first prompt on every frame, with the transfer of the results; on a GPU each
/// pass by itself, too.
pub(super) fn rows(engine: &mut Engine, cameras: &[(f32, Camera)]) -> Result<Vec<Timing>> {
    // One prompt, as a user asks.
    let words: Vec<String> = engine.queries().iter().take(1).map(|q| q.prompt.clone()).collect();
    engine.set_prompts(&words)?;
    let show = Show::new(engine, cameras);
    let mut rows = Vec::new();
    for (way, wanted) in WAYS {
        rows.push(Timing::of("shown", format!("from {way}"), show.time(engine, wanted)?));
    }
    let (again, wanted) = AGAIN;
    rows.push(Timing::of("shown", format!("from {again}"), show.again().time(engine, wanted)?));
    let costs = show.pass_costs(engine)?;
    rows.extend(costs.iter().map(|c| Timing::of(c.name, "by the device's own clock", vec![c.ms])));
    Ok(rows)
}
