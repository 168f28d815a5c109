//! Colours and sizes: dark and calm, with a contrast of 4.5:1 or better for every text.

use egui::{Color32, CornerRadius, FontFamily, FontId, Margin, Stroke, TextStyle, Vec2};

/// Background of the picture.
pub(crate) const BACKDROP: Color32 = Color32::from_rgb(0x0d, 0x0f, 0x12);
/// Background of panels.
pub(crate) const PANEL: Color32 = Color32::from_rgb(0x1a, 0x1d, 0x22);
/// Background of rows and dialogs.
pub(crate) const RAISED: Color32 = Color32::from_rgb(0x24, 0x28, 0x2f);
/// Background of buttons.
pub(crate) const CONTROL: Color32 = Color32::from_rgb(0x2f, 0x35, 0x3e);
/// Background of buttons under the pointer.
pub(crate) const CONTROL_HOVER: Color32 = Color32::from_rgb(0x3a, 0x42, 0x4d);
/// Colour of separators and of the borders of fields.
pub(crate) const LINE: Color32 = Color32::from_rgb(0x3c, 0x43, 0x4d);
/// Colour of the borders of what is under the pointer.
pub(crate) const LINE_HOVER: Color32 = Color32::from_rgb(0x72, 0x7d, 0x8b);
/// Colour of text.
pub(crate) const TEXT: Color32 = Color32::from_rgb(0xea, 0xed, 0xf1);
/// Colour of less important text.
pub(crate) const TEXT_WEAK: Color32 = Color32::from_rgb(0xae, 0xb6, 0xc1);
/// Colour of active elements, and of the border of what has the focus.
pub(crate) const ACCENT: Color32 = Color32::from_rgb(0x6c, 0xbd, 0xf5);
/// Background of selected elements.
pub(crate) const SELECTION: Color32 = Color32::from_rgb(0x1f, 0x4a, 0x68);
/// Colour of notes, and of views that nobody recorded.
pub(crate) const AMBER: Color32 = Color32::from_rgb(0xf5, 0xb8, 0x3d);
/// Colour of errors.
pub(crate) const ERROR: Color32 = Color32::from_rgb(0xff, 0x8a, 0x80);
/// Background of text on the picture.
pub(crate) const PLATE: Color32 = Color32::from_rgba_premultiplied(0x0c, 0x0e, 0x11, 0xd8);

/// Height of elements that can be clicked.
pub(crate) const CONTROL_HEIGHT: f32 = 32.0;

/// Converts a prompt's colour for painting.
pub(crate) fn colour32([r, g, b]: [u8; 3]) -> Color32 {
    Color32::from_rgb(r, g, b)
}

/// Returns the font of small text: captions and legends.
pub(crate) fn small() -> FontId {
    FontId::new(13.5, FontFamily::Proportional)
}

/// Applies the theme to everything shown afterwards.
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
    // A window at rest draws nothing, and a cursor that blinks is drawn.
    visuals.text_cursor.blink = false;
    visuals.error_fg_color = ERROR;
    visuals.hyperlink_color = ACCENT;
    visuals.selection.bg_fill = SELECTION;
    visuals.selection.stroke = Stroke::new(1.5, ACCENT);
    let widgets = &mut visuals.widgets;
    for (state, fill, line, text) in [
        (&mut widgets.noninteractive, PANEL, LINE, TEXT),
        (&mut widgets.inactive, CONTROL, LINE, TEXT),
        (&mut widgets.hovered, CONTROL_HOVER, LINE_HOVER, Color32::WHITE),
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

    /// Returns the WCAG contrast of two opaque colours, 1–21.
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
    fn what_is_under_the_pointer_does_not_look_like_what_has_the_focus() {
        let ctx = egui::Context::default();
        apply(&ctx);
        let style = ctx.style_of(egui::Theme::Dark);
        let widgets = &style.visuals.widgets;
        // The field that is typed into is drawn with the selection's line, other widgets as active ones.
        for focused in [style.visuals.selection.stroke.color, widgets.active.bg_stroke.color] {
            assert_eq!(focused, ACCENT);
            assert_ne!(widgets.hovered.bg_stroke.color, focused);
        }
        assert_ne!(widgets.hovered.weak_bg_fill, widgets.active.weak_bg_fill);
    }

    #[test]
    fn prompt_colours_stand_out_from_the_panel() {
        for colour in crate::settings::PROMPT_COLOURS {
            assert!(contrast(colour32(colour), RAISED) >= 4.5, "{colour:?}");
        }
    }

    /// Matrices of colour vision without one of the three kinds of cones (Machado et al. 2009), linear RGB;
    /// last: with all.
    const VISIONS: [[[f32; 3]; 3]; 4] = [
        [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
        [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
        [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    ];

    /// Returns CIE Lab of a colour as it looks with a kind of vision.
    fn seen(colour: [u8; 3], vision: &[[f32; 3]; 3]) -> [f32; 3] {
        let c = egui::Rgba::from(colour32(colour));
        let [r, g, b] = vision.map(|row| (row[0] * c.r() + row[1] * c.g() + row[2] * c.b()).clamp(0.0, 1.0));
        let xyz = [
            (0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505,
            0.2126 * r + 0.7152 * g + 0.0722 * b,
            (0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.0888,
        ];
        let [x, y, z] = xyz.map(|t| if t > 0.008_856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 });
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    /// Returns the smallest difference between two of `colours`, ΔE.
    fn nearest(colours: &[[u8; 3]], vision: &[[f32; 3]; 3]) -> f32 {
        let lab: Vec<_> = colours.iter().map(|c| seen(*c, vision)).collect();
        let pairs = (0..lab.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        let distance =
            |(i, j): (usize, usize)| (0..3).map(|k| (lab[i][k] - lab[j][k]).powi(2)).sum::<f32>().sqrt();
        pairs.map(distance).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn all_prompts_can_be_told_apart_with_any_colour_vision() {
        for vision in &VISIONS {
            let apart = nearest(&crate::settings::PROMPT_COLOURS, vision);
            assert!(apart > 20.0, "{apart} for {vision:?}");
        }
        let red_and_green = [[0xc8, 0x60, 0x40], [0x80, 0x80, 0x3a]];
        assert!(nearest(&red_and_green, &VISIONS[0]) < 20.0 && nearest(&red_and_green, &VISIONS[3]) > 40.0);
    }
}
