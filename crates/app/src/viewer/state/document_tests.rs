//! Tests of edits, and of undo as their inverse.

use crate::viewer::state::{content::Content, document::Document};
use proptest::prelude::*;
use std::collections::BTreeSet;
use surgtpgs_core::{
    grid::Grid,
    marks::{Mark, Shape},
    mask::CleanUp,
    overlay::OverlayLook,
};

fn document(prompts: &[&str]) -> Document {
    let mut document = Document::new(OverlayLook::default(), 0.4);
    prompts.iter().for_each(|p| document.add(p));
    document
}

#[test]
fn the_same_words_are_added_once_and_empty_ones_never() {
    let mut document = document(&["gallbladder", "  ", " Gallbladder "]);
    assert_eq!(document.prompts().len(), 1);
    document.toggle_visible(0);
    document.add("gallbladder");
    assert!(document.prompts()[0].is_visible);
}

#[test]
fn deleting_recolours_nobody_and_frees_the_colour() {
    let mut document = document(&["liver", "fat", "grasper"]);
    let colours: Vec<_> = document.prompts().iter().map(|p| p.colour).collect();
    assert!(colours[0] != colours[1] && colours[1] != colours[2] && colours[0] != colours[2]);
    document.remove(document.prompts()[1].id);
    assert_eq!([document.prompts()[0].colour, document.prompts()[1].colour], [colours[0], colours[2]]);
    assert_eq!(document.next_colour(), colours[1]);
}

#[test]
fn no_two_of_many_prompts_have_one_colour() {
    let mut document = document(&[]);
    (0..20).for_each(|k| document.add(&format!("structure {k}")));
    let colours: BTreeSet<[u8; 3]> = document.prompts().iter().map(|p| p.colour).collect();
    assert_eq!(colours.len(), 20);
    let third = document.prompts()[2].clone();
    document.remove(third.id);
    assert_eq!(document.next_colour(), third.colour, "the palette goes first");
}

#[test]
fn dragging_a_threshold_is_one_edit_until_the_mouse_is_let_go() {
    let mut document = document(&["liver"]);
    let id = document.prompts()[0].id;
    document.set_threshold(id, 0.5);
    document.set_threshold(id, 0.6);
    document.end_gesture();
    document.set_threshold(id, 7.0);
    assert_eq!(document.prompts()[0].threshold, 1.0);
    document.undo();
    assert_eq!(document.prompts()[0].threshold, 0.6);
    document.undo();
    assert_eq!(document.prompts()[0].threshold, 0.4);
}

#[test]
fn solo_again_shows_all() {
    let mut document = document(&["liver", "fat", "grasper"]);
    document.solo(1);
    assert_eq!(document.prompts().iter().map(|p| p.is_visible).collect::<Vec<_>>(), [false, true, false]);
    document.solo(1);
    assert!(document.prompts().iter().all(|p| p.is_visible));
}

#[test]
fn renaming_keeps_colour_and_threshold_and_refuses_what_would_be_double() {
    let mut document = document(&["liver", "fat"]);
    let before = document.prompts()[0].clone();
    document.rename(before.id, "FAT");
    document.rename(before.id, "   ");
    assert_eq!(document.prompts()[0], before);
    document.rename(before.id, " left liver ");
    assert_eq!(document.undo_name(), Some("changing \"liver\" to \"left liver\""));
    let after = document.prompts()[0].clone();
    assert_eq!((after.text.as_str(), after.colour, after.id), ("left liver", before.colour, before.id));
    document.rename(before.id, "Left Liver");
    assert_eq!(document.prompts()[0].text, "Left Liver", "only the case");
}

#[test]
fn the_first_and_the_last_prompt_can_be_moved_no_further() {
    let mut document = document(&["liver", "fat", "grasper"]);
    let words = |d: &Document| d.prompts().iter().map(|p| p.text.clone()).collect::<Vec<_>>();
    let [liver, grasper] = [0, 2].map(|i| document.prompts()[i].id);
    document.reorder(liver, -1);
    document.reorder(grasper, 1);
    assert_eq!(words(&document), ["liver", "fat", "grasper"]);
    document.reorder(grasper, -1);
    assert_eq!(words(&document), ["liver", "grasper", "fat"]);
}

#[test]
fn undoing_a_return_to_the_endoscope_looks_around_again_and_other_undos_leave_the_view_alone() {
    let mut document = document(&["liver"]);
    document.look.orbit = document.look.orbit.dragged([50.0, 0.0], 15.0);
    let turned = document.look;
    document.reset_look();
    document.undo();
    assert_eq!(document.look, turned);
    document.undo();
    assert_eq!((document.look, document.prompts().len()), (turned, 0));
    document.redo();
    document.redo();
    assert!(document.look.orbit.is_home());
}

#[test]
fn what_a_file_says_is_mended_to_what_is_possible() {
    let text = r#"{"prompts": [{"text": "liver", "colour": [1, 2, 3], "is_visible": true, "threshold": 7.0},
                               {"text": " ", "colour": [1, 2, 3], "is_visible": true, "threshold": 0.4}],
                   "bookmarks": [{"frame": 9}, {"frame": 2}, {"frame": 2}, {"frame": 99}], "range": [5, 99]}"#;
    let mut document = document(&["fat"]);
    document.load(serde_json::from_str(text).unwrap(), 10);
    assert_eq!(document.prompts().iter().map(|p| p.threshold).collect::<Vec<_>>(), [1.0]);
    assert_ne!(document.prompts()[0].id, 0, "the preview's own");
    assert_eq!(document.content().bookmarks.iter().map(|b| b.frame).collect::<Vec<_>>(), [2, 9]);
    assert_eq!((document.content().range, document.undo_name()), (None, None));
}

#[test]
fn what_belongs_to_frames_is_not_taken_to_another_recording() {
    let mut document = document(&["liver"]);
    document.toggle_bookmark(3);
    document.set_range(Some((1, 2)));
    document.start_recording(CleanUp::default());
    assert!(document.content().is_alike(&Content::default()));
    assert_eq!((document.selected, document.undo_name()), (None, None));
}

/// Makes a mark of one of all kinds, on one of a few frames; `number` chooses which. Two of the names are
/// one, and one is also given to prompts by [`apply`].
fn mark(number: usize) -> Mark {
    let (x, y) = ((number % 9) as f32, (number % 6) as f32);
    let shape = match number % 5 {
        0 => Shape::Click { point_px: [x, y], radius_px: 2.0 },
        1 => Shape::Stroke { points_px: vec![[x, y], [x + 3.0, y]], radius_px: 1.5 },
        2 => Shape::Polygon { points_px: vec![[x, y], [x + 4.0, y], [x, y + 5.0]] },
        3 => Shape::Box { corners_px: [[x, y], [x + 2.0, y + 2.0]] },
        _ => Shape::from(&Grid::from_vec(2, 1, vec![true, number.is_multiple_of(2)])),
    };
    let name = ["liver", "cystic duct", "Cysticduct", "vein", "other words 3"][number / 5 % 5];
    Mark::new(number % 7, name, !number.is_multiple_of(3), shape)
}

/// Applies one of the edits that a user can make; `number` chooses its target.
fn apply(document: &mut Document, (what, number): (u8, usize)) {
    let id = document.prompts().get(number % document.prompts().len().max(1)).map_or(0, |p| p.id);
    let index = number % 5;
    match what {
        0 => document.add(["liver", "fat", "grasper", "bile", "gallbladder", "tie"][number % 6]),
        1 => document.remove(id),
        2 => document.toggle_visible(index),
        3 => document.solo(index),
        4 => document.set_threshold(id, number as f32 / 100.0),
        5 => document.set_colour(id, [number as u8, 0, 0]),
        6 => document.rename(id, &format!("other words {}", number % 7)),
        7 => document.reorder(id, number as isize % 3 - 1),
        8 => document.toggle_bookmark(number % 20),
        9 => document.set_note(number % 20, &format!("note {}", number % 3)),
        10 => document.toggle_flag(number % 20),
        11 => document.set_range((!number.is_multiple_of(3)).then_some((number % 10, 10 + number % 10))),
        12 => document.look.orbit = document.look.orbit.dragged([number as f32, 5.0], 15.0),
        13 => document.reset_look(),
        14 => document.add_mark(mark(number)),
        15 => {
            let marks = [number, number + 7, number + 11].map(mark);
            document.add_marks(|count| format!("opening {count} marks"), marks.to_vec());
        }
        16 => document.clear_marks(number % 7),
        _ => document.end_gesture(),
    }
}

proptest! {
    #[test]
    fn undo_is_the_inverse_of_every_edit_and_redo_of_undo(
        steps in proptest::collection::vec((0_u8..18, 0_usize..100), 1..60)
    ) {
        let mut document = document(&[]);
        for step in steps {
            document.end_gesture();
            let before: (Content, _) = (document.content().clone(), document.look);
            let revision = document.revision();
            apply(&mut document, step);
            let after = (document.content().clone(), document.look);
            let is_view_alone = step.0 == 12;
            if before != after && !is_view_alone {
                document.undo();
                prop_assert_eq!(&(document.content().clone(), document.look), &before);
                document.redo();
                prop_assert_eq!(&(document.content().clone(), document.look), &after);
            }
            prop_assert!(before.0 == after.0 || document.revision() > revision, "a change that nobody would save");
            let has_prompt = |name: &str| document.prompts().iter().any(|p| p.is_marked_as(name));
            prop_assert!(document.marks().names().into_iter().all(has_prompt), "a mark without its prompt");
        }
        let end = document.content().clone();
        let mut steps = 0;
        while document.undo_name().is_some() {
            document.undo();
            steps += 1;
        }
        prop_assert_eq!(document.content(), &Content::default());
        (0..steps).for_each(|_| document.redo());
        prop_assert_eq!(document.content(), &end);
    }
}
