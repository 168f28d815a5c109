//! Area, scores, position and motion of found regions, a row per frame and prompt, as CSV or JSON. CSV is for
//! people: frames count from 1 and have a time, as in the window; the names of its columns say so.

use super::{Series, SeriesPlan, list::JsonList};
use crate::{export::frame::FrameContent, files::WholeFile, mask::Region, sequence::USUAL_SPEED};
use serde_json::json;
use std::io;

/// A row, with the names of JSON. Numbers that do not exist are empty or null.
#[derive(serde::Serialize)]
pub(super) struct TableRow<'a> {
    frame: usize,
    time_s: Option<f64>,
    /// The time that the window shows, which may be by an assumed speed.
    #[serde(skip)]
    shown_time_s: f64,
    prompt: &'a str,
    area_px: Option<usize>,
    area_fraction: Option<f64>,
    mean_score: Option<f64>,
    max_score: Option<f32>,
    centroid_x_px: Option<f64>,
    centroid_y_px: Option<f64>,
    /// Distance of the centroid from its position on the last earlier frame on which the prompt was found.
    moved_px: Option<f64>,
    /// File name of the recorded frame.
    source: Option<&'a str>,
    /// `found`, `nearest` or `absent`; `not_shown` where the scene shows nothing.
    answer: &'static str,
}

/// A format that rows are written in.
pub(super) trait Rows {
    fn push(&mut self, row: &TableRow<'_>) -> io::Result<()>;
    fn finish(self) -> io::Result<WholeFile>;
}

pub(super) struct FrameTable<R> {
    rows: R,
    /// Last known centroid of each prompt.
    last: Vec<Option<[f64; 2]>>,
}

impl<R: Rows> FrameTable<R> {
    pub(super) fn begin(rows: R) -> Self {
        Self { rows, last: Vec::new() }
    }
}

impl<R: Rows> Series for FrameTable<R> {
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        self.last.resize(frame.masks.len(), None);
        for (((prompt, mask), scores), last) in frame.found().zip(frame.scores).zip(&mut self.last) {
            let region = frame.is_shown().then(|| Region::of(scores, mask));
            let region = region.as_ref();
            let here = region.and_then(|region| region.centroid_px);
            let moved = last.zip(here).map(|([x0, y0], [x, y])| (x - x0).hypot(y - y0));
            *last = here.or(*last);
            self.rows.push(&TableRow {
                frame: frame.frame,
                time_s: frame.provenance.seconds(frame.frame),
                shown_time_s: frame.provenance.shown_seconds(frame.frame),
                prompt: &prompt.text,
                area_px: region.map(|region| region.area_px),
                area_fraction: region.map(|region| region.area_fraction),
                mean_score: region.and_then(|region| region.mean_score),
                max_score: region.map(|region| region.max_score),
                centroid_x_px: here.map(|[x, _]| x),
                centroid_y_px: here.map(|[_, y]| y),
                moved_px: moved,
                source: frame.provenance.source(frame.frame),
                answer: region.map_or("not_shown", |region| prompt.answer(region.area_px > 0)),
            })?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> io::Result<WholeFile> {
        self.rows.finish()
    }
}

pub(super) struct Csv(csv::Writer<WholeFile>);

/// Names of the columns of CSV behind those of frame and time.
const COLUMNS: [&str; 10] = [
    "prompt",
    "area_px",
    "area_fraction",
    "mean_score",
    "max_score",
    "centroid_x_px",
    "centroid_y_px",
    "moved_px",
    "source",
    "answer",
];

impl Csv {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Self> {
        let mut rows = csv::WriterBuilder::new().has_headers(false).from_writer(file);
        let time = match plan.provenance.frames_per_second {
            Some(_) => "time_s".to_owned(),
            None => format!("time_s_if_{USUAL_SPEED}_fps"),
        };
        rows.write_record(["frame_from_1", &time].into_iter().chain(COLUMNS))?;
        Ok(Self(rows))
    }
}

impl Rows for Csv {
    fn push(&mut self, row: &TableRow<'_>) -> io::Result<()> {
        let place = (row.centroid_x_px, row.centroid_y_px, row.moved_px);
        let found = (row.prompt, row.area_px, row.area_fraction, row.mean_score, row.max_score);
        Ok(self.0.serialize((row.frame + 1, row.shown_time_s, found, place, row.source, row.answer))?)
    }

    fn finish(self) -> io::Result<WholeFile> {
        self.0.into_inner().map_err(|e| e.into_error())
    }
}

pub(super) struct Json(JsonList);

impl Json {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Self> {
        let SeriesPlan { provenance, frames, size: (width, height), .. } = plan;
        let head = json!({
            "sequence": provenance.sequence_name,
            "frames_per_second": provenance.frames_per_second,
            "frames": frames.len(),
            "width_px": width,
            "height_px": height,
            "prompts": provenance.prompts.iter().map(|p| &p.text).collect::<Vec<_>>(),
        });
        Ok(Self(JsonList::begin(file, &head, "measurements")?))
    }
}

impl Rows for Json {
    fn push(&mut self, row: &TableRow<'_>) -> io::Result<()> {
        self.0.push(row)
    }

    fn finish(self) -> io::Result<WholeFile> {
        self.0.finish()
    }
}
