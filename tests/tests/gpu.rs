//! `tests/gpu.sh`, which judges the GPU of a machine, on the adapter that is here.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};
use surgtpgs_tests::{Run, binary, workspace};

/// Returns the newest test program of the passes, which lies beside this one if everything was built.
fn passes() -> Option<PathBuf> {
    let here = std::env::current_exe().unwrap();
    let is_ours = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("passes-") && path.extension().is_none_or(|e| e == "exe")
    };
    let files = fs::read_dir(here.parent().unwrap()).unwrap().map(|entry| entry.unwrap().path());
    files.filter(is_ours).max_by_key(|path| path.metadata().and_then(|m| m.modified()).ok())
}

/// Runs the script's short form; returns what it said, and its page.
fn judge(folder: &Path, change: impl FnOnce(&mut Command)) -> (Run, String) {
    let mut command = Command::new("bash");
    command.arg(workspace().join("tests/gpu.sh")).arg("--short").arg(folder).env("SURGTPGS_BIN", binary());
    if let Some(passes) = passes() {
        command.env("SURGTPGS_PASSES", passes);
    }
    change(&mut command);
    let run = Run::from(command.output().unwrap());
    let page = fs::read_to_string(folder.join("gpu.md")).unwrap_or_default();
    assert_eq!(run.stdout, page, "{}", run.stderr);
    (run, page)
}

/// Runs the script with these arguments in `folder`, with one file of it for both programs.
fn script(folder: &Path, program: &str, args: &[&str]) -> Run {
    let mut command = Command::new("bash");
    command.arg(workspace().join("tests/gpu.sh")).args(args).current_dir(folder);
    command.env("SURGTPGS_BIN", program).env("SURGTPGS_PASSES", program);
    Run::from(command.env("CARGO_TARGET_DIR", folder.join("target")).output().unwrap())
}

/// Returns the names in a folder, sorted, with the content and the permissions of its files.
fn listing(folder: &Path) -> Vec<(PathBuf, Vec<u8>, fs::Permissions)> {
    let entry = |path: PathBuf| {
        let permissions = path.metadata().unwrap().permissions();
        (path.clone(), fs::read(&path).unwrap_or_default(), permissions)
    };
    let mut paths: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths.into_iter().map(entry).collect()
}

#[test]
fn a_wrong_command_line_of_the_script_makes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "no program").unwrap();
    let before = listing(folder.path());
    for args in [
        &["--pack"][..],
        &["one", "two"],
        &["--pack", "one", "two"],
        &["--short", "--pack", "one"],
        &["--fast"],
        &[""],
        &["file"],
        &["--pack", "file"],
    ] {
        let run = script(folder.path(), "file", args);
        run.refused(2);
        assert_eq!(run.stderr.lines().count(), 1, "{args:?}: {}", run.stderr);
    }
    let help = script(folder.path(), "file", &["--help"]).ok();
    assert!(help.stdout.starts_with("usage: ") && help.stderr.is_empty(), "{help:?}");
    assert_eq!(listing(folder.path()), before);
}

#[test]
fn a_folder_that_holds_something_else_stays_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    for (name, file) in [("notes", "problems"), ("page", "gpu.md"), ("hidden", ".keep")] {
        let place = folder.path().join(name);
        fs::create_dir(&place).unwrap();
        fs::write(place.join(file), "mine").unwrap();
        let before = listing(&place);
        let run = script(folder.path(), "no-program", &["--short", name]);
        assert!(run.refused(2).contains(file), "{}", run.stderr);
        assert_eq!(listing(&place), before);
    }
}

#[test]
#[cfg(unix)]
fn what_is_no_program_is_refused_and_stays_as_it_was() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let files: [(&str, &[u8], u32); 5] = [
        ("notes", b"#!/bin/sh", 0o644),
        ("script", b"#!/bin/sh", 0o755),
        ("lost-its-right", b"\x7fELF", 0o644),
        ("damaged", b"\x7fELF", 0o755),
        ("damaged.xz", b"no archive", 0o644),
    ];
    for (name, content, mode) in files {
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
    }
    let before = listing(folder.path());
    for (name, ..) in files {
        let run = script(folder.path(), name, &["--pack", "packed"]);
        assert!(run.refused(3).contains(name), "{}", run.stderr);
    }
    script(folder.path(), "notes", &["judged"]).refused(3);
    assert_eq!(listing(folder.path()), before);
}

#[test]
#[cfg(target_os = "linux")]
fn packed_programs_are_copies() {
    let folder = tempfile::tempdir().unwrap();
    fs::copy("/bin/true", folder.path().join("program")).unwrap();
    let before = listing(folder.path());
    let said = script(folder.path(), "program", &["--pack", "packed"]).ok().stderr;
    assert_eq!(listing(folder.path())[1..], before, "{said}");
    let name = |entry: std::io::Result<fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
    let names: Vec<String> = fs::read_dir(folder.path().join("packed")).unwrap().map(name).collect();
    let packed: Vec<String> = names.iter().map(|name| format!("packed/{name}")).collect();
    assert!(packed.len() == 2 && packed.iter().all(|path| said.contains(path)), "{packed:?}: {said}");
    // What was packed can be packed again.
    let again = packed.iter().find(|path| path.contains("surgtpgs.")).unwrap();
    script(folder.path(), again, &["--pack", "again"]).ok();
    let before = listing(&folder.path().join("again"));
    let refused = script(folder.path(), "program", &["--pack", "again"]);
    assert!(refused.refused(2).contains("is there already"), "{}", refused.stderr);
    assert_eq!(listing(&folder.path().join("again")), before);
}

#[test]
fn one_command_judges_the_adapter_on_one_page() {
    let folder = tempfile::tempdir().unwrap();
    let (run, page) = judge(folder.path(), |_| ());
    if run.code == 3 && std::env::var("CI").as_deref() != Ok("true") {
        // As other tests of the GPU, this one needs a software adapter at least.
        return;
    }
    let heads = ["# GPU", "## Adapter", "## Training steps", "## Trainings", "## Frames"];
    for part in
        heads.iter().chain(&["memory bandwidth", "| the demo, 64×48 | GPU |", "| CPU |", "short: tiny"])
    {
        assert!(page.contains(part), "{part} is missing: {page}\n{}", run.stderr);
    }
    if passes().is_some() {
        assert_eq!(run.code, 0, "{page}\n{}", run.stderr);
        assert!(page.contains("Nothing failed.") && page.contains(" agree, 0 differ"), "{page}");
    } else {
        assert!(run.code == 1 && page.contains("nothing was compared"), "{page}\n{}", run.stderr);
    }
    // Three sizes with two choices of pixels, and 1 and 8 prompts in six ways each.
    assert_eq!(page.matches(" Gaussians | all | ").count(), 3, "{page}");
    assert_eq!(page.matches("| Gaussians to the scores |").count(), 2, "{page}");
    let report = fs::read_to_string(folder.path().join("gpu.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert!(report["bandwidth"].as_f64().unwrap() > 1e8, "{report}");
    let trainings = report["trainings"].as_array().unwrap();
    let psnr = |k: usize| trainings[k]["psnr_masked_db"].as_f64().unwrap();
    assert!(trainings.len() == 2 && psnr(0) > 15.0 && (psnr(0) - psnr(1)).abs() < 2.0, "{report}");
    for frames in report["frames"].as_array().unwrap() {
        for of in ["pictures", "scores"] {
            assert!(frames[of]["beyond_a_level"].as_f64().unwrap() < 0.02, "{of}: {frames}");
        }
        // Where a threshold decides otherwise, a picture is off by five levels at most; scores may be by more.
        // Two in a hundred of these, and a rounding to the other side here and there, come to 0.13.
        assert!(frames["pictures"]["mean_levels"].as_f64().unwrap() < 0.25, "{frames}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn without_an_adapter_the_page_says_what_was_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    // The second time, the page of the first is replaced.
    for _ in 0..2 {
        let (run, page) = judge(folder.path(), |command| {
            command.env("VK_DRIVER_FILES", "/nowhere/driver.json").env("CI", "true");
        });
        assert_eq!(run.code, 3, "{page}\n{}", run.stderr);
        for part in ["Vulkan loader", "/nowhere/driver.json (as VK_DRIVER_FILES says)", "no graphics adapter"]
        {
            assert!(page.contains(part), "{part} is missing: {page}\n{}", run.stderr);
        }
        assert!(!page.contains("Nothing failed"), "{page}");
    }
}
