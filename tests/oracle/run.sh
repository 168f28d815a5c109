#!/usr/bin/env bash
# Exports the tiny demo in every format, converts its scene, and reads all back with other programs. The
# argument is a Python that has them.
set -euo pipefail
python=$(realpath -s "$1")
cd "$(dirname "$0")/../.."
source tests/oracle/program.sh
binary=$(program_path)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
program() { "$binary" "$@" > /dev/null 2>> "$folder/log" || { cat "$folder/log"; exit 1; }; }

program demo -o "$folder/recording" --width 64 --height 48 --frames 10
program prepare "$folder/recording" -o "$folder/prepared" --labels
program train "$folder/prepared" -o "$folder/scene.safetensors" --iterations 400
program train "$folder/prepared" -o "$folder/long.safetensors" --iterations 100 --chapter-frames 4
program convert "$folder/long.safetensors" "$folder/last.ply" --frame 9
formats=cutout,overlay,binary,index,outline,score,npy,video,gif,sheet,csv,json,coco,nrrd
# The third prompt means nothing in the scene, so that nothing is written for it.
prompts=(--prompt liver "grasping tool" spaceship)
program export "$folder/scene.safetensors" -o "$folder/overlapping" --format $formats "${prompts[@]}" --threshold 0.3 --raw
program export "$folder/scene.safetensors" -o "$folder/exclusive" --format $formats "${prompts[@]}" --exclusive --raw

program convert "$folder/scene.safetensors" "$folder/frame.ply" --frame 4
program convert "$folder/scene.safetensors" "$folder/between.ply" --time 0.4321
program convert "$folder/scene.safetensors" "$folder/frame.glb" --frame 4
program convert "$folder/scene.safetensors" "$folder/frame.spz" --frame 4
"$python" -c 'import gsply, sys; gsply.write_spz(sys.argv[2], gsply.read_spz(sys.argv[1]), version=3)' "$folder"/{frame,third}.spz
program convert "$folder/third.spz" "$folder/third.ply"
program convert "$folder/scene.safetensors" "$folder/point_cloud.ply" --reference
program convert "$folder/point_cloud.ply" "$folder/released.safetensors" --like "$folder/scene.safetensors"
program convert "$folder/scene.safetensors" "$folder/small.safetensors" --quantize
"$binary" query "$folder/scene.safetensors" --prompt liver gallbladder --gaussians "$folder/objects" --json > "$folder/answers.json"
program convert "$folder/scene.safetensors" "$folder/page.html" "${prompts[@]}"
program render "$folder/scene.safetensors" -o "$folder/rendered"

"$python" tests/oracle/metrics.py | diff tests/oracle/metrics.json -
"$python" tests/oracle/read_exports.py "$folder/overlapping" "$folder/exclusive" > "$folder/output.txt"
"$python" tests/oracle/read_scenes.py "$folder" 0.4 >> "$folder/output.txt"
"$python" tests/oracle/page.py "$folder/page.html" "$folder/rendered/colour" 0 4 9 --masks "$folder/exclusive" >> "$folder/output.txt"
diff tests/oracle/output.txt "$folder/output.txt" && echo "the output is as stored"
