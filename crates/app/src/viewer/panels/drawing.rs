//! Marks on the picture: those of the shown frame, and the one that is being drawn.

use crate::viewer::{
    action::Action,
    panels::panes::PaneView,
    picture::texture::Texture,
    shared::Shared,
    state::{
        marking::{Draft, Tool},
        marks::{MarkList, canvas},
        zoom::Panes,
    },
    theme,
};
use egui::{Color32, ColorImage, Event, Painter, PointerButton, Pos2, Response, Stroke, Ui};
use surgtpgs_core::marks::{Mark, Shape};

/// Least distance of two points of an outline, px of the recording: while it is drawn, and between clicks.
const STEP_PX: f32 = 2.0;
const CORNER_PX: f32 = 4.0;
/// Least width of what an outline encloses, px, on average over half of its length.
const LEAST_WIDTH_PX: f32 = 2.0 / 3.0;
/// Message about an outline with nothing inside.
const ENCLOSES_NOTHING: &str = "This outline encloses nothing: draw around the structure";
/// Opacity of marked pixels, and of what surrounds those that are not meant.
const FILL: u8 = 0x60;
/// Width of the stripes on pixels that are not meant, px of the recording.
const STRIPE_PX: usize = 3;

/// Marks of a frame as they were painted last.
#[derive(Clone, PartialEq)]
struct Painted {
    frame: usize,
    marks: MarkList,
    colours: Vec<[u8; 3]>,
    size: [usize; 2],
}

/// The picture of the marks.
#[derive(Default)]
pub(crate) struct Drawing {
    painted: Option<(Painted, Texture)>,
}

impl Drawing {
    /// Paints the tool and the marks of the shown frame over every pane. Marks hide tissue, and are painted
    /// only while the tool is in use.
    pub(crate) fn ui(&mut self, ui: &Ui, shared: &Shared, panes: &[PaneView]) {
        let Some(frame) = shown_frame(shared).filter(|_| shared.viewport.marking.is_on) else { return };
        self.update(shared, frame);
        for pane in panes {
            let painter = ui.painter().with_clip_rect(pane.rect.intersect(ui.clip_rect()));
            if let Some((_, texture)) = &self.painted {
                texture.paint(&painter, pane.picture);
            }
            paint_tool(ui, &painter, shared, pane, frame);
        }
    }

    /// Makes the picture of the marks anew if they have changed.
    fn update(&mut self, shared: &Shared, frame: usize) {
        let Some(info) = shared.info() else { return };
        let marks = shared.marks_shown();
        let names: Vec<&str> = marks.names().into_iter().collect();
        let colours = names.iter().map(|name| shared.document.colour_of(name)).collect();
        let wanted = Painted { frame, colours, size: [info.width, info.height], marks: marks.clone() };
        if self.painted.as_ref().is_some_and(|(painted, _)| *painted == wanted) {
            return;
        }
        if marks.on(frame).next().is_none() {
            self.painted = None;
            return;
        }
        let mut image = ColorImage::filled(wanted.size, Color32::TRANSPARENT);
        for (name, colour) in names.iter().zip(&wanted.colours) {
            let own: Vec<&Mark> = marks.on(frame).filter(|mark| mark.name == *name).collect();
            paint_votes(&mut image, &votes(&own, wanted.size), theme::colour32(*colour));
        }
        self.painted = Some((wanted, Texture::new(image)));
    }
}

/// Returns the frame on the screen, if it is shown as it was recorded.
fn shown_frame(shared: &Shared) -> Option<usize> {
    let view = shared.picture()?.request.view;
    (view.orbit.is_home() && !shared.document.is_excluded(view.frame)).then_some(view.frame)
}

/// Returns for each pixel how many marks show it, less those that deny it.
fn votes(marks: &[&Mark], [width, height]: [usize; 2]) -> Vec<i32> {
    let mut votes = vec![0; width * height];
    for mark in marks {
        let pixels = mark.shape.pixels(width, height);
        let vote = if mark.add { 1 } else { -1 };
        votes.iter_mut().zip(&pixels.data).filter(|(_, is_marked)| **is_marked).for_each(|(v, _)| *v += vote);
    }
    votes
}

/// Paints pixels that are meant in a colour, and those that are not meant dark, with stripes of it.
fn paint_votes(image: &mut ColorImage, votes: &[i32], colour: Color32) {
    let [width, height] = image.size;
    let verdict = |x: usize, y: usize| votes[y * width + x].signum();
    let [r, g, b, _] = colour.to_array();
    let veil = Color32::from_rgba_unmultiplied(r, g, b, FILL);
    for y in 0..height {
        for x in 0..width {
            let own = verdict(x, y);
            if own == 0 {
                continue;
            }
            let is_border = x == 0
                || y == 0
                || x + 1 == width
                || y + 1 == height
                || [verdict(x - 1, y), verdict(x + 1, y), verdict(x, y - 1), verdict(x, y + 1)]
                    .iter()
                    .any(|other| *other != own);
            let is_stripe = ((x + y) / STRIPE_PX).is_multiple_of(3);
            image.pixels[y * width + x] = match (is_border, own > 0, is_stripe) {
                (true, ..) | (_, false, true) => colour,
                (_, true, _) => veil,
                _ => Color32::from_black_alpha(2 * FILL),
            };
        }
    }
}

/// Paints the outline being drawn, the size of the brush, and the place that is least sure.
fn paint_tool(ui: &Ui, painter: &Painter, shared: &Shared, pane: &PaneView, frame: usize) {
    let (marking, Some(info)) = (&shared.viewport.marking, shared.info()) else { return };
    let scale = pane.picture.width() / info.width.max(1) as f32;
    let on_screen = |[x, y]: [f32; 2]| pane.picture.min + scale * egui::vec2(x, y);
    if let Some(here) = shared.areas().and_then(|areas| areas.look_here_on(frame)) {
        for (width, colour) in [(5.0, theme::PLATE), (2.5, theme::AMBER)] {
            painter.circle_stroke(on_screen(here.point_px), 20.0, Stroke::new(width, colour));
        }
    }
    if let Some(Shape::Polygon { points_px }) = marking.draft_on(frame).map(|draft| &draft.mark.shape) {
        let points: Vec<Pos2> = points_px.iter().map(|p| on_screen(*p)).collect();
        for (width, colour) in [(4.0, theme::PLATE), (2.0, theme::TEXT)] {
            painter.add(egui::Shape::line(points.clone(), Stroke::new(width, colour)));
            for at in &points {
                painter.circle_filled(*at, width, colour);
            }
        }
    }
    let pointer = ui.ctx().pointer_hover_pos().filter(|at| pane.visible().contains(*at));
    if let Some(at) = pointer.filter(|_| marking.tool.has_radius()) {
        for (width, colour) in [(3.0, theme::PLATE), (1.5, theme::TEXT)] {
            painter.circle_stroke(at, (marking.radius_px * scale).max(2.0), Stroke::new(width, colour));
        }
    }
}

/// Draws with the mouse; returns `true` if the tool has it.
pub(crate) fn draw(shared: &Shared, actions: &mut Vec<Action>, panes: &Panes, response: &Response) -> bool {
    let marking = &shared.viewport.marking;
    if !marking.is_on {
        return false;
    }
    let way = Way::of(response);
    let is_dragged = response.dragged_by(PointerButton::Primary) || way.is_whole;
    let is_touched = response.clicked() || is_dragged;
    let (Some(frame), Some(info)) = (shown_frame(shared), shared.info()) else { return true };
    if is_touched && marking.plain_name().is_empty() {
        actions.push(Action::marking(|m| m.wants_name = true));
        return true;
    }
    if is_touched {
        // Keys are meant for the mark now, above all the one that undoes it.
        response.ctx.memory_mut(|memory| memory.stop_text_input());
    }
    let draft = marking.draft_on(frame);
    let size = [info.width, info.height];
    let is_denied = response.ctx.input(|i| i.modifiers.shift) == marking.adds;
    let add = draft.map_or(!is_denied, |draft| draft.mark.add);
    let name = shared.document.joined_name(&marking.plain_name());
    let made = |shape: Shape| {
        let mark = Mark::new(frame, &name, add, shape);
        Draft { fits: mark.fits(&canvas(info)), mark }
    };
    let is_stopped = response.drag_stopped_by(PointerButton::Primary);
    if is_dragged || is_stopped {
        let Some(press) = way.press else { return true };
        if draft.is_none() {
            // The mark belongs to the frame that is seen.
            actions.push(Action::GoTo(frame));
        }
        let points = press.points.iter().filter_map(|at| panes.pixel(*at, press.from, size));
        let shape = draft.map(|draft| draft.mark.shape.clone());
        let drawn = points.fold(shape, |s, to| Some(dragged(marking.tool, marking.radius_px, s, to)));
        let drawn = drawn.map(made);
        match is_stopped || way.is_whole {
            true => finish(actions, drawn.as_ref(), size),
            false => actions.push(Action::marking(move |m| m.draft = drawn)),
        }
    } else if response.clicked()
        && let Some(to) = response.interact_pointer_pos().and_then(|at| panes.pixel(at, at, size))
    {
        match clicked(marking.tool, marking.radius_px, draft, to) {
            None => {}
            Some(shape) if marking.tool == Tool::Outline => {
                // Two fast clicks on different places are two corners.
                let is_same = draft.is_some_and(|draft| draft.mark.shape == shape);
                let is_closed = response.double_clicked() && is_same;
                let draft = made(shape);
                actions.push(Action::GoTo(frame));
                match is_closed {
                    true => finish(actions, Some(&draft), size),
                    false => actions.push(Action::marking(move |m| m.draft = Some(draft))),
                }
            }
            Some(shape) => {
                actions.push(Action::GoTo(frame));
                finish(actions, Some(&made(shape)), size);
            }
        }
    }
    true
}

/// A press of the button on the picture.
#[derive(Clone)]
struct Press {
    from: Pos2,
    /// Positions of the pointer that nothing was drawn to yet, in order. The first one is that of the press.
    points: Vec<Pos2>,
}

impl Press {
    fn at(from: Pos2) -> Self {
        Self { from, points: vec![from] }
    }

    /// Hands over the positions so far, to be drawn to.
    fn hand_over(&mut self) -> Self {
        Self { from: self.from, points: std::mem::take(&mut self.points) }
    }
}

/// Way of the pointer since the last frame of the window, with all positions in between.
struct Way {
    /// The press that is drawn from, once it is no click.
    press: Option<Press>,
    /// `true` if the button was released, too, somewhere else. Where frames are slow, that may be all of a
    /// stroke, or all of it but the press, neither of which is a drag.
    is_whole: bool,
}

impl Way {
    fn of(response: &Response) -> Self {
        let (ctx, id) = (&response.ctx, response.id.with("press"));
        let mut held = ctx.data_mut(|data| data.remove_temp::<Option<Press>>(id)).flatten();
        let (events, turns) = ctx.input(|input| (input.events.clone(), input.modifiers.alt));
        let is_here = |at: Pos2| response.rect.contains(at) && ctx.layer_id_at(at) == Some(response.layer_id);
        let mut released: Option<Press> = None;
        for event in events {
            match event {
                Event::PointerMoved(at) => {
                    if let Some(press) = &mut held {
                        press.points.push(at);
                    }
                }
                Event::PointerButton { pos, button: PointerButton::Primary, pressed: true, .. } => {
                    held = (!turns && is_here(pos)).then(|| Press::at(pos));
                }
                Event::PointerButton { pos, button: PointerButton::Primary, .. } => {
                    if let Some(mut press) = held.take() {
                        press.points.push(pos);
                        released = released.or(Some(press));
                    }
                }
                _ => {}
            }
        }
        // A drag that was given up, or that something on the picture has, is none of the tool.
        let mut held = held.filter(|_| response.is_pointer_button_down_on() || released.is_some());
        let click_points = ctx.options(|options| options.input_options.max_click_dist);
        let is_far = |press: &Press| press.points.iter().any(|at| at.distance(press.from) > click_points);
        let is_whole = released.as_ref().is_some_and(is_far);
        let is_dragged = response.dragged_by(PointerButton::Primary);
        let press = released.or_else(|| held.as_mut().filter(|_| is_dragged).map(Press::hand_over));
        ctx.data_mut(|data| data.insert_temp(id, held));
        Self { press, is_whole }
    }
}

/// Makes the drawn mark one of the document, if it marks anything; says so of an outline around nothing.
fn finish(actions: &mut Vec<Action>, draft: Option<&Draft>, size: [usize; 2]) {
    let is_empty = |draft: &Draft| !draft.mark.name.is_empty() && encloses_nothing(&draft.mark.shape, size);
    if draft.is_some_and(is_empty) {
        actions.push(Action::Say(ENCLOSES_NOTHING));
    } else if let Some(mark) = draft.filter(|draft| draft.fits).map(|draft| draft.mark.clone()) {
        actions.push(Action::AddMark(mark));
    }
    actions.push(Action::marking(|m| m.draft = None));
}

/// Returns `true` for an outline around the centre of no pixel, or one that runs back beside itself. The
/// centres inside a small outline may be fewer than its area, and a line that crosses itself may enclose more
/// than that: the larger number counts.
fn encloses_nothing(shape: &Shape, [width, height]: [usize; 2]) -> bool {
    if !shape.is_outlined() {
        return false;
    }
    let count = shape.pixels(width, height).count();
    let Shape::Polygon { points_px } = shape else { return count == 0 };
    let next = points_px.iter().cycle().skip(1);
    let length_px: f32 = points_px.iter().zip(next).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
    let area_px = shape.area_px().max(count as f32);
    count == 0 || area_px < LEAST_WIDTH_PX * length_px / 2.0
}

/// Returns the shape after the mouse was dragged on to a point. A new one begins there.
fn dragged(tool: Tool, radius_px: f32, shape: Option<Shape>, to: [f32; 2]) -> Shape {
    let with = |points: Vec<[f32; 2]>, step: f32| extended(points, to, step);
    match (tool, shape) {
        (Tool::Brush, Some(Shape::Stroke { points_px, radius_px })) => {
            Shape::Stroke { points_px: with(points_px, (radius_px / 3.0).max(1.0)), radius_px }
        }
        (Tool::Brush, _) => Shape::Stroke { points_px: vec![to], radius_px },
        (Tool::Outline, Some(Shape::Polygon { points_px })) => {
            Shape::Polygon { points_px: with(points_px, STEP_PX) }
        }
        (Tool::Outline, _) => Shape::Polygon { points_px: vec![to] },
        (Tool::Box, Some(Shape::Box { corners_px: [from, _] })) => Shape::Box { corners_px: [from, to] },
        (Tool::Box, _) => Shape::Box { corners_px: [to, to] },
        (Tool::Click, _) => Shape::Click { point_px: to, radius_px },
    }
}

/// Returns the shape after a click; `None` where a click means nothing.
fn clicked(tool: Tool, radius_px: f32, draft: Option<&Draft>, at: [f32; 2]) -> Option<Shape> {
    match (tool, draft.map(|draft| &draft.mark.shape)) {
        (Tool::Brush, _) => Some(Shape::Stroke { points_px: vec![at], radius_px }),
        (Tool::Click, _) => Some(Shape::Click { point_px: at, radius_px }),
        (Tool::Outline, Some(Shape::Polygon { points_px })) => {
            let is_far = points_px.last().is_none_or(|last| distance(*last, at) >= CORNER_PX);
            let points_px = points_px.iter().copied().chain(is_far.then_some(at)).collect();
            Some(Shape::Polygon { points_px })
        }
        (Tool::Outline, _) => Some(Shape::Polygon { points_px: vec![at] }),
        (Tool::Box, _) => None,
    }
}

/// Adds a point. It takes the place of the last one if that is less than a step away from the one before, so
/// that the end is always where the mouse is.
fn extended(mut points: Vec<[f32; 2]>, to: [f32; 2], step: f32) -> Vec<[f32; 2]> {
    match &mut points[..] {
        [.., before, last] if distance(*before, *last) < step => *last = to,
        [.., last] if *last == to => {}
        _ => points.push(to),
    }
    points
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_and_its_opposite_paint_nothing() {
        let mark = |add| Mark::new(0, "fat", add, Shape::Box { corners_px: [[1.0, 1.0], [4.0, 3.0]] });
        let (this, other) = (mark(true), mark(false));
        let painted = |marks: &[&Mark]| {
            let mut image = ColorImage::filled([6, 4], Color32::TRANSPARENT);
            paint_votes(&mut image, &votes(marks, [6, 4]), Color32::RED);
            image.pixels.iter().filter(|pixel| **pixel != Color32::TRANSPARENT).count()
        };
        assert_eq!((painted(&[&this]), painted(&[&other]), painted(&[&this, &other])), (6, 6, 0));
    }

    #[test]
    fn a_straight_outline_encloses_nothing_and_a_small_one_does() {
        let around = |points: &[[f32; 2]]| Shape::Polygon { points_px: points.to_vec() };
        let from_to = |from, to| Shape::Box { corners_px: [from, to] };
        for (shape, expected) in [
            (around(&[[5.0, 5.0]]), true),
            (around(&[[5.0, 5.5], [25.0, 5.5], [15.0, 5.5]]), true),
            // Eight pixels beside a line of 40 and more.
            (around(&[[5.0, 5.0], [25.0, 5.0], [15.0, 5.8]]), true),
            (around(&[[5.0, 5.0], [7.0, 5.0], [7.0, 7.0], [5.0, 7.0]]), false),
            (around(&[[5.0, 5.0], [25.0, 5.0], [25.0, 8.0], [5.0, 8.0]]), false),
            // A corner with sides of 4 and of 3 px, around 6 and 3 centres.
            (around(&[[5.0, 5.0], [9.0, 5.0], [5.0, 9.0]]), false),
            (around(&[[5.0, 5.0], [8.0, 5.0], [5.0, 8.0]]), false),
            // A line that crosses itself, with as much to the right of it as to the left.
            (around(&[[5.0, 5.0], [15.0, 15.0], [15.0, 5.0], [5.0, 15.0]]), false),
            // Seven centres, by chance, in what is less than half a pixel high.
            (around(&[[6.4, 12.3], [19.2, 12.3], [12.9, 12.72]]), true),
            (from_to([5.0, 5.0], [25.0, 5.2]), true),
            (from_to([5.0, 5.0], [25.0, 6.0]), false),
            (Shape::Click { point_px: [5.0, 5.0], radius_px: 0.0 }, false),
        ] {
            assert_eq!(encloses_nothing(&shape, [32, 24]), expected, "{shape:?}");
        }
    }

    #[test]
    fn a_shaking_hand_moves_the_last_point() {
        let mut points = vec![[5.0, 5.0]];
        for to in [[5.5, 5.0], [5.2, 5.9], [9.0, 5.0], [9.1, 5.0]] {
            points = extended(points, to, 2.0);
        }
        assert_eq!(points, [[5.0, 5.0], [9.0, 5.0], [9.1, 5.0]]);
    }
}
