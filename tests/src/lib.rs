//! Tools that the whole-program tests share: finding the binary, running it, reading what it says.

use std::{
    ffi::OsStr,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::OnceLock,
};

/// The binary under test: `SURGTPGS_BIN`, or this workspace's, built in the profile of the tests.
pub fn binary() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| std::env::var_os("SURGTPGS_BIN").map_or_else(build, PathBuf::from))
}

/// Builds the binary beside this test; nothing happens if it is up to date.
fn build() -> PathBuf {
    // TARGET/PROFILE/deps/program-HASH
    let test = std::env::current_exe().unwrap_or_default();
    let profile = test.ancestors().nth(2).unwrap_or(Path::new("target/debug"));
    let target = profile.parent().unwrap_or(Path::new("target"));
    let mut command = Command::new(cargo());
    command.args(["build", "--quiet", "--package", "surgtpgs", "--target-dir"]).arg(target);
    if profile.ends_with("release") {
        command.arg("--release");
    }
    let built = command.current_dir(workspace()).status().is_ok_and(|s| s.success());
    assert!(built, "the binary must build before it can be tested");
    profile.join(format!("surgtpgs{}", std::env::consts::EXE_SUFFIX))
}

/// Returns the cargo that runs these tests.
pub fn cargo() -> PathBuf {
    std::env::var_os("CARGO").map_or_else(|| "cargo".into(), PathBuf::from)
}

/// Returns the workspace's root.
pub fn workspace() -> &'static Path {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests.parent().unwrap_or(tests)
}

/// Result of a run of the program.
#[derive(Debug)]
pub struct Run {
    /// Exit code; -1 if a signal ended it.
    pub code: i32,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl From<Output> for Run {
    fn from(Output { status, stdout, stderr }: Output) -> Self {
        Self {
            code: status.code().unwrap_or(-1),
            stdout: String::from_utf8_lossy(&stdout).into_owned(),
            stderr: String::from_utf8_lossy(&stderr).into_owned(),
        }
    }
}

impl Run {
    /// Fails the test unless the program ended well.
    pub fn ok(self) -> Self {
        assert_eq!(self.code, 0, "{self:#?}");
        self
    }

    /// Reads standard output as JSON: the whole of it must be JSON.
    pub fn json(&self) -> serde_json::Value {
        match serde_json::from_str(&self.stdout) {
            Ok(value) => value,
            Err(e) => panic!("standard output is not JSON: {e}\n{self:#?}"),
        }
    }

    /// Fails the test unless the program refused its input with one plain line and this code;
    /// returns that line.
    pub fn refused(&self, code: i32) -> &str {
        assert_eq!(self.code, code, "{self:#?}");
        assert!(!self.stderr.contains("panicked"), "{self:#?}");
        let lines: Vec<&str> = self.stderr.lines().filter(|l| l.starts_with("error: ")).collect();
        assert_eq!(lines.len(), 1, "one line says what is wrong: {self:#?}");
        lines[0]
    }
}

/// Returns the command that runs the program without a display in `folder`.
pub fn command_in(folder: &Path) -> Command {
    let mut command = Command::new(binary());
    command.current_dir(folder).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
    command
}

/// Runs the program without a display in `folder`.
pub fn run_in<S: AsRef<OsStr>>(folder: &Path, args: &[S]) -> Run {
    match command_in(folder).args(args).output() {
        Ok(output) => output.into(),
        Err(e) => panic!("{} does not start: {e}", binary().display()),
    }
}

/// Starts the program in `folder` and waits until it trains for the n-th time.
pub fn start_until_training(folder: &Path, args: &[&str], n: usize) -> Child {
    let mut command = command_in(folder);
    command.args(args).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(e) => panic!("{} does not start: {e}", binary().display()),
    };
    let said = child.stderr.as_mut().map(|said| BufReader::new(said).lines());
    let trains =
        said.into_iter().flatten().map_while(Result::ok).filter(|line| line.starts_with("training …"));
    assert_eq!(trains.take(n).count(), n, "{args:?} ended before it trained");
    child
}

/// Sends a signal, `-TERM` for instance, on systems that know signals.
pub fn signal(child: &Child, signal: &str) {
    let sent = Command::new("kill").args([signal, &child.id().to_string()]).status();
    assert!(sent.is_ok_and(|status| status.success()), "{signal} cannot be sent");
}

/// A tiny demo taken through the whole flow once, for all tests to look at.
#[derive(Debug)]
pub struct Flow {
    folder: tempfile::TempDir,
    /// Report of `train --json`.
    pub trained: serde_json::Value,
}

impl Flow {
    /// Number of frames of the recording.
    pub const FRAMES: usize = 10;
    /// Columns and rows of the recording.
    pub const SIZE: (u32, u32) = (64, 48);

    /// The flow's folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Returns a path inside the flow's folder, as text for the command line.
    pub fn at(&self, name: &str) -> String {
        self.path().join(name).display().to_string()
    }

    /// Runs the program in the flow's folder.
    pub fn run(&self, args: &[&str]) -> Run {
        run_in(self.path(), args)
    }
}

/// Records, prepares and trains the tiny demo: `recording`, `prepared` and `scene.safetensors`.
pub fn flow() -> &'static Flow {
    static FLOW: OnceLock<Flow> = OnceLock::new();
    FLOW.get_or_init(|| {
        let folder = match tempfile::tempdir() {
            Ok(folder) => folder,
            Err(e) => panic!("no temporary folder: {e}"),
        };
        let mut flow = Flow { folder, trained: serde_json::Value::Null };
        let frames = Flow::FRAMES.to_string();
        let (width, height) = (Flow::SIZE.0.to_string(), Flow::SIZE.1.to_string());
        let size = ["--width", &width, "--height", &height, "--frames", &frames];
        flow.run(&[&["demo", "-o", "recording"][..], &size].concat()).ok();
        flow.run(&["prepare", "recording", "-o", "prepared", "--labels", "--eval"]).ok();
        let train = ["train", "prepared", "-o", "scene.safetensors", "--iterations", "400", "--json"];
        flow.trained = flow.run(&train).ok().json();
        flow
    })
}

/// Returns `true` if processes can be traced here; if not, prints the reason. Some machines forbid it, but
/// where `CI` is set, `strace` has to be there.
#[expect(clippy::print_stderr, reason = "a test says so when it has nothing to test with")]
pub fn can_trace() -> bool {
    let tried = Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).output();
    assert!(tried.is_ok() || std::env::var_os("CI").is_none(), "there is no strace: {tried:?}");
    let works = tried.as_ref().is_ok_and(|output| output.status.success());
    if !works {
        eprintln!("SKIPPED, nothing was traced: strace cannot be had ({tried:?})");
    }
    works
}
