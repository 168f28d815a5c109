//! The classes of a recording, and measures of the masks that are found for them.

use surgtpgs_core::{
    Result,
    grid::{Grid, Mask},
    mask::exclusive,
    metrics::{ClassOnFrame, Confusion, MaskScores},
    prepare::is_background,
    sequence::{Class, LabelMap, NO_LABEL, Sequence},
};

/// Measures of all classes.
pub(super) struct Classes {
    all: Vec<Class>,
    /// Measures of the masks by threshold, each class by itself.
    pub(super) threshold: MaskScores,
    /// Measures of the masks that give each pixel its best class; `None` without scores.
    pub(super) argmax: Option<Argmax>,
    /// Measures of copied labels.
    pub(super) copied: MaskScores,
    /// Predicted and labelled class of each pixel, of frames to look at.
    pub(super) frames: Vec<Labelled>,
}

/// Measures of the masks that give each pixel its best class.
pub(super) struct Argmax {
    pub(super) scores: MaskScores,
    pub(super) confusion: Confusion,
}

/// Class indices of a frame's pixels; [`NO_LABEL`] for none.
pub(super) struct Labelled {
    pub(super) frame: usize,
    pub(super) predicted: Grid<u8>,
    pub(super) truth: LabelMap,
    pub(super) picture: image::RgbImage,
}

/// Largest number of frames whose pictures are kept.
const MOST_PICTURES: usize = 24;

/// Returns the places and classes without the background.
fn asked(classes: &[Class]) -> impl Iterator<Item = (usize, &Class)> {
    classes.iter().enumerate().filter(|(_, class)| !is_background(&class.name))
}

/// Measures the mask of a class against the labels of a frame.
fn measure_class(
    class: &Class,
    frame: usize,
    mask: &Mask,
    labels: &LabelMap,
    keep: &Mask,
) -> Result<ClassOnFrame> {
    ClassOnFrame::measure(frame, &class.name, mask, &labels.map(|&id| id == class.id), keep)
}

impl Classes {
    pub(super) fn new(classes: &[Class]) -> Self {
        let (threshold, copied) = <(MaskScores, MaskScores)>::default();
        Self { all: classes.to_vec(), threshold, argmax: None, copied, frames: Vec::new() }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.asked().next().is_none()
    }

    pub(super) fn all(&self) -> &[Class] {
        &self.all
    }

    /// Returns the places and classes without the background.
    pub(super) fn asked(&self) -> impl Iterator<Item = (usize, &Class)> {
        asked(&self.all)
    }

    /// Adds the scores of all classes on a frame; `found` makes a mask of scores. Does nothing if
    /// the frame has no labels.
    pub(super) fn add_scores(
        &mut self,
        scores: &[Grid<f32>],
        found: impl Fn(&Grid<f32>) -> Mask,
        sequence: &Sequence,
        frame: usize,
    ) -> Result<()> {
        // A scene without features has no scores, whatever the recording has.
        let is_scored = !self.all.is_empty() && scores.len() == self.all.len();
        let Some(labels) = sequence.labels(frame)?.filter(|_| is_scored) else { return Ok(()) };
        let keep = sequence.mask(frame)?;
        let each: Vec<Mask> = scores.iter().map(found).collect();
        let best = exclusive(&scores.iter().collect::<Vec<_>>(), &vec![0.0; scores.len()]);
        let names: Vec<String> = self.all.iter().map(|c| c.name.clone()).collect();
        let mut argmax = self
            .argmax
            .take()
            .unwrap_or_else(|| Argmax { scores: MaskScores::default(), confusion: Confusion::new(names) });
        for (k, class) in asked(&self.all) {
            self.threshold.add(measure_class(class, frame, &each[k], &labels, &keep)?);
            argmax.scores.add(measure_class(class, frame, &best[k], &labels, &keep)?);
        }
        let (predicted, truth) = (self.indices(&best), self.places(&labels));
        argmax.confusion.add(&predicted, &truth, &keep);
        self.argmax = Some(argmax);
        self.keep_picture(predicted, truth, sequence, frame)
    }

    /// Adds masks of all classes on a frame.
    pub(super) fn add_masks(&mut self, masks: Vec<Mask>, sequence: &Sequence, frame: usize) -> Result<()> {
        let Some(labels) = sequence.labels(frame)? else { return Ok(()) };
        // Another program's masks are not cut to the pixels that we learn from: the labels are not either.
        let keep = Mask::filled(labels.width, labels.height, true);
        for (k, class) in asked(&self.all) {
            self.threshold.add(measure_class(class, frame, &masks[k], &labels, &keep)?);
        }
        let (predicted, truth) = (self.indices(&masks), self.places(&labels));
        self.keep_picture(predicted, truth, sequence, frame)
    }

    /// Adds, as a guess of the labels of `frame`, those of the first of the frames `from` that has some. Does
    /// nothing if there are none, or nothing to compare them with.
    pub(super) fn add_copy(&mut self, sequence: &Sequence, frame: usize, from: &[usize]) -> Result<()> {
        let Some(truth) = sequence.labels(frame)? else { return Ok(()) };
        let mut guess = None;
        for &from in from {
            guess = sequence.labels(from)?;
            if guess.is_some() {
                break;
            }
        }
        let Some(guess) = guess else { return Ok(()) };
        let keep = sequence.mask(frame)?;
        for (_, class) in asked(&self.all) {
            let guess = guess.map(|&id| id == class.id);
            self.copied.add(measure_class(class, frame, &guess, &truth, &keep)?);
        }
        Ok(())
    }

    fn keep_picture(
        &mut self,
        predicted: Grid<u8>,
        truth: LabelMap,
        sequence: &Sequence,
        frame: usize,
    ) -> Result<()> {
        if self.frames.len() < MOST_PICTURES {
            let picture = sequence.frame(frame)?;
            self.frames.push(Labelled { frame, predicted, truth, picture });
        }
        Ok(())
    }

    /// Returns for each pixel the place of the first class whose mask has it.
    fn indices(&self, masks: &[Mask]) -> Grid<u8> {
        let Some(first) = masks.first() else { return Grid::filled(0, 0, NO_LABEL) };
        let class = |i: usize| masks.iter().position(|m| m.data[i]).map_or(NO_LABEL, |k| k as u8);
        Grid::from_vec(first.width, first.height, (0..first.data.len()).map(class).collect())
    }

    /// Turns class ids into places in the list of classes.
    fn places(&self, labels: &LabelMap) -> LabelMap {
        labels.map(|id| self.all.iter().position(|c| c.id == *id).map_or(NO_LABEL, |k| k as u8))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_are_not_asked_for() {
        let class = |name: &str| Class { id: 3, name: name.into(), colour: [0; 3] };
        assert!(Classes::new(&[class("black background")]).is_empty());
        assert!(!Classes::new(&[class("black background"), class("liver")]).is_empty());
    }

    #[test]
    fn labels_become_places_in_the_list() {
        let class = |id: u8| Class { id, name: format!("class {id}"), colour: [0; 3] };
        let classes = Classes::new(&[class(7), class(3)]);
        let labels = Grid::from_vec(4, 1, vec![3, 7, 9, NO_LABEL]);
        assert_eq!(classes.places(&labels).data, [1, 0, NO_LABEL, NO_LABEL]);
        let masks = [Grid::from_vec(2, 1, vec![false, true]), Grid::from_vec(2, 1, vec![false, true])];
        assert_eq!(classes.indices(&masks).data, [NO_LABEL, 0]);
    }
}
