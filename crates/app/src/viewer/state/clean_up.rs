//! Limits and names of the clean-up of masks.

use surgtpgs_core::mask::{CleanUp, MAX_SMOOTH};

/// Largest area of removed parts and filled holes, px.
pub(crate) const MAX_AREA: usize = 20_000;
/// Largest radius over which borders are rounded, px.
pub(crate) const MAX_ROUND: usize = 20;
/// Largest distance that a border moves, px.
pub(crate) const MAX_GROW: i32 = 20;

/// Limits the clean-up to what the window offers, because files may hold any values.
pub(crate) fn mended(clean_up: CleanUp) -> CleanUp {
    CleanUp {
        smooth_frames: clean_up.smooth_frames.min(MAX_SMOOTH),
        fill_holes_px: clean_up.fill_holes_px.min(MAX_AREA),
        min_area_px: clean_up.min_area_px.min(MAX_AREA),
        round_px: clean_up.round_px.min(MAX_ROUND),
        grow_px: clean_up.grow_px.clamp(-MAX_GROW, MAX_GROW),
    }
}

/// Describes the active clean-up in words, for the picture; `None` where masks are left as they are.
pub(crate) fn describe(clean_up: CleanUp) -> Option<String> {
    if clean_up.is_off() {
        return None;
    }
    let mut words = Vec::new();
    if (CleanUp { smooth_frames: 0, ..clean_up }) != CleanUp::default() {
        words.push("masks cleaned up".to_owned());
    }
    if clean_up.smooth_frames > 0 {
        words.push(format!("scores smoothed over {} frames", 2 * clean_up.smooth_frames + 1));
    }
    Some(words.join(", "))
}
