//! Tests of both machines behind one engine.

use super::{asking_tests::adapter, outside::outside, *};
use surgtpgs_render::{AdapterChoice, Gpu};

#[test]
fn an_engine_can_move_to_a_worker_thread() {
    fn is_send<T: Send>() {}
    is_send::<Engine>();
}

#[test]
fn nothing_is_written_into_the_text_encoder_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let encoder = folder.path().join("encoder");
    std::fs::create_dir(&encoder).unwrap();
    let refused = |encoder: EncoderChoice| {
        let options = EngineOptions { backend: BackendChoice::Cpu, encoder, ..Default::default() };
        let engine = Engine::new(Arc::new(surgtpgs_core::stress::ordinary(3)), None, options).unwrap();
        let inputs = engine.inputs(&folder.path().join("scene.safetensors"));
        surgtpgs_core::files::require_apart(&folder.path().join("encoder/out"), &inputs).err()
    };
    let error = refused(EncoderChoice::Folder(encoder)).unwrap().to_string();
    assert!(error.contains("inside the text encoder"), "{error}");
    assert!(refused(EncoderChoice::Builtin).is_none());
}

#[test]
fn marks_outside_of_the_field_of_view_are_named() {
    use surgtpgs_core::marks::{Mark, Marks, Shape};
    let mut scene = surgtpgs_core::stress::ordinary(3);
    scene.field_of_view = Grid::from_vec(2, 1, vec![false, true]);
    let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
    let mut engine = Engine::new(Arc::new(scene), None, options).unwrap();
    assert!(engine.mark_notes().is_empty());
    let canvas = engine.canvas();
    let places = [("duct", 6.0), ("fat", canvas.width as f32 - 6.0)];
    let marks =
        places.map(|(name, x)| Mark::new(0, name, true, Shape::Click { point_px: [x, 6.0], radius_px: 2.0 }));
    engine.set_marks(Marks::new(marks.to_vec(), &canvas).unwrap()).unwrap();
    let notes = engine.mark_notes();
    assert_eq!(notes.len(), 1);
    assert!(notes[0].starts_with("marks[0] (\"duct\" on frame 0) lies outside"), "{notes:?}");
}

#[test]
fn a_name_that_marks_only_deny_cannot_be_looked_for() {
    use surgtpgs_core::marks::{Mark, Marks, Shape};
    let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
    let mut engine = Engine::new(Arc::new(surgtpgs_core::stress::ordinary(3)), None, options).unwrap();
    let canvas = engine.canvas();
    for (add, absence) in [(true, Absence::NotThere), (false, Absence::NeedsMark)] {
        let shape = Shape::Click { point_px: [6.0, 6.0], radius_px: 2.0 };
        let marks = Marks::new(vec![Mark::new(0, "duct", add, shape)], &canvas).unwrap();
        engine.set_marks(marks).unwrap();
        engine.set_prompts(&["duct".to_owned()]).unwrap();
        assert_eq!(engine.answers()[0].absence, absence, "{:?}", engine.answers());
        let notes = engine.mark_notes();
        assert!(notes.iter().all(|note| note.contains("\"duct\" is marked only as what it is not")));
        assert_eq!(notes.len(), usize::from(!add), "{notes:?}");
    }
}

#[test]
fn marks_alone_are_shown_without_rendering_a_picture() {
    use surgtpgs_core::marks::{Mark, Marks, Shape};
    for backend in [Some(BackendChoice::Cpu), adapter().map(|_| BackendChoice::Gpu)].into_iter().flatten() {
        let options = EngineOptions { backend, ..Default::default() };
        let scene = Arc::new(surgtpgs_core::stress::ordinary(200));
        let mut engine = Engine::new(scene, None, options).unwrap();
        let shape = Shape::Box { corners_px: [[8.0, 8.0], [40.0, 32.0]] };
        let marks = Marks::new(vec![Mark::new(0, "duct", true, shape)], &engine.canvas()).unwrap();
        engine.set_marks(marks).unwrap();
        engine.set_prompts(&["duct".to_owned()]).unwrap();
        let view = engine.view(0).unwrap();
        let scores = Wanted { scores: true, ..Wanted::default() };
        let shown = engine.show(&view, Ask::Now, scores).unwrap();
        assert_eq!(engine.clock().runs(FramePass::Raster), 0, "{backend:?}");
        assert!(shown.scores[0].at(20, 20) > 0.5 && shown.picture.is_none(), "{backend:?}");
        let all = engine.show(&view, Ask::Now, Wanted::ALL).unwrap();
        assert!(all.scores == shown.scores && all.picture.is_some() && all.depth.is_some(), "{backend:?}");
        let images = engine.render(&view, true).unwrap();
        assert!(engine.scores(&images, &view).unwrap() == shown.scores, "{backend:?}");
    }
}

#[test]
fn spellings_of_a_marked_name_are_one() {
    use surgtpgs_core::marks::{Mark, Marks, Shape};
    let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
    let mut engine = Engine::new(Arc::new(surgtpgs_core::stress::ordinary(3)), None, options).unwrap();
    let click = |(name, x): (&str, f32)| {
        Mark::new(0, name, true, Shape::Click { point_px: [x, 6.0], radius_px: 2.0 })
    };
    let mut marks = [("gallbladder", 6.0), ("fat", 20.0), ("Gall Bladder", 40.0), ("gall-bladder", 50.0)];
    let mut digests = Vec::new();
    for _ in 0..marks.len() {
        marks.rotate_left(1);
        let canvas = engine.canvas();
        engine.set_marks(Marks::new(marks.map(click).to_vec(), &canvas).unwrap()).unwrap();
        let known = engine.marks().unwrap();
        assert_eq!(known.names(), ["fat", "gall bladder"], "{marks:?}");
        digests.push(known.digest());
    }
    digests.dedup();
    assert_eq!(digests.len(), 1, "the order of marks does not matter");
}

/// Opens an engine on an ordinary scene with a codec, and sets a prompt past the text encoder.
fn asked_engine(backend: BackendChoice) -> Engine {
    use surgtpgs_core::codec::{Codec, Linear};
    let layer = |rows: usize, columns: usize| Linear {
        weight: ndarray::Array2::from_shape_fn((rows, columns), |(i, k)| ((3 * i + 5 * k) as f32).sin()),
        bias: ndarray::Array1::from_shape_fn(rows, |i| (i as f32).cos()),
    };
    let codec = Codec { encoder: vec![layer(3, 8)], decoder: vec![layer(12, 3), layer(8, 12)] };
    let mut scene = surgtpgs_core::stress::ordinary(300);
    scene.codec = Some(codec);
    scene.gaussians.opacity_logits.fill(3.0);
    scene.field_of_view = Grid::from_vec(2, 1, vec![true, false]);
    let mut engine =
        Engine::new(Arc::new(scene), None, EngineOptions { backend, ..Default::default() }).unwrap();
    let text = |phase: f32| -> Vec<f32> {
        surgtpgs_core::num::normalised(&(0..8).map(|i| (phase + i as f32).sin()).collect::<Vec<_>>()).unwrap()
    };
    engine.asking.queries = vec![Query::new("liver", text(0.0)).but_not(vec![("object".into(), text(1.3))])];
    engine
}

fn shown(engine: &mut Engine, time: f32) -> Shown {
    let camera = engine.scene().cameras[0];
    let view = SceneView { time, camera, recorded: Some(0) };
    engine.show(&view, Ask::Now, Wanted::ALL).unwrap()
}

/// Returns `None` without an adapter, so that nothing is compared; under `CI=true` that is a failure.
fn gpu_engine() -> Option<Engine> {
    adapter().map(|_| asked_engine(BackendChoice::Gpu))
}

#[test]
fn both_machines_show_the_same() {
    let Some(mut gpu) = gpu_engine() else { return };
    let (found, expected) = (shown(&mut gpu, 0.3), shown(&mut asked_engine(BackendChoice::Cpu), 0.3));
    // Nearly all values agree. Where a threshold decided otherwise, they differ by up to `at_most`.
    let close = |a: &[f32], b: &[f32], by: f32, at_most: f32| {
        let apart: Vec<f32> = a.iter().zip(b).map(|(a, b)| (a - b).abs()).collect();
        let far = apart.iter().filter(|apart| !(**apart <= by)).count();
        assert!(a.len() == b.len() && far * 100 <= a.len(), "{far} of {}", a.len());
        let farthest = apart.iter().copied().fold(0.0, f32::max);
        assert!(apart.iter().all(|apart| *apart <= at_most), "{farthest} apart, {at_most} may be");
    };
    let bytes = |picture: &Option<image::RgbImage>| -> Vec<f32> {
        picture.as_ref().unwrap().as_raw().iter().map(|v| f32::from(*v)).collect()
    };
    // Planes differ by up to 4/255 of their largest value (`WHOLE_CHAIN` in `render/tests`), which is below 1
    // in those of colours; rounding adds a level. No two Gaussians are so near that their order could differ.
    close(&bytes(&found.picture), &bytes(&expected.picture), 1.0, 5.0);
    // Beside the least opacity that depth needs, a pixel may have depth on one of both alone.
    let depths = [found.depth, expected.depth].map(|depth| depth.unwrap().data);
    close(&depths[0], &depths[1], 1e-3, f32::INFINITY);
    // Both terms of depth over opacity are off by up to 4/255 of 6.2 units, over an opacity of at least 0.5.
    let both = depths[0].iter().zip(&depths[1]).filter(|(a, b)| **a > 0.0 && **b > 0.0);
    assert!(both.clone().count() > 100 && both.clone().all(|(a, b)| (a - b).abs() <= 0.4));
    // A feature of next to no length points anywhere, and its score may be anything.
    close(&found.scores[0].data, &expected.scores[0].data, 1e-3, 1.0);
    let masks = [&found.scores[0], &expected.scores[0]].map(|scores| threshold(scores, 0.25));
    let areas = masks.each_ref().map(|mask| mask.count());
    assert!(areas[0].abs_diff(areas[1]) <= 5 && areas[1] > 50, "{areas:?}");
    // The right half is outside the field of view.
    assert!((0..masks[0].height).all(|y| masks[0].row(y)[32..].iter().all(|found| !found)));
}

#[test]
fn a_view_asked_again_runs_no_pass_before_the_scores() {
    for backend in [Some(BackendChoice::Cpu), gpu_engine().map(|_| BackendChoice::Gpu)].into_iter().flatten()
    {
        let mut engine = asked_engine(backend);
        shown(&mut engine, 0.3);
        let before = engine.clock().clone();
        shown(&mut engine, 0.3);
        let ran = |pass| engine.clock().runs(pass) - before.runs(pass);
        assert_eq!((ran(FramePass::Raster), ran(FramePass::Relevancy)), (0, 1), "{backend:?}");
    }
}

#[test]
fn a_lost_device_is_replaced_without_a_word() {
    let Some(mut engine) = gpu_engine() else { return };
    let before = shown(&mut engine, 0.3);
    engine.gpu().unwrap().gpu().device().destroy();
    let after = shown(&mut engine, 0.3);
    assert!(before.picture == after.picture, "another picture");
    // The first frame's points were scored one by one, the second one's in the tables.
    let pairs = before.scores[0].data.iter().zip(&after.scores[0].data);
    assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-4));
    engine.gpu().unwrap().gpu().device().destroy();
    let view = SceneView::free(0.5, engine.scene().cameras[0]);
    assert!(engine.render(&view, true).is_ok());
}

#[test]
fn where_the_device_hangs_the_cpu_takes_over_unless_a_gpu_was_asked_for() {
    let Some(mut engine) = gpu_engine() else { return };
    let view = SceneView::free(0.5, engine.scene().cameras[0]).resized(1600, 1200);
    for backend in [BackendChoice::Gpu, BackendChoice::Auto] {
        let mut gpu = Gpu::open(AdapterChoice::Any).unwrap();
        // Without patience every device counts as hanging: none answers at once.
        gpu.set_patience(std::time::Duration::ZERO);
        engine.machine = Machine::Gpu(Box::new(GpuRenderer::new(gpu).unwrap()));
        engine.backend = backend;
        let rendered = engine.render(&view, true);
        assert_eq!(rendered.is_ok(), backend == BackendChoice::Auto, "{:?}", rendered.err());
        assert_eq!(engine.renderer_name().starts_with("CPU"), backend == BackendChoice::Auto);
    }
}

#[test]
fn what_a_gpu_has_no_room_for_the_cpu_does_unless_a_gpu_was_asked_for() {
    let Some(mut engine) = gpu_engine() else { return };
    let small = SceneView::free(0.5, engine.scene().cameras[0]);
    let large = small.resized(1600, 1200);
    let draw = |engine: &mut Engine, view: &SceneView, shows: bool| -> Result<()> {
        engine.forget_last();
        if shows {
            engine.show(view, Ask::Nothing, Wanted::ALL).map(drop)
        } else {
            engine.render(view, false).map(drop)
        }
    };
    let is_cpu = |engine: &Engine| engine.renderer_name().starts_with("CPU");
    for shows in [false, true] {
        for backend in [BackendChoice::Gpu, BackendChoice::Auto] {
            // The planes of the small picture take 60 KiB, those of the large one 37 MiB.
            let gpu = Gpu::open_small(16 << 20).unwrap();
            engine.machine = Machine::Gpu(Box::new(GpuRenderer::new(gpu).unwrap()));
            engine.backend = backend;
            draw(&mut engine, &small, shows).unwrap();
            assert!(!is_cpu(&engine));
            let drawn = draw(&mut engine, &large, shows);
            let goes_on = backend == BackendChoice::Auto;
            assert_eq!((drawn.is_ok(), is_cpu(&engine)), (goes_on, goes_on), "{:?}", drawn.err());
            draw(&mut engine, &small, shows).unwrap();
            assert_eq!(is_cpu(&engine), goes_on, "it stays the same machine");
        }
        assert!(!engine.give_tools().work(), "another scene may fit on the GPU");
    }
}

#[test]
fn a_pixel_is_most_like_itself_and_not_like_what_it_is_not() {
    for mut engine in [Some(asked_engine(BackendChoice::Cpu)), gpu_engine()].into_iter().flatten() {
        shown(&mut engine, 0.3);
        let camera = engine.scene().cameras[0];
        let view = SceneView { time: 0.3, camera, recorded: Some(0) };
        let sample = engine.sample(&view, [20, 24]).unwrap().unwrap();
        let other = engine.sample(&view, [4, 40]).unwrap().unwrap();
        assert_eq!(engine.sample(&view, [40, 24]).unwrap(), None, "outside the field of view");
        assert_eq!(engine.sample(&view, [4000, 24]).unwrap(), None);
        let negatives =
            Negatives { phrases: Vec::new(), samples: vec![("there".into(), other)], uses_classes: false };
        engine
            .set_questions(&[Question { like: Some(sample.clone()), ..Question::words("here", negatives) }])
            .unwrap();
        let images = engine.render(&view, true).unwrap();
        let scores = engine.scores(&images, &view).unwrap();
        assert!(scores[0].at(20, 24) > 0.5 && scores[0].at(4, 40) < 0.5);
        let strange = Sample { encoder_sha256: "of another".into(), ..sample };
        let negatives = Negatives { phrases: Vec::new(), samples: Vec::new(), uses_classes: false };
        let asked =
            engine.set_questions(&[Question { like: Some(strange), ..Question::words("x", negatives) }]);
        assert!(asked.unwrap_err().to_string().contains("another text encoder"));
    }
}

#[test]
fn what_is_still_does_not_move_and_what_is_seen_is_opaque() {
    for mut engine in [Some(asked_engine(BackendChoice::Cpu)), gpu_engine()].into_iter().flatten() {
        let view = SceneView { time: 0.3, camera: engine.scene().cameras[0], recorded: Some(0) };
        let opacity = engine.opacity(&view).unwrap();
        assert!(opacity.data.iter().all(|a| (0.0..=1.0).contains(a)) && opacity.at(20, 24) > 0.5);
        let mut moving = Scene::clone(engine.scene());
        moving.cameras = vec![view.camera; 9];
        moving.deformation.weights.iter_mut().for_each(|w| *w *= 4.0);
        let options = EngineOptions { backend: engine.backend, ..Default::default() };
        let motion_of = |scene: Scene| {
            Engine::new(Arc::new(scene), None, options.clone()).unwrap().motion(&view).unwrap()
        };
        let motion = motion_of(moving);
        assert_eq!(motion.num_gaussians, 300);
        assert!(motion.num_moving > 0 && motion.travel_px.data.iter().any(|px| *px > 0.0));
        let mut still = Scene::clone(engine.scene());
        still.deformation.weights.fill(0.0);
        let motion = motion_of(still);
        assert!(motion.num_moving == 0 && motion.travel_px.data.iter().all(|px| !(*px > 0.0)));
    }
}

#[test]
fn nothing_is_found_outside_the_field_of_view_at_any_size() {
    let left = Grid::from_vec(2, 1, vec![true, false]);
    let mut scores = Grid::filled(4, 3, 0.9);
    blank(&mut scores.data, &outside((4, 3), &left));
    assert!((0..3).all(|y| scores.row(y) == [0.9, 0.9, 0.0, 0.0]));
    assert!(outside((1, 1), &Grid::filled(3, 3, true)).is_empty());
    assert!(outside((4, 3), &Grid::filled(0, 0, true)).is_empty());
    // A run goes on from one row to the next.
    assert_eq!(outside((2, 2), &Grid::from_vec(2, 2, vec![true, false, false, true])), vec![1..3]);
}
