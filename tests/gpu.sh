#!/usr/bin/env bash
# Judges the GPU of this machine in less than eight minutes, on one page: which adapter there is, whether every
# pass agrees with its twin on the CPU, and how fast it is, with quality beside seconds.
#
#   bash tests/gpu.sh [--short] [FOLDER]    writes FOLDER/gpu.md (target/gpu without one)
#   bash tests/gpu.sh --pack FOLDER         copies the programs into FOLDER for another machine, small
#
# A folder for pages is new, empty, or holds an earlier page with its files, which are replaced, and nothing
# else. Packed programs are not replaced.
#
# Nothing is built or downloaded. The programs are those that SURGTPGS_BIN and SURGTPGS_PASSES name, as they
# were built or packed, or the newest that lie in the target folder (cargo build --release; cargo test
# --release --no-run --test passes --package surgtpgs-render). They are read and run, and stay as they are.
# Recordings are looked for in the folder that SURGTPGS_DATA names.
#
# The code is 0 if everything agrees or was packed, 1 if something failed, 2 if the command line is wrong,
# 3 if there is no adapter or no program; with 2, and without a program, nothing is made.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
target=$(realpath --canonicalize-missing "${CARGO_TARGET_DIR:-$root/target}")

# Seconds that the comparisons, and then the measurements, may take.
tests_limit=150
bench_limit=300

say() { printf '%s\n' "$*" >&2; }

# Prints the newest of the given files that can be run.
newest() {
  local file best=
  for file in "$@"; do
    if [[ -f $file && -x $file && $file != *.d && ( -z $best || $file -nt $best ) ]]; then best=$file; fi
  done
  printf '%s' "$best"
}

program=${SURGTPGS_BIN:-$(newest "$target"/{release,debug}/surgtpgs)}
passes=${SURGTPGS_PASSES:-$(newest "$target"/{release,debug}/deps/passes-*)}
data=${SURGTPGS_DATA:-}

usage="usage: bash tests/gpu.sh [--short] [FOLDER] | --pack FOLDER"
wrong() {
  say "error: $1"
  exit 2
}
missing() {
  say "error: there is no $1: $2"
  exit 3
}

short=
pack=
folder=
while (($#)); do
  case $1 in
    --short) short=yes ;;
    --pack) pack=yes ;;
    -h | --help) printf '%s\n' "$usage"; exit 0 ;;
    -* | "") wrong "there is no option \"$1\"; $usage" ;;
    *)
      if [[ $folder ]]; then wrong "one folder is enough; $usage"; fi
      folder=$1
      ;;
  esac
  shift
done
if [[ $pack && ( -z $folder || $short ) ]]; then wrong "--pack takes a folder, and nothing else; $usage"; fi
folder=${folder:-$target/gpu}
if [[ -e $folder && ! -d $folder ]]; then wrong "this is a file, not a folder: $folder"; fi

# Prints the name of something in a folder that no earlier run left there; nothing if a page may be written.
foreign_in() (
  shopt -s nullglob dotglob
  entries=("$1"/*)
  for entry in ${entries[@]+"${entries[@]}"}; do
    case ${entry##*/} in
      gpu.md | gpu.json | comparisons.txt | measured.txt)
        if [[ -f $entry && ! -L $entry ]]; then continue; fi
        ;;
    esac
    printf '%q' "${entry##*/}"
    exit
  done
  if ((${#entries[@]})) && ! grep -qs '^Made by `bash tests/gpu.sh' "$1/gpu.md"; then
    printf '%q' "${entries[0]##*/}"
  fi
)
if [[ -z $pack ]]; then
  foreign=$(foreign_in "$folder")
  if [[ $foreign ]]; then wrong "choose a new folder: no earlier run made $foreign in $folder"; fi
fi

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# Tells if a file can be run and is a program by its first bytes: ELF, Mach-O or, on Windows, PE.
is_program() {
  if [[ ! -f $1 || ! -x $1 ]]; then return 1; fi
  case $(head -c 4 "$1" 2> /dev/null | od -An -tx1 | tr -d ' \n') in
    7f454c46 | feedfac[ef] | c[ef]faedfe | cafebabe | 4d5a*) return 0 ;;
    *) return 1 ;;
  esac
}

# Writes the content of a packed file to standard output.
unpack() {
  if [[ $1 == *.gz ]]; then
    gzip -dc "$1"
  elif command -v xz > /dev/null; then
    xz -dc "$1"
  else
    python3 -c '
import lzma, shutil, sys
shutil.copyfileobj(lzma.open(sys.argv[1]), sys.stdout.buffer)' "$1"
  fi
}

# Prints the place of a program, which is unpacked first if it was packed. Anything else is refused.
runnable() {
  local file=$1
  if [[ $1 == *.xz || $1 == *.gz ]]; then
    file=$(mktemp "$scratch/XXXXXX")
    unpack "$1" > "$file" 2> /dev/null || missing "program in $1" "it cannot be unpacked"
    chmod +x "$file"
  fi
  is_program "$file" || missing "program in $1" "it may not be run, or is not an ELF or Mach-O file"
  realpath "$file"
}
[[ -f $program ]] || missing "program" "build it (cargo build --release), or name it in SURGTPGS_BIN"
program=$(runnable "$program")
if [[ -f $passes ]]; then passes=$(runnable "$passes"); fi

make_folder() {
  mkdir -p "$folder" 2> /dev/null || wrong "the folder cannot be made: $folder"
  folder=$(cd "$folder" && pwd)
}

if [[ $pack ]]; then
  [[ -f $passes ]] || missing "test program" \
    "build it (cargo test --release --no-run --package surgtpgs-render), or name it in SURGTPGS_PASSES"
  packed=$scratch/packed
  mkdir "$packed"
  end=gz
  if command -v xz > /dev/null; then end=xz; fi
  for file in "$folder"/{surgtpgs,passes}."$end"; do
    if [[ -e $file || -L $file ]]; then wrong "choose another folder: this is there already: $file"; fi
  done
  for file in "$program:surgtpgs" "$passes:passes"; do
    to=$packed/${file##*:}
    strip --strip-all -o "$to" "${file%:*}" || missing "program in ${file%:*}" "its symbols cannot be taken away"
    if [[ $end == xz ]]; then xz --threads=0 "$to"; else gzip --best "$to"; fi
  done
  make_folder
  cp "$packed"/* "$folder"
  ls -l "$folder"/{surgtpgs,passes}."$end" >&2
  say "run there: SURGTPGS_BIN=$folder/surgtpgs.$end SURGTPGS_PASSES=$folder/passes.$end bash tests/gpu.sh"
  exit 0
fi

make_folder
started=$SECONDS
# What goes into the folder at the end.
results=$scratch/results
mkdir "$results"
: > "$scratch/problems"
: > "$scratch/findings"
problem() { printf -- '- %s\n' "$*" >> "$scratch/problems"; say "problem: $*"; }
finding() { printf '| %s | %s |\n' "$1" "$2" >> "$scratch/findings"; }

# Drivers. What is found, and what is missing, is said; what can be set right is set right.

library() { # prints where the system finds a library
  local place
  # Not piped: grep -q would end the pipe early, and that counts as a failure.
  place=$({ /sbin/ldconfig -p 2>/dev/null || ldconfig -p 2>/dev/null || true; } | awk -v name="$1" '$1 == name { print $NF }')
  place=${place%%$'\n'*}
  local folder
  IFS=: read -ra folders <<< "${LD_LIBRARY_PATH:-}"
  for folder in ${folders[@]+"${folders[@]}"} /usr/local/nvidia/lib64 /usr/local/nvidia/lib /usr/lib/x86_64-linux-gnu /usr/lib64 /usr/lib; do
    if [[ -z $place && -n $folder && -e $folder/$1 ]]; then place=$folder/$1; fi
  done
  printf '%s' "$place"
}

loader=$(library libvulkan.so.1)
nvidia_library=$(library libGLX_nvidia.so.0)
shopt -s nullglob
nodes=(/dev/nvidiactl /dev/dri/renderD* /dev/dxg)
devices=
for node in "${nodes[@]}"; do if [[ -e $node ]]; then devices+="$node "; fi; done
# The places that the loader looks into, and one that containers use.
manifests=(/etc/vulkan/icd.d/*.json /usr/share/vulkan/icd.d/*.json /usr/local/share/vulkan/icd.d/*.json
  "${XDG_DATA_HOME:-${HOME:-/root}/.local/share}"/vulkan/icd.d/*.json)
elsewhere=(/usr/local/nvidia/share/vulkan/icd.d/*.json /usr/local/nvidia/etc/vulkan/icd.d/*.json)
shopt -u nullglob
given=${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}}

names_nvidia() {
  local file
  for file in "$@"; do if [[ $file == *nvidia* ]]; then return 0; fi; done
  return 1
}

drivers=${manifests[*]:-none}
if [[ -n $given ]]; then
  drivers="$given (as VK_DRIVER_FILES says)"
elif [[ $devices == *nvidia* ]] && ! names_nvidia ${manifests[@]+"${manifests[@]}"}; then
  if names_nvidia ${elsewhere[@]+"${elsewhere[@]}"}; then
    export VK_DRIVER_FILES=${elsewhere[0]}
    drivers="$VK_DRIVER_FILES (set here, because the loader does not look there)"
  elif [[ -n $nvidia_library ]]; then
    # A container has the library often, and the file that names it seldom.
    printf '{"file_format_version":"1.0.1","ICD":{"library_path":"%s","api_version":"1.3.0"}}\n' \
      "$nvidia_library" > "$scratch/nvidia_icd.json"
    export VK_DRIVER_FILES=$scratch/nvidia_icd.json
    drivers="$VK_DRIVER_FILES (made for this run, for $nvidia_library)"
  else
    problem "there is an NVIDIA device and no Vulkan driver for it: start the container with" \
      "NVIDIA_DRIVER_CAPABILITIES=all (or graphics), or install the driver's libGLX_nvidia.so.0"
  fi
fi
# Containers keep the driver's libraries where the system may not look.
for file in "$loader" "$nvidia_library"; do
  if [[ $file == /usr/local/nvidia/* ]]; then
    LD_LIBRARY_PATH=$(dirname "$file")${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
    export LD_LIBRARY_PATH
  fi
done
if [[ -z $loader ]]; then
  problem "there is no Vulkan loader (libvulkan.so.1): apt-get install libvulkan1, or unpack that package" \
    "anywhere and name its folder in LD_LIBRARY_PATH"
fi
if [[ -z $devices ]]; then
  devices="none: only a software adapter can be found"
  # It takes its time for the comparisons, and is measured at small sizes.
  tests_limit=300
  bench_limit=140
fi

finding "Vulkan loader" "${loader:-missing}"
finding "devices" "$devices"
finding "drivers" "$drivers"
if command -v nvidia-smi > /dev/null; then
  gpus=$(nvidia-smi --query-gpu=name,driver_version,memory.total,power.limit --format=csv,noheader 2>&1 || true)
  finding "nvidia-smi" "${gpus//$'\n'/; }"
fi
finding "processors" "$(nproc), $(awk -F': ' '/^model name/ { print $2; exit }' /proc/cpuinfo)"

# Mesa's drivers ask for it; without it they complain on standard error.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-$scratch}

# Comparisons of every pass with its twin. A test that finds no adapter fails.

comparisons="not made: there is no test program (SURGTPGS_PASSES)"
if [[ -x $passes ]]; then
  say "comparing every pass with its twin ..."
  filter=()
  if [[ $short ]]; then filter=(golden twins harness_can_fail); fi
  tests_started=$SECONDS
  code=0
  # They look for the shaders from the folder of their crate.
  (cd "$root/crates/render" && CI=true RUST_BACKTRACE=0 timeout --kill-after=5 "$tests_limit" \
    "$passes" ${filter[@]+"${filter[@]}"}) > "$results/comparisons.txt" 2>&1 || code=$?
  ok=$(grep -c '^test .* \.\.\. ok$' "$results/comparisons.txt" || true)
  failed=$(sed -n 's/^test \(.*\) \.\.\. FAILED$/\1/p' "$results/comparisons.txt")
  comparisons="$ok agree, $(grep -c . <<< "$failed" || true) differ, in $((SECONDS - tests_started)) s"
  if ((code == 124 || code == 137)); then
    comparisons+="; they were ended before they were all done"
    problem "the comparisons took more than $tests_limit s"
  elif ((code != 0)); then
    without=0
    while read -r name; do
      if [[ -n $name ]]; then
        reason=$(awk -v head="---- $name stdout ----" '
          $0 == head { is_here = 1; next }
          /^---- / || /^failures:/ || /^stack backtrace:/ { is_here = 0 }
          is_here && !/^$|^adapter:|^note:|panicked at|^error: XDG/ { text = text " " $0 }
          END { print substr(text, 2, 300) }' "$results/comparisons.txt")
        if [[ $reason == *"needs a graphics adapter"* ]]; then
          without=$((without + 1))
        else
          problem "$name: ${reason:-see comparisons.txt}"
        fi
      fi
    done <<< "$failed"
    if ((without)); then problem "$without comparisons found no adapter"; fi
    if [[ -z $failed ]]; then problem "the comparisons ended with code $code: $(tail -n 1 "$results/comparisons.txt")"; fi
  fi
else
  problem "nothing was compared: there is no test program (SURGTPGS_PASSES)"
fi

# Measurements.

arguments=(--seconds "$bench_limit" -o "$scratch/measured")
if [[ $short ]]; then
  arguments+=(--short)
else
  # Of the clip that is there in two forms, the one without losses is taken.
  for recording in cholecseg8k_raw endonerf_pulling pulling.mp4; do
    if [[ $data && -e $data/$recording && ! ( $recording == pulling.mp4 && -e $data/endonerf_pulling ) ]]; then
      arguments+=(--recording "$data/$recording")
    fi
  done
fi
say "measuring ..."
code=0
{
  timeout --kill-after=5 $((bench_limit + 25)) "$program" bench gpu "${arguments[@]}" 2>&1 >&3 |
    tee "$results/measured.txt" >&2
} 3> "$scratch/measured.md" || code=$?
if ((code != 0)); then
  reasons=$(sed -n -e 's/^failed: //p' -e 's/^error: //p' "$results/measured.txt")
  if ((code == 124 || code == 137)); then reasons="the measurements took more than $((bench_limit + 25)) s"; fi
  while read -r reason; do problem "${reason}"; done <<< "${reasons:-the measurements ended with code $code}"
  # What was measured before the program ended lies in its unfinished folder.
  if [[ ! -s $scratch/measured.md && -f $scratch/measured/gpu.md ]]; then
    cp "$scratch/measured/gpu.md" "$scratch/measured.md"
  fi
fi
if [[ -f $scratch/measured/gpu.json ]]; then cp "$scratch/measured/gpu.json" "$results"; fi

# The page.

{
  printf '# GPU\n\n'
  if [[ -s $scratch/problems ]]; then
    printf '**Failed: %s**\n\n' "$(grep -c . "$scratch/problems")"
    cat "$scratch/problems"
  else
    printf 'Nothing failed.\n'
  fi
  printf '\nMade by `bash tests/gpu.sh%s` in %s s. Comparisons with the CPU: %s.\n\n' \
    "${short:+ --short}" "$((SECONDS - started))" "$comparisons"
  printf '| machine | found |\n|---|---|\n'
  cat "$scratch/findings"
  printf '\n'
  cat "$scratch/measured.md"
} > "$results/gpu.md"
cat "$results/gpu.md"
# The page comes first, because it tells whose the others are. Those of an earlier run that this one lacks go.
cp "$results/gpu.md" "$folder"
for name in gpu.json comparisons.txt measured.txt; do
  if [[ -f $results/$name ]]; then cp "$results/$name" "$folder"; else rm -f "$folder/$name"; fi
done
if [[ ! -s $scratch/problems ]]; then exit 0; fi
if ((code == 3)) && ! grep -q '^failed: ' "$results/measured.txt"; then exit 3; fi
exit 1
