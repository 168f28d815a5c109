//! Nothing leaves the machine: no crate that could, and no socket while the program runs.

use std::{fs, iter, path::Path, process::Command};
use surgtpgs_tests::{binary, can_trace, cargo, flow, workspace};

/// Returns the crates that open connections, or make them secure.
fn banned() -> Vec<String> {
    let text = fs::read_to_string(workspace().join(".deny.toml")).unwrap();
    let rules: toml::Table = text.parse().unwrap();
    let banned = rules["bans"]["deny"].as_array().unwrap();
    banned.iter().map(|rule| rule["crate"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn no_network_crate_is_in_the_shipped_tree() {
    let tree = Command::new(cargo())
        .args(["tree", "--package", "surgtpgs", "--edges", "normal", "--prefix", "none", "--format", "{p}"])
        .current_dir(workspace())
        .output()
        .unwrap();
    let tree = String::from_utf8_lossy(&tree.stdout).into_owned();
    let names: Vec<&str> = tree.lines().filter_map(|l| l.split_whitespace().next()).collect();
    assert!(names.contains(&"surgtpgs-core"), "cargo tree said nothing useful:\n{tree}");
    let banned = banned();
    assert!(banned.len() > 10, "{banned:?}");
    let found: Vec<_> = names.iter().filter(|n| banned.iter().any(|b| b == *n)).collect();
    assert!(found.is_empty(), "network crates in the tree: {found:?}");
}

/// Returns the calls that make or connect sockets of families other than this machine's own, in a run of
/// `command` and of all that it starts, and the number of all calls on sockets that were seen. `around`
/// starts the run, without being watched itself.
#[cfg(target_os = "linux")]
fn sockets(folder: &Path, around: &[&str], command: &[&str]) -> (Vec<String>, usize) {
    let log = folder.join("sockets.log");
    let strace = ["strace", "-f", "-qq", "-e", "trace=network", "-o", log.to_str().unwrap()];
    let all = [around, &strace, command].concat();
    let mut run = Command::new(all[0]);
    run.args(&all[1..])
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        // What the window remembers is not to mix with what the user of this machine has opened.
        .envs(["XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME"].map(|name| (name, folder)))
        .current_dir(folder)
        .output()
        .unwrap();
    let text = fs::read_to_string(&log).unwrap();
    let makes = |line: &&str| ["socket(", "socketpair(", "connect("].iter().any(|call| line.contains(call));
    let calls: Vec<&str> = text.lines().filter(makes).collect();
    let local = |line: &&&str| line.contains("(AF_UNIX") || line.contains("sa_family=AF_UNIX");
    let others = calls.iter().filter(|line| !local(line)).map(|line| (*line).to_owned()).collect();
    (others, calls.len())
}

#[cfg(target_os = "linux")]
#[test]
fn no_verb_opens_a_socket_to_another_machine() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let program = binary().to_str().unwrap();
    for line in [
        "demo -o recording --width 64 --height 48 --frames 4",
        "check recording",
        "prepare recording -o prepared --labels",
        "train prepared -o scene.safetensors --iterations 20",
        "render scene.safetensors -o rendered",
        "query scene.safetensors --prompt liver",
        "export scene.safetensors --prompt liver -o exported",
        "eval scene.safetensors prepared",
        "convert scene.safetensors scene.ply",
        "convert scene.safetensors page.html --prompt liver",
    ] {
        let command: Vec<&str> = iter::once(program).chain(line.split(' ')).collect();
        let (others, _) = sockets(folder.path(), &[], &command);
        assert!(others.is_empty(), "{line}: {others:#?}");
    }
    for made in ["exported", "scene.ply"] {
        assert!(folder.path().join(made).exists(), "the verbs did not do their work: no {made}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn the_window_opens_no_socket_to_another_machine() {
    if !can_trace() {
        return;
    }
    let has_display = Command::new("xvfb-run").arg("--help").output().is_ok_and(|o| o.status.success());
    assert!(has_display || std::env::var_os("CI").is_none(), "xvfb-run cannot be had");
    if !has_display {
        eprintln!("SKIPPED, no window was looked at: xvfb-run cannot be had");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let scene = flow().at("scene.safetensors");
    let program = binary().to_str().unwrap();
    // The window is closed after a while, since nobody is there to do it.
    let command = ["timeout", "20", program, "view", &scene];
    let (others, calls) = sockets(folder.path(), &["xvfb-run", "-a"], &command);
    assert!(others.is_empty(), "{others:#?}");
    assert!(calls > 0, "the window was never connected to its display");
}

#[cfg(target_os = "linux")]
#[test]
fn a_socket_to_another_machine_is_seen() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    // A datagram socket is made, and nothing is sent.
    let (others, _) = sockets(folder.path(), &[], &["bash", "-c", "exec 3<>/dev/udp/127.0.0.1/9"]);
    assert!(others.iter().any(|line| line.contains("AF_INET")), "{others:?}");
}
