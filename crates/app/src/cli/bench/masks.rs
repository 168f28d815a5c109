//! `bench masks`: the fit of automatic masks to label masks, and the time they take, for every density.

use super::measure::{Files, Measure};
use crate::{
    cli::{
        args::MaskDensity,
        console::{ProgressView, print_report, say},
        verb::Exit,
    },
    jobs::Progress,
    pictures::png,
    tables,
};
use clap::Args;
use image::{Rgb, RgbImage};
use std::{path::PathBuf, time::Instant};
use surgtpgs_clip::SegmentAnything;
use surgtpgs_core::{
    Error, Result,
    files::Inputs,
    grid::{Grid, Mask},
    mask,
    num::spread,
    segment::{FrameMasks, Level, MaskSettings, automatic_masks},
    sequence::{Class, NO_LABEL, Sequence},
};

/// Compare automatic masks with label masks, for every density: masks.csv, and pictures of them
#[derive(Debug, Args)]
pub(super) struct BenchMasksArgs {
    /// A recording with label masks
    sequence: PathBuf,
    /// A folder with encoder and decoder of a Segment Anything (.onnx, .ort)
    #[arg(long, value_name = "DIR")]
    masks_model: PathBuf,
    /// Frames to measure, evenly spread
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Density of the points at which masks are asked for
    #[arg(long, value_enum, value_delimiter = ',', default_value = "coarse,medium,fine")]
    density: Vec<MaskDensity>,
    /// Folder for masks.csv and pictures
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Measurements of one density on one recording.
#[derive(serde::Serialize)]
struct Outcome {
    density: &'static str,
    frames: usize,
    /// Masks of the default level per frame.
    masks: f64,
    /// Share of the supervised pixels that a mask of the default level covers.
    covered: f64,
    /// Seconds per frame: encoder, decoder, everything else.
    encoder_s: f64,
    decoder_s: f64,
    rest_s: f64,
    classes: Vec<Fit>,
}

/// Fit of masks to one class, means over the frames that show it.
#[derive(serde::Serialize)]
struct Fit {
    class: String,
    /// IoU of the one mask, of any level, that fits best.
    best_iou: f64,
    /// IoU of all regions of the default level that show mostly this class, taken together: what
    /// perfect embeddings could reach.
    joint_iou: f64,
}

impl Measure for BenchMasksArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let sequence = Sequence::open(&self.sequence)?;
        let inputs = Inputs::none().with_recording(&sequence).with("the model", &self.masks_model);
        let files = Files::claim(self.output.as_ref(), &inputs, force)?;
        if sequence.classes().is_empty() {
            return Err(Error::input_at(
                sequence.path(),
                "the recording has no label masks to compare with",
                "Give one that has.",
            ));
        }
        let mut model = SegmentAnything::open(&self.masks_model)?;
        say(&format!("{} on {}", model.generation(), surgtpgs_clip::backend_name()));
        let frames: Vec<usize> = spread(sequence.num_frames(), self.frames as usize).collect();
        let mut outcomes = Vec::new();
        for &density in &self.density {
            let outcome = measure(&mut model, &sequence, &frames, density, &files)?;
            say(&line(&outcome));
            outcomes.push(outcome);
        }
        let table = csv(&outcomes)?;
        files.write("masks.csv", &table)?;
        print_report(&outcomes, &String::from_utf8_lossy(&table), self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

fn measure(
    model: &mut SegmentAnything,
    sequence: &Sequence,
    frames: &[usize],
    density: MaskDensity,
    files: &Files,
) -> Result<Outcome> {
    let settings = MaskSettings::from(density);
    let name = density_name(density);
    let classes = sequence.classes();
    let mut fits = vec![(0.0, 0.0, 0_usize); classes.len()];
    let (mut masks, mut covered, mut seconds) = (0, 0.0, 0.0);
    let network_before = model.network_time();
    let mut view = ProgressView::default();
    for (done, &i) in frames.iter().enumerate() {
        let (image, keep) = (sequence.frame(i)?, sequence.mask(i)?);
        let started = Instant::now();
        let mut tell = |of_frame: &Progress<'_>| {
            let detail = format!("point {} of {}", of_frame.done, of_frame.total);
            view.show(&Progress { detail: &detail, ..Progress::new(name, done, frames.len()) })
        };
        let found = automatic_masks(model, &image, &keep, &settings, &mut tell)?;
        seconds += started.elapsed().as_secs_f64();
        masks += found.level(Level::Default).len();
        let painted = found.painted(Level::Default);
        let inside = painted.data.iter().zip(&keep.data).filter(|(m, k)| **k && m.is_some()).count();
        covered += inside as f64 / keep.count().max(1) as f64;
        if files.folder().is_some() {
            files.write(&format!("{name}_{i:06}.png"), &png(drawn(&image, &found))?)?;
        }
        let Some(labels) = sequence.labels(i)? else { continue };
        let shown = shown_classes(&painted, &labels, &keep);
        for (class, fit) in classes.iter().zip(&mut fits) {
            let truth = within(&labels.map(|l| *l == class.id), &keep);
            if truth.count() > 0 {
                let joint = mask::iou(&shown.map(|l| *l == class.id), &truth).unwrap_or(0.0);
                *fit = (fit.0 + best_iou(&found, &truth, &keep), fit.1 + joint, fit.2 + 1);
            }
        }
    }
    drop(view);
    let [encoder_s, decoder_s] =
        [0, 1].map(|k| (model.network_time()[k] - network_before[k]).as_secs_f64() / frames.len() as f64);
    Ok(Outcome {
        density: name,
        frames: frames.len(),
        masks: masks as f64 / frames.len() as f64,
        covered: covered / frames.len() as f64,
        encoder_s,
        decoder_s,
        rest_s: seconds / frames.len() as f64 - encoder_s - decoder_s,
        classes: classes.iter().zip(fits).filter_map(fit).collect(),
    })
}

fn fit((class, (best, joint, n)): (&Class, (f64, f64, usize))) -> Option<Fit> {
    (n > 0).then(|| Fit { class: class.name.clone(), best_iou: best / n as f64, joint_iou: joint / n as f64 })
}

fn density_name(density: MaskDensity) -> &'static str {
    match density {
        MaskDensity::Coarse => "coarse",
        MaskDensity::Medium => "medium",
        MaskDensity::Fine => "fine",
        MaskDensity::Paper => "paper",
    }
}

fn within(mask: &Mask, keep: &Mask) -> Mask {
    Grid::from_vec(mask.width, mask.height, mask.data.iter().zip(&keep.data).map(|(m, k)| *m && *k).collect())
}

fn best_iou(found: &FrameMasks, truth: &Mask, keep: &Mask) -> f64 {
    let all = Level::ALL.iter().flat_map(|level| found.level(*level));
    all.filter_map(|f| mask::iou(&within(&f.mask.to_mask(), keep), truth)).fold(0.0, f64::max)
}

/// Returns for each pixel the class that most of its region shows.
fn shown_classes(painted: &Grid<Option<u16>>, labels: &Grid<u8>, keep: &Mask) -> Grid<u8> {
    let regions = painted.data.iter().flatten().max().map_or(0, |n| usize::from(*n) + 1);
    let mut counts = vec![[0_u32; 256]; regions];
    let pixels = || painted.data.iter().zip(&labels.data).zip(&keep.data);
    for ((region, label), _) in pixels().filter(|(_, keep)| **keep) {
        if let (Some(region), true) = (region, *label != NO_LABEL) {
            counts[usize::from(*region)][usize::from(*label)] += 1;
        }
    }
    let most = |counts: &[u32; 256]| {
        let shown = (0..=255_u8).filter(|l| counts[usize::from(*l)] > 0);
        shown.max_by_key(|l| counts[usize::from(*l)]).unwrap_or(NO_LABEL)
    };
    let classes: Vec<u8> = counts.iter().map(most).collect();
    let data = pixels().map(|((region, _), keep)| match region {
        Some(region) if *keep => classes[usize::from(*region)],
        _ => NO_LABEL,
    });
    Grid::from_vec(painted.width, painted.height, data.collect())
}

/// Draws every region in a colour of its own over the picture.
fn drawn(image: &RgbImage, found: &FrameMasks) -> RgbImage {
    let painted = found.painted(Level::Default);
    let mut picture = image.clone();
    for ((_, _, pixel), region) in picture.enumerate_pixels_mut().zip(&painted.data) {
        if let Some(region) = region {
            // Steps of the golden ratio keep neighbouring numbers apart.
            let hue = (f32::from(*region) * 0.618_034).fract() * std::f32::consts::TAU;
            let colour = [0.0, 2.1, 4.2].map(|shift| 127.5 + 127.5 * (hue + shift).sin());
            *pixel = Rgb([0, 1, 2].map(|c| (0.45 * f32::from(pixel[c]) + 0.55 * colour[c]) as u8));
        }
    }
    picture
}

fn line(outcome: &Outcome) -> String {
    format!(
        "{}: {:.1} masks a frame cover {:.0} %, {:.1} s encoder, {:.1} s decoder, {:.2} s the rest",
        outcome.density,
        outcome.masks,
        100.0 * outcome.covered,
        outcome.encoder_s,
        outcome.decoder_s,
        outcome.rest_s
    )
}

fn csv(outcomes: &[Outcome]) -> Result<Vec<u8>> {
    let columns =
        ["density", "class", "best_iou", "joint_iou", "masks", "covered", "encoder_s", "decoder_s", "rest_s"];
    let rows = outcomes.iter().flat_map(|o| {
        let row = move |fit| (o.density, fit, o.masks, o.covered, o.encoder_s, o.decoder_s, o.rest_s);
        o.classes.iter().map(row)
    });
    tables::csv_under(&columns, &rows.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_class_of_a_density_has_a_row() {
        let fit = |class: &str| Fit { class: class.to_owned(), best_iou: 0.75, joint_iou: 0.5 };
        let outcome = Outcome {
            density: "fine",
            frames: 2,
            masks: 12.5,
            covered: 1.0,
            encoder_s: 2.0,
            decoder_s: 3.0,
            rest_s: 0.25,
            classes: vec![fit("liver"), fit("fat, or so")],
        };
        let text = String::from_utf8(csv(&[outcome]).unwrap()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "density,class,best_iou,joint_iou,masks,covered,encoder_s,decoder_s,rest_s");
        assert_eq!(lines[1], "fine,liver,0.75,0.5,12.5,1.0,2.0,3.0,0.25");
        assert!(lines[2].starts_with("fine,\"fat, or so\",0.75"), "{}", lines[2]);
    }
}
