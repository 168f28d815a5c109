//! Colours and sizes: dark and calm, every text at 4.5:1 or better.

use egui::{Color32, CornerRadius, FontFamily, FontId, Margin, Stroke, TextStyle, Vec2};

/// Behind the picture.
pub(crate) const BACKDROP: Color32 = Color32::from_rgb(0x0d, 0x0f, 0x12);
/// Panels.
pub(crate) const PANEL: Color32 = Color32::from_rgb(0x1a, 0x1d, 0x22);
/// Rows and dialogs.
pub(crate) const RAISED: Color32 = Color32::from_rgb(0x24, 0x28, 0x2f);
/// Buttons.
pub(crate) const CONTROL: Color32 = Color32::from_rgb(0x2f, 0x35, 0x3e);
/// Buttons under the pointer.
pub(crate) const CONTROL_HOVER: Color32 = Color32::from_rgb(0x3a, 0x42, 0x4d);
/// Separators and the borders of fields.
pub(crate) const LINE: Color32 = Color32::from_rgb(0x3c, 0x43, 0x4d);
/// Text.
pub(crate) const TEXT: Color32 = Color32::from_rgb(0xea, 0xed, 0xf1);
/// Less important text.
pub(crate) const TEXT_WEAK: Color32 = Color32::from_rgb(0xae, 0xb6, 0xc1);
/// What is active.
pub(crate) const ACCENT: Color32 = Color32::from_rgb(0x6c, 0xbd, 0xf5);
/// Behind what is selected.
pub(crate) const SELECTION: Color32 = Color32::from_rgb(0x1f, 0x4a, 0x68);
/// A view that nobody recorded; things to know.
pub(crate) const AMBER: Color32 = Color32::from_rgb(0xf5, 0xb8, 0x3d);
/// What went wrong.
pub(crate) const ERROR: Color32 = Color32::from_rgb(0xff, 0x8a, 0x80);
/// Behind text on the picture.
pub(crate) const PLATE: Color32 = Color32::from_rgba_premultiplied(0x0c, 0x0e, 0x11, 0xd8);

/// Height of what is clicked.
pub(crate) const CONTROL_HEIGHT: f32 = 32.0;

/// A prompt's colour for painting.
pub(crate) fn colour32([r, g, b]: [u8; 3]) -> Color32 {
    Color32::from_rgb(r, g, b)
}

/// Small text: captions and legends.
pub(crate) fn small() -> FontId {
    FontId::new(13.5, FontFamily::Proportional)
}

/// Sets the look of everything that follows.
pub(crate) fn apply(ctx: &egui::Context) {
    ctx.set_theme(egui::Theme::Dark);
    ctx.style_mut_of(egui::Theme::Dark, |style| {
        style.text_styles = [
            (TextStyle::Heading, FontId::new(20.0, FontFamily::Proportional)),
            (TextStyle::Body, FontId::new(15.5, FontFamily::Proportional)),
            (TextStyle::Button, FontId::new(15.5, FontFamily::Proportional)),
            (TextStyle::Small, small()),
            (TextStyle::Monospace, FontId::new(14.0, FontFamily::Monospace)),
        ]
        .into();
        style.spacing.item_spacing = Vec2::new(8.0, 6.0);
        style.spacing.button_padding = Vec2::new(12.0, 5.0);
        style.spacing.interact_size = Vec2::new(40.0, CONTROL_HEIGHT);
        style.spacing.slider_width = 150.0;
        style.spacing.window_margin = Margin::same(18);
        style.spacing.menu_margin = Margin::same(8);
        colour(&mut style.visuals);
    });
}

fn colour(visuals: &mut egui::Visuals) {
    let radius = CornerRadius::same(6);
    visuals.panel_fill = PANEL;
    visuals.window_fill = RAISED;
    visuals.window_stroke = Stroke::new(1.0, LINE);
    visuals.window_corner_radius = CornerRadius::same(10);
    visuals.menu_corner_radius = CornerRadius::same(8);
    visuals.extreme_bg_color = BACKDROP;
    visuals.text_edit_bg_color = Some(BACKDROP);
    visuals.faint_bg_color = RAISED;
    visuals.weak_text_color = Some(TEXT_WEAK);
    visuals.warn_fg_color = AMBER;
    visuals.error_fg_color = ERROR;
    visuals.hyperlink_color = ACCENT;
    visuals.selection.bg_fill = SELECTION;
    visuals.selection.stroke = Stroke::new(1.5, ACCENT);
    let widgets = &mut visuals.widgets;
    for (state, fill, line, text) in [
        (&mut widgets.noninteractive, PANEL, LINE, TEXT),
        (&mut widgets.inactive, CONTROL, LINE, TEXT),
        (&mut widgets.hovered, CONTROL_HOVER, ACCENT, Color32::WHITE),
        (&mut widgets.active, SELECTION, ACCENT, Color32::WHITE),
        (&mut widgets.open, CONTROL, LINE, TEXT),
    ] {
        state.bg_fill = fill;
        state.weak_bg_fill = fill;
        state.bg_stroke = Stroke::new(1.0, line);
        state.fg_stroke = Stroke::new(1.5, text);
        state.corner_radius = radius;
        state.expansion = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// WCAG contrast of two opaque colours, 1–21.
    fn contrast(a: Color32, b: Color32) -> f32 {
        let luminance = |c: Color32| {
            let linear = egui::Rgba::from(c);
            0.2126 * linear.r() + 0.7152 * linear.g() + 0.0722 * linear.b()
        };
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn contrast_of_black_and_white_is_21() {
        assert!((contrast(Color32::BLACK, Color32::WHITE) - 21.0).abs() < 0.01);
    }

    #[test]
    fn text_can_be_read_on_every_ground() {
        for ground in [BACKDROP, PANEL, RAISED, CONTROL, CONTROL_HOVER, SELECTION] {
            assert!(contrast(TEXT, ground) >= 4.5, "text on {ground:?}");
        }
        for ground in [BACKDROP, PANEL, RAISED, CONTROL] {
            for text in [TEXT_WEAK, ACCENT, AMBER, ERROR] {
                assert!(contrast(text, ground) >= 4.5, "{text:?} on {ground:?}");
            }
        }
    }

    #[test]
    fn prompt_colours_stand_out_from_the_panel() {
        for colour in crate::settings::PROMPT_COLOURS {
            assert!(contrast(colour32(colour), RAISED) >= 4.5, "{colour:?}");
        }
    }
}
