#!/usr/bin/env bash
# Makes the release archive: program, README, licences of everything in it, desktop entry.
# `assets/package.sh [FOLDER]` writes surgtpgs-VERSION-TARGET.tar.gz into FOLDER (default: dist). One
# build packed twice gives the same bytes.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$(realpath --canonicalize-missing "${1:-dist}")
target_dir=${CARGO_TARGET_DIR:-target}
cargo build --release --locked
version=$(cargo metadata --no-deps --format-version 1 | sed -E 's/.*"name":"surgtpgs","version":"([^"]+)".*/\1/')
host=$(rustc -vV | sed -n 's/^host: //p')
name=surgtpgs-$version-$host
stage=$(mktemp -d)
trap 'rm -rf "$stage"' EXIT
mkdir "$stage/$name"
assets/strip.sh "$target_dir/release/surgtpgs" "$stage/$name/surgtpgs"
cp README.md LICENSE assets/surgtpgs.desktop "$stage/$name/"
mkdir -p "$stage/$name/crates/app"
cp crates/app/README.md crates/app/CHANGELOG.md "$stage/$name/crates/app/"
python3 assets/licences.py > "$stage/$name/LICENCES.txt"
mkdir -p "$out"
tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$(git log -1 --format=%ct)" -C "$stage" -cf - "$name" |
  gzip --no-name --best > "$out/$name.tar.gz"
sha256sum "$out/$name.tar.gz"
