//! Tells the program its commit; in releases only, so that a commit does not rebuild everything.

use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let is_release = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let commit = is_release.then(|| git(&["rev-parse", "--short=12", "HEAD"])).flatten();
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|_| is_release) {
        println!("cargo:rerun-if-changed={log}");
    }
    let commit = commit.map_or("development".to_owned(), |commit| format!("commit {commit}"));
    println!("cargo:rustc-env=SURGTPGS_COMMIT={commit}");
}

/// Returns git's answer in one line; `None` without git or a repository.
fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}
