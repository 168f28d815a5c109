//! Legend of the overlay: one line per prompt, tags at what was found, colour scales.

use crate::viewer::{
    panels::{marking::FOUND_WHEN_READY, plates::Plates, prompts::nothing_here, widgets::swatch},
    picture::{
        difference::difference_colour,
        found::Found,
        layer_colours::layer_colour,
        notes::Scale,
        request::{AskedPrompt, Finding},
    },
    shared::Shared,
    state::{content::PREVIEW, view_mode::ViewMode},
    text::percent,
    theme,
};
use egui::{
    Align2, Color32, Galley, Painter, Rect, Ui, pos2,
    text::{LayoutJob, TextWrapping},
    vec2,
};
use std::sync::Arc;
use surgtpgs_core::palette::Palette;

/// Shows the legend in the lower left corner and the tags on the pictures.
pub(crate) fn legend_ui(
    ui: &mut Ui,
    shared: &Shared,
    area: Rect,
    panes: &[(Rect, Rect)],
    plates: &mut Plates,
) {
    match shared.document.mode {
        ViewMode::Depth | ViewMode::Motion | ViewMode::Opacity => {
            return layer_scale(ui, shared, area, plates);
        }
        ViewMode::DepthBeside => {
            if let Some((pane, picture)) = panes.last() {
                layer_scale(ui, shared, pane.intersect(*picture), plates);
            }
        }
        ViewMode::Difference => return difference_scale(ui, area, plates),
        _ => {}
    }
    let lines = lines(shared);
    paint_lines(ui.painter(), &lines, area, plates);
    if let Some(words) = shared.clean_up_words().filter(|_| !lines.is_empty()) {
        plates.text(ui.painter(), area, Align2::LEFT_BOTTOM, &words, theme::AMBER);
    }
    if shared.document.overlay.style.shows_scores() && !lines.is_empty() {
        heat_scale(ui, shared.document.overlay.palette, area, plates);
    }
    for (pane, picture) in panes {
        let painter = ui.painter().with_clip_rect(*pane);
        lines.iter().for_each(|line| tag(&painter, line, *picture, *pane, plates));
    }
}

struct Line<'a> {
    number: String,
    text: String,
    value: String,
    colour: [u8; 3],
    threshold: f32,
    found: Option<&'a Found>,
}

/// Returns one line per prompt of the shown picture.
fn lines(shared: &Shared) -> Vec<Line<'_>> {
    let Some(picture) = shared.picture() else { return Vec::new() };
    let line = |prompt: &AskedPrompt| {
        let number = shared.document.prompts().iter().position(|p| p.id == prompt.id);
        let finding = picture.findings.iter().find(|f| f.id == prompt.id);
        let found = finding.and_then(|f| f.outcome.as_ref().ok());
        let value = finding.map_or_else(|| NO_ANSWER.to_owned(), |finding| value(shared, prompt, finding));
        let text = match finding.and_then(|f| f.stand_in(prompt)) {
            Some(class) => format!("{class} (asked: {})", prompt.question.text),
            None => prompt.question.text.clone(),
        };
        Line {
            number: if prompt.id == PREVIEW {
                String::new()
            } else {
                number.map_or(String::new(), |n| (n + 1).to_string())
            },
            text,
            value,
            colour: prompt.colour,
            threshold: prompt.threshold,
            found,
        }
    };
    picture.request.prompts.iter().map(line).collect()
}

/// Message of a prompt that cannot be answered.
const NO_ANSWER: &str = "no answer";

/// Says what a prompt found in the shown picture, or why it found nothing, in a few words.
pub(crate) fn value(shared: &Shared, asked: &AskedPrompt, finding: &Finding) -> String {
    let Ok(found) = &finding.outcome else { return NO_ANSWER.into() };
    if found.area_px > 0 {
        return format!("{} of the picture", percent(found.area_fraction));
    }
    if shared.document.prompt(asked.id).is_some_and(|prompt| shared.waits_as_marked(prompt)) {
        return FOUND_WHEN_READY.into();
    }
    let answer = finding.answer.as_ref().filter(|answer| !answer.may_be_found(asked.threshold));
    answer.map_or_else(|| nothing_here(shared).to_lowercase(), |answer| answer.absence.in_short().into())
}

/// Paints the number of a prompt on what it found, so that colour is not the only difference between prompts.
/// It goes to the side of a text that is in its way, as far as that was found, too, or is left out.
fn tag(painter: &Painter, line: &Line<'_>, picture: Rect, pane: Rect, plates: &mut Plates) {
    let Some((found, [u, v])) = line.found.and_then(|f| Some((f, f.anchor?))) else { return };
    let at = picture.min + vec2(u, v) * picture.size();
    let rect = |k: i32| Rect::from_center_size(at + vec2(24.0 * k as f32, 0.0), vec2(20.0, 20.0));
    let is_free = |rect: &Rect| {
        let place = (rect.center() - picture.min) / picture.size();
        let is_found = rect.center() == at || found.is_found_at(place.into(), line.threshold);
        is_found && pane.contains_rect(rect.expand(2.0)) && plates.is_free(rect.expand(2.0))
    };
    let Some(rect) = [0, 1, -1, 2, -2, 3, -3].into_iter().map(rect).find(is_free) else { return };
    plates.take(rect.expand(2.0));
    painter.rect_filled(rect.expand(2.0), 5.0, theme::PLATE);
    swatch(painter, rect, line.colour, &line.number);
}

/// Share of the picture that the lines cover at most; on a smaller picture they are set smaller.
const LARGEST_SHARE: f32 = 0.3;

/// Size of the lines.
#[derive(Clone, Copy)]
struct LineSize {
    height: f32,
    font: f32,
    /// `true` to give the area of what was found, too.
    has_area: bool,
}

impl LineSize {
    const USUAL: Self = Self { height: 24.0, font: 14.5, has_area: true };
    const SMALL: Self = Self { height: 18.0, font: 11.5, has_area: false };

    /// Returns the room to the left of the words.
    fn indent(self) -> f32 {
        self.height + 11.0
    }

    /// Lays out the words of a line: the name, cut short where it is too long, and the value where both fit.
    fn words(self, painter: &Painter, line: &Line<'_>, room: f32) -> Arc<Galley> {
        let job = |text: String| {
            LayoutJob::simple_singleline(text, egui::FontId::proportional(self.font), theme::TEXT)
        };
        let (name, is_found) = (shortened(&line.text), line.found.is_some_and(|found| found.area_px > 0));
        if self.has_area || !is_found {
            let both = painter.layout_job(job(format!("{name}   {}", line.value)));
            if both.size().x <= room {
                return both;
            }
        }
        let wrap = TextWrapping::truncate_at_width(room);
        painter.layout_job(LayoutJob { wrap, ..job(name) })
    }
}

/// Lines that are laid out, with the rectangle that each takes, from the upper left corner of all.
struct LaidOut {
    size: LineSize,
    rows: Vec<(Arc<Galley>, Rect)>,
}

impl LaidOut {
    /// Lays out as many lines as there is room for.
    fn new(size: LineSize, painter: &Painter, lines: &[Line<'_>], area: Rect) -> Self {
        let fitting = ((area.height() * 0.6) / size.height) as usize;
        let room = (area.width() - size.indent() - 31.0).max(20.0);
        let row = |(i, line): (usize, &Line<'_>)| {
            let words = size.words(painter, line, room);
            let at = pos2(0.0, i as f32 * size.height);
            let plate = Rect::from_min_size(at, vec2(words.size().x + size.indent() + 11.0, size.height));
            (words, plate)
        };
        Self { size, rows: lines.iter().take(fitting).enumerate().map(row).collect() }
    }

    /// Returns what the lines cover, points².
    fn covered(&self) -> f32 {
        self.rows.iter().map(|(_, plate)| plate.area()).sum()
    }

    fn bounds(&self) -> Option<Rect> {
        self.rows.iter().map(|(_, plate)| *plate).reduce(Rect::union)
    }
}

/// Paints the lines in the lower left corner. Each has a plate of its own, so that a long one hides no more
/// of the picture than its words.
fn paint_lines(painter: &Painter, lines: &[Line<'_>], area: Rect, plates: &mut Plates) {
    let mut laid_out = LaidOut::new(LineSize::USUAL, painter, lines, area);
    if laid_out.covered() > LARGEST_SHARE * area.area() {
        laid_out = LaidOut::new(LineSize::SMALL, painter, lines, area);
    }
    let place = laid_out.bounds().and_then(|bounds| plates.place(area, Align2::LEFT_BOTTOM, bounds.size()));
    let Some(place) = place else { return };
    let size = laid_out.size;
    for (line, (words, plate)) in lines.iter().zip(laid_out.rows) {
        let plate = plate.translate(place.min.to_vec2());
        painter.rect_filled(plate, 6.0, theme::PLATE);
        let (y, side) = (plate.center().y, size.height - 6.0);
        let mark = Rect::from_center_size(pos2(plate.left() + 9.0 + 0.5 * side, y), vec2(side, side));
        swatch(painter, mark, line.colour, &line.number);
        painter.galley(pos2(plate.left() + size.indent(), y - words.size().y / 2.0), words, theme::TEXT);
    }
}

pub(crate) fn shortened(text: &str) -> String {
    const LONGEST: usize = 40;
    if text.chars().count() <= LONGEST {
        text.to_owned()
    } else {
        text.chars().take(LONGEST - 1).chain(['…']).collect()
    }
}

/// Paints the colour scale of the heatmap.
fn heat_scale(ui: &Ui, palette: Palette, area: Rect, plates: &mut Plates) {
    let captions = [("0", 0.0), ("0.5", 0.5), ("1", 1.0)];
    scale(ui.painter(), area, plates, 180.0, &captions, "similarity score, fixed scale", |bar| {
        paint_ramp(ui.painter(), bar, |share| theme::colour32(palette.colour(share).map(|v| v as u8)));
    });
}

fn difference_scale(ui: &Ui, area: Rect, plates: &mut Plates) {
    let Scale { title, ends: [first, last], .. } = Scale::of_difference();
    let ends = [(first.as_str(), 0.0), (last.as_str(), 1.0)];
    scale(ui.painter(), area, plates, 260.0, &ends, title, |bar| {
        paint_ramp(ui.painter(), bar, difference_colour);
    });
}

fn paint_ramp(painter: &Painter, bar: Rect, colour: impl Fn(f32) -> Color32) {
    for x in 0..bar.width() as usize {
        let at = bar.left() + x as f32 + 0.5;
        painter.vline(at, bar.y_range(), (1.5, colour(x as f32 / bar.width())));
    }
}

fn layer_scale(ui: &Ui, shared: &Shared, area: Rect, plates: &mut Plates) {
    let Some(pane) = shared.picture().and_then(|p| p.layer.as_ref()) else { return };
    let is_known = shared.info().is_some_and(|i| !i.shape_is_guessed());
    let Scale { title, ends: [first, last], .. } = Scale::of_layer(pane, is_known);
    let ends = [(first.as_str(), 0.0), (last.as_str(), 1.0)];
    scale(ui.painter(), area, plates, 280.0, &ends, title, |bar| {
        paint_ramp(ui.painter(), bar, |share| layer_colour(pane.layer, share));
    });
    if !pane.note.is_empty() {
        plates.text(ui.painter(), area, Align2::LEFT_BOTTOM, &pane.note, theme::TEXT);
    }
}

/// Paints a bar with captions on a dark plate in the lower left corner.
fn scale(
    painter: &Painter,
    area: Rect,
    plates: &mut Plates,
    width: f32,
    captions: &[(&str, f32)],
    title: &str,
    paint_bar: impl FnOnce(Rect),
) {
    let font = egui::FontId::proportional(12.5);
    let width = width.min(area.width() - 16.0);
    let title = painter.layout(title.to_owned(), font.clone(), theme::TEXT, (width - 20.0).max(0.0));
    let size = vec2(width, 42.0 + title.size().y);
    let Some(rect) = plates.place(area, Align2::LEFT_BOTTOM, size) else { return };
    painter.rect_filled(rect, 6.0, theme::PLATE);
    let bottom = rect.top() + 5.0 + title.size().y;
    painter.galley(rect.min + vec2(10.0, 4.0), title, theme::TEXT);
    let bar =
        Rect::from_min_max(pos2(rect.left() + 10.0, bottom + 3.0), pos2(rect.right() - 10.0, bottom + 15.0));
    paint_bar(bar);
    for (text, share) in captions {
        let anchor = [Align2::LEFT_TOP, Align2::CENTER_TOP, Align2::RIGHT_TOP][(share * 2.0) as usize];
        let at = pos2(bar.left() + bar.width() * share, bar.bottom() + 2.0);
        painter.text(at, anchor, text, font.clone(), theme::TEXT);
    }
}
