//! Makes the built-in text encoder from `assets/text_encoder/lexicon.toml` (about ten minutes on one core):
//!
//! ```text
//! cargo run --release -p surgtpgs-clip --example train_builtin
//! ```
//!
//! The same lexicon and seed give the same files.

mod export;
mod lexicon;
mod model;
mod targets;
mod text;
mod train;

use std::{error::Error, fs, io::Write, path::Path};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/text_encoder");
    let lexicon = lexicon::Lexicon::parse(&fs::read_to_string(folder.join("lexicon.toml"))?)?;
    let mut plan = train::Plan::default();
    if let Some(steps) = std::env::args().nth(1) {
        plan.steps = steps.parse()?;
    }
    let mut progress = std::io::stderr();
    let trained = train::train(&lexicon, &plan, &mut |step, loss| {
        // A lost progress line is no reason to stop.
        let _ = writeln!(progress, "step {step}: loss {loss:.4}");
    })?;
    let misses = train::misses(&lexicon, &trained);
    for (cosine, phrase, concept) in misses.iter().take(10) {
        writeln!(progress, "{phrase} / {concept}: {cosine:.3}")?;
    }
    let model = export::onnx(&trained);
    writeln!(progress, "{} trigrams, {} bytes", trained.rows.count, model.len())?;
    fs::write(folder.join("model.onnx"), model)?;
    fs::write(folder.join("tokenizer.json"), text::tokenizer_json())?;
    Ok(())
}
