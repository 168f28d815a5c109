//! One program for all targets: `SURGTPGS_FUZZ_TARGET` names the one to run.

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

fuzz_target!(|bytes: &[u8]| (TARGET.run)(bytes));
