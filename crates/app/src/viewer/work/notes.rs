//! Notes about the shown picture: how far it can be trusted, and how it was made.

use crate::viewer::{
    picture::{
        notes::{FADED, GUESSED, SYNTHESISED, Scale},
        request::Picture,
    },
    shared::Shared,
    state::{clean_up, view_mode::ViewMode},
};
use surgtpgs_core::mask::CleanUp;

impl Shared {
    /// Returns what must be known about the reconstruction wherever it is seen.
    pub(crate) fn cautions(&self) -> Vec<String> {
        let Some(info) = self.info() else { return Vec::new() };
        let missing = self.not_reconstructed().map(str::to_owned);
        let unfinished = info.is_unfinished().then(|| match self.is_reconstructing() {
            true => "Still being learned".to_owned(),
            false => format!("Stopped early, after {:.0} % of its learning", 100.0 * info.learned),
        });
        let guessed = info.shape_is_guessed().then(|| GUESSED.to_owned());
        missing.or(unfinished).into_iter().chain(guessed).collect()
    }

    /// Says that no part of a long recording reconstructs the frame on the screen; `None` if one does.
    pub(crate) fn not_reconstructed(&self) -> Option<&'static str> {
        let (info, picture) = (self.info()?, self.picture()?);
        let said = match info.is_unfinished() {
            true => "This part is not reconstructed yet",
            false => "This part is not reconstructed",
        };
        info.is_unlearned(picture.request.view.frame).then_some(said)
    }

    /// Describes a clean-up of masks that is not the usual one.
    pub(crate) fn clean_up_words(&self) -> Option<String> {
        let clean_up = self.document.content().clean_up;
        let usual = self.info().map(|info| CleanUp::usual(info.width, info.height));
        clean_up::describe(clean_up).filter(|_| usual != Some(clean_up))
    }

    /// Returns what must be known about the shown picture where it is seen without the window.
    pub(crate) fn picture_notes(&self) -> Vec<String> {
        let Some(picture) = self.picture() else { return Vec::new() };
        let mode = self.document.mode;
        let is_recorded = matches!(mode, ViewMode::Original | ViewMode::Blink) && picture.original.is_some();
        let is_turned = !is_recorded && !picture.request.view.orbit.is_home();
        let is_faded = is_turned && picture.unseen_share > 0.0 && mode.needs_reconstruction();
        let mut notes: Vec<String> = Vec::new();
        notes.extend(is_turned.then(|| SYNTHESISED.to_owned()));
        notes.extend(is_faded.then(|| FADED.to_owned()));
        notes.extend(if is_recorded { Vec::new() } else { self.cautions() });
        notes.extend(self.clean_up_words().filter(|_| self.shows_masks(picture)));
        notes.extend(self.scale(picture).map(|scale| scale.words()));
        notes
    }

    /// Returns `true` if masks are drawn over a picture.
    fn shows_masks(&self, picture: &Picture) -> bool {
        let mode = self.document.mode;
        let has_colours = mode == ViewMode::Original || mode.needs_reconstruction();
        let is_comparison = mode == ViewMode::Difference;
        has_colours && !is_comparison && !self.document.is_hidden && !picture.request.prompts.is_empty()
    }

    /// Returns the scale of the colours of a picture; `None` where they are those of the frame.
    fn scale(&self, picture: &Picture) -> Option<Scale> {
        let mode = self.document.mode;
        if mode == ViewMode::Difference {
            return picture.difference.as_ref().map(|_| Scale::of_difference());
        }
        let is_known = self.info().is_some_and(|info| !info.shape_is_guessed());
        let layer = picture.layer.as_ref().filter(|_| mode.layer().is_some());
        layer.map(|layer| Scale::of_layer(layer, is_known))
    }
}
