"""Lays out an export for 3D Slicer and for MONAI Label. Needs numpy, pillow and pynrrd.

    surgtpgs export SCENE --prompt liver --prompt gallbladder -o EXPORT --format nrrd,index --exclusive
    python lay_out.py EXPORT RECORDING/images OUT

writes OUT/frames.nrrd, the recorded pictures as a volume in which the .seg.nrrd of the export lies, and
OUT/dataset/, a dataset of MONAI Label: NAME.png, labels/final/NAME.png and labels/final/labels.json. What the
recording hides is black in both.

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

# Endings of recorded pictures. Frames of videos have numbers for names, without an ending.
ENDINGS = (".png", ".jpg", ".jpeg")


class Export:
    """An export with the frames of its segmentation, in order."""

    def __init__(self, folder):
        record = json.loads((folder / "provenance.json").read_text("utf-8"))
        if not (record["complete"] and record["options"]["exclusive"]):
            sys.exit(f"{folder} is not a complete export with --exclusive: run it again")
        labels = {f["frame"]: folder / f["name"] for f in record["files"] if f["name"].startswith("index/frame_")}
        segmentation = next((folder / "nrrd").glob("*.seg.nrrd"), None)
        if not (labels and segmentation):
            sys.exit(f"{folder} lacks labels: export with --format nrrd,index --exclusive")
        self.folder = folder
        self.header = nrrd.read_header(str(segmentation))
        self.width, self.height, depth = map(int, self.header["sizes"])
        first, names = int(self.header["first_frame"]), record["sequence_frame_names"]
        # The name of each recorded frame and its label picture; None where the scene does not show the frame.
        self.frames = [(names[i], labels.get(i)) for i in range(first, first + depth)]
        # Rectangles that are black in every frame.
        self.hidden = record.get("hidden", [])

    def picture(self, recording, name):
        """Pixels of a recorded frame (row, column, colour), black where the recording is hidden."""
        path = recording / (name + ".png" if stem(name) == name else name)
        if not path.is_file():
            sys.exit(f"{path} is missing: give the folder that holds the recorded pictures")
        pixels = np.array(Image.open(path).convert("RGB"))
        if pixels.shape[:2] != (self.height, self.width):
            sys.exit(f"{path} is not {self.width}x{self.height} pixels large, as the recording is")
        for hidden in self.hidden:
            x, y = hidden["x"], hidden["y"]
            pixels[y : y + hidden["height"], x : x + hidden["width"]] = 0
        return pixels


def stem(name):
    """The name of a recorded frame without the ending of a picture."""
    return Path(name).stem if name.lower().endswith(ENDINGS) else name


def write_volume(path, export, pictures):
    """Writes the pictures as RGB, x, y, frame, with the axes of the export's segmentation. Frames without a
    picture are black, so that pictures and segments of a frame have the same place."""
    black = np.zeros((export.height, export.width, 3), "u1")
    voxels = np.stack([(black if p is None else p).transpose(2, 1, 0) for p in pictures], -1)
    header = {
        "space": "left-posterior-superior",
        "kinds": ["RGB-color", "domain", "domain", "domain"],
        "space directions": np.vstack([np.full(3, np.nan), np.eye(3)]),  # none for the colours
        "space origin": [0, 0, 0],
        "encoding": "gzip",
    }
    nrrd.write(str(path), voxels, header, compression_level=1)


def write_dataset(folder, export, pictures):
    """Writes pictures and label pictures under the same names, as MONAI Label's local datastore wants them.
    Frames without a label picture are left out: an empty one would say that nothing is there."""
    labels = folder / "labels/final"
    labels.mkdir(parents=True)
    for (name, label), picture in zip(export.frames, pictures):
        if label:
            Image.fromarray(picture).save(folder / f"{stem(name)}.png")
            shutil.copyfile(label, labels / f"{stem(name)}.png")
    shutil.copyfile(export.folder / "index/labels.json", labels / "labels.json")


def lay_out(export, recording, out):
    if out.exists():
        sys.exit(f"{out} is there already: choose another folder")
    export = Export(export)
    pictures = [export.picture(recording, name) if label else None for name, label in export.frames]
    out.mkdir(parents=True)
    write_volume(out / "frames.nrrd", export, pictures)
    write_dataset(out / "dataset", export, pictures)
    print(f"{len(pictures)} frames in {out}")
    black = sum(picture is None for picture in pictures)
    if black:
        print(f"{black} of them are black and not in the dataset, because the scene does not show them")


def bring_back(export, out, segmentation):
    """Writes the label pictures with the header of the export's segmentation, which names the segments. Frames
    that are not in the dataset stay empty."""
    if segmentation.exists():
        sys.exit(f"{segmentation} is there already: choose another name")
    export, labels = Export(export), out / "dataset/labels/final"
    empty = np.zeros((export.width, export.height), "u1")
    slices = [np.asarray(Image.open(labels / f"{stem(n)}.png")).T if label else empty for n, label in export.frames]
    nrrd.write(str(segmentation), np.stack(slices, -1).astype("u1"), export.header)
    print(f"{len(slices)} frames in {segmentation}")


if __name__ == "__main__":
    arguments = sys.argv[1:]
    is_back = arguments[:1] == ["--back"]
    paths = list(map(Path, arguments[is_back:]))
    if len(paths) != 3:
        sys.exit(__doc__)
    (bring_back if is_back else lay_out)(*paths)
