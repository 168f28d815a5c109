//! Draws found regions on top of a frame.

use crate::{
    grid::{Grid, Mask},
    mask::{self, border_lines},
    palette::Palette,
    strokes::{Outline, draw_outlines},
};
use image::{RgbImage, imageops};
use rayon::prelude::*;

/// Declares the styles: name on the command line, and a line about it; then label and tip in the window.
macro_rules! styles {
    ($($(#[$doc:meta])* $style:ident $name:literal $about:literal $label:literal $tip:literal)*) => {
        /// Style in which a found region is drawn. A new one is a row here, drawn by [`overlay_layers`] and
        /// [`outlines`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum OverlayStyle {
            $($(#[$doc])* $style,)*
        }

        impl OverlayStyle {
            /// All styles, in the order in which the window goes through them.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$style),*];

            /// Returns the style's name on the command line.
            pub fn name(self) -> &'static str {
                match self { $(Self::$style => $name),* }
            }

            /// Describes the style in one line.
            pub fn about(self) -> &'static str {
                match self { $(Self::$style => $about),* }
            }

            /// Returns the style's name in the window, and an explanation.
            pub fn label(self) -> (&'static str, &'static str) {
                match self { $(Self::$style => ($label, $tip)),* }
            }
        }
    };
}

styles! {
    /// A coloured contour with a dark halo: the default.
    Outline "outline" "A contour"
        "Outline" "A line around what was found"
    /// A translucent fill with a contour.
    Fill "fill" "A translucent fill with contour"
        "Fill" "What was found in a translucent colour"
    /// The score itself as colour, with the fixed range 0–1, never normalised per frame.
    Heatmap "heatmap" "The score as colour, fixed range 0 to 1"
        "Heatmap" "The similarity score itself, on a fixed scale from 0 to 1"
}

impl OverlayStyle {
    /// Returns the next style; the first one follows the last.
    pub fn next(self) -> Self {
        Self::ALL[(self as usize + 1) % Self::ALL.len()]
    }

    /// Returns `true` if the style shows scores, not regions.
    pub fn shows_scores(self) -> bool {
        self == Self::Heatmap
    }

    /// Returns `true` if the style draws more than contours.
    pub fn has_fill(self) -> bool {
        self != Self::Outline
    }
}

/// Style and opacities with which found regions are drawn.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct OverlayLook {
    /// Contours, fills or heatmap.
    pub style: OverlayStyle,
    /// Opacity of fills, 0–1.
    pub opacity: f32,
    /// Opacity of heatmaps, 0–1.
    pub heat_opacity: f32,
    /// Colours of heatmaps.
    pub palette: Palette,
    /// Opacity of contours and their halos, 0–1.
    pub outline_opacity: f32,
    /// `true` if instruments are drawn over the found regions; see [`overlay_layers`].
    pub below_instruments: bool,
}

impl Default for OverlayLook {
    fn default() -> Self {
        Self {
            style: OverlayStyle::Outline,
            opacity: 0.35,
            heat_opacity: 0.65,
            palette: Palette::default(),
            outline_opacity: 1.0,
            below_instruments: true,
        }
    }
}

impl OverlayLook {
    /// Clamps the opacities to values that are valid and visible, whatever a file says.
    pub fn mended(self) -> Self {
        let share = |v: f32, least: f32| if v.is_finite() { v.clamp(least, 1.0) } else { 1.0 };
        Self {
            opacity: share(self.opacity, 0.05),
            heat_opacity: share(self.heat_opacity, 0.05),
            outline_opacity: share(self.outline_opacity, 0.1),
            ..self
        }
    }
}

/// Scores of one prompt, with the threshold and colour to draw them.
#[derive(Clone, Copy, Debug)]
pub struct OverlayPrompt<'a> {
    /// Score image at the frame's size.
    pub scores: &'a Grid<f32>,
    /// Pixels with a score above this are found.
    pub threshold: f32,
    /// The prompt's own colour.
    pub colour: [u8; 3],
    /// `true` for a dashed contour without a fill: something that is only like what was asked for.
    pub is_dashed: bool,
}

impl<'a> OverlayPrompt<'a> {
    /// A prompt with a contour without gaps.
    pub fn new(scores: &'a Grid<f32>, threshold: f32, colour: [u8; 3]) -> Self {
        Self { scores, threshold, colour, is_dashed: false }
    }
}

/// Draws `prompts` over `frame`: [`overlay_layers`] at a `size` of columns and rows, and [`outlines`] on top.
/// Lines are drawn at this size: those of a larger picture would fade or show its pixels.
pub fn overlay(
    frame: &RgbImage,
    prompts: &[(OverlayPrompt<'_>, bool)],
    tools: Option<&Mask>,
    look: OverlayLook,
    size: (u32, u32),
) -> RgbImage {
    let mut drawn = overlay_layers(frame, prompts, tools, look);
    if size != drawn.dimensions() {
        drawn = imageops::resize(&drawn, size.0, size.1, imageops::FilterType::Triangle);
    }
    let of_scores = (frame.width() as usize, frame.height() as usize);
    draw_outlines(&mut drawn, &outlines(prompts, tools, look), of_scores, look.outline_opacity);
    drawn
}

/// Draws the fills or the heatmap of `prompts`, later ones over earlier ones; their lines are [`outlines`].
/// If the look says so, they lie below the instruments, whose pixels stay as they are in the frame.
/// Instruments are the pixels of `tools` (sampled at the frame's size) and those found by the prompts marked
/// as instruments (`true`). Those prompts are drawn on top. A prompt whose scores have another size than the
/// frame is not drawn. NaN counts as not found.
pub fn overlay_layers(
    frame: &RgbImage,
    prompts: &[(OverlayPrompt<'_>, bool)],
    tools: Option<&Mask>,
    look: OverlayLook,
) -> RgbImage {
    let drawn = |frame: &RgbImage, prompts: &[OverlayPrompt<'_>]| match look.style {
        OverlayStyle::Outline => frame.clone(),
        OverlayStyle::Fill => fill(frame, prompts, look.opacity),
        OverlayStyle::Heatmap => heatmap(frame, prompts, look),
    };
    // A heatmap shows scores wherever they are.
    if !look.below_instruments || look.style != OverlayStyle::Fill {
        let prompts: Vec<OverlayPrompt<'_>> = prompts.iter().map(|(p, _)| *p).collect();
        return drawn(frame, &prompts);
    }
    let of = |wanted: bool| -> Vec<OverlayPrompt<'_>> {
        prompts.iter().filter(|(_, is_instrument)| *is_instrument == wanted).map(|(p, _)| *p).collect()
    };
    let (tissue, instruments) = (of(false), of(true));
    let mut picture = drawn(frame, &tissue);
    let found = instruments.iter().map(|p| mask::threshold(p.scores, p.threshold));
    let size = (frame.width() as usize, frame.height() as usize);
    let tools = tools.map(|t| t.sampled(size.0, size.1));
    for mask in tools.into_iter().chain(found).filter(|m| (m.width, m.height) == size) {
        let pixels = picture.pixels_mut().zip(frame.pixels()).zip(&mask.data);
        pixels.filter(|(_, is_instrument)| **is_instrument).for_each(|((drawn, own), _)| *drawn = *own);
    }
    drawn(&picture, &instruments)
}

/// Returns the smooth lines around what `prompts` found, one outline per prompt; instruments and order as in
/// [`overlay_layers`]. Lines have no size yet: they are as wide on an enlarged picture as on a small one.
/// Heatmaps have no lines, and neither have prompts whose scores have another size than the first.
pub fn outlines(
    prompts: &[(OverlayPrompt<'_>, bool)],
    tools: Option<&Mask>,
    look: OverlayLook,
) -> Vec<Outline> {
    let Some((first, _)) = prompts.first().filter(|_| !look.style.shows_scores()) else { return Vec::new() };
    let (width, height) = (first.scores.width, first.scores.height);
    let found = |(p, _): &(OverlayPrompt<'_>, bool)| {
        let fits = (p.scores.width, p.scores.height) == (width, height);
        if fits { mask::threshold(p.scores, p.threshold) } else { Grid::filled(width, height, false) }
    };
    let masks: Vec<Mask> = prompts.par_iter().map(found).collect();
    let tools = tools.map(|t| t.sampled(width, height));
    let hidden = |k: usize, x: usize, y: usize| {
        let of_tools = tools.iter().chain(masks.iter().zip(prompts).filter(|(_, p)| p.1).map(|(m, _)| m));
        look.below_instruments && !prompts[k].1 && of_tools.into_iter().any(|mask| mask.at(x, y))
    };
    let lines = border_lines(&masks, hidden);
    let outline = |((p, _), lines): (&(OverlayPrompt<'_>, bool), _)| Outline {
        lines,
        colour: p.colour,
        is_dashed: p.is_dashed,
    };
    prompts.iter().zip(lines).map(outline).collect()
}

/// Tints what `prompts` found, later ones over earlier ones; what is drawn dashed has no tint.
fn fill(frame: &RgbImage, prompts: &[OverlayPrompt<'_>], opacity: f32) -> RgbImage {
    let size = (frame.width() as usize, frame.height() as usize);
    let mut drawn = frame.clone();
    for prompt in prompts.iter().filter(|p| !p.is_dashed && (p.scores.width, p.scores.height) == size) {
        let own = prompt.colour.map(f32::from);
        let pixels = drawn.pixels_mut().zip(&prompt.scores.data);
        pixels.filter(|(_, score)| **score > prompt.threshold).for_each(|(pixel, _)| {
            pixel.0 = to_bytes(mix(pixel.0.map(f32::from), own, opacity));
        });
    }
    drawn
}

/// Draws the highest score of each pixel in the colours of the palette. Equal scores have equal colours on
/// every frame; what was not seen stays as it is.
fn heatmap(frame: &RgbImage, prompts: &[OverlayPrompt<'_>], look: OverlayLook) -> RgbImage {
    let size = (frame.width() as usize, frame.height() as usize);
    let fits = |p: &&OverlayPrompt<'_>| (p.scores.width, p.scores.height) == size;
    let prompts: Vec<&OverlayPrompt<'_>> = prompts.iter().filter(fits).collect();
    let mut drawn = frame.clone();
    drawn.par_chunks_mut(3).with_min_len(4096).enumerate().for_each(|(i, pixel)| {
        // NaN is no maximum.
        let best = prompts.iter().map(|p| p.scores.data[i]).fold(0.0, f32::max);
        if best > 0.0 {
            let colour = [pixel[0], pixel[1], pixel[2]].map(f32::from);
            let heat = look.palette.colour(best.min(1.0));
            pixel.copy_from_slice(&to_bytes(mix(colour, heat, look.heat_opacity)));
        }
    });
    drawn
}

fn to_bytes(colour: [f32; 3]) -> [u8; 3] {
    colour.map(|v| (v + 0.5) as u8)
}

/// Returns `a` if `share` is 0 and `b` if it is 1.
fn mix(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    std::array::from_fn(|c| a[c] + (b[c] - a[c]) * share.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    const GREY: [u8; 3] = [100; 3];
    const GREEN: [u8; 3] = [0, 200, 80];

    const HEAT: OverlayLook = OverlayLook {
        style: OverlayStyle::Heatmap,
        opacity: 1.0,
        heat_opacity: 1.0,
        palette: Palette::Inferno,
        outline_opacity: 1.0,
        below_instruments: true,
    };
    const FILL: OverlayLook = OverlayLook { style: OverlayStyle::Fill, ..HEAT };

    /// Draws a prompt over a grey frame, in its size.
    fn draw(prompt: OverlayPrompt<'_>, look: OverlayLook) -> RgbImage {
        let scores = prompt.scores;
        let frame = RgbImage::from_pixel(scores.width as u32, scores.height as u32, Rgb(GREY));
        overlay(&frame, &[(prompt, false)], None, look, frame.dimensions())
    }

    /// Scores of which the left half is found.
    fn left_half() -> Grid<f32> {
        Grid::from_vec(40, 24, (0..40 * 24).map(|i| if i % 40 < 20 { 0.9 } else { 0.1 }).collect())
    }

    #[test]
    fn a_fill_mixes_by_opacity_below_its_line() {
        let scores = left_half();
        let prompt = OverlayPrompt::new(&scores, 0.4, GREEN);
        let at = |opacity| {
            let picture = draw(prompt, OverlayLook { opacity, ..FILL });
            [8, 18].map(|x| *picture.get_pixel(x, 12))
        };
        assert_eq!(at(0.0), [Rgb(GREY), Rgb(GREEN)]);
        assert_eq!(at(0.5), [Rgb([50, 150, 90]), Rgb(GREEN)]);
        assert_eq!(at(1.0), [Rgb(GREEN); 2]);
        let outlined = draw(prompt, OverlayLook { style: OverlayStyle::Outline, ..FILL });
        assert_eq!([8, 18].map(|x| *outlined.get_pixel(x, 12)), [Rgb(GREY), Rgb(GREEN)]);
        let dashed = draw(OverlayPrompt { is_dashed: true, ..prompt }, FILL);
        assert_eq!(*dashed.get_pixel(8, 12), Rgb(GREY), "what is only alike has no fill");
    }

    #[test]
    fn lines_are_as_wide_on_an_enlarged_picture() {
        let (scores, frame) = (left_half(), RgbImage::from_pixel(40, 24, Rgb(GREY)));
        let prompts = [(OverlayPrompt::new(&scores, 0.4, GREEN), false)];
        let picture = overlay(&frame, &prompts, None, OverlayLook::default(), (160, 96));
        assert_eq!((0..160).filter(|x| *picture.get_pixel(*x, 50) == Rgb(GREEN)).count(), 2);
    }

    #[test]
    fn under_instruments_the_frame_stays_and_instruments_are_outlined_on_top() {
        let (tissue, tool) = (
            Grid::filled(8, 8, 0.9),
            Grid::from_vec(8, 8, (0..64).map(|i| if i % 8 < 4 { 0.9 } else { 0.1 }).collect()),
        );
        let frame = RgbImage::from_pixel(8, 8, Rgb(GREY));
        let prompt = |scores, colour| OverlayPrompt::new(scores, 0.4, colour);
        let prompts = [(prompt(&tool, [0, 0, 200]), true), (prompt(&tissue, GREEN), false)];
        let picture = overlay_layers(&frame, &prompts, None, FILL);
        assert_eq!(*picture.get_pixel(7, 0), Rgb(GREEN));
        assert_eq!(
            *picture.get_pixel(0, 0),
            Rgb([0, 0, 200]),
            "the instrument's own colour, nothing of the tissue's"
        );
        let lower = Grid::from_vec(1, 2, vec![false, true]);
        let picture = overlay_layers(&frame, &prompts[1..], Some(&lower), FILL);
        assert_eq!((*picture.get_pixel(0, 3), *picture.get_pixel(0, 4)), (Rgb(GREEN), Rgb(GREY)));
        let all = overlay_layers(&frame, &prompts[1..], None, FILL);
        assert!(all.pixels().all(|p| *p == Rgb(GREEN)));
        let above = OverlayLook { below_instruments: false, ..FILL };
        assert_eq!(overlay_layers(&frame, &prompts, Some(&lower), above), all, "the later one covers both");
        let outlined = OverlayLook { style: OverlayStyle::Outline, ..FILL };
        assert_eq!(overlay_layers(&frame, &prompts, None, outlined), frame, "lines are drawn apart");
        let hot = overlay_layers(&frame, &prompts, None, HEAT);
        assert_eq!(
            overlay_layers(&frame, &prompts, Some(&lower), HEAT),
            hot,
            "scores show on instruments, too"
        );
    }

    #[test]
    fn lines_stop_at_instruments_and_run_around_them() {
        let half = |right: bool| {
            let score = |i: usize| if (i % 20 >= 10) == right { 0.9 } else { 0.1 };
            Grid::from_vec(20, 12, (0..240).map(score).collect())
        };
        let (left, right) = (half(false), half(true));
        let prompt = |scores, colour| OverlayPrompt::new(scores, 0.4, colour);
        let prompts = [(prompt(&left, GREEN), false), (prompt(&right, [0, 0, 200]), true)];
        let drawn = |tools: Option<&Mask>, look| -> Vec<usize> {
            outlines(&prompts, tools, look)
                .iter()
                .map(|o| o.lines.iter().map(|l| l.points_px.len()).sum())
                .collect()
        };
        let outlined = OverlayLook { style: OverlayStyle::Outline, ..FILL };
        assert_eq!(drawn(None, outlined), [12, 12]);
        let upper = Grid::from_vec(1, 2, vec![true, false]);
        assert_eq!(drawn(Some(&upper), FILL), [6, 12], "a fill has lines, too");
        assert_eq!(drawn(Some(&upper), OverlayLook { below_instruments: false, ..FILL }), [12, 12]);
        assert!(outlines(&prompts, None, HEAT).is_empty() && outlines(&[], None, FILL).is_empty());
    }

    #[test]
    fn heat_is_of_fixed_range_and_of_the_chosen_palette() {
        let ramp = Grid::from_vec(5, 1, vec![0.0, 0.25, 0.5, 0.75, 1.0]);
        let prompt = OverlayPrompt::new(&ramp, 0.4, GREEN);
        for palette in Palette::ALL {
            let picture = draw(prompt, OverlayLook { palette, ..HEAT });
            let expected = |i: usize| Rgb(to_bytes(palette.colour(i as f32 / 4.0)));
            assert_eq!(*picture.get_pixel(0, 0), Rgb(GREY), "what was not seen stays");
            assert!((1..5).all(|i| *picture.get_pixel(i as u32, 0) == expected(i)), "{palette:?}");
        }
        // A score looks the same whatever else is in the picture.
        let alone = Grid::from_vec(1, 1, vec![0.25]);
        let prompt = OverlayPrompt { scores: &alone, ..prompt };
        let small = draw(prompt, HEAT);
        assert_eq!(small.get_pixel(0, 0).0, to_bytes(Palette::Inferno.colour(0.25)));
    }

    #[test]
    fn the_hotter_of_two_prompts_shows() {
        let (low, high) = (Grid::filled(1, 1, 0.3), Grid::filled(1, 1, 0.5));
        let prompt = |scores, colour| OverlayPrompt::new(scores, 0.4, colour);
        let prompts = [(prompt(&high, [200, 0, 0]), false), (prompt(&low, [0, 0, 200]), false)];
        let picture = overlay_layers(&RgbImage::new(1, 1), &prompts, None, HEAT);
        assert_eq!(picture.get_pixel(0, 0).0, to_bytes(Palette::Inferno.colour(0.5)));
    }

    #[test]
    fn nothing_found_nan_and_misfits_leave_the_frame_as_it_is() {
        let frame = RgbImage::from_pixel(4, 3, Rgb(GREY));
        let (low, nan, misfit) =
            (Grid::filled(4, 3, 0.4), Grid::filled(4, 3, f32::NAN), Grid::filled(3, 4, 0.9));
        let drawn = |frame: &RgbImage, prompts: &[(OverlayPrompt<'_>, bool)], look| {
            overlay(frame, prompts, None, look, frame.dimensions())
        };
        for scores in [&low, &nan, &misfit] {
            let prompt = OverlayPrompt::new(scores, 0.4, GREEN);
            assert_eq!(drawn(&frame, &[(prompt, false)], FILL), frame);
        }
        assert_eq!(
            overlay_layers(&frame, &[(OverlayPrompt::new(&misfit, 0.4, GREEN), false)], None, HEAT),
            frame
        );
        assert_eq!(drawn(&frame, &[], HEAT), frame);
        let nothing = RgbImage::new(0, 0);
        assert_eq!(drawn(&nothing, &[], FILL), nothing);
    }

    #[test]
    fn a_region_that_fills_the_frame_has_no_contour() {
        let scores = Grid::filled(8, 8, 0.9);
        let picture = draw(OverlayPrompt::new(&scores, 0.4, GREEN), OverlayLook::default());
        assert!(picture.pixels().all(|p| *p == Rgb(GREY)));
    }
}
