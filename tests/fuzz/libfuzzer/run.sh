#!/usr/bin/env bash
# Fuzzes every target that does not need the whole program, guided by coverage, for RUNS executions
# each (default 100000). Needs cargo-fuzz and a nightly compiler. Bytes that break a target are kept
# under artifacts/TARGET. Once the target is mended, they go to ../regressions/TARGET and are tried
# in every run of the tests.
set -euo pipefail
cd "$(dirname "$0")"
runs=${1:-100000}
targets=${2:-scene ply picture mask label_picture label_list depth settings poses_bounds transforms video prepared langsplat frame_masks checkpoint npy_header png_chunks quantised_scene}
# The libraries are safe Rust almost everywhere: without the sanitizer it is ten times faster.
cargo +nightly fuzz build --fuzz-dir . --sanitizer none any
program=$(find . "${CARGO_TARGET_DIR:-target}" -path '*release/any' -type f | head -1)
# Without ffmpeg: videos that are not read here would be offered to it, once per execution.
without_ffmpeg=$(mktemp -d)
for target in $targets; do
  mkdir -p "corpus/$target" "artifacts/$target"
  [[ ! -d ../regressions/$target ]] || cp ../regressions/"$target"/* "corpus/$target"
  echo "== $target"
  SURGTPGS_FUZZ_TARGET=$target SURGTPGS_FUZZ_SEEDS=corpus/$target PATH=$without_ffmpeg TMPDIR=${FUZZ_TMPDIR:-/dev/shm} "$program" "corpus/$target" \
    -runs="$runs" -timeout=20 -rss_limit_mb=2048 -max_len=16384 -artifact_prefix="artifacts/$target/" -print_final_stats=1 2>&1 |
    grep -E 'stat::|ERROR|panicked|SUMMARY'
done
