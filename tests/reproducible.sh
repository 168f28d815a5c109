#!/usr/bin/env bash
# Builds the committed source twice, in two places, and compares every byte of what comes out.
# `tests/reproducible.sh [CARGO ARGUMENTS]`; without arguments the program, compared as it is released (many minutes), with
# `--package surgtpgs-core --lib`, for example, one library.
set -euo pipefail
cd "$(dirname "$0")/.."
places=$(mktemp -d)
trap 'rm -rf "$places"; git worktree prune' EXIT

build() { # PLACE ARGUMENTS…
  local place=$1
  shift
  git worktree add --quiet --detach "$place"
  # Where the source and the packages lie is all that may differ, and it is in line tables and messages.
  local maps="$place=/surgtpgs ${CARGO_HOME:-$HOME/.cargo}=/cargo"
  local rust="" c=""
  for map in $maps; do
    rust+=" --remap-path-prefix=$map"
    c+=" -ffile-prefix-map=$map"
  done
  (cd "$place" && CARGO_TARGET_DIR=$place/target CARGO_INCREMENTAL=0 RUSTFLAGS=$rust CFLAGS=$c CXXFLAGS=$c \
    cargo build --release --locked --quiet "$@")
  local program=$place/target/release/surgtpgs
  if [[ -f $program ]]; then assets/strip.sh "$program" "$program"; fi
  (cd "$place/target/release" && find . -maxdepth 1 -type f ! -name '*.d' ! -name '.*' -exec sha256sum {} + | sort -k 2) \
    > "$place.sums"
  git worktree remove --force "$place"
}

build "$places/one" "$@"
build "$places/another/place" "$@"
cat "$places/one.sums"
[[ -s $places/one.sums ]] && cmp "$places/one.sums" "$places/another/place.sums" && echo "both builds are the same"
