//! Choices that the viewer and the command line share.

/// Colours of prompts in their order (sRGB): far from tissue's red to orange, all of them told apart
/// with any colour vision.
pub const PROMPT_COLOURS: [[u8; 3]; 8] = [
    [0x3d, 0xd6, 0xff],
    [0xe8, 0x5e, 0xba],
    [0xb1, 0xf2, 0x93],
    [0xff, 0xff, 0xff],
    [0x84, 0x84, 0xfc],
    [0xf6, 0xe0, 0x4e],
    [0x58, 0xaa, 0x5b],
    [0xed, 0xa3, 0xb4],
];

/// Part of the circle of hues that further colours are of, degrees: all but tissue's.
const FURTHER_HUES: [f32; 2] = [50.0, 330.0];
/// Step from one further hue to the next, as share of that part: each is far from those before it.
const HUE_STEP: f32 = 0.618_034;
/// Saturation and lightness of further colours, in turns.
const FURTHER_LOOKS: [[f32; 2]; 2] = [[0.85, 0.76], [0.5, 0.86]];

/// Returns the colour of the prompt at a place of a list: that of the palette, and past its end one of
/// another hue.
pub fn prompt_colour(place: usize) -> [u8; 3] {
    let further = |past: usize| {
        let [first, last] = FURTHER_HUES;
        let hue = first + (last - first) * ((past + 1) as f32 * HUE_STEP).fract();
        let [saturation, lightness] = FURTHER_LOOKS[past % FURTHER_LOOKS.len()];
        of_hue(hue, saturation, lightness)
    };
    PROMPT_COLOURS.get(place).copied().unwrap_or_else(|| further(place - PROMPT_COLOURS.len()))
}

/// Returns the colour of a hue, degrees, at a saturation and a lightness, 0–1.
fn of_hue(hue: f32, saturation: f32, lightness: f32) -> [u8; 3] {
    let reach = saturation * lightness.min(1.0 - lightness);
    [0.0, 8.0, 4.0].map(|offset: f32| {
        let k = (offset + hue / 30.0) % 12.0;
        let value = lightness - reach * (k - 3.0).min(9.0 - k).clamp(-1.0, 1.0);
        (255.0 * value).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn many_prompts_have_colours_of_their_own() {
        let colours: BTreeSet<[u8; 3]> = (0..64).map(prompt_colour).collect();
        assert_eq!((colours.len(), prompt_colour(4)), (64, PROMPT_COLOURS[4]));
    }

    #[test]
    fn hues_are_those_of_the_colour_circle() {
        assert_eq!([of_hue(0.0, 1.0, 0.5), of_hue(120.0, 1.0, 0.5)], [[255, 0, 0], [0, 255, 0]]);
        assert_eq!(of_hue(240.0, 0.0, 1.0), [255; 3]);
    }
}
