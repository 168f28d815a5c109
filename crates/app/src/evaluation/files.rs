//! The files of an evaluation: tables, the report with every row, and pictures to look at.

use super::{Evaluation, masks::Labelled, matrix};
use crate::{
    outputs,
    pictures::{png, side_by_side},
    tables::{csv, csv_under},
};
use image::{Rgb, RgbImage};
use std::path::Path;
use surgtpgs_core::{
    Result,
    files::{Inputs, write_whole},
    metrics::{ClassOnFrame, MaskScores},
    sequence::{Class, NO_LABEL},
};

/// Colours of pixels that were predicted as another class, and as none although they have one.
const WRONG: [u8; 3] = [213, 94, 0];
const MISSED: [u8; 3] = [0, 114, 178];

/// A row of `classes.csv`.
#[derive(serde::Serialize)]
struct ClassRow<'a> {
    protocol: &'static str,
    #[serde(flatten)]
    row: &'a ClassOnFrame,
}

/// Writes an evaluation into the folder `path`; an earlier one is replaced if `replace` says so.
pub(crate) fn write(path: &Path, inputs: &Inputs, replace: bool, evaluation: &Evaluation) -> Result<()> {
    let output = outputs::folder(path, outputs::EVALUATION, inputs, replace)?;
    write_files(output.path(), evaluation)?;
    output.finish()
}

/// Writes those of `eval.json`, `frames.csv`, `classes.csv`, `confusion.svg` and `errors/` that have content.
pub(crate) fn write_files(folder: &Path, evaluation: &Evaluation) -> Result<()> {
    let classes = &evaluation.classes;
    let protocols: Vec<(&'static str, &MaskScores)> =
        [Some(("threshold", &classes.threshold)), classes.argmax.as_ref().map(|a| ("argmax", &a.scores))]
            .into_iter()
            .flatten()
            .collect();
    let rows: Vec<ClassRow<'_>> = protocols
        .iter()
        .flat_map(|(protocol, scores)| scores.rows().iter().map(move |row| ClassRow { protocol, row }))
        .collect();
    let json = serde_json::json!({
        "report": evaluation.report,
        "frames": evaluation.frames,
        "classes": rows,
        "confusion": classes.argmax.as_ref().map(|a| &a.confusion),
    });
    let text = serde_json::to_string_pretty(&json).unwrap_or_default() + "\n";
    write_whole(&folder.join("eval.json"), text.as_bytes())?;
    if !evaluation.frames.is_empty() {
        write_whole(&folder.join("frames.csv"), &csv(&evaluation.frames)?)?;
    }
    if !rows.is_empty() {
        write_whole(&folder.join("classes.csv"), &csv_of_classes(&rows)?)?;
    }
    if let Some(argmax) = &classes.argmax {
        write_whole(&folder.join("confusion.svg"), matrix::svg(&argmax.confusion)?.as_bytes())?;
    }
    for frame in &classes.frames {
        let name = format!("errors/frame_{:06}.png", frame.frame);
        write_whole(&folder.join(name), &png(errors(frame, classes.all()))?)?;
    }
    Ok(())
}

/// Returns the rows as CSV. They are flattened here, since the csv crate does not write flattened structs.
fn csv_of_classes(rows: &[ClassRow<'_>]) -> Result<Vec<u8>> {
    let flat: Vec<_> = rows
        .iter()
        .map(|ClassRow { protocol, row: r }| {
            let counts = (r.labelled_px, r.predicted_px, r.both_px, r.kept_px);
            (*protocol, r.frame, &r.class, counts, (r.iou, r.dice, r.boundary_f, r.precision, r.recall))
        })
        .collect();
    let columns =
        "protocol,frame,class,labelled_px,predicted_px,both_px,kept_px,iou,dice,boundary_f,precision,recall";
    csv_under(&columns.split(',').collect::<Vec<_>>(), &flat)
}

/// Draws the labels, the prediction, and their differences, side by side.
fn errors(frame: &Labelled, classes: &[Class]) -> RgbImage {
    let (width, height) = frame.picture.dimensions();
    let colour = |k: u8| classes.get(usize::from(k)).map(|c| c.colour);
    let mixed = |a: u8, b: u8| ((u16::from(a) + u16::from(b)) / 2) as u8;
    let drawn = |pixel_colour: &dyn Fn(usize) -> Option<[u8; 3]>, grey: bool| {
        RgbImage::from_fn(width, height, |x, y| {
            let [r, g, b] = frame.picture.get_pixel(x, y).0;
            let under =
                if grey { [((u16::from(r) + u16::from(g) + u16::from(b)) / 6) as u8; 3] } else { [r, g, b] };
            let over = pixel_colour(y as usize * width as usize + x as usize);
            Rgb(over.map_or(under, |c| [0, 1, 2].map(|i| mixed(under[i], c[i]))))
        })
    };
    let difference = |i: usize| match (frame.predicted.data[i], frame.truth.data[i]) {
        (_, NO_LABEL) => None,
        (NO_LABEL, _) => Some(MISSED),
        (predicted, truth) if predicted != truth => Some(WRONG),
        _ => None,
    };
    side_by_side(&[
        drawn(&|i| colour(frame.truth.data[i]), false),
        drawn(&|i| colour(frame.predicted.data[i]), false),
        drawn(&difference, true),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use surgtpgs_core::grid::Grid;

    #[test]
    fn pictures_show_labels_prediction_and_errors() {
        let class = |colour| Class { id: 0, name: String::new(), colour };
        let frame = Labelled {
            frame: 0,
            predicted: Grid::from_vec(4, 1, vec![0, 1, NO_LABEL, 0]),
            truth: Grid::from_vec(4, 1, vec![0, 0, 0, NO_LABEL]),
            picture: RgbImage::from_pixel(4, 1, Rgb([60, 60, 60])),
        };
        let picture = errors(&frame, &[class([200, 0, 0]), class([0, 200, 0])]);
        let at = |panel: u32, x: u32| picture.get_pixel(panel * (picture.width() + 4) / 3 + x, 0).0;
        assert_eq!((at(0, 0), at(0, 3)), ([130, 30, 30], [60, 60, 60]));
        assert_eq!((at(1, 1), at(1, 2)), ([30, 130, 30], [60, 60, 60]));
        assert_eq!((at(2, 0), at(2, 3)), ([30; 3], [30; 3]), "right, and unknown");
        assert_eq!((at(2, 1)[0], at(2, 2)[2]), (121, 104));
    }

    #[test]
    fn tables_have_a_head_and_empty_fields() {
        let row = ClassOnFrame {
            frame: 3,
            class: "fat, or so".into(),
            labelled_px: 0,
            predicted_px: 0,
            both_px: 0,
            kept_px: 9,
            iou: None,
            dice: None,
            boundary_f: None,
            precision: None,
            recall: Some(0.5),
        };
        let text = String::from_utf8(csv_of_classes(&[ClassRow { protocol: "argmax", row: &row }]).unwrap())
            .unwrap();
        assert_eq!(text.lines().nth(1).unwrap(), "argmax,3,\"fat, or so\",0,0,0,9,,,,,0.5");
        assert_eq!(text.lines().next().unwrap().split(',').count(), 12);
    }
}
