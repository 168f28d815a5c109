//! Draws found regions on top of a frame; [`overlay`] is the CPU twin of `shaders/overlay.wgsl`.

use crate::{
    grid::{Grid, Mask},
    mask::{self, Bits, border_lines, set_bits},
    palette::Palette,
    strokes::Outline,
};
use image::RgbImage;
use rayon::prelude::*;

/// Declares the styles: name on the command line, and a line about it; then label and tip in the window.
macro_rules! styles {
    ($($(#[$doc:meta])* $style:ident $name:literal $about:literal $label:literal $tip:literal)*) => {
        /// Style in which a found region is drawn. A new one is a row here, drawn by [`overlay`] and by
        /// `shaders/overlay.wgsl`.
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

/// Length of a dash and of the gap after it, px along either axis.
pub const DASH: u32 = 8;

/// Width of a contour, px; the contour lies inside the found region.
pub const CONTOUR_WIDTH: u32 = 2;
/// Amount by which the halo, 1 px on either side of a contour, darkens the frame. It keeps contours
/// visible on any tissue.
pub const HALO_DARKNESS: f32 = 0.6;

/// Draws `prompts` over `frame`, later ones over earlier ones. Contours are [`CONTOUR_WIDTH`] px wide at
/// the frame's size. A prompt whose scores have another size is not drawn. NaN counts as not found.
pub fn overlay(frame: &RgbImage, prompts: &[OverlayPrompt<'_>], look: OverlayLook) -> RgbImage {
    let OverlayLook { style, opacity, outline_opacity, .. } = look;
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let fits = |p: &&OverlayPrompt<'_>| (p.scores.width, p.scores.height) == (width, height);
    let prompts: Vec<&OverlayPrompt<'_>> = prompts.iter().filter(fits).collect();
    let mut out = frame.clone();
    if width * height == 0 || prompts.is_empty() {
        return out;
    }
    if style.shows_scores() {
        out.par_chunks_mut(3).with_min_len(4096).enumerate().for_each(|(i, pixel)| {
            let colour = [pixel[0], pixel[1], pixel[2]].map(f32::from);
            pixel.copy_from_slice(&to_bytes(heat(colour, &prompts, i, look)));
        });
        return out;
    }
    let fill = if style.has_fill() { opacity } else { 0.0 };
    let zones: Vec<Zones> = prompts.iter().map(|p| Zones::of(p)).collect();
    out.par_chunks_mut(3 * width).with_min_len(8).enumerate().for_each(|(y, row)| {
        let mut touched = vec![0; width.div_ceil(u64::BITS as usize)];
        for zones in &zones {
            zones.mark(y, fill > 0.0, &mut touched);
        }
        for x in set_bits(&touched) {
            let pixel = &mut row[3 * x..3 * x + 3];
            let mut colour = [pixel[0], pixel[1], pixel[2]].map(f32::from);
            for (prompt, zones) in prompts.iter().zip(&zones) {
                let fill = if prompt.is_dashed { 0.0 } else { fill };
                if !(prompt.is_dashed && is_gap(x, y)) {
                    colour = zones.draw(x, y, colour, prompt.colour.map(f32::from), (outline_opacity, fill));
                }
            }
            pixel.copy_from_slice(&to_bytes(colour));
        }
    });
    out
}

/// Draws the fills or the heatmap of `prompts`; their lines are [`outlines`]. If the look says so, they lie
/// below the instruments, whose pixels stay as they are in the frame. Instruments are the pixels of `tools`
/// (sampled at the frame's size) and those found by the prompts marked as instruments (`true`). Those
/// prompts are drawn on top.
pub fn overlay_layers(
    frame: &RgbImage,
    prompts: &[(OverlayPrompt<'_>, bool)],
    tools: Option<&Mask>,
    look: OverlayLook,
) -> RgbImage {
    let drawn = |frame: &RgbImage, prompts: &[OverlayPrompt<'_>]| match look.style {
        OverlayStyle::Outline => frame.clone(),
        OverlayStyle::Fill => fill(frame, prompts, look.opacity),
        OverlayStyle::Heatmap => overlay(frame, prompts, look),
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

/// Returns `true` where a dashed contour has a gap.
fn is_gap(x: usize, y: usize) -> bool {
    (x + y) / DASH as usize % 2 == 1
}

fn to_bytes(colour: [f32; 3]) -> [u8; 3] {
    colour.map(|v| (v + 0.5) as u8)
}

/// Zones of the region that a prompt found, by city-block distance from its border. Up to [`CONTOUR_WIDTH`]
/// inside the border is contour, the next pixel on either side is halo. The image's edge is no border.
struct Zones {
    inside: Bits,
    contour: Bits,
    halo: Bits,
}

impl Zones {
    fn of(prompt: &OverlayPrompt<'_>) -> Self {
        let scores = prompt.scores;
        // Also false for NaN.
        let found = Bits::of(scores.width, scores.height, |i| scores.data[i] > prompt.threshold);
        let within = (0..CONTOUR_WIDTH).fold(found.clone(), |bits, _| bits.eroded());
        let inside = within.eroded();
        let halo = within.without(&inside).or(&found.dilated().without(&found));
        Self { contour: found.without(&within), inside, halo }
    }

    /// Adds the drawn pixels of row `y`.
    fn mark(&self, y: usize, with_inside: bool, touched: &mut [u64]) {
        let inside = if with_inside { self.inside.row(y) } else { &[] };
        for row in [inside, self.contour.row(y), self.halo.row(y)] {
            touched.iter_mut().zip(row).for_each(|(touched, word)| *touched |= word);
        }
    }

    fn draw(
        &self,
        x: usize,
        y: usize,
        colour: [f32; 3],
        own: [f32; 3],
        (outline, fill): (f32, f32),
    ) -> [f32; 3] {
        if self.contour.has(x, y) {
            mix(colour, own, outline)
        } else if self.halo.has(x, y) {
            mix(colour, [0.0; 3], HALO_DARKNESS * outline)
        } else if self.inside.has(x, y) {
            mix(colour, own, fill)
        } else {
            colour
        }
    }
}

/// Draws the highest score of a pixel in the colours of the palette. Equal scores have equal colours on every
/// frame; what was not seen stays as it is.
fn heat(base: [f32; 3], prompts: &[&OverlayPrompt<'_>], i: usize, look: OverlayLook) -> [f32; 3] {
    // NaN is no maximum.
    let best = prompts.iter().map(|p| p.scores.data[i]).fold(0.0, f32::max);
    if best > 0.0 { mix(base, look.palette.colour(best.min(1.0)), look.heat_opacity) } else { base }
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

    /// Draws a disc of score 0.9 in a field of 0.1.
    fn disc(size: usize) -> Grid<f32> {
        let centre = size as f32 / 2.0;
        let score = |i: usize| {
            let (x, y) = ((i % size) as f32 + 0.5 - centre, (i / size) as f32 + 0.5 - centre);
            if x * x + y * y < 0.1 * (size * size) as f32 { 0.9 } else { 0.1 }
        };
        Grid::from_vec(size, size, (0..size * size).map(score).collect())
    }

    fn draw(scores: &Grid<f32>, style: OverlayStyle, opacity: f32) -> RgbImage {
        let frame = RgbImage::from_pixel(scores.width as u32, scores.height as u32, Rgb(GREY));
        let look = OverlayLook { style, opacity, ..Default::default() };
        overlay(&frame, &[OverlayPrompt::new(scores, 0.4, GREEN)], look)
    }

    const HEAT: OverlayLook = OverlayLook {
        style: OverlayStyle::Heatmap,
        opacity: 1.0,
        heat_opacity: 1.0,
        palette: Palette::Inferno,
        outline_opacity: 1.0,
        below_instruments: true,
    };
    const FILL: OverlayLook = OverlayLook { style: OverlayStyle::Fill, ..HEAT };

    #[test]
    fn an_outline_is_contour_between_halos_and_leaves_the_rest_alone() {
        let picture = draw(&disc(40), OverlayStyle::Outline, 1.0);
        let dark = Rgb([40; 3]);
        // Along the middle row: outside, halo, two pixels of contour, halo, inside.
        let row: Vec<Rgb<u8>> = (5..13).map(|x| *picture.get_pixel(x, 20)).collect();
        assert_eq!(row, [Rgb(GREY), dark, Rgb(GREEN), Rgb(GREEN), dark, Rgb(GREY), Rgb(GREY), Rgb(GREY)]);
        assert_eq!(*picture.get_pixel(20, 20), Rgb(GREY));
    }

    #[test]
    fn a_fill_mixes_by_opacity_and_keeps_the_contour() {
        let at = |opacity| *draw(&disc(40), OverlayStyle::Fill, opacity).get_pixel(20, 20);
        assert_eq!(at(0.0), Rgb(GREY));
        assert_eq!(at(0.5), Rgb([50, 150, 90]));
        assert_eq!(at(1.0), Rgb(GREEN));
        assert_eq!(*draw(&disc(40), OverlayStyle::Fill, 0.5).get_pixel(8, 20), Rgb(GREEN));
    }

    #[test]
    fn a_faint_outline_lets_the_tissue_through() {
        let scores = disc(40);
        let frame = RgbImage::from_pixel(40, 40, Rgb(GREY));
        let prompt = OverlayPrompt::new(&scores, 0.4, GREEN);
        let at = |outline_opacity| {
            let picture = overlay(&frame, &[prompt], OverlayLook { outline_opacity, ..Default::default() });
            [6, 8].map(|x| picture.get_pixel(x, 20).0)
        };
        assert_eq!(at(0.0), [GREY; 2]);
        assert_eq!(at(0.5), [[70; 3], [50, 150, 90]]);
        assert_eq!(at(1.0), [[40; 3], GREEN]);
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
        let both = [prompts[0].0, prompts[1].0];
        assert_eq!(overlay_layers(&frame, &prompts, Some(&lower), HEAT), overlay(&frame, &both, HEAT));
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
        let frame = RgbImage::from_pixel(5, 1, Rgb(GREY));
        let prompt = OverlayPrompt::new(&ramp, 0.4, GREEN);
        for palette in Palette::ALL {
            let picture = overlay(&frame, &[prompt], OverlayLook { palette, ..HEAT });
            let expected = |i: usize| Rgb(to_bytes(palette.colour(i as f32 / 4.0)));
            assert_eq!(*picture.get_pixel(0, 0), Rgb(GREY), "what was not seen stays");
            assert!((1..5).all(|i| *picture.get_pixel(i as u32, 0) == expected(i)), "{palette:?}");
        }
        // A score looks the same whatever else is in the picture.
        let alone = Grid::from_vec(1, 1, vec![0.25]);
        let prompt = OverlayPrompt { scores: &alone, ..prompt };
        let small = overlay(&RgbImage::new(1, 1), &[prompt], HEAT);
        assert_eq!(small.get_pixel(0, 0).0, to_bytes(Palette::Inferno.colour(0.25)));
    }

    #[test]
    fn the_hotter_of_two_prompts_shows() {
        let (low, high) = (Grid::filled(1, 1, 0.3), Grid::filled(1, 1, 0.5));
        let prompt = |scores, colour| OverlayPrompt::new(scores, 0.4, colour);
        let picture =
            overlay(&RgbImage::new(1, 1), &[prompt(&high, [200, 0, 0]), prompt(&low, [0, 0, 200])], HEAT);
        assert_eq!(picture.get_pixel(0, 0).0, to_bytes(Palette::Inferno.colour(0.5)));
    }

    #[test]
    fn nothing_found_nan_and_misfits_leave_the_frame_as_it_is() {
        let frame = RgbImage::from_pixel(4, 3, Rgb(GREY));
        let (low, nan, misfit) =
            (Grid::filled(4, 3, 0.4), Grid::filled(4, 3, f32::NAN), Grid::filled(3, 4, 0.9));
        for scores in [&low, &nan, &misfit] {
            let prompt = OverlayPrompt::new(scores, 0.4, GREEN);
            assert_eq!(overlay(&frame, &[prompt], FILL), frame);
        }
        assert_eq!(overlay(&frame, &[], HEAT), frame);
        let nothing = RgbImage::new(0, 0);
        assert_eq!(overlay(&nothing, &[], FILL), nothing);
    }

    #[test]
    fn a_region_that_fills_the_frame_has_no_contour() {
        let picture = draw(&Grid::filled(8, 8, 0.9), OverlayStyle::Outline, 1.0);
        assert!(picture.pixels().all(|p| *p == Rgb(GREY)));
    }
}
