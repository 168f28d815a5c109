#!/usr/bin/env bash
# `assets/strip.sh PROGRAM OUT`: the program as it is released, without symbols and line tables, which make it six times as
# large. The build ID is of those too: names in them differ from build to build (tract-core's hashes of codegen units).
set -euo pipefail
strip --remove-section=.note.gnu.build-id -o "$2" "$1"
