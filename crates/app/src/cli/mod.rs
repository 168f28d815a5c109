//! The verbs, one file each, and what they share: exit codes and the console.

mod batch;
mod bench;
mod check;
mod console;
mod convert;
mod default_job;
mod demo;
mod document;
mod eval;
mod export;
mod figures;
mod objects;
mod prepare;
mod query;
mod remedy;
mod render;
mod train;
mod view;

use crate::{
    args::{Cli, SceneArgs, Verb},
    engine::{Engine, EngineOptions},
    memory,
    text::visible,
};
pub use batch::check_jobs_file;
use clap::Parser;
use std::ffi::OsString;
use surgtpgs_core::{Error, Result, files::full_path};

/// Exit code of the program; the numbers are a contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Everything was done.
    Done = 0,
    /// The input is wrong; a message says what to do.
    WrongInput = 1,
    /// The command line is wrong.
    Usage = 2,
    /// The machine lacks something; a message says how to get it.
    Lacking = 3,
}

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Runs a command line (the program's name first) and prints one plain message if it fails.
pub fn run(args: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Exit {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(message) => {
            // Help and version are messages too, for standard output; clap knows which is which.
            let printed = message.print();
            return match (message.use_stderr(), printed) {
                (true, _) => Exit::Usage,
                (false, Ok(())) => Exit::Done,
                (false, Err(e)) if e.kind() == std::io::ErrorKind::BrokenPipe => Exit::Done,
                (false, Err(_)) => Exit::WrongInput,
            };
        }
    };
    console::keep_writing();
    console::end_cleanly();
    let ready =
        memory::start_threads().and_then(|()| surgtpgs_clip::choose_provider(cli.execution_provider.into()));
    match ready.and_then(|()| run_verb(cli.verb)) {
        Ok(exit) => exit,
        Err(error) => {
            console::say(&format!("error: {}", one_line(&remedy::message(&error))));
            if matches!(error, Error::Missing { .. }) { Exit::Lacking } else { Exit::WrongInput }
        }
    }
}

fn run_verb(verb: Option<Verb>) -> Result<Exit> {
    if let Some(output) = verb.as_ref().and_then(Verb::output).filter(|output| output.is_symlink()) {
        let target = full_path(output);
        console::say(&one_line(&format!("{} is a link to {}", output.display(), target.display())));
    }
    match verb {
        None => default_job::run(),
        Some(Verb::View(args)) => view::run(&args),
        Some(Verb::Demo(args)) => demo::run(&args),
        Some(Verb::Check(args)) => check::run(&args),
        Some(Verb::Prepare(args)) => prepare::run(&args),
        Some(Verb::Train(args)) => train::run(&args),
        Some(Verb::Render(args)) => render::run(&args),
        Some(Verb::Query(args)) => query::run(&args),
        Some(Verb::Export(args)) => export::run(&args),
        Some(Verb::Eval(args)) => eval::run(&args),
        Some(Verb::Batch(args)) => batch::run(&args),
        Some(Verb::Bench(args)) => bench::run(&args),
        Some(Verb::Convert(args)) => convert::run(&args),
    }
}

/// Opens a scene and says what renders it.
fn open_engine(scene: &SceneArgs, options: EngineOptions) -> Result<Engine> {
    let engine = Engine::open(&scene.scene, options)?;
    console::say(&format!("rendering on {}", engine.renderer_name()));
    Ok(engine)
}

/// Makes a message one line, without anything that a terminal would obey. Messages from libraries may have
/// several lines, and names of files and the text in them may hold escape sequences.
fn one_line(text: &str) -> String {
    let shown: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    visible(&shown.split_whitespace().collect::<Vec<_>>().join(" ")).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_one_line_that_no_terminal_obeys() {
        assert_eq!(one_line("a\n  b\u{1b}[31mred\u{7} \u{9b}2J é"), "a b [31mred 2J é");
        assert_eq!(one_line("clip\u{202e}gpj.exe"), r"clip\u{202e}gpj.exe");
    }
}
