//! One program for all targets. `SURGTPGS_FUZZ_TARGET` names the one to run, `SURGTPGS_FUZZ_SEEDS` the folder
//! that its seeds are written to first.

#![no_main]

use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

static TARGET: LazyLock<surgtpgs_fuzz::Target> = LazyLock::new(|| {
    let name = std::env::var("SURGTPGS_FUZZ_TARGET").unwrap_or_default();
    let known = surgtpgs_fuzz::targets();
    let names: Vec<_> = known.iter().map(|t| t.name).collect();
    let found = known.iter().position(|t| t.name == name);
    let at = found.unwrap_or_else(|| panic!("set SURGTPGS_FUZZ_TARGET to one of {names:?}"));
    surgtpgs_fuzz::targets().swap_remove(at)
});

fn write_seeds() {
    let Some(folder) = std::env::var_os("SURGTPGS_FUZZ_SEEDS") else { return };
    for (i, seed) in (TARGET.seeds)().into_iter().enumerate() {
        let path = std::path::Path::new(&folder).join(format!("seed-{i}"));
        std::fs::write(&path, seed).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    }
}

fuzz_target!(init: write_seeds(), |bytes: &[u8]| (TARGET.run)(bytes));
