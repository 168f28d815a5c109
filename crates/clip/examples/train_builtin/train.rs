//! The training run.

use crate::{
    lexicon::{Examples, Lexicon, Meaning},
    model::{self, Goal, HIDDEN_1, Rows, Trainer, Weights, dot},
    targets::Targets,
};
use half::f16;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Largest cosine of an unknown word with a concept that adds nothing to the loss.
const UNKNOWN_LIMIT: f32 = 0.25;

/// Length and speed of the training.
pub struct Plan {
    /// Steps of Adam.
    pub steps: usize,
    /// Texts per step.
    pub batch: usize,
    /// Learning rate at the start; it falls to 0 along a half cosine.
    pub rate: f32,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for Plan {
    fn default() -> Self {
        Self { steps: 40_000, batch: 64, rate: 2e-3, seed: 7 }
    }
}

/// A trained encoder, its weights rounded as in the file.
pub struct Trained {
    /// Table row of each trigram.
    pub rows: Rows,
    /// Weights; those of the table are rounded to the file's 8-bit integers.
    pub weights: Weights,
    /// Step of the 8-bit table for each column, [HIDDEN_1].
    pub table_scale: Vec<f32>,
}

/// Trains on a lexicon; `report` is called with the step and the mean loss now and then.
pub fn train(lexicon: &Lexicon, plan: &Plan, report: &mut dyn FnMut(usize, f32)) -> Result<Trained, String> {
    let rng = &mut ChaCha8Rng::seed_from_u64(plan.seed);
    let examples = Examples::new(lexicon);
    let rows = Rows::new(examples.texts());
    let targets = Targets::new(lexicon, &examples, &rows, rng)?;
    let mut trainer = Trainer::new(rows.count, rng);
    let mut table_scale = vec![1.0; HIDDEN_1];
    let mut mean_loss = 0.0;
    for step in 0..plan.steps {
        // The last eighth of the steps trains the layers after the table, to make up for the table's
        // rounding.
        if step == plan.steps * 7 / 8 {
            table_scale = round_table(&mut trainer.weights.table);
            trainer.is_table_frozen = true;
        }
        let drawn: Vec<_> = (0..plan.batch).map(|_| examples.draw(rng)).collect();
        let unknown: Vec<Vec<f32>> = drawn
            .iter()
            .map(|(_, meaning)| match meaning {
                Meaning::Concept(_) => vec![],
                Meaning::Unknown(own) => targets.unknown(&rows.of(own)),
            })
            .collect();
        let goals = drawn.iter().zip(&unknown).map(|((text, meaning), unknown)| {
            let goal = match meaning {
                Meaning::Concept(index) => Goal { target: targets.concept(*index), avoid: &[], limit: 1.0 },
                Meaning::Unknown(_) => {
                    Goal { target: unknown, avoid: &targets.concepts, limit: UNKNOWN_LIMIT }
                }
            };
            (rows.of(text), goal)
        });
        let progress = step as f32 / plan.steps as f32;
        let rate = plan.rate * 0.5 * (1.0 + (std::f32::consts::PI * progress).cos());
        mean_loss += 0.01 * (trainer.step(&goals.collect::<Vec<_>>(), rate) - mean_loss);
        if step % 1000 == 999 {
            report(step + 1, mean_loss);
        }
    }
    let mut weights = trainer.weights;
    for part in [&mut weights.dense_1, &mut weights.dense_2] {
        part.iter_mut().for_each(|w| *w = f16::from_f32(*w).to_f32());
    }
    Ok(Trained { rows, weights, table_scale })
}

/// Cosine of every phrase with its concept's name, the worst first: (cosine, phrase, concept).
pub fn misses<'a>(lexicon: &'a Lexicon, trained: &Trained) -> Vec<(f32, &'a str, &'a str)> {
    let embed = |text: &str| model::embed(&trained.weights, &trained.rows.of(text));
    let cosine = |(concept, phrase)| (dot(&embed(concept), &embed(phrase)), phrase, concept);
    let mut all: Vec<_> = lexicon.phrases().map(cosine).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// Rounds every column to 255 steps and returns the step of each column.
fn round_table(table: &mut [f32]) -> Vec<f32> {
    let mut scale = vec![1e-12f32; HIDDEN_1];
    for row in table.chunks_exact(HIDDEN_1) {
        scale.iter_mut().zip(row).for_each(|(s, v)| *s = s.max(v.abs() / 127.0));
    }
    for row in table.chunks_exact_mut(HIDDEN_1) {
        row.iter_mut().zip(&scale).for_each(|(v, s)| *v = (*v / s).round() * s);
    }
    scale
}
