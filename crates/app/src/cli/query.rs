//! `surgtpgs query`: the frames on which a scene shows the structures that the prompts name.

use super::{
    answers::{Answers, PromptAnswers, ask},
    args::{FrameArgs, MarkArgs, PromptArgs, RelevancyArgs, SceneArgs},
    console::{ProgressView, print, print_data, print_json, say},
    objects,
    verb::{Exit, Run},
};
use crate::{
    outputs,
    text::{one_line, visible},
};
use clap::Args;
use std::path::{Path, PathBuf};
use surgtpgs_core::Result;

/// Say on which frames a scene shows the structures that the prompts name
#[derive(Debug, Args)]
pub(super) struct QueryArgs {
    /// The scene
    #[command(flatten)]
    scene: SceneArgs,
    /// Prompts to look for
    #[command(flatten)]
    prompts: PromptArgs,
    /// Marks by hand
    #[command(flatten)]
    marks: MarkArgs,
    /// Path of the recording, by whose pictures marks are carried, if it is not where it was when training
    #[arg(long, value_name = "SEQ")]
    sequence: Option<PathBuf>,
    /// Frames to work on
    #[command(flatten)]
    frames: FrameArgs,
    /// Also write the Gaussians that each prompt finds on the frame where it covers most, as a .ply for splat
    /// viewers, and their place, size and motion over time, as objects.csv and objects.json
    #[arg(long, value_name = "DIR")]
    gaussians: Option<PathBuf>,
    /// Replace an earlier result in that folder, once the new one is whole
    #[arg(long, requires = "gaussians")]
    force: bool,
    /// Options for answering prompts
    #[command(flatten)]
    relevancy: RelevancyArgs,
    /// Report as JSON
    #[arg(long, conflicts_with = "csv")]
    json: bool,
    /// Report as CSV, a line per prompt and frame
    #[arg(long)]
    csv: bool,
}

impl Run for QueryArgs {
    fn run(&self) -> Result<Exit> {
        let mut engine = self.scene.open(&self.relevancy, self.sequence.clone())?;
        self.marks.give_to(&mut engine)?;
        if let (Some(_), Some(why)) = (engine.marks(), engine.recording_missing()) {
            say(&format!("note: marks are carried by the pictures of the reconstruction: {why}"));
        }
        let questions = self.prompts.questions(engine.settings())?;
        let frames = self.frames.of(engine.scene().num_frames())?;
        let inputs = engine.inputs(&self.scene.scene);
        let take = |folder| outputs::folder(folder, outputs::OBJECTS, &inputs, self.force);
        let objects = self.gaussians.as_deref().map(take).transpose()?;
        let mut view = ProgressView::default();
        let mut answers = ask(&mut engine, &questions, &frames, &mut |p| view.show(p))?;
        drop(view);
        if let Some((output, folder)) = objects.zip(self.gaussians.as_deref()) {
            objects::write(&mut engine, &mut answers, output.path(), folder)?;
            output.finish()?;
        }
        if self.json {
            print_json(&answers)?;
        } else if self.csv {
            print_data(&as_csv(&answers))?;
        } else {
            print(&as_text(&answers))?;
        }
        Ok(Exit::Done)
    }

    fn output(&self) -> Option<&Path> {
        self.gaussians.as_deref()
    }
}

fn as_text(answers: &Answers) -> String {
    let line = |prompt: &PromptAnswers| {
        let found = match prompt.largest() {
            None => prompt.why_not_found(),
            Some(largest) => format!(
                "found on {} of {} frames, largest on frame {} ({} px, {:.1} %)",
                prompt.frames_found(),
                prompt.frames_shown(),
                largest.frame,
                largest.area_px.unwrap_or(0),
                100.0 * largest.area_fraction.unwrap_or(0.0)
            ),
        };
        let caution = match prompt.max_score() {
            score if score < 0.5 && prompt.frames_found() > 0 => "; less likely than not",
            _ => "",
        };
        let written = prompt.gaussians.as_ref().map_or(String::new(), |g| {
            format!("  {} Gaussians of frame {}: {}\n", g.count, g.frame, g.file.display())
        });
        format!(
            "{}: {found}; best score {:.3}{caution}\n{written}",
            one_line(&prompt.text),
            prompt.max_score()
        )
    };
    let look_here = answers.look_here.as_ref().map(|here| {
        let [x, y] = here.point_px;
        format!("look here: one more mark would help most on frame {}, around ({x:.0}, {y:.0})\n", here.frame)
    });
    answers.prompts.iter().map(line).chain(look_here).collect()
}

/// Columns of the report as CSV.
const COLUMNS: &str =
    "prompt,frame,found,area_px,area_fraction,max_score,source,answer,nearest,needs_mark,not_understood";

fn as_csv(answers: &Answers) -> String {
    let mut text = format!("{COLUMNS}\n");
    for prompt in &answers.prompts {
        let name = quoted(&prompt.text);
        for f in &prompt.frames {
            text += &format!(
                "{name},{},{},{},{},{},{},{},{},{},{}\n",
                f.frame,
                f.found,
                cell(f.area_px),
                cell(f.area_fraction),
                cell(f.max_score),
                f.source.as_deref().map_or(String::new(), quoted),
                f.answer.name(),
                f.nearest.as_deref().map_or(String::new(), quoted),
                prompt.needs_mark,
                prompt.not_understood
            );
        }
    }
    text
}

/// Returns a CSV field of a number, empty if there is none.
fn cell(number: Option<impl ToString>) -> String {
    number.map_or(String::new(), |number| number.to_string())
}

/// Returns a CSV field in quotes, with invisible characters escaped as in the report as text.
fn quoted(text: &str) -> String {
    format!("\"{}\"", visible(text).replace('"', "\"\""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{Negatives, Question, asking_tests::unfinished_engine};
    use surgtpgs_core::progress::unobserved;

    #[test]
    fn the_table_tells_words_that_are_not_understood_from_absent_ones() {
        let mut engine = unfinished_engine();
        let negatives = Negatives::of(engine.settings());
        let questions = ["liver", "spleen", "Leber"].map(|words| Question::words(words, negatives.clone()));
        let table = as_csv(&ask(&mut engine, &questions, &[0], &mut unobserved).unwrap());
        let column = |name: &str| -> Vec<&str> {
            let at = COLUMNS.split(',').position(|column| column == name).unwrap();
            table.lines().skip(1).map(|line| line.split(',').nth(at).unwrap()).collect()
        };
        assert_eq!(column("answer"), ["found", "absent", "absent"], "{table}");
        assert_eq!(column("not_understood"), ["false", "false", "true"], "{table}");
        assert_eq!(column("needs_mark"), ["false"; 3], "{table}");
    }

    #[test]
    fn the_table_holds_nothing_that_a_terminal_obeys() {
        assert_eq!(quoted("li\u{1b}[31mver \u{202e}\"x\""), r#""li\u{1b}[31mver \u{202e}""x""""#);
    }
}
