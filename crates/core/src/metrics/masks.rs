//! Quality of class masks, per class and frame and over a recording.

use super::boundary_f;
use crate::{
    Error, Result,
    grid::{Grid, Mask},
    num,
};
use std::collections::BTreeMap;

/// Measures of a class on a frame, predicted and labelled. Shares are 0–1 and `None` if they
/// are not defined.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ClassOnFrame {
    /// The frame, counted from 0.
    pub frame: usize,
    /// The class's name.
    pub class: String,
    /// Number of pixels of the class in the labels.
    pub labelled_px: usize,
    /// Number of pixels of the class in the prediction.
    pub predicted_px: usize,
    /// Number of pixels in both.
    pub both_px: usize,
    /// Number of pixels that predictions may cover.
    pub kept_px: usize,
    /// Intersection over union.
    pub iou: Option<f64>,
    /// Sørensen–Dice, the F-measure of pixels.
    pub dice: Option<f64>,
    /// F-measure of borders, see [`boundary_f`]; only if the class is labelled.
    pub boundary_f: Option<f64>,
    /// Share of the predicted pixels that are right.
    pub precision: Option<f64>,
    /// Share of the labelled pixels that were predicted.
    pub recall: Option<f64>,
}

impl ClassOnFrame {
    /// Compares a `prediction`, limited to the pixels that count (`keep`), with the unlimited
    /// `truth` (method §9.5).
    pub fn measure(frame: usize, class: &str, prediction: &Mask, truth: &Mask, keep: &Mask) -> Result<Self> {
        let size = (truth.width, truth.height);
        if size != (prediction.width, prediction.height) || size != (keep.width, keep.height) {
            return Err(Error::input(
                format!(
                    "masks of the class \"{class}\" differ in size: predicted {}×{}, labelled {}×{}, kept {}×{}",
                    prediction.width, prediction.height, truth.width, truth.height, keep.width, keep.height
                ),
                "Evaluate a scene on the recording it was trained on.",
            ));
        }
        let kept = prediction.data.iter().zip(&keep.data).map(|(p, k)| *p && *k).collect();
        let kept = Mask::from_vec(size.0, size.1, kept);
        let both_px = kept.data.iter().zip(&truth.data).filter(|(p, t)| **p && **t).count();
        let (labelled_px, predicted_px) = (truth.count(), kept.count());
        let share = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
        Ok(Self {
            frame,
            class: class.to_owned(),
            labelled_px,
            predicted_px,
            both_px,
            kept_px: keep.count(),
            iou: share(both_px, labelled_px + predicted_px - both_px),
            dice: share(2 * both_px, labelled_px + predicted_px),
            boundary_f: if labelled_px > 0 { boundary_f(&kept, truth) } else { None },
            precision: share(both_px, predicted_px),
            recall: share(both_px, labelled_px),
        })
    }

    fn is_labelled(&self) -> bool {
        self.labelled_px > 0
    }
}

/// Mean IoU per class and over everything.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct IouReport {
    /// Mean over all counted (frame, class) pairs, 0–1; `None` if none was counted.
    pub mean: Option<f64>,
    /// Mean over the counted frames of each class, 0–1.
    pub classes: BTreeMap<String, f64>,
}

/// Measures of classes on frames, and their summaries.
#[derive(Clone, Debug, Default)]
pub struct MaskScores(Vec<ClassOnFrame>);

impl MaskScores {
    /// Adds a class on a frame.
    pub fn add(&mut self, row: ClassOnFrame) {
        self.0.push(row);
    }

    /// Returns every class on every frame, in the order they were added.
    pub fn rows(&self) -> &[ClassOnFrame] {
        &self.0
    }

    /// Returns the IoU by the paper's protocol (method §9.5): only classes that are labelled
    /// on a frame count.
    pub fn paper(&self) -> IouReport {
        report(self.0.iter().filter(|r| r.is_labelled()))
    }

    /// Returns the IoU by a strict protocol: a class that is predicted but not labelled also counts, as 0, so
    /// that false finds cost something. Classes that are neither labelled nor predicted are not counted.
    pub fn strict(&self) -> IouReport {
        report(self.0.iter())
    }

    /// Returns all measures, together and by class.
    pub fn summary(&self) -> MaskSummary {
        let mut classes: BTreeMap<String, Vec<&ClassOnFrame>> = BTreeMap::new();
        self.0.iter().for_each(|row| classes.entry(row.class.clone()).or_default().push(row));
        MaskSummary {
            all: ClassSummary::of(self.0.iter()),
            classes: classes
                .into_iter()
                .map(|(name, rows)| (name, ClassSummary::of(rows.into_iter())))
                .collect(),
        }
    }
}

/// All measures of a set of masks.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct MaskSummary {
    /// Measures over all classes.
    #[serde(flatten)]
    pub all: ClassSummary,
    /// Measures by class.
    pub classes: BTreeMap<String, ClassSummary>,
}

/// Measures over frames; shares are 0–1, `None` if there is nothing to measure.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct ClassSummary {
    /// Number of (frame, class) pairs that are labelled.
    pub labelled: usize,
    /// Mean IoU of the labelled pairs.
    pub iou: Option<f64>,
    /// Mean Dice of the labelled pairs.
    pub dice: Option<f64>,
    /// Mean F-measure of their borders.
    pub boundary_f: Option<f64>,
    /// Right pixels among all predicted ones of all frames, those of absent classes included.
    pub precision: Option<f64>,
    /// Predicted pixels among all labelled ones of all frames.
    pub recall: Option<f64>,
    /// Predictions on frames where the class is absent.
    pub absent: Absent,
}

/// Share of the kept pixels from which on a prediction counts as a find; fewer are specks.
pub const LEAST_FIND: f64 = 0.0005;

fn is_find(row: &ClassOnFrame) -> bool {
    row.predicted_px > 0 && row.predicted_px as f64 >= LEAST_FIND * row.kept_px as f64
}

/// Measures of predictions on frames where a class is not labelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Absent {
    /// Number of (frame, class) pairs that are not labelled.
    pub pairs: usize,
    /// Share of these pairs on which something is predicted.
    pub false_positive_rate: Option<f64>,
    /// Share of these pairs on which at least [`LEAST_FIND`] of the kept pixels is predicted.
    pub false_find_rate: Option<f64>,
    /// Mean share of the kept pixels that is predicted there.
    pub area_fraction: Option<f64>,
}

impl ClassSummary {
    fn of<'a>(rows: impl Iterator<Item = &'a ClassOnFrame>) -> Self {
        let (labelled, absent): (Vec<_>, Vec<_>) = rows.partition(|r| r.is_labelled());
        let mean = |value: fn(&ClassOnFrame) -> Option<f64>, rows: &[&ClassOnFrame]| {
            num::mean(rows.iter().copied().filter_map(value))
        };
        let both: usize = labelled.iter().map(|r| r.both_px).sum();
        let predicted: usize = labelled.iter().chain(&absent).map(|r| r.predicted_px).sum();
        let truth: usize = labelled.iter().map(|r| r.labelled_px).sum();
        let share = |whole: usize| (whole > 0).then(|| both as f64 / whole as f64);
        Self {
            labelled: labelled.len(),
            iou: mean(|r| r.iou, &labelled),
            dice: mean(|r| r.dice, &labelled),
            boundary_f: mean(|r| r.boundary_f, &labelled),
            precision: share(predicted),
            recall: share(truth),
            absent: Absent {
                pairs: absent.len(),
                false_positive_rate: mean(|r| Some(f64::from(r.predicted_px > 0)), &absent),
                false_find_rate: mean(|r| Some(f64::from(is_find(r))), &absent),
                area_fraction: mean(|r| Some(r.predicted_px as f64 / r.kept_px.max(1) as f64), &absent),
            },
        }
    }
}

fn report<'a>(rows: impl Iterator<Item = &'a ClassOnFrame>) -> IouReport {
    let mut sums: BTreeMap<&str, (f64, usize)> = BTreeMap::new();
    for (row, iou) in rows.filter_map(|r| r.iou.map(|iou| (r, iou))) {
        let (sum, count) = sums.entry(&row.class).or_default();
        *sum += iou;
        *count += 1;
    }
    let (total, count) = sums.values().fold((0.0, 0), |(t, n), (sum, count)| (t + sum, n + count));
    IouReport {
        mean: (count > 0).then(|| total / count as f64),
        classes: sums
            .into_iter()
            .map(|(class, (sum, count))| (class.to_owned(), sum / count as f64))
            .collect(),
    }
}

/// Confusion of classes: pixels per labelled and predicted class.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Confusion {
    /// The classes; the last column of the counts after them is "none".
    pub classes: Vec<String>,
    /// Numbers of pixels, [labelled class][predicted class or none].
    pub pixels: Vec<Vec<u64>>,
}

impl Confusion {
    /// Creates a table in which nothing is counted yet.
    pub fn new(classes: Vec<String>) -> Self {
        let pixels = vec![vec![0; classes.len() + 1]; classes.len()];
        Self { classes, pixels }
    }

    /// Counts the kept pixels of a frame. Both images hold indices into the classes; any other value is
    /// no class. Images of differing sizes are not counted.
    pub fn add(&mut self, predicted: &Grid<u8>, labelled: &Grid<u8>, keep: &Mask) {
        let none = self.classes.len();
        let sizes = [labelled.data.len(), keep.data.len()];
        if sizes != [predicted.data.len(); 2] {
            return;
        }
        for ((p, l), _) in
            predicted.data.iter().zip(&labelled.data).zip(&keep.data).filter(|(_, keep)| **keep)
        {
            if let Some(row) = self.pixels.get_mut(usize::from(*l)) {
                row[usize::from(*p).min(none)] += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(v: [u8; 4]) -> Mask {
        Mask::from_vec(4, 1, v.iter().map(|&b| b == 1).collect())
    }

    fn scores(rows: &[(&str, [u8; 4], [u8; 4])], keep: [u8; 4]) -> MaskScores {
        let mut scores = MaskScores::default();
        for (frame, (class, prediction, truth)) in rows.iter().enumerate() {
            let row = ClassOnFrame::measure(frame, class, &grid(*prediction), &grid(*truth), &grid(keep));
            scores.add(row.unwrap());
        }
        scores
    }

    #[test]
    fn absent_classes_cost_nothing_in_the_paper_and_something_when_strict() {
        let rows = [
            // Half right; labelled pixels outside the keep mask still count against the prediction.
            ("liver", [1, 0, 0, 1], [1, 0, 0, 1]),
            ("liver", [1, 1, 0, 0], [1, 1, 0, 0]),
            ("blood", [0, 0, 1, 0], [0, 0, 0, 0]),
            ("fat", [0, 0, 0, 1], [0, 0, 0, 0]),
        ];
        let scores = scores(&rows, [1, 1, 1, 0]);
        let (paper, strict) = (scores.paper(), scores.strict());
        assert_eq!(paper.mean, Some(0.75));
        assert_eq!(paper.classes, BTreeMap::from([("liver".to_owned(), 0.75)]));
        assert_eq!(strict.mean, Some(0.5));
        assert_eq!(strict.classes["blood"], 0.0);
        assert!(!strict.classes.contains_key("fat"), "absent and not predicted is not counted");
        assert_eq!(MaskScores::default().paper().mean, None);
        let wrong = ClassOnFrame::measure(0, "fat", &Mask::filled(1, 1, true), &grid([1; 4]), &grid([1; 4]));
        assert!(wrong.unwrap_err().to_string().contains("differ in size"));
    }

    #[test]
    fn the_mean_is_over_pairs_not_over_classes() {
        let (yes, no) = ([1; 4], [0; 4]);
        let rows = [("liver", yes, yes), ("liver", yes, yes), ("liver", yes, yes), ("blood", no, yes)];
        assert_eq!(scores(&rows, yes).paper().mean, Some(0.75));
    }

    #[test]
    fn every_measure_of_known_masks() {
        let rows = [
            ("liver", [1, 1, 1, 0], [0, 1, 1, 1]),
            ("liver", [1, 0, 0, 0], [0, 0, 0, 0]),
            ("fat", [0, 0, 0, 0], [0, 0, 0, 0]),
        ];
        let scores = scores(&rows, [1; 4]);
        let first = &scores.rows()[0];
        assert_eq!((first.iou, first.dice), (Some(0.5), Some(2.0 / 3.0)));
        assert_eq!((first.precision, first.recall), (Some(2.0 / 3.0), Some(2.0 / 3.0)));
        let absent = &scores.rows()[1];
        assert_eq!((absent.iou, absent.precision, absent.recall), (Some(0.0), Some(0.0), None));
        assert_eq!((scores.rows()[2].iou, scores.rows()[2].dice), (None, None));
        let summary = scores.summary();
        assert_eq!((summary.all.labelled, summary.all.absent.pairs), (1, 2));
        assert_eq!((summary.all.precision, summary.all.recall), (Some(0.5), Some(2.0 / 3.0)));
        assert_eq!(summary.all.absent.false_positive_rate, Some(0.5));
        assert_eq!(summary.all.absent.area_fraction, Some(0.125));
        assert_eq!(summary.classes["fat"].absent.false_positive_rate, Some(0.0));
        assert_eq!((summary.classes["fat"].iou, summary.classes["liver"].dice), (None, Some(2.0 / 3.0)));
    }

    #[test]
    fn confusion_counts_kept_pixels_of_known_labels() {
        let mut confusion = Confusion::new(vec!["liver".into(), "fat".into()]);
        let image = |v: [u8; 4]| Grid::from_vec(4, 1, v.to_vec());
        confusion.add(&image([0, 1, 9, 0]), &image([0, 0, 1, 255]), &grid([1, 1, 1, 1]));
        confusion.add(&image([0, 0, 0, 0]), &image([0, 1, 1, 1]), &grid([0, 1, 0, 0]));
        assert_eq!(confusion.pixels, [[1, 1, 0], [1, 0, 1]]);
        let before = confusion.clone();
        confusion.add(&Grid::filled(1, 1, 0), &image([0; 4]), &grid([1; 4]));
        assert_eq!(confusion, before);
    }
}
