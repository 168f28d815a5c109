#!/usr/bin/env bash
# Builds the committed source twice, in two places, and compares every byte of the results.
# `tests/reproducible.sh [CARGO ARGUMENTS]`; without arguments the program, as it is released (many
# minutes), with `--package surgtpgs-core --lib`, for example, one library. Results that differ are
# kept, to be looked into.
set -euo pipefail
cd "$(dirname "$0")/.."
places=$(mktemp -d)

build() { # PLACE OUT ARGUMENTS…
  local place=$1 out=$2
  shift 2
  git worktree add --quiet --detach "$place"
  # Only the places of the source and of the packages may differ, and these are in line tables and messages.
  local maps="$place=/surgtpgs ${CARGO_HOME:-$HOME/.cargo}=/cargo"
  local rust="" c=""
  for map in $maps; do
    rust+=" --remap-path-prefix=$map"
    c+=" -ffile-prefix-map=$map"
  done
  (cd "$place" && CARGO_TARGET_DIR=$place/target CARGO_INCREMENTAL=0 RUSTFLAGS=$rust CFLAGS=$c CXXFLAGS=$c \
    cargo build --release --locked --quiet "$@")
  mkdir "$out"
  local made=$place/target/release
  if [[ -f $made/surgtpgs ]]; then
    assets/strip.sh "$made/surgtpgs" "$out/surgtpgs"
  else
    find "$made" -maxdepth 1 -type f ! -name '*.d' ! -name '.*' -exec cp -t "$out" {} +
  fi
  git worktree remove --force "$place"
}

build "$places/one" "$places/first" "$@"
build "$places/another/place" "$places/second" "$@"
(cd "$places/first" && sha256sum -- *)
diff -r "$places/first" "$places/second"
rm -r "$places"
echo "both builds are the same"
