use super::*;
use crate::{
    Result,
    camera::Camera,
    deform::{Deformation, GATE_SLOPE},
    gaussian::{Gaussians, SH_C0},
    grid::{Grid, Mask},
    num::logit,
    raster::{CpuRenderer, Renderer},
    scene::{Provenance, Scene},
};
use image::RgbImage;
use proptest::prelude::*;
use std::sync::Arc;

pub(super) const SIZE: [usize; 2] = [64, 48];
pub(super) const FRAMES: usize = 4;

pub(super) fn canvas() -> Canvas {
    let frame_names = (0..FRAMES).map(|i| format!("picture_{i}.png")).collect();
    Canvas { width: SIZE[0], height: SIZE[1], frame_names, num_frames: FRAMES }
}

/// A wall that is red on the left and green on the right.
pub(super) fn scene() -> Scene {
    let camera = Camera::with_field_of_view(SIZE[0] as u32, SIZE[1] as u32, 60.0);
    let places: Vec<(f32, f32)> =
        (0..24 * 32).map(|i| ((i % 32) as f32 * 2.0 + 1.0, (i / 32) as f32 * 2.0 + 1.0)).collect();
    let n = places.len();
    let colour = |&(u, _): &(f32, f32)| {
        let rgb: [f32; 3] = if u < 32.0 { [0.7, 0.2, 0.2] } else { [0.2, 0.6, 0.3] };
        rgb.map(|c| (c - 0.5) / SH_C0)
    };
    let gaussians = Gaussians {
        means: places.iter().map(|(u, v)| camera.unproject(*u, *v, 10.0).into()).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        log_scales: vec![[(10.0 / camera.fx).ln(); 3]; n],
        opacity_logits: vec![logit(0.9); n],
        colours: places.iter().map(colour).collect(),
        ..Gaussians::default()
    };
    Scene {
        gaussians: gaussians.into(),
        deformation: Deformation::at_rest(n, 0, 5, 0.25, GATE_SLOPE).into(),
        chapters: crate::scene::Chapters::default(),
        cameras: vec![camera; FRAMES],
        times: Vec::new(),
        field_of_view: Mask::filled(SIZE[0], SIZE[1], true),
        codec: None,
        classes: Vec::new(),
        encoder: None,
        words: Default::default(),
        provenance: Provenance::default(),
    }
}

pub(super) fn picture(scene: &Scene, frame: usize) -> Result<RgbImage> {
    Ok(CpuRenderer::default().render(scene, &scene.cameras[frame], scene.time(frame), false)?.to_rgb())
}

fn scores(marks: Vec<Mark>, frame: usize) -> (Vec<String>, FrameScores) {
    let scene = scene();
    let marks = Marks::new(marks, &canvas()).unwrap();
    let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &marks, CarrySettings::default());
    let found = carried.on_frame(&scene, frame, &mut |i| picture(&scene, i)).unwrap();
    (carried.names().to_vec(), found)
}

pub(super) fn stroke(frame: usize, name: &str, add: bool, points: &[[f32; 2]]) -> Mark {
    Mark::new(frame, name, add, Shape::Stroke { points_px: points.to_vec(), radius_px: 1.5 })
}

#[test]
fn a_stroke_on_each_side_finds_both_sides_on_every_frame() {
    let marks = vec![
        stroke(1, "Liver", true, &[[8.0, 10.0], [20.0, 40.0]]),
        stroke(1, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]),
    ];
    let (names, found) = scores(marks, 3);
    assert_eq!(names, ["fat", "liver"]);
    let share = |k: usize, left: bool| share_of_half(&found.scores[k], left);
    assert!(share(0, false) > 0.97 && share(0, true) < 0.03, "{} {}", share(0, false), share(0, true));
    assert!(share(1, true) > 0.97 && share(1, false) < 0.03, "{} {}", share(1, true), share(1, false));
}

/// Share of the left or the right half where something is found.
pub(super) fn share_of_half(scores: &Grid<f32>, left: bool) -> f32 {
    let inside = |i: &usize| (i % SIZE[0] < SIZE[0] / 2) == left;
    let pixels: Vec<usize> = (0..SIZE[0] * SIZE[1]).filter(inside).collect();
    pixels.iter().filter(|i| scores.data[**i] > 0.5).count() as f32 / pixels.len() as f32
}

#[test]
fn one_more_mark_on_another_frame_takes_nothing_else_away() {
    let first = [
        stroke(0, "liver", true, &[[8.0, 10.0], [20.0, 40.0]]),
        stroke(0, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]),
    ];
    for more in [
        stroke(3, "liver", false, &[[26.0, 10.0], [28.0, 14.0]]),
        stroke(3, "liver", true, &[[8.0, 10.0], [20.0, 40.0]]),
        stroke(3, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]),
    ] {
        let marks = [first.to_vec(), vec![more.clone()]].concat();
        for frame in [2, 3] {
            let (_, found) = scores(marks.clone(), frame);
            let (fat, liver) =
                (share_of_half(&found.scores[0], false), share_of_half(&found.scores[1], true));
            assert!(fat > 0.97 && liver > 0.9, "{fat} {liver} on frame {frame} after {more:?}");
        }
    }
}

#[test]
fn names_marked_on_different_frames_are_found_beside_each_other() {
    let marks = vec![
        stroke(0, "liver", true, &[[8.0, 10.0], [20.0, 40.0]]),
        stroke(3, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]),
    ];
    for frame in 0..FRAMES {
        let (_, found) = scores(marks.clone(), frame);
        let (fat, liver) = (share_of_half(&found.scores[0], false), share_of_half(&found.scores[1], true));
        assert!(fat > 0.9 && liver > 0.9, "{fat} {liver} on frame {frame}");
    }
}

#[test]
fn what_comes_in_later_is_not_found_before() {
    let scene = scene();
    // A bright tool lies over both halves from the third frame on.
    let [columns, rows] = [20..44, 16..30];
    let is_tool = |x: usize, y: usize| columns.contains(&x) && rows.contains(&y);
    let with_tool = |frame: usize| {
        let mut picture = picture(&scene, frame)?;
        for (x, y, pixel) in picture.enumerate_pixels_mut().filter(|_| frame >= 2) {
            if is_tool(x as usize, y as usize) {
                pixel.0 = [200, 205, 215];
            }
        }
        Ok(picture)
    };
    let marks = vec![
        stroke(0, "liver", true, &[[8.0, 6.0], [14.0, 40.0]]),
        stroke(0, "fat", true, &[[54.0, 6.0], [50.0, 40.0]]),
        stroke(3, "tool", true, &[[23.0, 23.0], [40.0, 23.0]]),
    ];
    let marks = Marks::new(marks, &canvas()).unwrap();
    let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &marks, CarrySettings::default());
    let tool = carried.names().iter().position(|name| name == "tool").unwrap();
    for frame in 0..FRAMES {
        let found = carried.on_frame(&scene, frame, &mut |i| with_tool(i)).unwrap();
        let is_found = |i: &usize| found.scores[tool].data[*i] > 0.5;
        let area = (0..SIZE[0] * SIZE[1]).filter(is_found).count();
        let wanted = if frame >= 2 { 250..450 } else { 0..20 };
        assert!(wanted.contains(&area), "{area} px on frame {frame}");
    }
}

#[test]
fn where_a_tool_was_before_it_left_it_is_not_found() {
    let scene = scene();
    let with_tool = |frame: usize| {
        let mut picture = picture(&scene, frame)?;
        for (x, y, pixel) in picture.enumerate_pixels_mut().filter(|_| frame < 2) {
            if (20..44).contains(&x) && (16..30).contains(&y) {
                pixel.0 = [200, 205, 215];
            }
        }
        Ok(picture)
    };
    let marks = vec![
        stroke(0, "tool", true, &[[23.0, 23.0], [40.0, 23.0]]),
        stroke(0, "liver", true, &[[8.0, 6.0], [14.0, 40.0]]),
    ];
    let marks = Marks::new(marks, &canvas()).unwrap();
    let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &marks, CarrySettings::default());
    for frame in 0..FRAMES {
        let found = carried.on_frame(&scene, frame, &mut |i| with_tool(i)).unwrap();
        assert_eq!(carried.names(), ["liver", "tool"]);
        let area = found.scores[1].data.iter().filter(|score| **score > 0.5).count();
        let wanted = if frame < 2 { 250..450 } else { 0..20 };
        assert!(wanted.contains(&area), "{area} px on frame {frame}");
    }
}

#[test]
fn a_name_on_another_frame_leaves_what_has_no_name_without_one() {
    let scene = scene();
    // Things from left to right: the third one comes in later, and the last and widest one is never marked.
    let colour = |x: u32, frame: usize| match x {
        ..12 => [170, 50, 45],
        12..24 => [60, 140, 70],
        24..36 if frame >= 2 => [215, 180, 80],
        _ => [75, 130, 75],
    };
    let striped = |frame: usize| {
        let grain = |x: u32, y: u32| ((x * 7 + y * 13) % 9) as u8;
        let pixel = |x: u32, y: u32| image::Rgb(colour(x, frame).map(|level: u8| level + grain(x, y)));
        Ok(RgbImage::from_fn(SIZE[0] as u32, SIZE[1] as u32, pixel))
    };
    let down = |x: f32| [[x, 6.0], [x, 42.0]];
    let marks = vec![
        stroke(0, "liver", true, &down(6.0)),
        stroke(0, "bile", true, &down(18.0)),
        stroke(3, "fat", true, &down(30.0)),
    ];
    let marks = Marks::new(marks, &canvas()).unwrap();
    let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &marks, CarrySettings::default());
    for frame in 0..FRAMES {
        let found = carried.on_frame(&scene, frame, &mut |i| striped(i)).unwrap();
        for (scores, name) in found.scores.iter().zip(carried.names()) {
            let unnamed = |i: &usize| i % SIZE[0] >= 40 && scores.data[*i] > 0.5;
            let area = (0..SIZE[0] * SIZE[1]).filter(unnamed).count();
            assert!(area < 60, "{name}: {area} px without a name on frame {frame}");
        }
    }
}

#[test]
fn one_stroke_alone_does_not_flood_what_looks_different() {
    let (_, found) = scores(vec![stroke(1, "liver", true, &[[8.0, 10.0], [20.0, 40.0]])], 3);
    assert!(found.scores[0].at(12, 20) > 0.5, "{}", found.scores[0].at(12, 20));
    assert!(found.scores[0].at(56, 20) < 0.5, "{}", found.scores[0].at(56, 20));
}

#[test]
fn outlines_correct_strokes_where_they_are_and_grow_no_further() {
    let outline = Shape::Box { corners_px: [[4.0, 4.0], [16.0, 16.0]] };
    let scene = scene();
    let marks = vec![
        stroke(0, "liver", true, &[[8.0, 20.0], [20.0, 40.0]]),
        stroke(0, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]),
        Mark::new(3, "fat", true, outline),
    ];
    let marks = Marks::new(marks, &canvas()).unwrap();
    // The box has no border in the picture.
    let settings = CarrySettings { refines_borders: false, ..CarrySettings::default() };
    let on = |frames: &[usize]| {
        let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &marks, settings);
        let each = frames.iter().map(|f| carried.on_frame(&scene, *f, &mut |i| picture(&scene, i)).unwrap());
        each.last().unwrap()
    };
    for frame in 0..FRAMES {
        let fat = &on(&[frame]).scores[0];
        assert!(fat.at(10, 10) > 0.5, "{} on frame {frame}", fat.at(10, 10));
        assert!(fat.at(24, 30) < 0.5 && fat.at(50, 30) > 0.5, "on frame {frame}");
    }
    assert_eq!(on(&[2]), on(&[0, 3, 1, 2]), "what was looked at before does not matter");
}

#[test]
fn an_outlined_structure_ends_at_its_outline() {
    let scene = scene();
    let outline = |frame: usize, corners: [[f32; 2]; 2]| {
        Mark::new(frame, "liver", true, Shape::Box { corners_px: corners })
    };
    // A part of the left half, which looks the same all over.
    let whole = outline(1, [[6.0, 6.0], [20.0, 30.0]]);
    let marks =
        |marks: &[Mark]| Marks::new(marks.to_vec(), &canvas()).unwrap().with_outsides(&scene, &(0..FRAMES));
    let alone = marks(std::slice::from_ref(&whole));
    let settings = CarrySettings { refines_borders: false, ..CarrySettings::default() };
    let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &alone, settings);
    for frame in 0..FRAMES {
        let liver = &carried.on_frame(&scene, frame, &mut |i| picture(&scene, i)).unwrap().scores[0];
        let area = liver.data.iter().filter(|score| **score > 0.5).count();
        let expected = if frame == 1 { 336..=336 } else { 300..=380 };
        assert!(expected.contains(&area), "{area} px instead of 336 on frame {frame}");
    }
    let denied = |marks: &Marks| -> Vec<usize> {
        marks.all().iter().filter(|mark| !mark.add).map(|mark| mark.frame).collect()
    };
    assert_eq!(denied(&alone), [1]);
    let piece = outline(2, [[6.0, 30.0], [12.0, 34.0]]);
    assert_eq!(denied(&marks(&[whole.clone(), piece])), [1], "a piece is not all of it");
    let pointed_at = stroke(3, "liver", true, &[[8.0, 10.0]]);
    assert!(denied(&marks(&[whole.clone(), pointed_at])).is_empty(), "what is pointed at goes on");
    let opposite = Mark { add: false, ..whole.clone() };
    assert!(denied(&marks(&[whole, opposite])).is_empty(), "nothing is left");
}

#[test]
fn an_outline_erases_the_strokes_below_it() {
    let wrong = stroke(0, "liver", true, &[[50.0, 10.0], [44.0, 40.0]]);
    let right = stroke(0, "fat", true, &[[8.0, 10.0], [20.0, 40.0]]);
    let whole = Shape::Polygon { points_px: vec![[34.0, 0.0], [64.0, 0.0], [64.0, 48.0], [34.0, 48.0]] };
    let not = Mark::new(0, "liver", false, whole);
    for frame in [0, 2] {
        let (names, found) = scores(vec![wrong.clone(), right.clone(), not.clone()], frame);
        let liver = names.iter().position(|name| name == "liver").unwrap();
        let most = found.scores[liver].data.iter().copied().fold(0.0, f32::max);
        assert!(most <= 0.5, "liver is found with {most} on frame {frame}");
    }
    // A mask that takes everything back leaves nothing to grow on that frame.
    let erased = |add: bool| {
        let pixels = right.shape.pixels(SIZE[0], SIZE[1]);
        Mark::new(0, "fat", add, Shape::from(&pixels))
    };
    let marks = vec![erased(false), stroke(3, "fat", true, &[[8.0, 10.0], [20.0, 40.0]]), right.clone()];
    assert_eq!(scores(marks, 1).0, ["fat"]);
}

#[test]
fn denied_pixels_are_not_found() {
    let all = Shape::Box { corners_px: [[0.0, 0.0], [64.0, 48.0]] };
    let hole = Shape::Box { corners_px: [[10.0, 10.0], [20.0, 20.0]] };
    let marks = vec![Mark::new(0, "liver", true, all), Mark::new(2, "liver", false, hole.clone())];
    let (_, found) = scores(marks, 2);
    let inside = hole.pixels(SIZE[0], SIZE[1]);
    assert!(inside.data.iter().zip(&found.scores[0].data).all(|(denied, score)| !denied || *score == 0.0));
    assert!(found.scores[0].at(60, 44) > 0.5, "far away nothing changes");
}

#[test]
fn what_is_denied_leaves_the_lead_of_other_names() {
    let not_fat = Mark::new(0, "fat", false, Shape::Box { corners_px: [[0.0; 2], [1.0, 1.0]] });
    let names = ["fat", "liver"].map(str::to_owned);
    let evidence = Evidence::of(&Marks::unchecked(vec![not_fat]), 0, &names, [2, 1]);
    let mut shares = [vec![0.4; 2], vec![0.5; 2]];
    carried::keep_marked(&evidence, &mut shares);
    let [before, after] = [0.5 / 0.9, shares[1][0]];
    assert!((after - before).abs() < 1e-3 && shares[0] == [0.0, 0.4] && shares[1][1] == 0.5, "{shares:?}");
}

#[test]
fn a_correction_changes_its_surroundings_alone() {
    let scene = scene();
    let graph = Arc::new(Graph::of(&scene));
    let before = |score: f32| Arc::new(Grid::filled(SIZE[0], SIZE[1], score));
    let correction = |marks: &Marks| {
        let mut before = |_: &str, _| Ok(before(0.8));
        Correction::of_names(&scene, &graph, marks, 0.6, &mut before).unwrap().remove("liver").unwrap()
    };
    let mark = stroke(0, "liver", false, &[[6.0, 6.0], [10.0, 6.0]]);
    let marks = Marks::new(vec![mark], &canvas()).unwrap();
    let mut scores = Grid::filled(SIZE[0], SIZE[1], 0.8);
    let view = (scene.cameras[3], scene.time(3));
    correction(&marks).apply(&scene, view, Some(3), &mut scores);
    assert!(scores.at(8, 6) < 0.5 && (scores.at(60, 44) - 0.8).abs() < 1e-3);
    // The Gaussians change as the pixels that show them. The last one is far from the mark.
    let mut of_gaussians = vec![0.8_f32; scene.gaussians.len()];
    correction(&marks).apply_to_gaussians(&mut of_gaussians);
    let (least, last) = (of_gaussians.iter().copied().fold(1.0, f32::min), of_gaussians[24 * 32 - 1]);
    assert!(least < 0.5 && (last - 0.8).abs() < 1e-2, "{least} {last}");
    let opposite = stroke(0, "liver", true, &[[6.0, 6.0], [10.0, 6.0]]);
    // The same pixels, but not the same shape.
    let longer = stroke(0, "liver", true, &[[6.0, 6.0], [8.0, 6.0], [10.0, 6.0]]);
    let both = Marks::new(vec![marks.all()[0].clone(), longer], &canvas()).unwrap();
    let mut unchanged = Grid::filled(SIZE[0], SIZE[1], 0.8);
    correction(&both).apply(&scene, view, Some(0), &mut unchanged);
    assert_eq!(unchanged, Grid::filled(SIZE[0], SIZE[1], 0.8));
    // What was found already is no news.
    let same = Marks::new(vec![opposite], &canvas()).unwrap();
    correction(&same).apply(&scene, view, Some(3), &mut unchanged);
    assert_eq!(unchanged, Grid::filled(SIZE[0], SIZE[1], 0.8));
}

#[test]
fn more_threads_give_the_same_scores() {
    let marks = || {
        vec![
            stroke(0, "liver", true, &[[8.0, 10.0], [20.0, 40.0]]),
            stroke(3, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]),
        ]
    };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scores(marks(), 1))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn doubt_leads_to_a_frame_without_a_mark() {
    let scene = scene();
    let marks = Marks::new(vec![stroke(0, "liver", true, &[[8.0, 10.0], [20.0, 40.0]])], &canvas()).unwrap();
    let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &marks, CarrySettings::default());
    let places = carried.in_doubt(&scene, &mut |i| picture(&scene, i)).unwrap();
    assert_eq!(places.iter().map(|here| here.frame).collect::<Vec<_>>(), [1, 2, 3]);
    let here = LookHere::best(&places).unwrap();
    assert!(here.frame != 0 && (0.0..=1.0).contains(&here.doubt), "{here:?}");
    assert!(here.point_px[0] < SIZE[0] as f32 && here.point_px[1] < SIZE[1] as f32);
}

#[test]
fn one_frame_in_doubt_counts_less_than_several_beside_each_other() {
    let here = |(frame, doubt): (usize, f32)| LookHere { frame, point_px: [0.0; 2], doubt };
    let doubts = [(0, 0.1), (1, 0.1), (9, 0.5), (10, 0.6), (11, 0.5), (40, 0.7)];
    let places: Vec<LookHere> = doubts.into_iter().map(here).collect();
    assert_eq!(LookHere::best(&places).map(|best| best.frame), Some(10));
    assert_eq!(LookHere::best(&places[5..]).map(|best| best.frame), Some(40));
    assert_eq!(LookHere::best(&[]), None);
}

#[test]
fn a_mark_given_twice_is_taken_back_by_one_opposite() {
    let fat = stroke(0, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]);
    let polygon = vec![[5.0, 5.0], [30.0, 8.0], [20.0, 44.0]];
    let shapes = [
        [
            Shape::Box { corners_px: [[3.0, 20.0], [30.0, 4.0]] },
            Shape::Box { corners_px: [[30.0, 4.0], [3.0, 20.0]] },
        ],
        [(); 2].map(|()| Shape::Polygon { points_px: polygon.clone() }),
        [(); 2].map(|()| Shape::from(&Mask::from_vec(SIZE[0], SIZE[1], vec![true; SIZE[0] * SIZE[1]]))),
        [(); 2].map(|()| Shape::Click { point_px: [8.0, 8.0], radius_px: 3.0 }),
    ];
    for [shape, same] in shapes {
        let liver = |add: bool, shape: &Shape| Mark::new(0, "liver", add, shape.clone());
        let given = vec![liver(true, &shape), liver(true, &shape), liver(false, &same), fat.clone()];
        let marks = Marks::new(given.clone(), &canvas()).unwrap();
        let alone = Marks::new(vec![fat.clone()], &canvas()).unwrap();
        assert_eq!((marks.names(), marks.digest()), (alone.names(), alone.digest()), "{shape:?}");
        assert_eq!((marks.all().len(), marks.standing().count()), (4, 1));
        assert_eq!(scores(given, 0), scores(vec![fat.clone()], 0), "{shape:?}");
    }
}

#[test]
fn a_small_structure_marked_inside_a_large_one_is_found() {
    let large = Shape::from(&Mask::from_vec(SIZE[0], SIZE[1], vec![true; SIZE[0] * SIZE[1]]));
    let inside = [
        stroke(0, "duct", true, &[[10.0, 10.0], [20.0, 10.0]]),
        Mark::new(0, "duct", true, Shape::Box { corners_px: [[8.0, 8.0], [20.0, 16.0]] }),
        Mark::new(0, "duct", true, Shape::Polygon { points_px: vec![[8.0, 8.0], [24.0, 8.0], [8.0, 20.0]] }),
    ];
    for small in inside {
        let pixels = small.shape.pixels(SIZE[0], SIZE[1]);
        let large = Mark::new(0, "liver", true, large.clone());
        let found = [vec![small.clone(), large.clone()], vec![large, small]].map(|marks| scores(marks, 0));
        assert_eq!(found[0], found[1]);
        let (names, found) = &found[0];
        assert_eq!(*names, ["duct", "liver"]);
        for (i, is_duct) in pixels.data.iter().enumerate() {
            assert_eq!([0, 1].map(|k| found.scores[k].data[i] > 0.5), [*is_duct, !is_duct], "pixel {i}");
        }
    }
}

#[test]
fn a_name_that_is_only_denied_is_not_marked() {
    let liver = stroke(0, "liver", true, &[[8.0, 10.0], [20.0, 40.0]]);
    let not_fat = stroke(0, "fat", false, &[[12.0, 20.0], [16.0, 20.0]]);
    let marks = Marks::new(vec![liver.clone(), not_fat.clone()], &canvas()).unwrap();
    assert_eq!(
        (marks.names(), marks.shown_names()),
        (vec!["fat".into(), "liver".into()], vec!["liver".into()])
    );
    assert_eq!(scores(vec![liver.clone(), not_fat], 0), scores(vec![liver], 0));
}

/// Any few marks on the small canvas.
pub(super) fn any_marks() -> impl Strategy<Value = Vec<Mark>> {
    let point = || (0.0f32..64.0, 0.0f32..48.0).prop_map(|(x, y)| [x, y]);
    let shape = prop_oneof![
        (point(), 0.0f32..9.0).prop_map(|(point_px, radius_px)| Shape::Click { point_px, radius_px }),
        (proptest::collection::vec(point(), 1..4), 0.0f32..5.0)
            .prop_map(|(points_px, radius_px)| Shape::Stroke { points_px, radius_px }),
        Just(Shape::Box { corners_px: [[3.0, 4.0], [30.0, 20.0]] }),
        Just(Shape::Polygon { points_px: vec![[5.0, 5.0], [60.0, 8.0], [30.0, 44.0]] }),
    ];
    let mark = (0..FRAMES, prop_oneof![Just("liver"), Just("fat")], any::<bool>(), shape)
        .prop_map(|(frame, name, add, shape)| Mark::new(frame, name, add, shape));
    proptest::collection::vec(mark, 1..5)
}

/// Returns what is found on a frame for some of six marks: after others were looked for, and from nothing.
fn took_over_and_anew(before: &[usize], asked: &[usize], after: &[usize], frame: usize) -> [FrameScores; 2] {
    let scene = scene();
    let graph = Arc::new(Graph::of(&scene));
    let [liver, fat] = [[[8.0, 10.0], [20.0, 40.0]], [[50.0, 10.0], [44.0, 40.0]]];
    let pool = [
        stroke(0, "liver", true, &liver),
        stroke(0, "fat", true, &fat),
        stroke(3, "fat", true, &fat),
        stroke(3, "liver", true, &liver),
        stroke(1, "liver", false, &[[26.0, 10.0], [28.0, 14.0]]),
        Mark::new(2, "fat", true, Shape::Box { corners_px: [[40.0, 4.0], [56.0, 16.0]] }),
    ];
    let carried = |chosen: &[usize]| {
        let marks = Marks::new(chosen.iter().map(|i| pool[*i].clone()).collect(), &canvas()).unwrap();
        Carried::new(&scene, Arc::clone(&graph), &marks, CarrySettings::default())
    };
    let on = |carried: &mut Carried, frame: usize| {
        carried.on_frame(&scene, frame, &mut |i| picture(&scene, i)).unwrap()
    };
    let mut earlier = carried(before);
    asked.iter().for_each(|frame| drop(on(&mut earlier, *frame)));
    [on(&mut carried(after).after(earlier), frame), on(&mut carried(after), frame)]
}

#[test]
fn a_marked_frame_whose_neighbours_lose_their_marks_is_found_as_before() {
    let [took_over, anew] = took_over_and_anew(&[0, 1, 2], &[2], &[0, 1], 0);
    assert_eq!(took_over, anew);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    #[test]
    fn what_was_found_before_changes_no_score(
        before in prop::sample::subsequence((0..6).collect::<Vec<usize>>(), 1..6),
        asked in prop::collection::vec(0..FRAMES, 1..3),
        after in prop::sample::subsequence((0..6).collect::<Vec<usize>>(), 1..6),
        frame in 0..FRAMES,
    ) {
        let [took_over, anew] = took_over_and_anew(&before, &asked, &after, frame);
        prop_assert_eq!(took_over, anew);
    }

    #[test]
    fn the_order_of_marks_does_not_matter(marks in any_marks(), turn in 0usize..5, frame in 0..FRAMES) {
        let mut turned = marks.clone();
        turned.rotate_left(turn % marks.len());
        turned.reverse();
        let digest = |marks: &[Mark]| Marks::new(marks.to_vec(), &canvas()).unwrap().digest();
        prop_assert_eq!(digest(&marks), digest(&turned));
        prop_assert_eq!(scores(marks, frame), scores(turned, frame));
    }

    #[test]
    fn a_mark_and_its_opposite_leave_nothing(marks in any_marks(), frame in 0..FRAMES) {
        let opposite = |mark: &Mark| Mark { add: !mark.add, ..mark.clone() };
        let both: Vec<Mark> = marks.iter().cloned().chain(marks.iter().map(opposite)).collect();
        let (names, found) = scores(both, frame);
        prop_assert!(names.is_empty() && found.scores.is_empty());
    }

    #[test]
    fn an_undone_mark_never_was(marks in any_marks(), extra in any_marks(), frame in 0..FRAMES) {
        // Undone by its opposite, over whatever else was marked there, but not twice.
        let is_same = |a: &Mark, b: &Mark| a.frame == b.frame && a.shape == b.shape;
        let undone: Vec<Mark> = extra
            .iter()
            .filter(|&m| !marks.iter().any(|mark| mark.name == marks[0].name && is_same(mark, m)))
            .map(|m| Mark::new(m.frame, &marks[0].name, m.add, m.shape.clone()))
            .flat_map(|mark| [Mark { add: !mark.add, ..mark.clone() }, mark])
            .chain(marks.iter().cloned())
            .collect();
        prop_assert_eq!(scores(undone, frame), scores(marks, frame));
    }
}

#[test]
fn more_marked_frames_than_are_kept_give_the_same_scores_in_any_order() {
    const MANY: usize = 12;
    let scene = Scene { cameras: vec![scene().cameras[0]; MANY], ..scene() };
    let canvas = Canvas { num_frames: MANY, frame_names: Vec::new(), ..canvas() };
    let outline = Shape::Box { corners_px: [[40.0, 4.0], [56.0, 16.0]] };
    let mut marks = vec![Mark::new(0, "fat", true, outline)];
    marks.extend((1..MANY - 1).map(|i| stroke(i, "liver", true, &[[8.0, 10.0], [20.0, 40.0]])));
    marks.push(stroke(5, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]));
    let marks = Marks::new(marks, &canvas).unwrap();
    let on = |frames: &[usize]| {
        let mut carried = Carried::new(&scene, Arc::new(Graph::of(&scene)), &marks, CarrySettings::default());
        let each = frames.iter().map(|f| carried.on_frame(&scene, *f, &mut |i| picture(&scene, i)).unwrap());
        each.last().unwrap()
    };
    for frame in [0, 5, 11] {
        let found = on(&[frame]);
        assert_eq!(found.scores.len(), 2, "on frame {frame}");
        assert_eq!(found, on(&[11, 3, 0, frame]), "on frame {frame}");
    }
}
