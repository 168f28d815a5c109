//! Marks in scenes of chapters.

use super::{
    tests::{SIZE, canvas, picture, scene, stroke},
    *,
};
use crate::{codec::Codec, grid::Mask, scene::Scene, sequence::Class};
use std::ops::Range;

/// The wall as a scene of chapters, each with the frames that it shows and learned.
fn in_chapters<const N: usize>(ranges: [(Range<usize>, Range<usize>); N]) -> Scene {
    let num_frames = ranges[N - 1].0.end;
    let parts = ranges.into_iter().enumerate().map(|(index, (shown, learned))| {
        let mut part = scene();
        part.cameras = vec![part.cameras[0]; num_frames];
        let chapter = crate::scene::Chapter { index, count: N, shown, learned };
        part.provenance.settings = serde_json::json!({ "chapter": chapter });
        part.as_chapter()
    });
    parts.fold(None, |earlier, part| Some(Scene::joined(earlier, part))).unwrap()
}

/// Strokes on the two sides of the wall in the first frame.
fn liver_and_fat() -> Vec<Mark> {
    vec![
        stroke(0, "liver", true, &[[8.0, 10.0], [20.0, 40.0]]),
        stroke(0, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]),
    ]
}

#[test]
fn marks_reach_the_next_chapter_as_masks_and_are_redetected_beyond_a_cut() {
    let marks = Marks::new(liver_and_fat(), &canvas()).unwrap();
    // Frame 2 belongs to the second chapter alone, so that a cut parts the third.
    let chapters = in_chapters([(0..2, 0..3), (2..3, 1..3), (3..4, 3..4)]);
    let mut chapter_marks = ChapterMarks::new(&marks);
    // The third shot may show another place, in another light.
    let in_chapter = |chapter_marks: &mut ChapterMarks, index: usize, light: [u8; 3]| {
        let scene = chapters.of_chapter(index).unwrap();
        let mut pictures = |i| {
            let mut picture = picture(&scene, i)?;
            if i == 3 {
                picture.pixels_mut().for_each(|p| p.0 = std::array::from_fn(|c| p.0[c].max(light[c])));
            }
            Ok(picture)
        };
        chapter_marks.marks(&scene, &mut pictures).unwrap()
    };
    assert_eq!(in_chapter(&mut chapter_marks, 0, [0; 3]), marks);
    let next = in_chapter(&mut chapter_marks, 1, [0; 3]);
    assert_eq!((next.frames(), next.names()), (vec![2], marks.names()));
    let far = in_chapter(&mut chapter_marks.clone(), 2, [0; 3]);
    assert_eq!((far.frames(), far.names()), (vec![3], marks.names()));
    for found in [next, far] {
        let shown = |name: &str, add: bool| {
            let mark = found.all().iter().find(|mark| mark.name == name && mark.add == add).unwrap();
            mark.shape.pixels(SIZE[0], SIZE[1])
        };
        let liver = shown("liver", true);
        assert!(liver.at(12, 20) && !liver.at(56, 20));
        assert!(shown("fat", true).at(56, 20) && shown("fat", false).at(12, 20));
    }
    assert!(in_chapter(&mut chapter_marks, 2, [20, 30, 250]).is_empty(), "another place");
    let whole = scene();
    let mut chapter_marks = ChapterMarks::new(&marks);
    assert_eq!(chapter_marks.marks(&whole, &mut |i| picture(&whole, i)).unwrap(), marks);
}

#[test]
fn marks_reach_a_chapter_from_both_sides() {
    let chapters = in_chapters([(0..2, 0..3), (2..4, 1..5), (4..6, 3..6)]);
    let canvas = Canvas { num_frames: 6, frame_names: Vec::new(), ..canvas() };
    let liver = stroke(0, "liver", true, &[[8.0, 10.0], [20.0, 40.0]]);
    let fat = stroke(5, "fat", true, &[[50.0, 10.0], [44.0, 40.0]]);
    let marks = Marks::new(vec![liver.clone(), fat.clone()], &canvas).unwrap();
    // Returns the marks of a chapter, and the frames that were looked at for them.
    let of = |chapter_marks: &mut ChapterMarks, index: usize| {
        let scene = chapters.of_chapter(index).unwrap();
        let mut frames = Vec::new();
        let mut pictures = |i| {
            frames.push(i);
            picture(&scene, i)
        };
        let found = chapter_marks.marks(&scene, &mut pictures).unwrap();
        (found, frames)
    };
    let mut chapter_marks = ChapterMarks::new(&marks);
    for (index, by_hand) in [(0, vec!["liver"]), (1, vec![]), (2, vec!["fat"])] {
        let (found, _) = of(&mut chapter_marks, index);
        assert_eq!(found.names(), marks.names());
        for name in ["liver", "fat"] {
            let mut shown = found.all().iter().filter(|mark| mark.name == name && mark.add);
            assert!(
                shown.any(|mark| mark.shape.is_outlined() != by_hand.contains(&name)),
                "{name} in {index}"
            );
        }
    }
    // Another mark at the end leaves what came from the beginning, and not what it may change.
    let more = Marks::new(vec![liver, fat, stroke(5, "fat", true, &[[60.0, 8.0]])], &canvas).unwrap();
    let mut chapter_marks = chapter_marks.for_marks(&chapters, &more);
    assert!(of(&mut chapter_marks, 2).1.is_empty(), "it is known already");
    assert!(!of(&mut chapter_marks, 0).1.is_empty());
}

#[test]
fn what_a_name_is_not_in_another_chapter_takes_nothing_away() {
    let chapters = in_chapters([(0..2, 0..3), (2..4, 1..5), (4..6, 3..6)]);
    let canvas = Canvas { num_frames: 6, frame_names: Vec::new(), ..canvas() };
    let mut marks = liver_and_fat();
    marks.push(stroke(3, "liver", false, &[[60.0, 8.0], [60.0, 12.0]]));
    let marks_in = |marks: &[Mark], index: usize| {
        let scene = chapters.of_chapter(index).unwrap();
        let mut chapter_marks = ChapterMarks::new(&Marks::new(marks.to_vec(), &canvas).unwrap());
        chapter_marks.marks(&scene, &mut |i| picture(&scene, i)).unwrap()
    };
    let shows = |marks: &Marks, name: &str| marks.all().iter().any(|mark| mark.add && mark.name == name);
    for index in [1, 2] {
        let found = marks_in(&marks, index);
        assert!(shows(&found, "liver") && shows(&found, "fat"), "{index}: {:?}", found.names());
    }
    // What is denied alone is shown nowhere.
    marks.remove(0);
    for index in [0, 1, 2] {
        assert!(!shows(&marks_in(&marks, index), "liver"));
    }
}

#[test]
fn corrections_of_what_the_scene_finds_stay_in_their_chapter() {
    let mut chapters = in_chapters([(0..2, 0..3), (2..4, 1..5), (4..6, 3..6)]);
    chapters.codec = Some(Codec { encoder: Vec::new(), decoder: Vec::new() });
    chapters.classes = vec![(Class { id: 1, name: "liver".into(), colour: [0; 3] }, vec![1.0])];
    let canvas = Canvas { num_frames: 6, frame_names: Vec::new(), ..canvas() };
    let mut marks = liver_and_fat();
    marks[0].add = false;
    let mut chapter_marks = ChapterMarks::new(&Marks::new(marks.clone(), &canvas).unwrap());
    let scene = chapters.of_chapter(1).unwrap();
    assert!(scene.finds("liver") && !scene.finds("fat"));
    let found = chapter_marks.marks(&scene, &mut |i| picture(&scene, i)).unwrap();
    assert_eq!(found.names(), ["fat"]);
    // Marks by hand alone correct, not what outlines deny.
    let correcting = |chapters: &Scene, index: usize| {
        let outline = Mark::new(0, "fat", true, Shape::Box { corners_px: [[40.0, 4.0], [56.0, 16.0]] });
        let marks = Marks::new(vec![outline, marks[0].clone()], &canvas).unwrap();
        ChapterMarks::new(&marks).correcting(&chapters.of_chapter(index).unwrap())
    };
    assert_eq!([0, 1].map(|index| correcting(&chapters, index).names()), [vec!["liver".to_owned()], vec![]]);
    // Without a list of classes, words are found, whatever they are.
    chapters.classes.clear();
    let here = correcting(&chapters, 0);
    assert_eq!((here.names(), here.standing().count()), (vec!["fat".to_owned(), "liver".to_owned()], 2));
    assert!(correcting(&chapters, 2).is_empty());
    chapters.codec = None;
    assert!(correcting(&chapters, 0).is_empty(), "without features there is nothing to correct");
}

#[test]
fn a_chapter_far_away_waits_for_few_others() {
    const N: usize = 20;
    let chapters =
        in_chapters::<N>(std::array::from_fn(|k| (2 * k..2 * k + 2, (2 * k).saturating_sub(1)..2 * k + 3)));
    let canvas = Canvas { num_frames: 2 * N, frame_names: Vec::new(), ..canvas() };
    let mut chapter_marks = ChapterMarks::new(&Marks::new(liver_and_fat(), &canvas).unwrap());
    let scene = chapters.of_chapter(N - 1).unwrap();
    let mut frames = std::collections::BTreeSet::new();
    let mut pictures = |i| {
        frames.insert(i);
        picture(&scene, i)
    };
    let found = chapter_marks.marks(&scene, &mut pictures).unwrap();
    assert_eq!(found.names(), ["fat", "liver"]);
    // The marked frame, and those from the sixteenth chapter on.
    assert!(frames.first() == Some(&0) && frames.iter().skip(1).all(|frame| *frame >= 31), "{frames:?}");
}

#[test]
fn names_that_left_the_view_are_redetected_by_their_appearance() {
    let strokes = vec![
        stroke(0, "liver", true, &[[6.0, 10.0], [12.0, 40.0]]),
        stroke(0, "fat", true, &[[58.0, 10.0], [52.0, 40.0]]),
        stroke(0, "clip", true, &[[24.0, 20.0], [26.0, 26.0]]),
    ];
    let (scene, marks) = (scene(), Marks::new(strokes, &canvas()).unwrap());
    // A blue clip is seen at first, and later elsewhere.
    let pictures = |i: usize, clip: Option<[u32; 2]>| {
        let mut picture = picture(&scene, i)?;
        if let Some([left, top]) = clip {
            let pixels = (0..16 * 16).map(|k| (left + k % 16, top + k / 16));
            pixels.for_each(|(x, y)| picture.put_pixel(x, y, image::Rgb([40, 60, 220])));
        }
        Ok(picture)
    };
    let by_hand = redetect::ByHand { scene: &scene, all: &marks, source_marks: &marks };
    let (mut examples, clip) = (redetect::Examples::default(), ["clip".to_owned()]);
    let mut found = |later: [u32; 2]| {
        let seen = |i: usize| if i == 0 { Some([18, 14]) } else { Some(later).filter(|_| i == 3) };
        let mut pictures = |i: usize| pictures(i, seen(i));
        examples.redetect(&clip, by_hand, &(1..4), &mut pictures).unwrap()
    };
    let back = found([22, 20]);
    let [mark, not] = &back[..] else { panic!("{} marks", back.len()) };
    let not = (not.frame, not.add, not.shape.pixels(SIZE[0], SIZE[1]));
    let pixels = mark.shape.pixels(SIZE[0], SIZE[1]);
    let is_clip = |i: usize| (22..38).contains(&(i % SIZE[0])) && (20..36).contains(&(i / SIZE[0]));
    let right = (0..pixels.data.len()).filter(|i| pixels.data[*i] && is_clip(*i)).count();
    assert_eq!((mark.frame, mark.add, mark.name.as_str()), (3, true, "clip"));
    assert!(right == pixels.count() && right > 100, "{right} of {}", pixels.count());
    assert!((not.0, not.1) == (3, false) && not.2.count() > 1000, "{not:?}");
    assert!((0..pixels.data.len()).all(|i| !(not.2.data[i] && is_clip(i))));
    // A mask of a name that has all but left the view is dropped.
    let mut kept = |pixels: usize| {
        let mask = Mask::from_vec(SIZE[0], SIZE[1], (0..SIZE[0] * SIZE[1]).map(|i| i < pixels).collect());
        let mark = Mark::new(1, "clip", true, Shape::from(&mask));
        let mut pictures = |i: usize| pictures(i, Some([18, 14]));
        let kept = examples.drop_vanished(vec![mark], by_hand, &(1..4), &mut pictures);
        kept.unwrap().len()
    };
    assert_eq!([kept(3), kept(60)], [0, 1]);
    let nowhere = redetect::Examples::default()
        .redetect(&clip, by_hand, &(1..4), &mut |i| pictures(i, Some([18, 14]).filter(|_| i == 0)));
    assert!(nowhere.unwrap().is_empty());
}
