//! Opens the things that belong to a scene: its recording, its text encoder, its scores.

use super::{EncoderChoice, Recorded};
use std::path::Path;
use surgtpgs_clip::TextEncoder;
use surgtpgs_core::{
    Error, Remedy, Result,
    prepare::Prepared,
    relevancy::{self, Fastest},
    scene::Scene,
    sequence::Sequence,
};

/// Opens a text encoder's folder; embeddings are kept in the user's cache, by hashes of encoder and text.
pub fn open_text_encoder(folder: &Path) -> Result<TextEncoder> {
    let cache = dirs::cache_dir().map(|dir| dir.join("surgtpgs").join("embeddings"));
    TextEncoder::open_with_cache(folder, cache.as_deref())
}

pub(super) fn open_relevancy(scene: &Scene) -> Option<Fastest> {
    scene.codec.clone().map(relevancy::best)
}

/// Opens the text encoder and makes sure that it is the one the scene's features belong to.
pub(super) fn open_encoder(scene: &Scene, choice: &EncoderChoice) -> Result<TextEncoder> {
    let expected = scene.encoder.as_ref();
    let encoder = match (choice, expected.and_then(|e| e.folder.as_deref())) {
        (EncoderChoice::Folder(folder), _) => open_text_encoder(folder)?,
        (EncoderChoice::OfScene, Some(folder)) if !folder.is_dir() => {
            return Err(Error::input_at(
                folder,
                "the text encoder that this scene was prepared with is not there any more",
                Remedy::OtherEncoder,
            ));
        }
        (EncoderChoice::OfScene, Some(folder)) => open_text_encoder(folder)?,
        (EncoderChoice::OfScene | EncoderChoice::Builtin, _) => TextEncoder::builtin()?,
    };
    let found = encoder.identity();
    let wanted_dim = scene.codec.as_ref().map_or(found.dim, |c| c.embedding_dim());
    if found.dim != wanted_dim {
        return Err(Error::input(
            format!(
                "the text encoder \"{}\" makes {} values; this scene's decoder makes {wanted_dim}",
                found.name, found.dim
            ),
            "They come from different models: use the encoder the scene was prepared with.",
        ));
    }
    match expected {
        Some(e) if e.sha256 != found.sha256 => Err(Error::input(
            format!(
                "this scene was prepared with the text encoder \"{}\", not with \"{}\"",
                e.name, found.name
            ),
            "Answers would be wrong without notice: use the same encoder files, or prepare and train again.",
        )),
        _ => Ok(encoder),
    }
}

/// Opens a recording and makes sure that it fits the scene.
pub(super) fn open_recording(scene: &Scene, path: &Path) -> Result<Sequence> {
    const GIVE: &str = "Give the recording that the scene was trained on.";
    if !path.exists() {
        return Err(Error::input_at(path, "there is no such recording", GIVE));
    }
    let then = scene.provenance.identity.as_ref();
    let sequence = if Prepared::is_prepared(path) {
        Prepared::open(path)?.sequence
    } else {
        Sequence::open_with(path, None, then.map_or(&[], |then| then.hidden()))?
    };
    if let Some(difference) = then.and_then(|then| sequence.outline().difference(then)) {
        let what = format!("this is not the scene's recording: {difference}");
        return Err(Error::input_at(path, what, difference.hint(GIVE, sequence.path())));
    }
    let found = (sequence.num_frames(), sequence.width(), sequence.height());
    let size = scene.cameras.first().map_or((0, 0), |c| (c.width as usize, c.height as usize));
    let expected = (scene.num_frames(), size.0, size.1);
    if found != expected {
        return Err(Error::input_at(
            path,
            format!(
                "this is not the scene's recording: {} frames of {}×{} instead of {} of {}×{}",
                found.0, found.1, found.2, expected.0, expected.1, expected.2
            ),
            GIVE,
        ));
    }
    Ok(sequence)
}

/// Looks for the recording where it was when the scene was trained, then at `beside`.
pub(super) fn find_recording(scene: &Scene, beside: Option<&Path>) -> Recorded {
    let places = [Some(scene.provenance.sequence_path.as_path()), beside];
    let mut why = "the recording is not where it was when the scene was trained".to_owned();
    for place in places.into_iter().flatten().filter(|p| !p.as_os_str().is_empty() && p.exists()) {
        match open_recording(scene, place) {
            Ok(sequence) => return Recorded::Found(sequence),
            Err(e) => why = e.to_string(),
        }
    }
    Recorded::Missing(why)
}
