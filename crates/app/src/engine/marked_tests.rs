//! Tests of marks by hand that correct what features without classes find.

use super::{asking_tests::unlabelled_engine, *};
use surgtpgs_core::marks::{Mark, Marks, Shape};

/// Number of frames, which all look the same.
const FRAMES: usize = 3;
/// Corners of all frames.
const WHOLE: [[f32; 2]; 2] = [[0.0, 0.0], [64.0, 48.0]];

/// Opens an engine on the features of liver and fat. What is looked up in their tables from now on does not
/// change them.
fn engine(words: &[&str]) -> Engine {
    let mut engine = unlabelled_engine(&["liver", "fat"], FRAMES);
    scores(&mut engine, words);
    engine
}

/// Returns the scores of prompts on all frames, [frames][prompts].
fn scores(engine: &mut Engine, words: &[&str]) -> Vec<Vec<Grid<f32>>> {
    let words: Vec<String> = words.iter().map(|words| (*words).to_owned()).collect();
    engine.set_prompts(&words).unwrap();
    let on_frame = |frame: usize| {
        let view = engine.view(frame).unwrap();
        let images = engine.render(&view, true).unwrap();
        engine.scores(&images, &view).unwrap()
    };
    (0..FRAMES).map(on_frame).collect()
}

fn rectangle(frame: usize, name: &str, add: bool, corners_px: [[f32; 2]; 2]) -> Mark {
    Mark::new(frame, name, add, Shape::Box { corners_px })
}

fn set_marks(engine: &mut Engine, marks: &[Mark]) {
    let canvas = engine.canvas();
    engine.set_marks(Marks::new(marks.to_vec(), &canvas).unwrap()).unwrap();
}

/// Returns the number of pixels of a rectangle where something is found.
fn found_in(scores: &Grid<f32>, corners_px: [[f32; 2]; 2]) -> usize {
    let inside = Shape::Box { corners_px }.pixels(scores.width, scores.height);
    scores.data.iter().zip(&inside.data).filter(|(score, is_inside)| **is_inside && **score > 0.5).count()
}

/// Returns the number of pixels of a rectangle where the first prompt is found, on each frame.
fn each_found_in(scores: &[Vec<Grid<f32>>], corners_px: [[f32; 2]; 2]) -> Vec<usize> {
    scores.iter().map(|scores| found_in(&scores[0], corners_px)).collect()
}

/// Returns the scores of all prompts but the first.
fn others(scores: &[Vec<Grid<f32>>]) -> Vec<&[Grid<f32>]> {
    scores.iter().map(|scores| &scores[1..]).collect()
}

#[test]
fn what_is_only_denied_is_taken_away_on_all_frames_and_comes_back_with_an_undo() {
    let words = ["liver", "fat", "organ", "liver, fat"];
    let mut engine = engine(&words);
    let before = scores(&mut engine, &words);
    let denied = rectangle(0, "Liver", false, WHOLE);
    set_marks(&mut engine, std::slice::from_ref(&denied));
    assert!(engine.mark_notes().is_empty(), "a correction alone says enough");
    let after = scores(&mut engine, &words);
    let [found, left] = [&before, &after].map(|scores| each_found_in(scores, WHOLE));
    assert!(found.iter().all(|px| *px > 20) && left[0] == 0, "{found:?} {left:?}");
    assert!((1..FRAMES).all(|frame| 2 * left[frame] < found[frame]), "{found:?} {left:?}");
    assert!(others(&before) == others(&after), "no other prompt changes, to the last bit");
    // Neither marks that cancel each other nor an undo leave anything.
    for marks in [vec![denied.clone(), Mark { add: true, ..denied }], Vec::new()] {
        set_marks(&mut engine, &marks);
        assert!(scores(&mut engine, &words) == before, "{} marks", marks.len());
    }
}

#[test]
fn what_is_added_is_found_there_and_on_other_frames() {
    let (words, place) = (["liver", "fat"], [[8.0, 8.0], [40.0, 32.0]]);
    let mut engine = engine(&words);
    let before = scores(&mut engine, &words);
    set_marks(&mut engine, &[rectangle(1, "liver", true, place)]);
    let after = scores(&mut engine, &words);
    let [few, many] = [&before, &after].map(|scores| each_found_in(scores, place));
    assert!(few[1] < many[1] && many[1] == 32 * 24, "{few:?} {many:?}");
    assert!((0..FRAMES).all(|frame| few[frame] < many[frame]), "{few:?} {many:?}");
    let mut pairs = before.iter().zip(&after).flat_map(|(a, b)| a[0].data.iter().zip(&b[0].data));
    assert!(pairs.all(|(before, after)| *after > before - 1e-3), "nothing is lost elsewhere");
    assert!(others(&before) == others(&after));
}

#[test]
fn what_is_added_and_what_is_denied_both_count() {
    let (here, not_here) = ([[2.0, 2.0], [20.0, 20.0]], [[36.0, 4.0], [62.0, 44.0]]);
    let mut engine = engine(&["liver"]);
    let before = scores(&mut engine, &["liver"]);
    let marks = [(true, here), (false, not_here)].map(|(add, place)| rectangle(0, "liver", add, place));
    set_marks(&mut engine, &marks);
    let after = scores(&mut engine, &["liver"]);
    assert_eq!([here, not_here].map(|place| found_in(&after[0][0], place)), [18 * 18, 0]);
    let [found, left] = [&before, &after].map(|scores| each_found_in(scores, not_here));
    assert!((0..FRAMES).all(|frame| left[frame] < found[frame]), "{found:?} {left:?}");
}

#[test]
fn marks_correct_the_prompts_that_have_their_name() {
    let words = ["liver", "Liver ", "HEPAR", "hepatic tissue", "fat", "organ"];
    let mut engine = engine(&words);
    let before = scores(&mut engine, &words);
    set_marks(&mut engine, &[rectangle(0, "hepar", false, WHOLE)]);
    let after = scores(&mut engine, &words);
    let are_corrected: Vec<bool> = engine.asking.corrected.iter().map(|names| *names == ["hepar"]).collect();
    assert_eq!(are_corrected, [true, true, true, true, false, false]);
    for (k, words) in words.iter().enumerate() {
        let is_same = (0..FRAMES).all(|frame| before[frame][k] == after[frame][k]);
        let left = found_in(&after[0][k], WHOLE);
        assert!(if are_corrected[k] { left == 0 } else { is_same }, "{words}: {left} px");
    }
}

#[test]
fn a_sample_is_not_corrected_by_marks_of_its_name() {
    let mut engine = engine(&["liver"]);
    let view = engine.view(0).unwrap();
    let sample = (0..64).find_map(|x| engine.sample(&view, [x, 24]).unwrap());
    let negatives = Negatives::of(engine.settings());
    let question = Question { like: sample, ..Question::words("liver", negatives) };
    assert!(question.like.is_some());
    set_marks(&mut engine, &[rectangle(0, "liver", false, WHOLE)]);
    engine.set_questions(&[question]).unwrap();
    assert_eq!(engine.asking.corrected, [Vec::<String>::new()]);
}
