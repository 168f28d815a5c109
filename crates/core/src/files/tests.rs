use super::*;
use crate::{Error, Remedy, Result};
use std::{
    io::Write,
    path::{Path, PathBuf},
    time::Duration,
};

#[test]
fn a_full_path_means_the_same_everywhere() {
    let here = std::env::current_dir().unwrap();
    assert_eq!(full_path(Path::new("src/../src/lib.rs")), full_path(&here.join("src/lib.rs")));
    assert!(full_path(Path::new("src")).is_absolute());
    assert_eq!(full_path(Path::new("not/there")), here.join("not/there"));
}

#[cfg(unix)]
#[test]
fn results_have_the_permissions_of_other_new_files() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let [ours, theirs] = ["ours", "theirs"].map(|name| folder.path().join(name));
    write_whole(&ours, b"").unwrap();
    std::fs::write(&theirs, b"").unwrap();
    let [ours, theirs] = [ours, theirs].map(|path| path.metadata().unwrap().permissions().mode());
    assert_eq!(ours, theirs);
}

#[test]
fn what_a_killed_writer_left_does_not_claim_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    assert!(is_free_folder(&folder.path().join("none")).unwrap() && is_free_folder(folder.path()).unwrap());
    std::fs::write(folder.path().join(".part-abc"), "half").unwrap();
    assert!(is_free_folder(folder.path()).unwrap());
    std::fs::write(folder.path().join("a"), "").unwrap();
    assert!(!is_free_folder(folder.path()).unwrap());
    assert!(is_free_folder(&folder.path().join("a")).is_err());
}

#[test]
fn a_failed_write_leaves_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b.txt");
    write_whole(&path, b"old").unwrap();
    let failed = write_whole_with(&path, |f| {
        f.write_all(b"ne")?;
        Err(std::io::Error::other("disk full"))
    });
    assert!(failed.unwrap_err().to_string().contains("disk full"));
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
    assert_eq!(std::fs::read_dir(folder.path().join("a")).unwrap().count(), 1);
}

/// Lists every file under a folder with its bytes; links and folders by name.
fn tree(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let entries = walkdir::WalkDir::new(folder).sort_by_file_name().into_iter().map(|e| e.unwrap());
    entries.map(|e| (e.path().to_owned(), std::fs::read(e.path()).unwrap_or_default())).collect()
}

fn take(path: &Path, inputs: &Inputs, replace: bool) -> Result<OutputFolder> {
    OutputFolder::claim(path, Claim::new("thing", inputs, replace))
}

/// Makes a finished result of two files.
fn finished(path: &Path, text: &str) {
    let output = take(path, &Inputs::none(), true).unwrap();
    write_whole(&output.path().join("a/b.txt"), text.as_bytes()).unwrap();
    write_whole(&output.path().join("c.txt"), text.as_bytes()).unwrap();
    output.finish().unwrap();
}

#[test]
fn a_result_is_replaced_on_request_alone_and_only_by_a_whole_one() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("new/out");
    finished(&place, "first");
    let before = tree(folder.path());
    let refused = take(&place, &Inputs::none(), false).unwrap_err();
    assert!(refused.remedy() == Some(Remedy::Replace) && refused.to_string().contains("thing"), "{refused}");
    {
        let output = take(&place, &Inputs::none(), true).unwrap();
        write_whole(&output.path().join("c.txt"), b"half").unwrap();
        assert_eq!(std::fs::read(place.join("c.txt")).unwrap(), b"first");
    }
    assert_eq!(tree(folder.path()), before, "one that is given up leaves no trace");
    let output = take(&place, &Inputs::none(), true).unwrap();
    write_whole(&output.path().join("d.txt"), b"second").unwrap();
    output.finish().unwrap();
    let names: Vec<_> = tree(&place).into_iter().map(|(path, _)| path).collect();
    assert_eq!(names, [place.clone(), place.join(record::RECORD_FILE), place.join("d.txt")]);
    assert_eq!(std::fs::read_dir(place.parent().unwrap()).unwrap().count(), 1, "nothing is left beside it");
}

#[test]
fn what_this_program_did_not_write_is_never_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    finished(&at("mine"), "x");
    std::fs::write(at("mine/a/notes.txt"), "weeks of work").unwrap();
    std::fs::create_dir(at("theirs")).unwrap();
    std::fs::write(at("theirs/picture.png"), "theirs").unwrap();
    let other = OutputFolder::claim(&at("other"), Claim::new("other", &Inputs::none(), false)).unwrap();
    write_whole(&other.path().join("a.txt"), b"").unwrap();
    other.finish().unwrap();
    std::fs::create_dir(at("forged")).unwrap();
    std::fs::write(at("forged/.surgtpgs"), "{\"surgtpgs\":\"thing\"}\n\"../mine/c.txt\"\n\"/etc/passwd\"\n")
        .unwrap();
    std::fs::write(at("forged/a"), "theirs").unwrap();
    let before = tree(folder.path());
    for replace in [false, true] {
        for (name, word) in [
            ("mine", if replace { "notes.txt" } else { "another thing" }),
            ("theirs", "not empty"),
            ("other", "another kind"),
            ("forged", "\"a\""),
        ] {
            let error = take(&at(name), &Inputs::none(), replace).unwrap_err().to_string();
            assert!(error.contains(word), "{name}: {error}");
            assert_eq!(tree(folder.path()), before, "{name}");
        }
        for inside in ["mine/new", "other/a/new"] {
            let error = take(&at(inside), &Inputs::none(), replace).unwrap_err().to_string();
            assert!(error.contains("lies inside a result"), "{error}");
        }
        assert!(take(&at("theirs/picture.png"), &Inputs::none(), replace).is_err());
        assert!(take(&at("theirs/picture.png/more"), &Inputs::none(), replace).is_err());
        assert_eq!(tree(folder.path()), before);
    }
}

#[test]
fn inputs_are_known_by_every_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("in/clip")).unwrap();
    std::fs::write(at("scene"), "a scene").unwrap();
    let inputs = Inputs::none().with("the recording", &at("in/clip")).with("the scene", &at("scene"));
    let file = |path: &Path| {
        OutputFile::claim(
            path,
            FileClaim { kind: "scene", inputs: &inputs, replace: true, is_ours: |_| true },
        )
    };
    let mut folders = vec![at("in/clip"), at("in/clip/new/deep"), at("in/../in/clip"), at("in")];
    let mut files = vec![at("scene"), at("in/clip/new.file"), at("in/../scene")];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(at("in/clip"), at("link")).unwrap();
        std::os::unix::fs::symlink(at("scene"), at("scene link")).unwrap();
        std::fs::hard_link(at("scene"), at("scene again")).unwrap();
        folders.extend([at("link"), at("link/new")]);
        files.extend([at("link/new"), at("scene link"), at("scene again")]);
    }
    let before = tree(folder.path());
    for path in folders {
        let error = take(&path, &inputs, true).unwrap_err().to_string();
        assert!(error.contains("inputs are never written to"), "{}: {error}", path.display());
    }
    for path in files {
        let error = file(&path).unwrap_err().to_string();
        assert!(error.contains("inputs are never written to"), "{}: {error}", path.display());
    }
    assert_eq!(tree(folder.path()), before);
    assert!(file(&at("scene 2")).is_ok() && take(&at("in-clip"), &inputs, false).is_ok());
}

#[cfg(unix)]
#[test]
fn special_files_are_refused_and_links_are_followed() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let made = std::process::Command::new("mkfifo").arg(at("pipe")).status().unwrap();
    assert!(made.success());
    let _socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
    symlink(at("nowhere"), at("dangling")).unwrap();
    let none = Inputs::none();
    let claim = FileClaim { kind: "scene", inputs: &none, replace: true, is_ours: |_| true };
    for name in ["pipe", "socket", "dangling", "dangling/more"]
        .map(at)
        .into_iter()
        .chain([PathBuf::from("/dev/null")])
    {
        assert!(take(&name, &none, true).is_err() && OutputFile::claim(&name, claim).is_err());
        assert!(write_whole(&name, b"").is_err(), "{}", name.display());
    }
    std::fs::create_dir(at("real")).unwrap();
    symlink(at("real"), at("folder")).unwrap();
    symlink(at("real/file"), at("file")).unwrap();
    finished(&at("folder/out"), "x");
    assert!(at("real/out/c.txt").is_file());
    std::fs::write(at("real/file"), "old").unwrap();
    OutputFile::claim(&at("file"), claim).unwrap().write(b"new").unwrap();
    assert_eq!(std::fs::read(at("real/file")).unwrap(), b"new");
    assert!(at("file").is_symlink());
}

#[test]
fn two_programs_do_not_write_one_result_and_the_dead_hold_none() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("out");
    let first = take(&place, &Inputs::none(), false).unwrap();
    let error = take(&place, &Inputs::none(), true).unwrap_err().to_string();
    assert!(error.contains("another program") && error.contains(&std::process::id().to_string()), "{error}");
    drop(first);
    assert!(!place.exists(), "a folder that nothing was written into goes again");
    std::fs::create_dir(&place).unwrap();
    std::fs::write(place.join(record::LOCK_FILE), "process 1 on a machine that lost its power").unwrap();
    finished(&place, "x");
    assert!(!place.join(record::LOCK_FILE).exists());

    let file = folder.path().join("x".repeat(250));
    let none = Inputs::none();
    let claim = FileClaim { kind: "scene", inputs: &none, replace: true, is_ours: |_| true };
    let first = OutputFile::claim(&file, claim).unwrap();
    assert!(OutputFile::claim(&file, claim).is_err());
    first.write(b"1").unwrap();
    drop(first);
    assert!(OutputFile::claim(&file, claim).is_ok());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "no lock stays");
}

#[test]
fn a_lock_that_is_held_for_a_moment_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("short.lock");
    let mut held = Some(Lock::acquire(&path, folder.path()).unwrap());
    let at_once = Lock::acquire_within(Duration::ZERO, &path, folder.path());
    assert!(at_once.unwrap_err().to_string().contains("another program"));
    let mut attempts = 0;
    let lock = lock::retried(Duration::from_secs(600), || {
        attempts += 1;
        if attempts == 3 {
            drop(held.take());
        }
        Lock::attempt(&path, folder.path())
    });
    assert!(lock.is_ok() && attempts == 3, "{attempts}");
    assert!(Lock::acquire(&path, folder.path()).is_err());
}

#[test]
fn unfinished_work_is_gone_on_with_or_begun_again() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("out");
    let none = Inputs::none();
    let leave = |unfinished| {
        let output = OutputFolder::claim(&place, Claim { unfinished, ..Claim::new("thing", &none, false) })?;
        let names = tree(output.path()).len();
        write_whole(&output.path().join("a/half.txt"), b"half")?;
        Ok::<_, Error>((names, output.path() == place.canonicalize().unwrap()))
    };
    // The folder, its lock and its record.
    assert_eq!(leave(Earlier::GoOn).unwrap(), (3, true));
    assert_eq!(leave(Earlier::GoOn).unwrap(), (5, true));
    assert_eq!(leave(Earlier::BeginAgain).unwrap(), (3, true));
    assert!(leave(Earlier::Keep).is_err());
    let again = Claim { is_same: &|_| true, completes_same: true, ..Claim::new("thing", &none, false) };
    OutputFolder::claim(&place, again).unwrap().finish().unwrap();
    assert!(leave(Earlier::GoOn).is_err(), "it is finished now");
    assert_eq!(OutputFolder::claim(&place, again).unwrap().path(), place.canonicalize().unwrap());
}

#[test]
fn files_that_an_interrupted_run_did_not_take_over_are_taken_over_by_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("out");
    let none = Inputs::none();
    let claim = |replace| {
        let claim = Claim { unfinished: Earlier::GoOn, ..Claim::new("thing", &none, replace) };
        OutputFolder::claim(&place, claim).unwrap()
    };
    let first = claim(false);
    for name in ["a", "b", "c"] {
        write_whole(&first.path().join("masks").join(name), b"old").unwrap();
    }
    first.finish().unwrap();
    // It was killed after one file, and another one was made anew.
    let killed = claim(true);
    write_whole(&killed.path().join("masks/a"), b"old").unwrap();
    write_whole(&killed.path().join("masks/b"), b"new").unwrap();
    drop(killed);
    let next = claim(true);
    next.take_over("masks").unwrap();
    let read = |name: &str| std::fs::read_to_string(next.path().join("masks").join(name)).unwrap();
    assert_eq!(["a", "b", "c"].map(read), ["old", "new", "old"]);
}

#[test]
fn a_place_for_several_results_may_hold_empty_folders_but_no_files_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let take_all = || claim_collection(&at("out"), "batch", &Inputs::none());
    std::fs::create_dir_all(at("out/a/steps")).unwrap();
    take_all().unwrap();
    finished(&at("out/a/thing"), "x");
    take_all().unwrap();
    assert!(claim_collection(&at("out"), "demo", &Inputs::none()).is_err());
    std::fs::create_dir_all(at("theirs/a")).unwrap();
    std::fs::write(at("theirs/a/picture.png"), "").unwrap();
    assert!(claim_collection(&at("theirs"), "batch", &Inputs::none()).is_err());
    assert!(claim_collection(&at("out/a/thing"), "batch", &Inputs::none()).is_err());
}

#[test]
fn where_folders_cannot_change_places_at_once_they_do_in_steps() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let make = |name: &str| {
        std::fs::create_dir(at(name)).unwrap();
        std::fs::write(at(name).join("text"), name).unwrap();
    };
    make("old");
    assert!(output::exchange_in_steps(&at("missing"), &at("old")).is_err());
    assert_eq!(std::fs::read_to_string(at("old/text")).unwrap(), "old", "taken back");
    make("new");
    output::exchange_in_steps(&at("new"), &at("old")).unwrap();
    assert_eq!(std::fs::read_to_string(at("old/text")).unwrap(), "new");
    assert_eq!(std::fs::read_to_string(at("new/text")).unwrap(), "old");
    // As if killed between the two steps.
    finished(&at("out"), "x");
    std::fs::rename(
        at("out"),
        output::beside(&at("out").parent().unwrap().canonicalize().unwrap().join("out"), "old"),
    )
    .unwrap();
    assert!(take(&at("out"), &Inputs::none(), false).unwrap_err().to_string().contains("another thing"));
    assert!(at("out/c.txt").is_file());
}

#[test]
fn a_record_survives_a_kill_in_the_middle_of_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("out");
    let output = take(&place, &Inputs::none(), false).unwrap();
    write_whole(&output.path().join("a.txt"), b"").unwrap();
    let path = output.path().join(record::RECORD_FILE);
    drop(output);
    let mut text = std::fs::read_to_string(&path).unwrap();
    text.push_str("\"b.t");
    std::fs::write(&path, text).unwrap();
    let record = record::Record::read(&place).unwrap();
    assert_eq!(
        (record.complete, record.files.into_iter().collect::<Vec<_>>()),
        (false, vec!["a.txt".to_owned()])
    );
    take(&place, &Inputs::none(), false).unwrap().finish().unwrap();
    assert!(record::Record::read(&place).unwrap().complete);
}

#[cfg(unix)]
#[test]
fn links_in_the_place_of_own_files_are_neither_followed_nor_own() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("theirs"), "weeks of work").unwrap();
    let none = Inputs::none();
    let output = take(&at("out"), &none, false).unwrap();
    let file = output.path().join("a.txt");
    write_whole(&file, b"a").unwrap();
    std::fs::remove_file(&file).unwrap();
    std::os::unix::fs::symlink(at("theirs"), &file).unwrap();
    assert!(write_whole(&file, b"b").unwrap_err().to_string().contains("a link has taken the place"));
    output.finish().unwrap();
    assert!(take(&at("out"), &none, true).is_err(), "it holds something of somebody else's");
    assert_eq!(std::fs::read(at("theirs")).unwrap(), b"weeks of work");
}

#[test]
fn a_file_of_somebody_else_that_is_called_as_the_record_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let notes = folder.path().join(".surgtpgs");
    std::fs::write(&notes, "my own notes").unwrap();
    assert!(!is_free_folder(folder.path()).unwrap());
    assert!(take(folder.path(), &Inputs::none(), true).is_err());
    write_whole(&folder.path().join("a/b.txt"), b"b").unwrap();
    assert_eq!(std::fs::read(&notes).unwrap(), b"my own notes");
}

#[test]
fn the_remains_of_a_removal_are_in_nobodys_way() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("out");
    let none = Inputs::none();
    finished(&place, "old");
    // The replaced result, of which a kill left a part.
    let remains = output::beside(&place, "new");
    finished(&remains, "older");
    std::fs::remove_dir_all(remains.join("a")).unwrap();
    let output = take(&place, &none, true).unwrap();
    write_whole(&output.path().join("new.txt"), b"new").unwrap();
    output.finish().unwrap();
    assert!(place.join("new.txt").is_file() && !remains.exists());
}
