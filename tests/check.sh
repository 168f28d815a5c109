#!/usr/bin/env bash
# Everything that must hold before a change is merged, cheapest first. Needs only cargo; GPU tests use any
# Vulkan adapter, a software one included (see .ci/run for a bare machine).
set -euo pipefail
cd "$(dirname "$0")/.."

# Tests of the whole program run the binary that was built before them, wherever that is.
export CARGO_TARGET_DIR
CARGO_TARGET_DIR=$(realpath --canonicalize-missing "${CARGO_TARGET_DIR:-target}")

step() { printf '\n== %s\n' "$*"; }

step format
cargo fmt --all --check

step lints
cargo clippy --workspace --all-targets --quiet -- -D warnings

# All packages at once, here and below: another selection has other features, and compiles everything again.
step build
cargo build --workspace --all-targets --quiet

step "tests, of units and of the program on whole recordings"
SURGTPGS_BIN=$CARGO_TARGET_DIR/debug/surgtpgs cargo test --workspace --quiet

step documentation
RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet

# Not on the release build, which would take a quarter of an hour more to compile.
step "the headless demo"
SURGTPGS_BIN=$CARGO_TARGET_DIR/debug/surgtpgs cargo test --workspace --quiet --test program -- --ignored

printf '\nall checks passed\n'
