//! Compares the chain from Gaussians to picture and scores with core on the same image planes.

use crate::{
    compare::{self, SMOOTH, Tolerance},
    fixture::{Recipe, codec, gpu, moved_camera, query, scene, uncertain},
};
use surgtpgs_core::{
    camera::Camera,
    grid::{Grid, Mask},
    raster::{FEATURE_PLANE, FrameClock, FramePass, Images, Renderer},
    relevancy::{Exact, Lattice, Query, Relevancy, RelevancySettings},
    scene::Scene,
};
use surgtpgs_render::{Asked, GpuRenderer, RenderInput, Shown, Wanted};

const SCORES: Wanted = Wanted { picture: false, depth: false, scores: true };

/// A renderer, a scene, and the prompts.
pub(crate) struct Stage {
    renderer: GpuRenderer,
    pub scene: Scene,
    pub camera: Camera,
    pub lattice: Lattice,
    pub queries: Vec<Query>,
    pub settings: RelevancySettings,
}

impl Stage {
    pub(crate) fn new() -> Option<Self> {
        Some(Self {
            renderer: GpuRenderer::new(gpu()?).unwrap(),
            scene: scene(Recipe::default()),
            camera: moved_camera(121, 77),
            lattice: Lattice::new(&codec()).unwrap(),
            queries: vec![query("liver", 4), uncertain()],
            settings: RelevancySettings::default(),
        })
    }

    pub(crate) fn show(&mut self, time: f32, field_of_view: Option<&Mask>) -> Shown {
        self.show_wanted(time, field_of_view, Wanted::ALL, &mut FrameClock::default())
    }

    fn show_wanted(
        &mut self,
        time: f32,
        field_of_view: Option<&Mask>,
        wanted: Wanted,
        clock: &mut FrameClock,
    ) -> Shown {
        let input = RenderInput { scene: &self.scene, camera: &self.camera, time, features: true };
        let asked = Asked { lattice: &mut self.lattice, queries: &self.queries, settings: &self.settings };
        self.renderer.show(&input, field_of_view, Some(asked), wanted, clock).unwrap()
    }

    /// Reads the device's own planes, so that each later pass is compared by itself.
    fn planes(&mut self, time: f32, field_of_view: Option<&Mask>) -> Images {
        let mut images = self.renderer.render(&self.scene, &self.camera, time, true).unwrap();
        let Some(mask) = field_of_view else { return images };
        let inside = mask.sampled(images.width, images.height);
        for plane in images.planes.chunks_exact_mut(inside.data.len()) {
            plane.iter_mut().zip(&inside.data).for_each(|(v, inside)| *v = if *inside { *v } else { 0.0 });
        }
        images
    }
}

/// A disc as field of view, at another size than the frame.
pub(crate) fn disc() -> Mask {
    let is_inside = |i: usize| (i % 40).abs_diff(20).pow(2) + (i / 40).abs_diff(15).pow(2) < 160;
    Grid::from_vec(40, 30, (0..1200).map(is_inside).collect())
}

#[test]
fn every_pass_after_the_raster_equals_its_twin() {
    let Some(mut stage) = Stage::new() else { return };
    let mask = disc();
    for (time, field_of_view) in [(0.2, None), (0.7, Some(&mask))] {
        let shown = stage.show(time, field_of_view);
        let planes = stage.planes(time, field_of_view);
        compare::pictures(&shown.picture.unwrap(), &planes.to_rgb()).unwrap();
        let depth = planes.normalised_depth();
        compare::close("depth", &shown.depth.unwrap().data, &depth.data, SMOOTH).unwrap();

        let scores = stage.lattice.score(&planes, &stage.queries, &stage.settings);
        assert_eq!(shown.scores.len(), 2);
        for (found, expected) in shown.scores.iter().zip(&scores) {
            // A point on the border of two cells may be looked up in either.
            let differ = found.data.iter().zip(&expected.data).filter(|(f, e)| (**f - **e).abs() > 1e-5);
            assert!(differ.count() <= found.data.len() / 500);
            let tolerance = Tolerance { absolute: 1.0 / 255.0, relative: 0.0 };
            compare::close("scores", &found.data, &expected.data, tolerance).unwrap();
        }
        let found = shown.scores[1].data.iter().filter(|s| **s > 0.3).count();
        assert!((50..121 * 77).contains(&found), "{found} pixels are found");
    }
}

#[test]
fn what_learned_no_feature_is_never_found() {
    let Some(mut stage) = Stage::new() else { return };
    stage.scene.gaussians.features.fill(0.0);
    let deformation = &mut *stage.scene.deformation;
    deformation.feature_weight.iter_mut().chain(&mut deformation.feature_bias).for_each(|v| *v = 0.0);
    // The second time, the tables hold all cells that were needed.
    for _ in 0..2 {
        let shown = stage.show(0.4, None);
        assert!(shown.scores.iter().all(|scores| scores.data.iter().all(|s| *s == 0.0)));
    }
}

#[test]
fn a_repeated_prompt_and_one_that_means_nothing_have_their_own_scores() {
    let Some(mut stage) = Stage::new() else { return };
    let [first, other] = [stage.queries[0].clone(), stage.queries[1].clone()];
    let nothing = Query { meant: Vec::new(), ..first.clone() };
    // The tables of earlier prompts are known already.
    stage.show(0.4, None);
    for queries in [vec![other.clone(), other.clone()], vec![first.clone(), nothing], vec![first, other]] {
        stage.queries = queries;
        let shown = stage.show(0.4, None);
        let planes = stage.planes(0.4, None);
        let scores = stage.lattice.score(&planes, &stage.queries, &stage.settings);
        for (found, expected) in shown.scores.iter().zip(&scores) {
            let tolerance = Tolerance { absolute: 1.0 / 255.0, relative: 0.0 };
            compare::close("scores", &found.data, &expected.data, tolerance).unwrap();
            let is_seen = |scores: &Grid<f32>| scores.data.iter().map(|s| *s > 0.0).collect::<Vec<_>>();
            assert_eq!(is_seen(found), is_seen(expected));
        }
    }
}

#[test]
fn scores_keep_the_promise_against_decoding_every_pixel() {
    let Some(mut stage) = Stage::new() else { return };
    let shown = stage.show(0.4, None);
    let planes = stage.planes(0.4, None);
    let exact = Exact::new(codec()).score(&planes, &stage.queries, &stage.settings);
    for (found, exact) in shown.scores.iter().zip(&exact) {
        let promise = Tolerance { absolute: 1.0 / 255.0, relative: 0.0 };
        compare::close("scores", &found.data, &exact.data, promise).unwrap();
    }
    assert!(exact[0].data.contains(&0.0) && exact[0].data.iter().any(|s| *s > 0.0));
}

#[test]
fn what_the_tables_left_open_is_repaired_in_the_same_frame() {
    let Some(mut stage) = Stage::new() else { return };
    // There are no cells yet, so all of the first frame is open. Later only the pixels that no cell can
    // decide are.
    let first = stage.show(0.4, None);
    let cells = stage.lattice.report().cells;
    let second = stage.show(0.4, None);
    assert!(cells > 100 && stage.lattice.report().cells == cells);
    for (first, second) in first.scores.iter().zip(&second.scores) {
        let rounding = Tolerance { absolute: 1e-5, relative: 0.0 };
        compare::close("scores", &first.data, &second.data, rounding).unwrap();
    }
    assert_eq!(second.scores, stage.show(0.4, None).scores);
    // A new prompt cuts cells that are still whole on the device.
    stage.queries[1] = query("grasper of steel", 3);
    let third = stage.show(0.4, None);
    let planes = stage.planes(0.4, None);
    let exact = Exact::new(codec()).score(&planes, &stage.queries, &stage.settings);
    let promise = Tolerance { absolute: 1.0 / 255.0, relative: 0.0 };
    compare::close("scores", &third.scores[1].data, &exact[1].data, promise).unwrap();
}

#[test]
fn only_what_is_wanted_comes_back() {
    let Some(mut stage) = Stage::new() else { return };
    let clock = &mut FrameClock::default();
    let nothing = stage.show_wanted(0.4, None, Wanted::default(), clock);
    assert!(nothing.picture.is_none() && nothing.depth.is_none() && nothing.scores.is_empty());
    let clock = &mut FrameClock::default();
    let scored = stage.show_wanted(0.4, None, SCORES, clock);
    assert!(scored.picture.is_none() && scored.depth.is_none() && scored.scores.len() == 2);
    // The image planes are still valid.
    assert_eq!((clock.runs(FramePass::Raster), clock.runs(FramePass::Relevancy)), (0, 1));
    let input = RenderInput { scene: &stage.scene, camera: &stage.camera, time: 0.4, features: false };
    let bare = stage.renderer.show(&input, None, None, Wanted::ALL, &mut FrameClock::default()).unwrap();
    assert!(bare.depth.is_some() && bare.scores.is_empty());
    let planes = stage.renderer.render(&stage.scene, &stage.camera, 0.4, false).unwrap();
    compare::pictures(&bare.picture.unwrap(), &planes.to_rgb()).unwrap();
}

#[test]
fn passes_are_timed_where_the_adapter_can() {
    let Some(mut stage) = Stage::new() else { return };
    if !stage.renderer.time_passes() {
        return;
    }
    stage.show(0.4, None);
    stage.show(0.5, None);
    let costs = stage.renderer.pass_costs().unwrap();
    let names: Vec<&str> = costs.iter().map(|cost| cost.name).collect();
    assert!(names.starts_with(&["deform", "project", "bin", "raster", "lattice", "compose"]), "{names:?}");
    assert!(costs.iter().all(|cost| (0.0..10_000.0).contains(&cost.ms) && cost.bytes > 0), "{costs:?}");
    // The picture and the depth are written, the planes without features and one bit per pixel are read.
    let pixels = 121 * 77;
    let compose = costs.iter().find(|cost| cost.name == "compose").unwrap();
    let expected = pixels * 4 * (2 + FEATURE_PLANE as u64) + pixels.div_ceil(32) * 4;
    assert!(compose.bytes.abs_diff(expected) < 64, "{compose:?}, expected {expected}");
    stage.show_wanted(0.6, None, SCORES, &mut FrameClock::default());
    let costs = stage.renderer.pass_costs().unwrap();
    assert!(costs.iter().all(|cost| cost.name != "compose"), "no picture is wanted: {costs:?}");
}
