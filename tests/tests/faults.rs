//! Disks that are full, writers that are killed, readers that go away, recordings that are cut off: a plain
//! message, nothing lost, and the same command finishes the work afterwards (tests/README.md has the matrix).
//!
//! The limit on the size of written files stands for the full disk: the write that passes it fails, whether
//! its signal is ignored or not. A kill comes with one of the calls that write, sync or rename.

use crate::workplace::{contents, workplace};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::Command,
};
use surgtpgs_tests::{Run, binary, can_trace, flow};

/// Fault at the limit.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    /// The write fails, as on a full disk.
    Full,
    /// The program dies in the write, as by kill -9 or a power cut.
    Killed,
}

/// Returns the faults that can be made here.
fn faults() -> &'static [Fault] {
    if can_trace() { &[Fault::Full, Fault::Killed] } else { &[Fault::Full] }
}

/// A verb that writes into a [`workplace`].
struct Writer {
    name: &'static str,
    args: &'static [&'static str],
    /// File or folder that the verb makes.
    output: &'static str,
}

const WRITERS: [Writer; 9] = [
    Writer {
        name: "demo",
        args: &["demo", "-o", "out", "--width", "64", "--height", "48", "--frames", "3"],
        output: "out",
    },
    Writer { name: "prepare", args: &["prepare", "recording", "-o", "out", "--labels"], output: "out" },
    Writer {
        name: "train",
        args: &["train", "prepared", "-o", "out.safetensors", "--iterations", "30", "--backend", "cpu"],
        output: "out.safetensors",
    },
    Writer { name: "render", args: &["render", "scene.safetensors", "-o", "out"], output: "out" },
    Writer {
        name: "export",
        args: &[
            "export",
            "scene.safetensors",
            "--prompt",
            "liver",
            "-o",
            "out",
            "--format",
            "cutout,coco,csv,nrrd",
        ],
        output: "out",
    },
    Writer { name: "convert", args: &["convert", "scene.safetensors", "out.ply"], output: "out.ply" },
    Writer {
        name: "quantize",
        args: &["convert", "scene.safetensors", "out.safetensors", "--quantize"],
        output: "out.safetensors",
    },
    Writer { name: "eval", args: &["eval", "scene.safetensors", "prepared", "-o", "out"], output: "out" },
    Writer { name: "batch", args: &["batch", "jobs.toml", "-o", "out"], output: "out" },
];

/// Code of a program that was killed by a signal.
const KILLED: i32 = -1;

/// Largest sizes of a file, bytes: nothing, within headers, within the bodies.
const BUDGETS: [u64; 4] = [0, 100, 700, 3000];

/// Runs the program where files may have `budget` bytes, or until a thread's n-th call that changes files.
fn limited(folder: &Path, args: &[&str], budget: u64, fault: Fault) -> Run {
    let line = match fault {
        // prlimit counts bytes; the shell's own ulimit counts kilobytes.
        Fault::Full => format!("exec prlimit --fsize={budget} -- \"$@\""),
        Fault::Killed => {
            let calls = "write,fsync,rename,renameat2,unlink";
            let nth = 1 + budget / 40;
            format!(
                "exec strace -f -qq -o /dev/null -e trace={calls} -e inject={calls}:signal=KILL:when={nth} \"$@\""
            )
        }
    };
    let mut shell = Command::new("bash");
    shell.arg("-c").arg(line).arg("bash").arg(binary());
    let output = shell.args(args).current_dir(folder).env_remove("DISPLAY").output().unwrap();
    output.into()
}

fn run(folder: &Path, args: &[&str]) -> Run {
    surgtpgs_tests::run_in(folder, args)
}

/// Returns the files that are there when nothing goes wrong with `writer`.
fn whole(writer: &Writer) -> BTreeMap<PathBuf, Vec<u8>> {
    let folder = workplace();
    run(folder.path(), writer.args).ok();
    contents(folder.path())
}

#[test]
fn a_full_disk_or_a_kill_at_any_point_loses_nothing_and_the_work_can_be_finished() {
    for writer in &WRITERS {
        let expected = whole(writer);
        for budget in BUDGETS {
            for &fault in faults() {
                let case = format!("{} with {budget} bytes, {fault:?}", writer.name);
                let folder = workplace();
                let before = contents(folder.path());
                let broken = limited(folder.path(), writer.args, budget, fault);
                // A shell that cannot start it has other codes.
                assert!(fault == Fault::Full || [0, KILLED].contains(&broken.code), "{case}: {broken:#?}");
                if broken.code == 0 {
                    // The verb writes nothing as large as the limit.
                    assert!(folder.path().join(writer.output).exists(), "{case}");
                } else if fault == Fault::Full && writer.name == "batch" {
                    // The batch goes on with other recordings and lists what failed.
                    assert!(
                        broken.code == 1 && broken.stderr.contains("could not write"),
                        "{case}: {broken:#?}"
                    );
                } else if fault == Fault::Full {
                    broken.refused(1);
                }
                assert!(!broken.stderr.contains("panicked"), "{case}: {broken:#?}");
                let after = contents(folder.path());
                for (file, bytes) in &before {
                    assert!(after.get(file) == Some(bytes), "{case}: {} was changed", file.display());
                }
                for (file, bytes) in after.iter().filter(|(file, _)| !before.contains_key(*file)) {
                    let is_within = fault == Fault::Killed || bytes.len() as u64 <= budget;
                    let is_whole = is_within || !expected.contains_key(file);
                    assert!(is_whole, "{case}: {} has {} bytes", file.display(), bytes.len());
                }
                let again = run(folder.path(), writer.args);
                // The kill may have come after the last file.
                let is_done = fault == Fault::Killed && again.stderr.contains("--force");
                assert!(again.code == 0 || is_done, "{case}, then once more: {again:#?}");
                let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
                assert_eq!(names(&contents(folder.path())), names(&expected), "{case}");
            }
        }
    }
}

#[test]
fn a_result_is_never_replaced_by_half_of_another() {
    for writer in WRITERS.iter().filter(|w| w.output.contains('.')) {
        let folder = workplace();
        let output = folder.path().join(writer.output);
        run(folder.path(), writer.args).ok();
        let mut good = fs::read(&output).unwrap();
        for budget in BUDGETS {
            for &fault in faults() {
                let broken = limited(folder.path(), &[writer.args, &["--force"]].concat(), budget, fault);
                let codes = if fault == Fault::Full { [0, 1] } else { [0, KILLED] };
                assert!(codes.contains(&broken.code), "{broken:#?}");
                // A kill may come with the very last step, or never.
                let is_new = || {
                    fault == Fault::Killed
                        && run(folder.path(), &["render", writer.output, "-o", "r", "--force"]).code == 0
                };
                let case = format!("{}, {budget}, {fault:?}", writer.name);
                assert!(fs::read(&output).unwrap() == good || is_new(), "{case}");
                good = fs::read(&output).unwrap();
            }
        }
    }
}

#[test]
fn answers_that_cannot_be_written_are_an_error_and_readers_may_go_away() {
    let scene = flow().at("scene.safetensors");
    let at = |to: &str, args: &str| {
        let line = format!("\"$0\" {args} {to}; exit ${{PIPESTATUS[0]}}");
        let mut shell = Command::new("bash");
        shell.args(["-c", &line]).arg(binary()).arg(&scene).current_dir(flow().path());
        let output = shell.output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    for args in
        ["query \"$1\" --prompt liver", "query \"$1\" --prompt liver --json", "check recording", "--help"]
    {
        let (code, stderr) = at("> /dev/full", args);
        assert_eq!(code, Some(1), "{args}: {stderr}");
        assert!(!stderr.contains("panicked"), "{args}: {stderr}");
        let (code, stderr) = at("| true", args);
        assert!(code == Some(0) && !stderr.contains("panicked"), "{args}: {code:?} {stderr}");
    }
}

#[test]
fn places_that_cannot_be_written_to_are_named() {
    let folder = workplace();
    fs::write(folder.path().join("file"), "no folder").unwrap();
    for writer in &WRITERS {
        let output = format!("file/{}", writer.output);
        let args: Vec<&str> =
            writer.args.iter().map(|a| if *a == writer.output { output.as_str() } else { a }).collect();
        assert!(run(folder.path(), &args).refused(1).contains("file"), "{}", writer.name);
        assert_eq!(fs::read(folder.path().join("file")).unwrap(), b"no folder");
    }
}

/// Halves the files of a few pictures under `folder`. Their heads stay, so that the damage is found
/// only when the picture is needed.
fn cut_off(folder: &Path) {
    let mut files: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    // Not all of them, or it would be another recording.
    for path in files.iter().take(3) {
        let file = fs::OpenOptions::new().write(true).open(path).unwrap();
        file.set_len(file.metadata().unwrap().len() / 2).unwrap();
    }
}

#[test]
fn recordings_that_are_cut_off_lose_nothing_and_the_work_can_be_finished() {
    for writer in WRITERS.iter().filter(|w| ["prepare", "train", "eval"].contains(&w.name)) {
        let folder = workplace();
        let kinds = ["images", "labels"].map(|kind| folder.path().join("recording").join(kind));
        let whole = kinds.each_ref().map(|kind| contents(kind));
        run(folder.path(), writer.args).ok();
        let good = contents(folder.path());
        let output = folder.path().join(writer.output);
        if output.is_dir() {
            fs::remove_dir_all(&output).unwrap();
        }
        kinds.iter().for_each(|kind| cut_off(kind));
        let force = [writer.args, &["--force"]].concat();
        let message = run(folder.path(), &force).refused(1).to_owned();
        assert!(message.contains("recording") && message.contains(".png"), "{}: {message}", writer.name);
        if output.is_file() {
            assert!(fs::read(&output).unwrap() == good[Path::new(writer.output)], "{}", writer.name);
        }
        for (kind, files) in kinds.iter().zip(&whole) {
            files.iter().for_each(|(name, bytes)| fs::write(kind.join(name), bytes).unwrap());
        }
        run(folder.path(), &force).ok();
        let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&contents(folder.path())), names(&good), "{}", writer.name);
    }
}

/// Returns a training on a recording that only ffmpeg could read, with an `ffmpeg` that does what `script`
/// says; `$out` is the folder for pictures. Without a script there is no `ffmpeg`.
#[cfg(unix)]
fn training_with_ffmpeg(script: Option<&str>) -> (tempfile::TempDir, Command) {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("clip.avi"), b"RIFF and so on").unwrap();
    image::RgbImage::new(32, 24).save(folder.path().join("frame.png")).unwrap();
    let [programs, scratch] = ["programs", "scratch"].map(|name| folder.path().join(name));
    fs::create_dir(&programs).unwrap();
    fs::create_dir(&scratch).unwrap();
    if let Some(script) = script {
        let program = programs.join("ffmpeg");
        // It lists no packets, so that frames are unpacked.
        let listing = "[ \"${@: -1}\" = - ] && exit 1";
        let text = format!("#!/bin/bash\n{listing}\nout=$(/usr/bin/dirname \"${{@: -1}}\")\n{script}\n");
        fs::write(&program, text).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let mut command = surgtpgs_tests::command_in(folder.path());
    command.args(["train", "clip.avi", "-o", "scene.safetensors", "--iterations", "2", "--backend", "cpu"]);
    // The temporary folder is ours, to see what is left in it.
    command.env("PATH", programs).env("TMPDIR", scratch);
    (folder, command)
}

#[cfg(unix)]
fn train_with_ffmpeg(script: Option<&str>) -> Run {
    let (folder, mut command) = training_with_ffmpeg(script);
    let output = command.output().unwrap();
    let left = fs::read_dir(folder.path().join("scratch")).unwrap().count();
    assert_eq!(left, 0, "pictures of the video are left behind");
    output.into()
}

#[cfg(unix)]
#[test]
fn an_ffmpeg_that_is_missing_or_dies_is_one_plain_message() {
    let copy = |to: &str| format!("/bin/cp frame.png $out/{to}.png");
    let two = format!("{}; {}", copy("00000000"), copy("00000001"));
    let works = train_with_ffmpeg(Some(&two));
    assert_eq!(works.code, 0, "{works:#?}");
    assert!(train_with_ffmpeg(None).refused(3).contains("Install ffmpeg"));
    let (folder, _) = training_with_ffmpeg(None);
    for more in [None, Some("--json")] {
        let mut check = surgtpgs_tests::command_in(folder.path());
        check.args(["check", "clip.avi"]).args(more).env("PATH", folder.path().join("programs"));
        let run = Run::from(check.output().unwrap());
        assert!(run.refused(3).contains("Install ffmpeg") && run.stdout.is_empty(), "{run:#?}");
    }
    let run = train_with_ffmpeg(Some(&format!("{two}; kill -9 $$")));
    assert!(run.refused(1).contains("nor by ffmpeg"), "{run:#?}");
    let full = train_with_ffmpeg(Some(&format!("{two}; echo 'No space left on device' >&2; exit 1")));
    assert!(full.refused(3).contains("scratch is full") && full.stderr.contains("TMPDIR"), "{full:#?}");
    let half = format!("{two}; /usr/bin/truncate -s 40 $out/00000001.png");
    assert!(train_with_ffmpeg(Some(&half)).refused(1).contains("cannot be read"));
}

#[cfg(unix)]
#[test]
fn an_ffmpeg_that_hangs_can_be_interrupted() {
    use std::os::unix::process::CommandExt;
    let (folder, mut command) = training_with_ffmpeg(Some("echo > started; exec /bin/sleep 600"));
    let mut child = command.process_group(0).spawn().unwrap();
    while !folder.path().join("started").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before ffmpeg was asked");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    // The signal goes to the program and all that it started, as from a terminal. It is SIGTERM, because a
    // shell may have told this test to ignore Ctrl-C.
    let interrupt = Command::new("kill").args(["-TERM", "--", &format!("-{}", child.id())]).status();
    assert!(interrupt.unwrap().success());
    assert!(!child.wait().unwrap().success());
    assert!(!folder.path().join("scene.safetensors").exists());
}

/// Starts a training through `shell` and sends it `signal` once it trains. Returns its exit code,
/// and `true` if there is a scene.
#[cfg(unix)]
fn signalled(shell: &str, signal: &str) -> (Option<i32>, bool) {
    let folder = workplace();
    let mut command = Command::new("bash");
    let steps = if signal == "HUP" && shell.contains("nohup") { "300" } else { "1000000" };
    command.args(["-c", shell]).arg("bash").arg(binary());
    command.args(["train", "prepared", "-o", "out.safetensors", "--backend", "cpu", "--iterations", steps]);
    command.current_dir(folder.path()).stdout(fs::File::create(folder.path().join("said")).unwrap());
    let mut child = command.stderr(fs::File::create(folder.path().join("told")).unwrap()).spawn().unwrap();
    let trains = || fs::read_to_string(folder.path().join("told")).unwrap().contains("training …");
    while !trains() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    for _ in 0..2 {
        assert!(
            Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap().success()
        );
    }
    (child.wait().unwrap().code(), folder.path().join("out.safetensors").exists())
}

#[cfg(unix)]
#[test]
fn a_terminal_that_closes_keeps_the_work_and_nohup_goes_on() {
    assert_eq!(signalled("exec env --default-signal=HUP \"$@\"", "HUP"), (Some(1), true));
    assert_eq!(signalled("exec nohup \"$@\"", "HUP"), (Some(0), true));
}
