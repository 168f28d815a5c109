//! `bench words`: how often words for what is absent are found, and other words for what is there are not.

use super::{
    codec::{read, the_table},
    measure::{Files, Measure},
};
use crate::{
    cli::{args::encoder_choice, console::print_report, verb::Exit},
    engine::{EncoderChoice, open_text_encoder},
    tables,
};
use clap::{Args, ValueHint};
use ndarray::{Array2, Axis};
use rand::{SeedableRng, seq::index::sample};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};
use surgtpgs_clip::TextEncoder;
use surgtpgs_core::{
    Error, Result,
    codec::{Codec, CodecSettings},
    files::Inputs,
    meaning::{Calibration, ClassWords, Interpreter, Meaning, Space, Vocabulary},
    progress::unobserved,
    reading::read_text,
    relevancy::{Exact, Points, Query, Relevancy, RelevancySettings, Rivals},
};

/// Ask lists of words of a list of classes, and count false finds and misses: words.csv
#[derive(Debug, Args)]
pub(super) struct BenchWordsArgs {
    /// `builtin`, or a text encoder's folder
    #[arg(long, value_name = "DIR|builtin", value_hint = ValueHint::DirPath, default_value = "builtin")]
    text_encoder: String,
    /// Names of the classes that a recording shows, one a line
    #[arg(long, value_name = "FILE", required_unless_present = "embeddings")]
    classes: Option<PathBuf>,
    /// Words for what is not in that list, one a line
    #[arg(long, value_name = "FILE")]
    absent: Option<PathBuf>,
    /// Other words for what is in the list: words, a tab, and the class, one a line
    #[arg(long, value_name = "FILE")]
    other: Option<PathBuf>,
    /// Instead of words: a folder with one table of embeddings, NAME.npy [texts, dim]. Of it 13 alike texts are
    /// classes, 300 compete, and 200 are asked
    #[arg(long, value_name = "DIR", conflicts_with_all = ["classes", "absent", "other"])]
    embeddings: Option<PathBuf>,
    /// Number of draws from the table
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    draws: u32,
    /// Folder for words.csv
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// A word that was asked, and what it was taken for.
#[derive(serde::Serialize)]
struct Row {
    words: String,
    /// Class that the words mean; empty if none.
    meant: String,
    /// Classes that were found, between semicolons.
    found: String,
    nearest: String,
    certainty: f32,
    is_right: bool,
    why: String,
}

/// Shares of the words asked, 0–1.
#[derive(serde::Serialize)]
struct Report {
    /// Number of words for what is absent.
    absent: usize,
    /// Share of them that was found.
    absent_found: f64,
    /// Number of other words for what is there.
    other: usize,
    /// Share of them that was found as their class, and as nothing else.
    other_found: f64,
}

impl Measure for BenchWordsArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let inputs = [&self.classes, &self.absent, &self.other, &self.embeddings];
        let inputs = inputs.into_iter().flatten().fold(Inputs::none(), |all, path| all.with("a list", path));
        let files = Files::claim(self.output.as_ref(), &inputs, force)?;
        let report = if let Some(folder) = &self.embeddings {
            of_embeddings(&read(&the_table(folder)?)?, self.draws)?
        } else {
            let rows = self.ask()?;
            files.write("words.csv", &tables::csv(&rows)?)?;
            Report::of(&rows)
        };
        print_report(&report, &report.as_text(), self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

impl BenchWordsArgs {
    /// Asks all words of the lists.
    fn ask(&self) -> Result<Vec<Row>> {
        let mut encoder = match encoder_choice(&self.text_encoder) {
            EncoderChoice::Folder(folder) => open_text_encoder(&folder)?,
            EncoderChoice::Builtin | EncoderChoice::OfScene => TextEncoder::builtin()?,
        };
        let names = lines(self.classes.as_deref())?;
        let texts: Vec<&str> = names.iter().map(String::as_str).collect();
        let rows = encoder.encode_prompts(&texts)?;
        let classes: Vec<ClassWords> =
            names.iter().zip(&rows).map(|(name, row)| ClassWords::seen(name, row)).collect();
        let sha256 = encoder.identity().sha256.clone();
        let space = Space::new(Vocabulary::standard(), &sha256, &mut |words| encoder.encode_prompts(words))?;
        let calibration = Calibration::measure(&space, &classes);
        let interpreter = Interpreter::new(Vocabulary::standard(), &classes, Some(&calibration));
        let mut ask = |words: &str, meant: &str| -> Result<Row> {
            let embedding = encoder.encode_prompts(&[words])?.swap_remove(0);
            let meaning = match interpreter.by_words(words) {
                Some(meaning) => {
                    let nearest = meaning.nearest.or_else(|| interpreter.nearest(&embedding));
                    Meaning { nearest, ..meaning }
                }
                None => interpreter.by_encoder(words, &embedding, &space),
            };
            Ok(Row::new(words, meant, &meaning, &names))
        };
        let mut asked = Vec::new();
        for words in lines(self.absent.as_deref())? {
            asked.push(ask(&words, "")?);
        }
        for line in lines(self.other.as_deref())? {
            let Some((words, class)) =
                line.split_once('\t').filter(|(_, class)| names.iter().any(|n| n == class))
            else {
                let what = format!("\"{line}\" is not words, a tab and one of the classes");
                return Err(Error::input(what, "Correct the list of other words."));
            };
            asked.push(ask(words, class)?);
        }
        Ok(asked)
    }
}

impl Row {
    fn new(words: &str, meant: &str, meaning: &Meaning, names: &[String]) -> Self {
        let classes = meaning.classes.iter().filter(|_| meaning.is_found());
        let found = classes.map(|&k| names[k].as_str()).collect::<Vec<_>>().join("; ");
        Self {
            words: words.to_owned(),
            is_right: found == meant,
            meant: meant.to_owned(),
            found,
            nearest: meaning.nearest.map_or(String::new(), |k| names[k].clone()),
            certainty: meaning.probability,
            why: meaning.reason.to_string(),
        }
    }
}

impl Report {
    fn of(rows: &[Row]) -> Self {
        let (absent, other): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| row.meant.is_empty());
        let right = |rows: &[&Row]| rows.iter().filter(|row| row.is_right).count();
        Self {
            absent: absent.len(),
            absent_found: share(absent.len() - right(&absent), absent.len()),
            other: other.len(),
            other_found: share(right(&other), other.len()),
        }
    }

    fn as_text(&self) -> String {
        format!(
            "absent words found            {:.1} % of {}\nother words found as their class {:.1} % of {}\n",
            100.0 * self.absent_found,
            self.absent,
            100.0 * self.other_found,
            self.other
        )
    }
}

fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

/// Returns the lines of a file that hold anything; none without a file.
fn lines(file: Option<&Path>) -> Result<Vec<String>> {
    let Some(file) = file else { return Ok(Vec::new()) };
    let text = read_text(file).map_err(|e| Error::io("read the list", file, e))?;
    Ok(text.lines().map(str::trim_end).filter(|line| !line.trim().is_empty()).map(str::to_owned).collect())
}

/// Number of texts of a table that are classes, that compete besides, and that are asked.
const DRAWN: [usize; 3] = [13, 300, 200];

/// Asks texts of a table of which nothing but their embeddings is known: each competes with all classes and
/// with further texts, on the classes' features after the codec.
fn of_embeddings(table: &Array2<f32>, draws: u32) -> Result<Report> {
    let [classes, others, asked] = DRAWN;
    if table.nrows() < classes + others + asked {
        let what = format!("the table has {} texts, {} are needed", table.nrows(), classes + others + asked);
        return Err(Error::input(what, "Give a larger table."));
    }
    let (mut false_finds, mut own_found) = (0, 0);
    for seed in 0..u64::from(draws) {
        let drawn = super::codec::drawn(table, classes, super::codec::Draw::Alike, seed);
        let rest: Vec<usize> = (0..table.nrows()).filter(|i| !drawn.contains(i)).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let more: Vec<usize> = sample(&mut rng, rest.len(), others + asked).iter().map(|i| rest[i]).collect();
        let rows = table.select(Axis(0), &drawn);
        let codec = Codec::train(
            rows.view(),
            &vec![1.0; classes],
            &CodecSettings { seed, ..CodecSettings::default() },
            &mut unobserved,
        )?;
        let latents: Vec<f32> = codec.encode(rows.view()).iter().copied().collect();
        let points = Points::of_latents(&latents, codec.latent_dim());
        let row = |i: usize| table.row(i).to_vec();
        let competing: Vec<Vec<f32>> = drawn.iter().chain(&more[..others]).map(|&i| row(i)).collect();
        let rivals = Rivals::new(competing.iter().map(|row| ("", row.as_slice())));
        let own = (0..classes).map(|k| Query::new("own", row(drawn[k])).among(&rivals, vec![k]));
        let foreign = more[others..].iter().map(|&i| Query::new("other", row(i)).among(&rivals, Vec::new()));
        let queries: Vec<Query> = own.chain(foreign).collect();
        let settings = RelevancySettings::default();
        let scores = Exact::new(codec.clone()).score_points(&points, &queries, &settings);
        own_found += (0..classes).filter(|&k| scores[k][k] > settings.threshold).count();
        let is_found = |scores: &&Vec<f32>| scores.iter().any(|score| *score > settings.threshold);
        false_finds += scores[classes..].iter().filter(is_found).count();
    }
    let draws = draws as usize;
    Ok(Report {
        absent: asked * draws,
        absent_found: share(false_finds, asked * draws),
        other: classes * draws,
        other_found: share(own_found, classes * draws),
    })
}
