#!/usr/bin/env bash
# Runs the workflow of assets/snakemake on this machine. Checks that a bad recording stops no other, that work
# that is done is not done again unless it is gone or its recording has changed, and that `surgtpgs batch` knows
# the results of the workflow. The argument is a Python that has Snakemake.
set -euo pipefail
python=$(realpath -s "$1")
cd "$(dirname "$0")/../.."
source tests/oracle/program.sh
program=$(program_path)
workflow=$PWD/assets/snakemake
folder=$(mktemp -d --suffix " of workflows")
trap 'rm -rf "$folder"' EXIT
cd "$folder"

"$program" demo -o recording --width 48 --height 32 --frames 9 2> log
cat > jobs.toml << 'JOBS'
[defaults]
eval = true
labels = true
iterations = 40
backend = "cpu"
prompts = ["liver"]
formats = ["index", "sheet"]
[[recording]]
path = "recording"
name = "it's $(the) <first>"
[[recording]]
path = "bad"
[[recording]]
path = "recording"
labels = false
chapter_frames = 4
JOBS
mkdir bad
run() {
    "$python" -m snakemake --snakefile "$workflow/Snakefile" --configfile "$workflow/config.yaml" \
        --config program="$program" --cores 2 --keep-going "$@" > log 2>&1
}
expect() { "$@" || { cat "$folder/log"; echo "failed: $*"; exit 1; }; }
recorded() { "$python" -c 'import json; print([r["state"] for r in json.load(open("jobs/report.json"))["recordings"]])'; }

! run || { echo "a bad recording was not noticed"; exit 1; }
expect test "$(recorded)" = "['done', 'failed', 'done']"
expect grep -q "it's \$(the) &lt;first&gt;" jobs/report.html

rmdir bad && cp -r recording bad
expect run
expect test "$(recorded)" = "['done', 'done', 'done']"
expect run
expect grep -q "Nothing to be done" log
"$program" batch jobs.toml 2> log > /dev/null
expect test "$(grep -c ' is done$' log)" = 10

rm jobs/recording/scene.safetensors
cp recording/images/frame_000000.png bad/images/frame_000001.png
expect run
expect test -f jobs/recording/scene.safetensors
expect grep -q "recording: chapter 2" log
expect test "$(recorded)" = "['done', 'done', 'done']"
"$program" batch jobs.toml 2> log > /dev/null
expect test "$(grep -c ' is done$' log)" = 10
expect run
expect grep -q "Nothing to be done" log
echo "the workflow did what the batch does"
