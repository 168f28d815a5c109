"""Lays out an export for 3D Slicer and for MONAI Label. Needs numpy, pillow and pynrrd.

    surgtpgs export SCENE --prompt liver --prompt gallbladder -o EXPORT --format nrrd,index --exclusive
    python lay_out.py EXPORT RECORDING/images OUT

writes OUT/frames.nrrd, the recorded pictures as a volume in which the .seg.nrrd of the export lies, and
OUT/dataset/, a dataset of MONAI Label: NAME.png, labels/final/NAME.png and labels/final/labels.json.

    python lay_out.py --back EXPORT OUT corrected.seg.nrrd

makes a segmentation of the label pictures of OUT/dataset, which `--labels-from` and `--marks` read.
"""

import json
import shutil
import sys
from pathlib import Path

import nrrd
import numpy as np
from PIL import Image


def frames_of(export):
    """Numbers of the frames that an export has label pictures of, with the names of the recorded ones."""
    record = json.loads((export / "provenance.json").read_text("utf-8"))
    if not (record["complete"] and record["options"]["exclusive"]):
        sys.exit(f"{export} is not a complete export with --exclusive: run it again")
    frames = sorted({f["frame"] for f in record["files"] if f["name"].startswith("index/frame_")})
    if not frames:
        sys.exit(f"{export} has no label pictures: export with --format nrrd,index --exclusive")
    return [(i, record["sequence_frame_names"][i]) for i in frames]


def pictures(export, recording):
    """Paths of the recorded pictures and of the label pictures, in order."""
    pairs = [(recording / name, export / f"index/frame_{i:06}.png") for i, name in frames_of(export)]
    missing = next((picture for picture, _ in pairs if not picture.is_file()), None)
    if missing:
        sys.exit(f"{missing} is missing: give the folder that holds the recorded pictures")
    return pairs


def write_volume(path, pairs):
    """Writes the pictures as RGB, x, y, frame, with the axes of the export's segmentation."""
    voxels = np.stack([np.asarray(Image.open(p).convert("RGB")).transpose(2, 1, 0) for p, _ in pairs], -1)
    header = {
        "space": "left-posterior-superior",
        "kinds": ["RGB-color", "domain", "domain", "domain"],
        "space directions": np.vstack([np.full(3, np.nan), np.eye(3)]),  # none for the colours
        "space origin": [0, 0, 0],
        "encoding": "gzip",
    }
    nrrd.write(str(path), voxels, header, compression_level=1)


def write_dataset(folder, export, pairs):
    """Copies pictures and label pictures under the same names, as MONAI Label's local datastore wants them."""
    labels = folder / "labels/final"
    labels.mkdir(parents=True)
    for picture, label in pairs:
        name = picture.stem + ".png"
        Image.open(picture).convert("RGB").save(folder / name)
        shutil.copyfile(label, labels / name)
    shutil.copyfile(export / "index/labels.json", labels / "labels.json")


def lay_out(export, recording, out):
    if out.exists():
        sys.exit(f"{out} is there already: choose another folder")
    pairs = pictures(export, recording)
    out.mkdir(parents=True)
    write_volume(out / "frames.nrrd", pairs)
    write_dataset(out / "dataset", export, pairs)
    print(f"{len(pairs)} frames in {out}")


def bring_back(export, out, segmentation):
    """Writes the label pictures with the header of the export's segmentation, which names the segments."""
    if segmentation.exists():
        sys.exit(f"{segmentation} is there already: choose another name")
    header = nrrd.read_header(str(next((export / "nrrd").glob("*.seg.nrrd"))))
    labels = [out / "dataset/labels/final" / (Path(name).stem + ".png") for _, name in frames_of(export)]
    voxels = np.stack([np.asarray(Image.open(label)).T for label in labels], -1)
    nrrd.write(str(segmentation), voxels.astype("u1"), header)
    print(f"{len(labels)} frames in {segmentation}")


if __name__ == "__main__":
    arguments = sys.argv[1:]
    is_back = arguments[:1] == ["--back"]
    paths = list(map(Path, arguments[is_back:]))
    if len(paths) != 3:
        sys.exit(__doc__)
    (bring_back if is_back else lay_out)(*paths)
