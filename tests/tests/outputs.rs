//! No verb writes into or over what it reads or what it did not write, with or without `--force`. Whatever
//! goes wrong while a result is replaced, the earlier one is there to the last byte.

use crate::workplace::{contents, workplace};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};
use surgtpgs_tests::{Run, binary, command_in, run_in, signal, start_until_training};

/// A verb that writes; `OUT` stands for its output.
struct Verb {
    args: &'static [&'static str],
    /// Ending of the file that it writes; empty for a folder.
    ending: &'static str,
    /// File or folder in [`workplace`] that it may replace on request: it made that and does not read it.
    own: &'static str,
    has_force: bool,
}

const fn verb(args: &'static [&'static str], ending: &'static str, own: &'static str) -> Verb {
    Verb { args, ending, own, has_force: true }
}

const SCENE: &str = "scene.safetensors";

const VERBS: [Verb; 14] = [
    verb(&["demo", "-o", "OUT", "--width", "32", "--height", "24", "--frames", "2"], "", "recording"),
    verb(&["prepare", "recording", "-o", "OUT", "--labels"], "", "prepared"),
    verb(&["prepare", "recording", "-o", "spare", "--labels", "--langsplat", "OUT"], "", ""),
    verb(&["train", "prepared", "-o", "OUT", "--iterations", "2", "--backend", "cpu"], ".safetensors", SCENE),
    verb(
        &["train", "recording", "-o", "OUT", "--iterations", "2", "--backend", "cpu"],
        ".safetensors",
        SCENE,
    ),
    verb(&["join", "chapter.safetensors", "-o", "OUT"], ".safetensors", SCENE),
    verb(&["render", SCENE, "-o", "OUT", "--frames", "0"], "", "pictures"),
    verb(&["query", SCENE, "--prompt", "liver", "--frames", "0", "--gaussians", "OUT"], "", ""),
    verb(
        &["export", SCENE, "--sequence", "recording", "--prompt", "liver", "-o", "OUT", "--frames", "0..2"],
        "",
        "",
    ),
    verb(&["eval", SCENE, "prepared", "-o", "OUT"], "", ""),
    verb(&["convert", SCENE, "OUT"], ".safetensors", ""),
    verb(&["convert", SCENE, "OUT", "--reference", "--fit-steps", "2"], ".ply", ""),
    verb(&["convert", SCENE, "OUT"], "", ""),
    Verb { args: &["batch", "jobs.toml", "-o", "OUT"], ending: "", own: "", has_force: false },
];

impl Verb {
    fn args(&self, out: &str, force: bool) -> Vec<String> {
        let args = self.args.iter().map(|arg| arg.replace("OUT", out));
        args.chain(force.then(|| "--force".to_owned())).collect()
    }

    /// Returns a new name for its output.
    fn output(&self) -> String {
        format!("out{}", self.ending)
    }
}

/// Returns every file, folder and link under `root`, with the bytes of files and the targets of links.
fn tree(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let entry = entry.unwrap();
            let (path, kind) = (entry.path(), entry.file_type().unwrap());
            let bytes = match () {
                () if kind.is_symlink() => {
                    fs::read_link(&path).unwrap().into_os_string().into_encoded_bytes()
                }
                () if kind.is_file() => fs::read(&path).unwrap(),
                () => Vec::new(),
            };
            if kind.is_dir() {
                folders.push(path.clone());
            }
            found.insert(path.strip_prefix(root).unwrap().to_owned(), bytes);
        }
    }
    found
}

/// Returns the names that differ between two trees.
fn difference(before: &BTreeMap<PathBuf, Vec<u8>>, after: &BTreeMap<PathBuf, Vec<u8>>) -> Vec<PathBuf> {
    let names = before.keys().chain(after.keys());
    let mut changed: Vec<_> = names.filter(|name| before.get(*name) != after.get(*name)).cloned().collect();
    changed.dedup();
    changed
}

/// Returns `true` if a verb may write to this place in `folder`.
#[cfg(unix)]
fn is_exempt(verb: &Verb, place: &str, force: bool, folder: &Path) -> bool {
    let real = |name: &str| folder.join(name).canonicalize().ok();
    let is_own = !verb.own.is_empty() && real(place) == real(verb.own);
    // The file has two names; the other one stays.
    let is_own = is_own || verb.own == SCENE && place == "again.safetensors";
    // The verb reads no recording, or another one.
    let reads_none = ["demo", "convert", "render", "query"].contains(&verb.args[0]);
    let is_new = reads_none && place.contains("recording") && place.contains("/new");
    is_new || (force && (is_own || !verb.has_force))
}

#[cfg(unix)]
#[test]
fn nothing_is_written_into_inputs_or_over_what_was_not_written_here() {
    use std::os::unix::fs::symlink;
    let folder = workplace();
    let at = |name: &str| folder.path().join(name);
    run_in(folder.path(), &["render", SCENE, "-o", "pictures", "--frames", "0"]).ok();
    fs::create_dir(at("theirs")).unwrap();
    fs::write(at("theirs/picture.png"), "a picture of another program").unwrap();
    for name in ["notes", "notes.safetensors", "notes.ply"] {
        fs::write(at(name), "weeks of work").unwrap();
    }
    for (target, link) in [
        ("recording", "link to recording"),
        ("prepared", "link to prepared"),
        ("theirs", "link to theirs"),
        (SCENE, "link to scene.safetensors"),
        ("recording/images/frame_000000.png", "link to frame.safetensors"),
        ("nowhere", "dangling"),
        ("nowhere", "dangling.safetensors"),
        ("nowhere", "dangling.ply"),
    ] {
        symlink(at(target), at(link)).unwrap();
    }
    fs::hard_link(at(SCENE), at("again.safetensors")).unwrap();
    assert!(Command::new("mkfifo").arg(at("pipe")).status().unwrap().success());
    let before = tree(folder.path());
    for verb in &VERBS {
        let ending = verb.ending;
        let mut places: Vec<String> = [
            "recording",
            "recording/new",
            "recording/images/new",
            "prepared",
            "prepared/new",
            SCENE,
            "recording/images/frame_000000.png",
            "prepared/codec.safetensors",
            ".",
            "link to recording",
            "link to recording/new",
            "link to prepared/new",
            "link to scene.safetensors",
            "link to frame.safetensors",
            "again.safetensors",
            "theirs",
            "link to theirs",
            "pictures",
            "pictures/new",
            "notes",
            "notes.safetensors",
            "notes/new",
            "dangling",
            "dangling.safetensors",
            "dangling/new",
            "pipe",
            "/dev/null",
            "jobs.toml",
            "recording/../recording",
        ]
        .map(String::from)
        .to_vec();
        places.extend(
            ["recording/new", "prepared/new", "pictures/new", "notes", "dangling"]
                .map(|p| p.to_owned() + ending),
        );
        for place in places {
            for force in [false, true] {
                if is_exempt(verb, &place, force, folder.path()) {
                    continue;
                }
                let args = verb.args(&place, force);
                let run = run_in(folder.path(), &args);
                let changed = difference(&before, &tree(folder.path()));
                assert!(changed.is_empty(), "{args:?} changed {changed:?}: {run:#?}");
                assert!(!run.refused(1).is_empty(), "{args:?}");
            }
        }
    }
}

#[test]
fn every_verb_replaces_its_own_result_on_request_and_not_without() {
    for verb in VERBS.iter().filter(|verb| verb.has_force) {
        let folder = workplace();
        let out = verb.output();
        run_in(folder.path(), &verb.args(&out, false)).ok();
        let whole = tree(folder.path());
        if verb.args[0] != "demo" && verb.args[0] != "export" {
            // `demo` and `export` complete the same recording or export instead.
            let again = run_in(folder.path(), &verb.args(&out, false));
            assert!(again.refused(1).contains("--force"), "{:?}: {again:#?}", verb.args);
        }
        let damaged = whole
            .iter()
            .find(|(name, bytes)| name.starts_with(&out) && bytes.len() > 100 && !name.ends_with(".surgtpgs"))
            .map(|(name, _)| folder.path().join(name))
            .unwrap();
        let mut bytes = fs::read(&damaged).unwrap();
        bytes.extend(b"damage");
        fs::write(&damaged, &bytes).unwrap();
        run_in(folder.path(), &verb.args(&out, true)).ok();
        assert_ne!(fs::read(&damaged).unwrap(), bytes, "{:?}: {}", verb.args, damaged.display());
        let names = |tree: &BTreeMap<PathBuf, Vec<u8>>| tree.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&tree(folder.path())), names(&whole), "{:?}", verb.args);
    }
}

/// Fault while a result is replaced.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// Files may have no more bytes than this, as on a full disk.
    Full(u64),
    /// A signal is sent once the new result has more files than this.
    Signal(&'static str, usize),
    /// A picture of the recording is cut off.
    CutOff,
    /// An option names a model that is not there.
    NoModel,
    /// The earlier result holds a file of somebody else's.
    Foreign,
    /// Another program writes to the earlier result.
    Locked,
    /// Something has the name of the new result while it is made.
    InTheWay,
}

const FAULTS: [Fault; 12] = [
    Fault::Full(0),
    Fault::Full(100),
    Fault::Full(700),
    Fault::Full(3000),
    Fault::Signal("-KILL", 0),
    Fault::Signal("-KILL", 2),
    Fault::Signal("-TERM", 1),
    Fault::CutOff,
    Fault::NoModel,
    Fault::Foreign,
    Fault::Locked,
    Fault::InTheWay,
];

/// Returns the folder beside the output that a replacement is made in.
fn new_beside(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    entries.into_iter().find(|path| path.is_dir() && path.to_string_lossy().ends_with(".new"))
}

fn start(folder: &Path, args: &[String]) -> Child {
    command_in(folder).args(args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Lets the fault happen to a run that replaces `out`. Returns `false` if it did not happen.
fn suffer(fault: Fault, folder: &Path, verb: &Verb, out: &str) -> bool {
    let args = verb.args(out, true);
    let must_fail = |run: Run| assert_ne!(run.code, 0, "{args:?}, {fault:?}: {run:#?}");
    match fault {
        Fault::Full(budget) => {
            let mut shell = Command::new("bash");
            shell.arg("-c").arg(format!("trap '' XFSZ; exec prlimit --fsize={budget} -- \"$@\"")).arg("bash");
            must_fail(shell.arg(binary()).args(&args).current_dir(folder).output().unwrap().into());
        }
        Fault::Signal(which, files) => {
            let mut child = start(folder, &args);
            let is_there = || new_beside(folder).is_some_and(|new| contents(&new).len() > files);
            while !is_there() && child.try_wait().unwrap().is_none() {}
            if child.try_wait().unwrap().is_none() {
                signal(&child, which);
            }
            // If the run was quicker than the signal, it has replaced the result.
            return !child.wait().unwrap().success();
        }
        Fault::CutOff => {
            if !["prepare", "train", "eval"].contains(&verb.args[0]) {
                return false;
            }
            let files = ["images", "labels"]
                .map(|kind| ["1", "4"].map(|i| format!("recording/{kind}/frame_00000{i}.png")));
            let files: Vec<PathBuf> = files.as_flattened().iter().map(|file| folder.join(file)).collect();
            let whole: Vec<Vec<u8>> = files.iter().map(|file| fs::read(file).unwrap()).collect();
            files
                .iter()
                .zip(&whole)
                .for_each(|(file, bytes)| fs::write(file, &bytes[..bytes.len() / 2]).unwrap());
            must_fail(run_in(folder, &args));
            files.iter().zip(whole).for_each(|(file, bytes)| fs::write(file, bytes).unwrap());
        }
        Fault::NoModel => {
            if !["prepare", "query", "export", "eval"].contains(&verb.args[0]) {
                return false;
            }
            must_fail(run_in(folder, &[&args[..], &["--text-encoder".into(), "typo".into()]].concat()));
        }
        Fault::Foreign => {
            let notes = folder.join(out).join("notes.txt");
            fs::write(&notes, "mine").unwrap();
            assert!(run_in(folder, &args).refused(1).contains("notes.txt"));
            assert_eq!(fs::read(&notes).unwrap(), b"mine");
            fs::remove_file(&notes).unwrap();
        }
        Fault::Locked => {
            let lock = folder.join(out).join(".surgtpgs.lock");
            let held = fs::File::create(&lock).unwrap();
            held.lock().unwrap();
            assert!(run_in(folder, &args).refused(1).contains("another program"));
            fs::remove_file(&lock).unwrap();
        }
        Fault::InTheWay => {
            let mut child = start(folder, &args);
            while new_beside(folder).is_none() && child.try_wait().unwrap().is_none() {}
            let _ = child.kill();
            child.wait().unwrap();
            let Some(new) = new_beside(folder) else { return false };
            fs::remove_dir_all(&new).unwrap();
            fs::write(&new, "somebody else's").unwrap();
            must_fail(run_in(folder, &args));
            assert_eq!(fs::read(&new).unwrap(), b"somebody else's");
            fs::remove_file(&new).unwrap();
        }
    }
    true
}

#[cfg(unix)]
#[test]
fn whatever_goes_wrong_while_a_result_is_replaced_the_earlier_one_stays() {
    let mut signals = 0;
    for verb in VERBS.iter().filter(|verb| verb.has_force && verb.ending.is_empty()) {
        let folder = workplace();
        let out = verb.output();
        run_in(folder.path(), &verb.args(&out, false)).ok();
        let whole = tree(folder.path());
        let mut earlier = contents(&folder.path().join(&out));
        let mut happened = 0;
        for fault in FAULTS {
            let has_happened = suffer(fault, folder.path(), verb, &out);
            let now = contents(&folder.path().join(&out));
            if let (Fault::Signal(..), false) = (fault, has_happened) {
                let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
                assert_eq!(names(&now), names(&earlier), "{:?}, {fault:?}", verb.args);
                earlier = now;
                continue;
            }
            assert!(now == earlier, "{:?}, {fault:?}: {:?}", verb.args, difference(&earlier, &now));
            signals += usize::from(matches!(fault, Fault::Signal(..)));
            happened += usize::from(has_happened);
        }
        assert!(happened >= 7, "{:?}: {happened}", verb.args);
        run_in(folder.path(), &verb.args(&out, true)).ok();
        let names = tree(folder.path()).into_keys().collect::<Vec<_>>();
        assert_eq!(names, whole.into_keys().collect::<Vec<_>>(), "{:?}: nothing is left behind", verb.args);
    }
    assert!(signals >= 9, "only {signals} runs were stopped by a signal");
}

#[cfg(unix)]
#[test]
fn a_training_that_is_stopped_replaces_no_whole_scene_and_goes_on() {
    let folder = workplace();
    let read = |name: &str| fs::read(folder.path().join(name)).ok();
    let train = ["train", "prepared", "--backend", "cpu", "-o"];
    let stop = |scene: &str, args: &[&str]| {
        let mut child = start_until_training(folder.path(), &[&train[..], &[scene], args].concat(), 1);
        signal(&child, "-TERM");
        assert_eq!(child.wait().unwrap().code(), Some(1), "{args:?}");
    };
    let endless = ["--iterations", "1000000", "--force"];
    for (scene, checkpoint) in [(SCENE, "scene.unfinished"), ("new.safetensors", "new.unfinished")] {
        let (whole, mut kept) = (read(scene), None);
        for args in [&endless[..], &["--resume"], &endless] {
            stop(scene, args);
            assert!(whole.is_none() || read(scene) == whole, "{scene}, {args:?}");
            assert!(read(scene).is_some() && read(checkpoint) != kept, "{scene}, {args:?}");
            kept = read(checkpoint);
        }
        let refused = run_in(folder.path(), &[&train[..], &[scene]].concat());
        assert!(refused.refused(1).contains("--resume"), "{refused:#?}");
    }
}
