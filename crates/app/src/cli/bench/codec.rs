//! `bench codec`: the effect of compressing text embeddings to a few numbers on classes and their prompts.

use super::measure::{Files, Measure};
use crate::{
    cli::{
        console::{ProgressView, print_report, say},
        verb::Exit,
    },
    tables,
};
use clap::Args;
use ndarray::{Array2, Axis};
use rand::{SeedableRng, seq::index::sample};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    codec::{Codec, CodecSettings},
    files::Inputs,
    num,
    progress::unobserved,
    reading::npy,
    relevancy::{Fidelity, RelevancySettings, fidelity},
};

const HINT: &str = "Give a folder with one table of embeddings, NAME.npy [texts, dim].";

/// Compress text embeddings and count which classes and prompts survive it: codec.csv
#[derive(Debug, Args)]
pub(super) struct BenchCodecArgs {
    /// A folder with one table of text embeddings, NAME.npy [texts, dim]
    #[arg(long, value_name = "DIR")]
    embeddings: PathBuf,
    /// Numbers of classes that a scene has
    #[arg(long, value_delimiter = ',', default_value = "7,13,50", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    classes: Vec<u32>,
    /// Latent numbers per pixel
    #[arg(long, value_delimiter = ',', default_value = "3,4,8,16", value_parser = clap::value_parser!(u32).range(1..=16))]
    latent: Vec<u32>,
    /// Number of draws of classes from the table; results are means
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    draws: u32,
    /// Folder for codec.csv
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Way in which classes are drawn from the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Draw {
    /// Any classes.
    Random,
    /// A random class and those nearest to it: the hardest to keep apart.
    Alike,
}

/// Embeddings that a prompt is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
enum Negatives {
    /// The other classes.
    Classes,
    /// The mean of the whole table: a stand-in for "object", "things", "stuff", "texture".
    Generic,
}

/// Row of the results: means over the draws.
#[derive(serde::Serialize)]
struct Row {
    classes: usize,
    draw: Draw,
    latent: usize,
    negatives: Negatives,
    top: f64,
    top_noisy: f64,
    order: f64,
    found: f64,
    alone: f64,
    same: f64,
    score_error: f64,
}

impl Measure for BenchCodecArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let inputs = Inputs::none().with("the embeddings", &self.embeddings);
        let files = Files::claim(self.output.as_ref(), &inputs, force)?;
        let file = the_table(&self.embeddings)?;
        let table = read(&file)?;
        let most = self.classes.iter().max().map_or(0, |n| *n as usize);
        if most > table.nrows() {
            let what = format!("{most} classes are asked for, the table has {}", table.nrows());
            return Err(Error::input_at(&file, what, "Ask for fewer with `--classes`."));
        }
        say(&format!("{} texts of {} numbers", table.nrows(), table.ncols()));
        let mut view = ProgressView::default();
        let all = self.classes.len() * self.latent.len() * 2;
        let mut rows = Vec::new();
        for &classes in &self.classes {
            for draw in [Draw::Random, Draw::Alike] {
                for &latent in &self.latent {
                    view.count("training codecs", rows.len() / 2, all)?;
                    rows.extend(measure(&table, classes as usize, draw, latent as usize, self.draws)?);
                }
            }
        }
        drop(view);
        let csv = tables::csv(&rows)?;
        files.write("codec.csv", &csv)?;
        print_report(&rows, &String::from_utf8_lossy(&csv), self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

/// Returns the only `.npy` file of a folder.
pub(super) fn the_table(folder: &Path) -> Result<PathBuf> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io("list the folder", folder, e))?;
    let paths = entries.flatten().map(|entry| entry.path());
    let tables: Vec<PathBuf> = paths.filter(|p| p.extension().is_some_and(|e| e == "npy")).collect();
    match &tables[..] {
        [one] => Ok(one.clone()),
        _ => Err(Error::input_at(folder, format!("the folder holds {} .npy files", tables.len()), HINT)),
    }
}

/// Reads a table and scales its rows to unit length.
pub(super) fn read(file: &Path) -> Result<Array2<f32>> {
    let wrong = |what: String| Error::input_at(file, what, HINT);
    let (shape, values) = npy(file)?;
    let [n, dim] = shape[..] else {
        return Err(wrong(format!("expected a table [texts, dim], found the shape {shape:?}")));
    };
    let values: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
    let mut flat = Vec::with_capacity(values.len());
    for (i, row) in values.chunks_exact(dim.max(1)).enumerate() {
        flat.extend(num::normalised(row).ok_or_else(|| wrong(format!("row {i} is zero or not finite")))?);
    }
    Array2::from_shape_vec((n, dim), flat).map_err(|e| wrong(e.to_string()))
}

/// Measures one setting; returns a row of the results for each kind of negatives.
fn measure(table: &Array2<f32>, classes: usize, draw: Draw, latent: usize, draws: u32) -> Result<[Row; 2]> {
    let mean = table.mean_axis(Axis(0)).map(|m| m.to_vec()).and_then(|m| num::normalised(&m));
    let generic: Vec<(String, Vec<f32>)> = mean.into_iter().map(|m| ("generic".to_owned(), m)).collect();
    let mut sums = [[0.0; 7]; 2];
    for seed in 0..u64::from(draws) {
        let rows = table.select(Axis(0), &drawn(table, classes, draw, seed));
        let settings = CodecSettings { latent_dim: latent, seed, ..CodecSettings::default() };
        let codec = Codec::train(rows.view(), &vec![1.0; classes], &settings, &mut unobserved)?;
        for (sums, negatives) in sums.iter_mut().zip([Negatives::Classes, Negatives::Generic]) {
            let by_classes = negatives == Negatives::Classes;
            let settings = RelevancySettings { class_negatives: by_classes, ..Default::default() };
            let phrases = if by_classes { &[][..] } else { &generic };
            let kept = values(&fidelity(&codec, rows.view(), phrases, &settings)?);
            sums.iter_mut().zip(kept).for_each(|(sum, value)| *sum += value / f64::from(draws));
        }
    }
    let row = |negatives, [top, top_noisy, order, found, alone, same, score_error]: [f64; 7]| Row {
        classes,
        draw,
        latent,
        negatives,
        top,
        top_noisy,
        order,
        found,
        alone,
        same,
        score_error,
    };
    Ok([row(Negatives::Classes, sums[0]), row(Negatives::Generic, sums[1])])
}

fn values(f: &Fidelity) -> [f64; 7] {
    [f.top, f.top_noisy, f.order, f.found, f.alone, f.same, f.score_error]
}

/// Draws the indices of `n` different rows.
pub(super) fn drawn(table: &Array2<f32>, n: usize, draw: Draw, seed: u64) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    match draw {
        Draw::Random => sample(&mut rng, table.nrows(), n).into_vec(),
        Draw::Alike => {
            let first = sample(&mut rng, table.nrows(), 1).index(0);
            let cosines = table.dot(&table.row(first));
            let mut order: Vec<usize> = (0..table.nrows()).collect();
            order.sort_by(|&a, &b| cosines[b].total_cmp(&cosines[a]));
            order.truncate(n);
            order
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alike_classes_are_the_nearest_and_random_ones_differ() {
        let table = Array2::from_shape_fn((40, 2), |(i, c)| {
            let angle = i as f32 * 0.03;
            if c == 0 { angle.cos() } else { angle.sin() }
        });
        let mut alike = drawn(&table, 5, Draw::Alike, 1);
        alike.sort_unstable();
        assert_eq!(alike[4] - alike[0], 4, "{alike:?}");
        let mut random = drawn(&table, 40, Draw::Random, 1);
        random.sort_unstable();
        assert_eq!(random, (0..40).collect::<Vec<_>>());
    }
}
