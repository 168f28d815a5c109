//! The jobs file, turned into command lines. Its keys are the options of the verbs on the command line.

use super::{
    facts::{RecordingFacts, masks_named_by},
    folders::folder_names,
    steps::{Step, StepLine, StepVerb},
};
use clap::{Arg, CommandFactory, Parser, ValueHint};
use std::{
    collections::HashSet,
    ffi::OsString,
    path::{Path, PathBuf},
    sync::OnceLock,
};
use surgtpgs_core::{
    Error, Result,
    files::{absolute_path, full_path},
    reading::read_text,
};
use toml::{Table, Value};

/// The jobs file as it is written.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct JobsFile {
    output: Option<PathBuf>,
    #[serde(default)]
    defaults: Table,
    #[serde(default)]
    recording: Vec<Table>,
}

/// Work of a whole batch.
pub(super) struct BatchPlan {
    /// Folder that holds the reports and the folders of the recordings.
    pub(super) output: PathBuf,
    pub(super) jobs: Vec<BatchJob>,
}

/// Work on one recording.
pub(super) struct BatchJob {
    pub(super) name: String,
    pub(super) recording: PathBuf,
    pub(super) folder: PathBuf,
    /// Tasks, in the order of their steps.
    pub(super) tasks: Vec<Task>,
    /// Facts about the recording, set once it was looked at.
    pub(super) facts: OnceLock<RecordingFacts>,
}

/// A step of a job.
pub(super) struct Task {
    pub(super) step: Step,
    /// The command line as a user would type it.
    pub(super) command: Vec<OsString>,
    pub(super) verb: StepVerb,
    /// Files and folders, besides the recording, that the result depends on.
    pub(super) inputs: Vec<PathBuf>,
    /// File or folder that the task makes.
    pub(super) output: PathBuf,
}

impl BatchJob {
    pub(super) fn has(&self, step: Step) -> bool {
        self.tasks.iter().any(|t| t.step == step)
    }

    /// Fails if the recording is not at hand at the moment, so that its results are not thrown away.
    pub(super) fn require_recording(&self) -> Result<()> {
        if self.recording.exists() {
            return Ok(());
        }
        let what = "there is no recording here";
        Err(Error::input_at(&self.recording, what, "Correct its `path` in the jobs file."))
    }
}

/// Options that the batch sets itself, or that have no place in a batch.
const OWN: [&str; 9] =
    ["output", "sequence", "chapter", "force", "resume", "json", "masks", "langsplat", "help"];

/// Keys that a recording has beside options.
const OF_RECORDING: [&str; 2] = ["name", "path"];

/// Keys that name a source of features. One of them must be given for features, and so for prompts.
const FEATURE_SOURCES: [&str; 6] =
    ["labels", "labels_from", "masks_model", "features", "dense_encoder", MARKS];

/// Key of the marks. Beside another source of features they correct what it finds.
const MARKS: &str = "marks";

/// Name of the option for the network that makes masks of them.
const MARKS_MODEL: &str = "marks-model";

/// Key of the parts of the frames to hide. A prepared folder knows them itself.
const HIDE: &str = "hide";

impl BatchPlan {
    /// Reads a jobs file; `output` replaces the folder that it names.
    pub(super) fn read(path: &Path, output: Option<&Path>) -> Result<Self> {
        let text = read_text(path).map_err(|e| Error::io("read the jobs file", path, e))?;
        Self::of(&text, path, output)
            .map_err(|what| Error::input_at(path, what, "Correct the jobs file; nothing was done."))
    }

    fn of(text: &str, path: &Path, output: Option<&Path>) -> Result<Self, String> {
        let file: JobsFile = toml::from_str(text).map_err(|e| format!("this is no jobs file: {e}"))?;
        // The full path, so that paths in the file mean the same wherever the program is started.
        let path = full_path(path);
        let beside = path.parent().unwrap_or(Path::new("."));
        let output = match (output, &file.output) {
            (Some(output), _) => absolute_path(output),
            (None, Some(output)) => beside.join(output),
            (None, None) => path.with_extension(""),
        };
        if output == path {
            return Err("the results' folder would have the name of this file: give an `output`".into());
        }
        let verbs = Verbs::new();
        let defaults = verbs.settings(file.defaults, &[])?;
        let (mut named, mut own_settings) = (Vec::new(), Vec::new());
        for (i, table) in file.recording.into_iter().enumerate() {
            let own = verbs.settings(table, &OF_RECORDING)?;
            named.push(identity(&own, beside).map_err(|what| format!("recording {}: {what}", i + 1))?);
            own_settings.push(own);
        }
        require_distinct(&named)?;
        let names: Vec<&str> = named.iter().map(|(name, _)| name.as_str()).collect();
        let folders = folder_names(&names);
        let mut jobs = Vec::new();
        for ((own, (name, recording)), folder) in own_settings.into_iter().zip(named).zip(folders) {
            let mut settings = defaults.clone();
            settings.extend(own);
            let mut job = BatchJob {
                folder: output.join(folder),
                name,
                recording,
                tasks: Vec::new(),
                facts: OnceLock::new(),
            };
            job.add_tasks(&settings, beside, &verbs)
                .map_err(|e| format!("recording \"{}\": {e}", job.name))?;
            jobs.push(job);
        }
        Ok(Self { jobs, output })
    }
}

/// Fails if there are no recordings, or if two of them have the same name.
fn require_distinct(named: &[(String, PathBuf)]) -> Result<(), String> {
    if named.is_empty() {
        return Err("the file has no [[recording]]".into());
    }
    let mut names = HashSet::new();
    match named.iter().find(|(name, _)| !names.insert(name)) {
        Some((name, _)) => Err(format!("two recordings have the name \"{name}\"")),
        None => Ok(()),
    }
}

/// Returns the name and path of a recording.
fn identity(table: &Table, beside: &Path) -> Result<(String, PathBuf), String> {
    let text = |key: &str| match table.get(key) {
        None => Ok(None),
        Some(Value::String(text)) if !text.trim().is_empty() => Ok(Some(text.as_str())),
        Some(other) => Err(format!("{key} = {other} is not a text")),
    };
    let path = text("path")?.ok_or("it has no `path`")?;
    let last = || Path::new(path).file_name().map(|n| n.to_string_lossy().into_owned());
    let name = text("name")?
        .map(str::to_owned)
        .or_else(last)
        .ok_or("its path has no last part: give it a `name`")?;
    Ok((name, beside.join(path)))
}

impl BatchJob {
    fn add_tasks(&mut self, settings: &Table, beside: &Path, verbs: &Verbs) -> Result<(), String> {
        let has_any = |keys: &[&str]| keys.iter().any(|key| settings.get(*key).is_some_and(is_given));
        let has_features = has_any(&FEATURE_SOURCES);
        let has_prompts = has_features && has_any(&["prompt"]);
        let (prepared, scene) = (self.folder.join("prepared"), self.folder.join("scene.safetensors"));
        for step in Step::ALL {
            let (subjects, output) = match step {
                Step::Prepare if has_features => (vec![&self.recording], prepared.clone()),
                Step::Train if has_features => (vec![&prepared], scene.clone()),
                Step::Train => (vec![&self.recording], scene.clone()),
                Step::Eval => (vec![&scene, &self.recording], self.folder.join("eval")),
                Step::Export if has_prompts => (vec![&scene], self.folder.join("masked-frames")),
                Step::Prepare | Step::Export => continue,
            };
            let mut command: Vec<OsString> = vec!["surgtpgs".into(), step.name().into()];
            command.extend(subjects.into_iter().map(|p| p.clone().into_os_string()));
            command.extend(["-o".into(), output.clone().into_os_string()]);
            if step == Step::Export {
                // The recording may have moved since the scene was trained.
                command.extend(["--sequence".into(), self.recording.clone().into_os_string()]);
            }
            let mut inputs = Vec::new();
            let left_out: &[&str] = match step {
                Step::Prepare if has_any(&FEATURE_SOURCES[..FEATURE_SOURCES.len() - 1]) => {
                    &[MARKS, MARKS_MODEL]
                }
                Step::Train if has_features => &[HIDE],
                _ => &[],
            };
            let is_left_out = |arg: &&Arg| arg.get_long().is_some_and(|name| left_out.contains(&name));
            for arg in verbs.options(step).filter(|arg| !is_left_out(arg)) {
                if let Some(value) = key_of(arg).and_then(|key| settings.get(&key)) {
                    command.extend(flags(arg, value, beside, &mut inputs)?);
                }
            }
            let StepLine { verb } = StepLine::try_parse_from(&command).map_err(|e| in_short(&e))?;
            self.tasks.push(Task { step, command, verb, inputs, output });
        }
        Ok(())
    }
}

/// Returns `true` if a setting is there: `false` and an empty list take back what the defaults say.
fn is_given(value: &Value) -> bool {
    *value != Value::Boolean(false) && value.as_array().is_none_or(|values| !values.is_empty())
}

/// Returns the first paragraph of clap's message, in one line.
fn in_short(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let first = text.trim_start_matches("error: ").split("\n\n").next().unwrap_or_default();
    first.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns an option as it is typed, once for each value.
fn flags(
    arg: &Arg,
    value: &Value,
    beside: &Path,
    inputs: &mut Vec<PathBuf>,
) -> Result<Vec<OsString>, String> {
    let name = arg.get_long().unwrap_or_default();
    let wrong = |expected: &str| Err(format!("{} = {value} is not {expected}", name.replace('-', "_")));
    if !arg.get_action().takes_values() {
        return match value {
            Value::Boolean(true) => Ok(vec![format!("--{name}").into()]),
            Value::Boolean(false) => Ok(Vec::new()),
            _ => wrong("true or false"),
        };
    }
    let values = match value {
        Value::Array(values) => values.as_slice(),
        one => std::slice::from_ref(one),
    };
    let mut flags = Vec::new();
    for value in values {
        let text = match value {
            Value::String(text) => text.clone(),
            Value::Integer(_) | Value::Float(_) => value.to_string(),
            _ => return wrong("a text, a number or a list of these"),
        };
        let mut flag = OsString::from(format!("--{name}="));
        if is_path(arg) && text != "builtin" {
            let path = beside.join(text);
            flag.push(&path);
            if name == MARKS {
                inputs.extend(masks_named_by(&path));
            }
            inputs.push(path);
        } else {
            flag.push(text);
        }
        flags.push(flag);
    }
    Ok(flags)
}

fn is_path(arg: &Arg) -> bool {
    matches!(arg.get_value_hint(), ValueHint::AnyPath | ValueHint::DirPath)
}

/// Returns the key of an option, under which settings are kept.
fn key_of(arg: &Arg) -> Option<String> {
    keys_of(arg).next()
}

/// Returns the keys that stand for an option: its name and its other names.
fn keys_of(arg: &Arg) -> impl Iterator<Item = String> {
    let names = arg.get_long().into_iter().chain(arg.get_all_aliases().unwrap_or_default());
    names.map(|name| name.replace('-', "_"))
}

/// Options of the steps' verbs.
struct Verbs(Vec<(Step, Vec<Arg>)>);

impl Verbs {
    fn new() -> Self {
        let mut line = StepLine::command();
        line.build();
        let is_free = |arg: &&Arg| arg.get_long().is_some_and(|name| !OWN.contains(&name));
        let options = |step: Step| {
            let verb = line.find_subcommand(step.name());
            (step, verb.into_iter().flat_map(|v| v.get_arguments()).filter(is_free).cloned().collect())
        };
        Self(Step::ALL.map(options).into())
    }

    fn options(&self, step: Step) -> impl Iterator<Item = &Arg> {
        self.0.iter().filter(move |(s, _)| *s == step).flat_map(|(_, args)| args)
    }

    /// Returns the settings in a table, each under the key of its option. Fails if the table has a key that is
    /// neither an option nor one of `own`, or two keys of one option.
    fn settings(&self, table: Table, own: &[&str]) -> Result<Table, String> {
        let mut settings = Table::new();
        for (name, value) in table {
            let option = || self.all().find(|arg| keys_of(arg).any(|key| key == name)).and_then(key_of);
            let key = if own.contains(&name.as_str()) { Some(name.clone()) } else { option() };
            let Some(key) = key else {
                return Err(format!("unknown key \"{name}\"; there are {}", self.keys().join(", ")));
            };
            if settings.insert(key.clone(), value).is_some() {
                return Err(format!("\"{key}\" is given by two of its names: give it once"));
            }
        }
        Ok(settings)
    }

    fn all(&self) -> impl Iterator<Item = &Arg> {
        self.0.iter().flat_map(|(_, args)| args)
    }

    /// Returns all keys, for a message to people.
    fn keys(&self) -> Vec<String> {
        let mut keys: Vec<String> = self.all().filter_map(key_of).collect();
        keys.sort_unstable();
        keys.dedup();
        OF_RECORDING.map(str::to_owned).into_iter().chain(keys).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<BatchPlan> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("jobs.toml");
        std::fs::write(&path, text).unwrap();
        BatchPlan::read(&path, Some(Path::new("/out")))
    }

    fn lines(text: &str) -> Vec<String> {
        let plan = read(text).unwrap();
        let tasks = plan.jobs.iter().flat_map(|j| &j.tasks);
        tasks.map(|t| t.command.iter().map(|c| c.to_string_lossy()).collect::<Vec<_>>().join(" ")).collect()
    }

    #[test]
    fn a_recording_is_a_few_command_lines() {
        let all = lines(
            "[defaults]\nlabels = true\niterations = 7\nprompts = [\"liver\", \"-x\"]\nformats = [\"index\"]\n\
             [[recording]]\npath = \"/data/a\"\neval = true\nthreshold = 0.5\n\
             [[recording]]\npath = \"/data/a\"\nname = \"B c\"\nlabels = false\ntext_encoder = \"/minilm\"\n",
        );
        assert_eq!(
            all,
            [
                "surgtpgs prepare /data/a -o /out/a/prepared --labels --eval",
                "surgtpgs train /out/a/prepared -o /out/a/scene.safetensors --eval --iterations=7",
                "surgtpgs eval /out/a/scene.safetensors /data/a -o /out/a/eval --threshold=0.5",
                "surgtpgs export /out/a/scene.safetensors -o /out/a/masked-frames --sequence /data/a --prompt=liver --prompt=-x \
                 --format=index --threshold=0.5",
                "surgtpgs train /data/a -o /out/b-c/scene.safetensors --iterations=7",
                "surgtpgs eval /out/b-c/scene.safetensors /data/a -o /out/b-c/eval --text-encoder=/minilm",
            ]
        );
    }

    #[test]
    fn marks_make_features_or_correct_those_of_labels() {
        let all = lines("[[recording]]\npath = \"/data/a\"\nmarks = \"/m.json\"\n");
        assert_eq!(all[0], "surgtpgs prepare /data/a -o /out/a/prepared --marks=/m.json");
        assert!(all[2].ends_with("/out/a/eval --marks=/m.json"), "{all:?}");
        let all = lines("[[recording]]\npath = \"/data/a\"\nmarks = \"/m.json\"\nlabels = true\n");
        assert_eq!(all[0], "surgtpgs prepare /data/a -o /out/a/prepared --labels");
        assert!(all[2].ends_with("/out/a/eval --marks=/m.json"), "{all:?}");
        let all = lines(
            "[[recording]]\npath = \"/data/a\"\nmarks = \"/m.json\"\nmarks_model = \"/sam\"\nlabels = true\n",
        );
        assert_eq!(all[0], "surgtpgs prepare /data/a -o /out/a/prepared --labels");
        assert!(all[2].ends_with("/out/a/eval --marks=/m.json --marks-model=/sam"), "{all:?}");
    }

    #[test]
    fn masks_that_marks_name_are_read_too() {
        let folder = tempfile::tempdir().unwrap();
        let marks = folder.path().join("marks.json");
        std::fs::write(&marks, "{\"marks\": [{\"mask\": \"liver.png\"}]}").unwrap();
        let plan = read(&format!("[[recording]]\npath = \"a\"\nmarks = {marks:?}\n")).unwrap();
        assert_eq!(plan.jobs[0].tasks[0].inputs, [folder.path().join("liver.png"), marks]);
    }

    #[test]
    fn what_is_hidden_is_decided_when_features_are_made() {
        let hide = "[[recording]]\npath = \"/data/a\"\nhide = [\"0,0,9,9\", \"5,5,9,9\"]\n";
        let all = lines(&format!("{hide}labels = true\n"));
        let hidden = |line: &str| line.matches(" --hide=").count();
        assert_eq!(all.iter().map(|line| hidden(line)).collect::<Vec<_>>(), [2, 0, 0]);
        assert_eq!(lines(hide).iter().map(|line| hidden(line)).collect::<Vec<_>>(), [2, 0]);
    }

    #[test]
    fn a_recordings_own_setting_counts_by_any_of_its_names() {
        for (default, own) in [("prompt", "prompts"), ("prompts", "prompt")] {
            let all = lines(&format!(
                "[defaults]\nlabels = true\n{default} = [\"liver\", \"fat\"]\nformat = \"index\"\n\
                 [[recording]]\npath = \"/data/a\"\n{own} = [\"gallbladder\"]\nformats = [\"csv\"]\n"
            ));
            assert!(all[3].ends_with("--prompt=gallbladder --format=csv"), "{all:?}");
            let none = lines(&format!(
                "[defaults]\nlabels = true\n{default} = \"liver\"\n[[recording]]\npath = \"/a\"\n{own} = []\n"
            ));
            assert_eq!(none.len(), 3, "nothing to export");
        }
    }

    #[test]
    fn paths_begin_where_the_file_is() {
        let plan = read("[[recording]]\npath = \"a\"\nmasks_model = \"sam\"\nimage_encoder = \"../clip\"\n")
            .unwrap();
        let job = &plan.jobs[0];
        assert!(job.recording.is_absolute() && job.recording.ends_with("a"));
        let inputs: Vec<_> = job.tasks[0].inputs.iter().map(|p| p.file_name().unwrap()).collect();
        assert_eq!(inputs, ["sam", "clip"]);
        assert!(job.tasks[0].inputs.iter().all(|p| p.is_absolute()));
    }

    #[test]
    fn the_file_to_begin_with_is_right() {
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/batch");
        let plan = BatchPlan::read(&assets.join("jobs.toml"), None).unwrap();
        assert_eq!(plan.jobs.iter().map(|j| j.tasks.len()).collect::<Vec<_>>(), [4, 4, 4, 2]);
        assert!(plan.output.ends_with("batch/jobs") && plan.jobs[3].recording.ends_with("batch/pulling"));
    }

    #[test]
    fn wrong_files_are_refused_with_what_is_wrong() {
        let a = "[[recording]]\npath = \"a\"\n";
        for (text, says) in [
            ("", "no [[recording]]"),
            ("[[recordings]]\n", "unknown field `recordings`"),
            ("[[recording]]\nname = \"x\"\n", "recording 1: it has no `path`"),
            ("[[recording]]\npath = 3\n", "path = 3 is not a text"),
            ("[[recording]]\npath = \"/\"\n", "give it a `name`"),
            (
                &format!("{a}iteration = 3\n"),
                "unknown key \"iteration\"; there are name, path, above_instruments",
            ),
            (&format!("[defaults]\npath = \"a\"\n{a}"), "unknown key \"path\""),
            (&format!("{a}force = true\n"), "unknown key \"force\""),
            (&format!("{a}execution_provider = \"cuda\"\n"), "unknown key \"execution_provider\""),
            (
                &format!("{a}prompt = \"liver\"\nprompts = [\"fat\"]\n"),
                "\"prompt\" is given by two of its names",
            ),
            (&format!("{a}{a}"), "two recordings have the name \"a\""),
            (&format!("{a}eval = 1\n"), "recording \"a\": eval = 1 is not true or false"),
            (&format!("{a}profile = \"best\"\n"), "invalid value 'best' for '--profile"),
            (&format!("{a}labels = true\nprompts = [\"liver\", \"\"]\n"), "give a few words"),
            (
                &format!("{a}labels = true\nprompt = \"liver\"\nframes = \"5..3\"\n"),
                "invalid value '5..3' for '--frames",
            ),
            (&format!("{a}seed = [[1]]\n"), "is not a text, a number or a list"),
            (&format!("{a}masks_model = \"sam\"\n"), "--image-encoder"),
            ("path = [\n", "this is no jobs file"),
        ] {
            let message = read(text).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(message.contains(says) && message.contains("jobs.toml)"), "{text}: {message}");
        }
    }
}
