//! The short run of CI: every seed, every regression, and seeded mutations of the seeds.

use cap::Cap;
use std::{
    alloc::System,
    fs,
    io::Write,
    panic::catch_unwind,
    path::Path,
    sync::{
        Mutex, PoisonError,
        mpsc::{RecvTimeoutError, channel},
    },
    thread,
    time::Duration,
};
use surgtpgs_fuzz::{Mutator, Target, targets};

/// Returns the number of mutations of a target; `FUZZ_EXECUTIONS` asks for another number.
fn executions(target: &Target) -> usize {
    let asked = std::env::var("FUZZ_EXECUTIONS").ok().and_then(|n| n.parse().ok());
    asked.unwrap_or(match target.name {
        // These load a network or decode video each time.
        "model" | "tokenizer" | "encoder_settings" | "video" => 20,
        "dicom" => 100,
        _ => 300,
    })
}

#[global_allocator]
static MEMORY: Cap<System> = Cap::new(System, usize::MAX);

/// Returns the most memory that an execution may take besides what was there, bytes; beyond it, an allocation
/// fails and ends the process.
fn most_memory(target: &Target) -> usize {
    match target.name {
        "scene" | "ply" | "spz" | "quantised_scene" | "npy_header" | "langsplat" => 192 << 20,
        // A picture of the largest size, decoded and converted.
        _ => 1 << 30,
    }
}
/// Longest time of an execution, on a busy machine.
const MOST_TIME: Duration = Duration::from_secs(60);
/// Lock that lets executions be measured one at a time.
static ONE: Mutex<()> = Mutex::new(());

/// Runs a target; bytes that break it, or end the process, are kept for the report.
fn run(target: &Target, what: &str, bytes: &[u8]) {
    let _alone = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let kept = std::env::temp_dir().join(format!("surgtpgs-fuzz-{}-{}", target.name, std::process::id()));
    let written = fs::write(&kept, bytes);
    let said = format!("{what} breaks {target:?}; its bytes are in {} ({written:?})", kept.display());
    let (done, wait) = channel::<()>();
    let late = format!("{said}: it takes more than {} seconds\n", MOST_TIME.as_secs());
    let watch = thread::spawn(move || {
        if wait.recv_timeout(MOST_TIME) == Err(RecvTimeoutError::Timeout) {
            let _ = std::io::stderr().write_all(late.as_bytes());
            std::process::abort();
        }
    });
    let limited = MEMORY.set_limit(MEMORY.allocated() + most_memory(target));
    assert!(limited.is_ok(), "memory cannot be limited");
    let broken = catch_unwind(|| (target.run)(bytes)).is_err();
    let free = MEMORY.set_limit(usize::MAX);
    drop(done);
    assert!(watch.join().is_ok() && free.is_ok());
    assert!(!broken, "{said}");
    let _ = fs::remove_file(&kept);
}

#[test]
fn seeds_and_regressions_hold() {
    let regressions = Path::new(env!("CARGO_MANIFEST_DIR")).join("regressions");
    let targets = targets();
    for entry in fs::read_dir(&regressions).into_iter().flatten() {
        let name = entry.unwrap().file_name();
        assert!(targets.iter().any(|t| name == t.name), "there is no target {name:?}");
    }
    for target in &targets {
        let seeds = (target.seeds)();
        assert!(!seeds.is_empty(), "{target:?} has no seeds");
        seeds.iter().enumerate().for_each(|(i, seed)| run(target, &format!("seed {i}"), seed));
        for entry in fs::read_dir(regressions.join(target.name)).into_iter().flatten() {
            let path = entry.unwrap().path();
            run(target, &path.display().to_string(), &fs::read(&path).unwrap());
        }
    }
}

#[test]
fn damaged_seeds_are_refused_or_read() {
    let only = std::env::var("FUZZ_TARGET").ok();
    for target in targets().iter().filter(|t| only.as_ref().is_none_or(|name| t.name == name)) {
        let seeds = (target.seeds)();
        let mut mutator = Mutator::new(1);
        for i in 0..executions(target) {
            run(target, &format!("mutation {i}"), &mutator.mutate(&seeds[i % seeds.len()]));
        }
    }
}

#[test]
fn mutations_are_many_and_repeatable() {
    let series = || {
        let mut mutator = Mutator::new(7);
        (0..100).map(|_| mutator.mutate(b"P5 16 16 255 some bytes")).collect::<Vec<_>>()
    };
    let made = series();
    assert_eq!(made, series());
    let different: std::collections::BTreeSet<_> = made.iter().collect();
    assert!(different.len() > 90, "{} of 100 differ", different.len());
}
