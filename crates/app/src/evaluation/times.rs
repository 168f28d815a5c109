//! Times of rendering and asking.

use crate::engine::{Engine, SceneView};
use std::{sync::Arc, time::Instant};
use surgtpgs_core::{
    Result,
    clock::PassName,
    num::median,
    raster::{FramePass, Images},
};

/// Median times per frame; `relevancy` is of one prompt, `frame` of everything with one prompt.
#[derive(serde::Serialize)]
pub(crate) struct Milliseconds {
    /// `None` where the renderer does both passes in one.
    pub(crate) deform: Option<f64>,
    pub(crate) raster: f64,
    pub(crate) relevancy: Option<f64>,
    pub(crate) frame: f64,
}

#[derive(Default)]
pub(super) struct Times {
    deform: Vec<f64>,
    raster: Vec<f64>,
    relevancy: Vec<f64>,
    warm: bool,
}

impl Times {
    /// Renders with features; the first frame is rendered twice, to warm up.
    pub(super) fn render(&mut self, engine: &mut Engine, view: &SceneView) -> Result<Arc<Images>> {
        if !std::mem::replace(&mut self.warm, true) {
            engine.render(view, true)?;
            engine.forget_last();
        }
        let ms = |engine: &Engine, pass| engine.clock().seconds(pass) * 1e3;
        let all = |engine: &Engine| FramePass::ALL.iter().map(|p| ms(engine, *p)).sum::<f64>();
        let (deform_before, before) = (ms(engine, FramePass::Deform), all(engine));
        let images = engine.render(view, true)?;
        let deform = ms(engine, FramePass::Deform) - deform_before;
        // A GPU does both passes at once, so this one has no time of its own.
        self.deform.extend((deform > 0.0).then_some(deform));
        self.raster.push(all(engine) - before - deform);
        Ok(images)
    }

    pub(super) fn scored(&mut self, started: Instant, prompts: usize) {
        if prompts > 0 {
            self.relevancy.push(started.elapsed().as_secs_f64() * 1e3 / prompts as f64);
        }
    }

    pub(super) fn medians(&mut self) -> Milliseconds {
        let (deform, relevancy) = (median(&mut self.deform), median(&mut self.relevancy));
        let raster = median(&mut self.raster).unwrap_or(0.0);
        let frame = deform.unwrap_or(0.0) + raster + relevancy.unwrap_or(0.0);
        Milliseconds { deform, raster, relevancy, frame }
    }
}
