//! Obstacles of commands: each function says what is in the way in the present state, in a few words.

use crate::viewer::{
    picture::{areas::Curve, open::Open},
    shared::Shared,
    state::{
        excluded::EXCLUDED,
        view_mode::{NO_ORIGINAL, NO_RECONSTRUCTION},
    },
};

/// Reason why a command cannot be given now; `None` if it can.
pub(super) type Obstacle = Option<&'static str>;

/// Reason while areas are not known on every frame.
const COUNTING: &str = "The areas are still being counted";

pub(super) fn never(_: &Shared) -> Obstacle {
    None
}

pub(super) fn nothing_open(shared: &Shared) -> Obstacle {
    shared.open.is_none().then_some("Open a recording or a reconstruction first")
}

/// A file dialog is open.
pub(super) fn picking(shared: &Shared) -> Obstacle {
    shared.opening.picking.is_some().then_some("Answer the file dialog first")
}

pub(super) fn no_demo(shared: &Shared) -> Obstacle {
    if shared.opening.is_making_demo() {
        Some("The demo is being made")
    } else {
        shared.opening.demo_folder.is_none().then_some("There is no folder to keep the demo in")
    }
}

/// The shown recording is being reconstructed.
pub(super) fn reconstructing(shared: &Shared) -> Obstacle {
    shared.is_reconstructing().then_some("It is being reconstructed: wait, or stop that first")
}

/// No file holds the scene that is shown: it is being reconstructed, or a preview is left of that.
pub(super) fn not_in_a_file(shared: &Shared) -> Obstacle {
    let is_preview = shared.open.as_ref().is_some_and(Open::is_preview);
    let preview = is_preview.then_some("This is a preview: open the finished reconstruction");
    reconstructing(shared).or(preview)
}

/// A new reconstruction cannot be asked for.
pub(super) fn not_reconstructible(shared: &Shared) -> Obstacle {
    let Some(info) = shared.info() else { return nothing_open(shared) };
    match &info.recording {
        None => Some("The recording is not at hand"),
        Some(recording) if shared.reconstruction.is_planned(recording) => {
            Some("It is being reconstructed, or waits for it")
        }
        Some(_) if shared.opening.is_making_demo() => Some("The demo is being made"),
        Some(_) if shared.reconstruction.is_flipping() => Some("Its masks are being flipped"),
        Some(_) => {
            let is_wrong = shared.reconstruction.would_be_wrong();
            is_wrong.then_some("The check of the recording found a fault: see the panel at the right")
        }
    }
}

pub(super) fn no_reconstruction(shared: &Shared) -> Obstacle {
    let is_there = shared.info().is_some_and(|i| i.has_reconstruction);
    nothing_open(shared).or((!is_there).then_some(NO_RECONSTRUCTION))
}

/// Recorded and reconstructed frames are not both at hand.
pub(super) fn nothing_to_compare(shared: &Shared) -> Obstacle {
    let has_original = shared.info().is_some_and(|i| i.has_original);
    no_reconstruction(shared).or((!has_original).then_some(NO_ORIGINAL))
}

/// Prompts cannot be asked.
pub(super) fn no_answers(shared: &Shared) -> Obstacle {
    if shared.can_ask() {
        return None;
    }
    no_reconstruction(shared).or(Some("No words can be found in it: mark a structure by hand first"))
}

/// Prompts cannot even be typed.
pub(super) fn no_prompts(shared: &Shared) -> Obstacle {
    if shared.takes_prompts() { None } else { no_answers(shared) }
}

/// Nothing can be exported.
pub(super) fn no_export(shared: &Shared) -> Obstacle {
    let is_exporting = shared.is_exporting().then_some("Another export is running");
    nothing_open(shared).or(not_in_a_file(shared)).or(no_answers(shared)).or(is_exporting)
}

pub(super) fn no_marks(shared: &Shared) -> Obstacle {
    shared.document.marks().is_empty().then_some("Mark a structure first")
}

pub(super) fn nothing_to_undo(shared: &Shared) -> Obstacle {
    shared.document.undo_name().is_none().then_some("There is nothing to undo")
}

pub(super) fn nothing_to_redo(shared: &Shared) -> Obstacle {
    shared.document.redo_name().is_none().then_some("There is nothing to do again")
}

/// No areas are counted: prompts have no answers, or a passing state is shown.
fn no_areas(shared: &Shared) -> Obstacle {
    no_answers(shared).or(not_in_a_file(shared))
}

/// The areas of a visible prompt are not known on every frame, or no visible prompt has any. Those that have
/// no answer do not count.
pub(super) fn uncounted(shared: &Shared) -> Obstacle {
    let curves = shared.curves();
    if curves.is_empty() {
        return no_areas(shared).or(Some("No prompt is shown"));
    }
    if curves.iter().all(|(.., curve)| curve.has_no_answer()) {
        return Some("No shown prompt can be looked for");
    }
    let is_counted = curves.iter().all(|(.., curve)| curve.has_no_answer() || curve.is_complete());
    (!is_counted).then_some(COUNTING)
}

/// No picture is shown that may be seen.
pub(super) fn no_picture(shared: &Shared) -> Obstacle {
    let Some(picture) = shared.picture() else {
        return nothing_open(shared).or(Some("There is no picture yet"));
    };
    let is_left_out = shared.document.is_excluded(picture.request.view.frame);
    is_left_out.then_some(EXCLUDED)
}

/// The selected prompt is found nowhere, as far as is known.
pub(super) fn not_found(shared: &Shared) -> Obstacle {
    let curve = shared.selected_curve();
    let has_no_answer = curve.as_ref().is_some_and(Curve::has_no_answer);
    if let Some(curve) = curve.filter(|curve| curve.is_complete() && !has_no_answer) {
        return curve.first().is_none().then_some("It is found on no frame");
    }
    let selected = shared.document.selected.and_then(|id| shared.document.prompt(id));
    let missing = match selected {
        None => "Type what to find first",
        Some(_) if has_no_answer => "It cannot be looked for",
        Some(prompt) if !prompt.is_visible => "Show the selected prompt first",
        Some(_) => COUNTING,
    };
    no_areas(shared).or(Some(missing))
}

/// No place is known where one more mark would help.
pub(super) fn nowhere_to_look(shared: &Shared) -> Obstacle {
    let counts = |frame: usize| !shared.document.is_excluded(frame);
    if shared.areas().is_some_and(|areas| areas.knows_where_to_look(counts)) {
        return None;
    }
    let not_yet = no_reconstruction(shared).or(reconstructing(shared)).or(no_marks(shared));
    not_yet.or_else(|| uncounted(shared)).or_else(|| nothing_unsure(shared))
}

/// All frames that count were looked at, and none has a place where one more mark would help.
fn nothing_unsure(shared: &Shared) -> Obstacle {
    let info = shared.info()?;
    let marked = shared.document.marks().frames();
    let counts = |frame: &usize| !shared.document.is_excluded(*frame) && !info.is_unlearned(*frame);
    let are_all_marked = (0..info.num_frames).filter(counts).all(|frame| marked.contains(&frame));
    Some(if are_all_marked {
        "Every frame is marked already"
    } else {
        "Nothing is unsure: all that is marked is a known class"
    })
}

/// Returns `true` if the frame that is seen has a bookmark.
fn is_bookmarked(shared: &Shared) -> bool {
    let frame = shared.seen_frame();
    shared.document.bookmarks().iter().any(|b| b.frame == frame)
}

/// The frame that is seen has a bookmark.
pub(super) fn bookmarked(shared: &Shared) -> Obstacle {
    is_bookmarked(shared).then_some("This frame has a bookmark already")
}

/// The frame that is seen has no bookmark.
pub(super) fn not_bookmarked(shared: &Shared) -> Obstacle {
    (!is_bookmarked(shared)).then_some("This frame has no bookmark")
}

pub(super) fn no_bookmarks(shared: &Shared) -> Obstacle {
    shared.document.bookmarks().is_empty().then_some("There is no bookmark yet")
}

/// The time bar shows the whole recording.
pub(super) fn no_span(shared: &Shared) -> Obstacle {
    shared.viewport.span.is_none().then_some("The time bar shows the whole recording")
}
