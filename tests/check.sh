#!/usr/bin/env bash
# Everything that must hold before a change is merged, cheapest first.
# Needs only cargo; GPU tests use any Vulkan adapter, a software one included (see .ci/run for a bare machine).
set -euo pipefail
cd "$(dirname "$0")/.."

step() { printf '\n== %s\n' "$*"; }

step format
cargo fmt --all --check

step lints
cargo clippy --workspace --all-targets --quiet -- -D warnings

step unit tests
cargo test --workspace --exclude surgtpgs-tests --quiet

step the program on whole recordings
cargo build --package surgtpgs --quiet
cargo test --package surgtpgs-tests --quiet

step documentation
RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet

step the headless demo, as users get it
cargo build --release --quiet
cargo test --release --package surgtpgs-tests --quiet -- --ignored

printf '\nall checks passed\n'
