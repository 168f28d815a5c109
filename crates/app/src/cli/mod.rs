//! The command line: verbs in the order of the data flow, one file or folder each.
//!
//! A verb's file holds its arguments, whose comments are its help, and carries it out. The table of verbs is
//! here.

mod answers;
mod args;
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
mod join;
mod objects;
mod page;
mod prepare;
mod query;
mod remedy;
mod render;
mod train;
mod verb;
mod view;

pub use batch::check_jobs_file;
pub use verb::Exit;

use crate::{memory, text::one_line};
use args::CommonArgs;
use clap::{Arg, CommandFactory, FromArgMatches, Parser, Subcommand};
use std::{ffi::OsString, path::Path};
use surgtpgs_core::{Error, Result, files::full_path};
use verb::Run;

/// Version of the program and, in a release build, the commit it was built from.
const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("SURGTPGS_COMMIT"), ")");

/// The list of [`Exit`] at the end of the help.
const EXIT_CODES: &str = "Exit codes: 0 done, 1 the input is wrong or the work was stopped, 2 usage, 3 the \
                          machine lacks something, 130 a signal ended the program at once.";

/// See a deforming reconstruction of a recorded endoscopic clip, ask it for structures by name,
/// export masked frames.
///
/// Without a verb: the viewer, on PATH if one is given. With no display, the demo's job into
/// `surgtpgs-demo/`. Research use only. Not for diagnostic or intra-operative use.
#[derive(Debug, Parser)]
#[command(name = "surgtpgs", version = VERSION, about, max_term_width = 110, disable_help_subcommand = true)]
#[command(after_help = EXIT_CODES)]
pub struct Cli {
    #[command(subcommand)]
    verb: Option<Verb>,
    #[command(flatten)]
    common: CommonArgs,
}

/// Verb of the program, with its arguments.
#[derive(Debug, Subcommand)]
enum Verb {
    View(view::ViewArgs),
    Demo(demo::DemoArgs),
    Check(check::CheckArgs),
    Prepare(prepare::PrepareArgs),
    Train(train::TrainArgs),
    Join(join::JoinArgs),
    Render(render::RenderArgs),
    Query(query::QueryArgs),
    Export(export::ExportArgs),
    Eval(eval::EvalArgs),
    Batch(batch::BatchArgs),
    Bench(bench::BenchArgs),
    Convert(convert::ConvertArgs),
}

impl Verb {
    /// Returns the arguments.
    fn args(&self) -> &dyn Run {
        match self {
            Self::View(args) => args,
            Self::Demo(args) => args,
            Self::Check(args) => args,
            Self::Prepare(args) => args,
            Self::Train(args) => args,
            Self::Join(args) => args,
            Self::Render(args) => args,
            Self::Query(args) => args,
            Self::Export(args) => args,
            Self::Eval(args) => args,
            Self::Batch(args) => args,
            Self::Bench(args) => args,
            Self::Convert(args) => args,
        }
    }
}

/// Runs a command line (the program's name first) and prints one plain message if it fails.
pub fn run(args: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Exit {
    let args = with_verb(args.into_iter().map(Into::into).collect());
    let cli = match parse(args) {
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
    match run_verb(&cli) {
        Ok(exit) => exit,
        Err(error) => {
            console::say(&format!("error: {}", one_line(&remedy::message(&error))));
            if matches!(error, Error::Missing { .. }) { Exit::Lacking } else { Exit::WrongInput }
        }
    }
}

/// Parses a command line. Options take numbers below zero, so that the range is named and not an escape.
fn parse(args: Vec<OsString>) -> Result<Cli, clap::Error> {
    let taking_numbers = |arg: Arg| {
        let takes_values = arg.get_action().takes_values();
        arg.allow_negative_numbers(takes_values)
    };
    let mut command = Cli::command().mut_subcommands(|verb| verb.mut_args(taking_numbers));
    let matches = command.try_get_matches_from_mut(args)?;
    Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut command))
}

/// Adds the verb `view` to a command line that is nothing but a path: something that exists, or that no verb
/// looks like. Verbs win over paths.
fn with_verb(mut args: Vec<OsString>) -> Vec<OsString> {
    if let [_, path] = &args[..] {
        let is_verb = path.to_str().is_some_and(|word| Cli::command().find_subcommand(word).is_some());
        let text = path.to_string_lossy();
        let is_like_one = !text.starts_with('-') && text.contains(['/', '.', std::path::MAIN_SEPARATOR]);
        if !is_verb && (is_like_one || Path::new(path).exists()) {
            args.insert(1, "view".into());
        }
    }
    args
}

fn run_verb(cli: &Cli) -> Result<Exit> {
    // These come first: they find out whether there is memory for any thread.
    memory::start_threads()?;
    console::end_cleanly();
    surgtpgs_clip::choose_provider(cli.common.execution_provider.into())?;
    let Some(verb) = cli.verb.as_ref().map(Verb::args) else { return default_job::run() };
    if let Some(output) = verb.output().filter(|output| output.is_symlink()) {
        let target = full_path(output);
        console::say(&one_line(&format!("{} is a link to {}", output.display(), target.display())));
    }
    let exit = verb.run();
    console::say_backend_notes();
    exit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_number_below_zero_is_out_of_range_and_no_option() {
        let line = "surgtpgs train recording -o scene.safetensors --iterations -1";
        let refused = parse(line.split(' ').map(OsString::from).collect()).unwrap_err().to_string();
        assert!(refused.contains("is not in 1") && !refused.contains("tip"), "{refused}");
    }

    #[test]
    fn the_help_lists_every_exit_code() {
        let codes = [Exit::Done, Exit::WrongInput, Exit::Usage, Exit::Lacking, Exit::Ended];
        assert_eq!(codes.map(|exit| exit as u8), [0, 1, 2, 3, 130]);
        assert!(codes.iter().all(|exit| EXIT_CODES.contains(&format!(" {} ", *exit as u8))));
    }

    #[test]
    fn a_path_is_viewed_and_a_typing_error_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let words = |word: &std::ffi::OsStr| with_verb(vec!["surgtpgs".into(), word.to_owned()]).len();
        assert_eq!(words(folder.path().as_os_str()), 3);
        for word in ["trian", "--help", "train", "--no.such"] {
            assert_eq!(words(word.as_ref()), 2, "{word}");
        }
        for path in ["/no/such", "./nothing.mp4", "nothing.mp4"] {
            assert_eq!(words(path.as_ref()), 3, "{path}");
        }
        assert_eq!(run(["surgtpgs", "./nothing.mp4"]), Exit::WrongInput, "there is no such file");
        let typed = parse(with_verb(vec!["surgtpgs".into(), "trian".into()]));
        assert!(typed.is_err_and(|e| e.use_stderr()));
    }

    #[test]
    fn verbs_are_listed_in_the_order_of_the_data_flow() {
        let verbs: Vec<String> = Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
        assert_eq!(
            verbs,
            [
                "view", "demo", "check", "prepare", "train", "join", "render", "query", "export", "eval",
                "batch", "bench", "convert"
            ]
        );
    }
}
