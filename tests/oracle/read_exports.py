"""Reads exports of the program with the programs' own readers and compares the formats with each other.

The 0/255 masks and the f32 scores are the reference; everything else is made from the same pixels and must
agree. Exits with 1 at the first thing that does not. See README.md beside this file.
"""

import contextlib
import csv
import io
import json
import sys
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import av
import cairosvg
import nrrd
import numpy as np
import slicerio
from PIL import Image, ImageSequence
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO


def check(is_right, what):
    if not is_right:
        sys.exit(f"wrong: {what}")


def one(folder, name):
    files = list((folder / name).iterdir())
    check(len(files) == 1, f"one file in {name}")
    return files[0]


class Export:
    """Masks and scores of an export, [prompt][frame] of rows × columns."""

    def __init__(self, folder):
        self.folder = folder
        self.record = json.loads((folder / "provenance.json").read_text("utf-8"))
        check(self.record["complete"], "the export is complete")
        self.prompts = [p["text"] for p in self.record["prompts"]]
        self.is_exclusive = self.record["options"]["exclusive"]
        by_place = {(f["prompt"], f["frame"]): f["name"] for f in self.record["files"] if f["name"].startswith("binary/")}
        self.frames = sorted({frame for _, frame in by_place})
        self.slug = lambda p, f: by_place[p, f].removeprefix("binary/").removesuffix(".png")
        self.masks = [[self.image(f"binary/{self.slug(p, f)}.png") == 255 for f in self.frames] for p in self.prompts]
        self.scores = [[np.load(folder / f"npy/{self.slug(p, f)}.npy") for f in self.frames] for p in self.prompts]

    def image(self, name):
        return np.asarray(Image.open(self.folder / name))

    def each(self):
        for p, prompt in enumerate(self.prompts):
            for i, frame in enumerate(self.frames):
                yield prompt, frame, self.masks[p][i], self.scores[p][i]

    def labels(self, i):
        """The index picture of the i-th frame."""
        return self.image(f"index/frame_{self.frames[i]:06}.png")


def check_pictures(e):
    """Pillow, NumPy."""
    worst = 0.0
    for prompt, frame, mask, scores in e.each():
        check(scores.dtype == np.float32 and scores.shape == mask.shape, "scores are f32 of the masks' size")
        grey = e.image(f"score/{e.slug(prompt, frame)}.png")
        check(grey.dtype == np.uint16 or grey.dtype == np.int32, "score pictures have 16 bits")
        worst = max(worst, np.abs(grey / 65535 - scores.astype(np.float64)).max())
        cut = e.image(f"cutout/{e.slug(prompt, frame)}.png")
        check(((cut[..., 3] == 255) == mask).all() and (cut[~mask] == 0).all(), "cut-outs show the mask")
        if not e.is_exclusive:
            threshold = next(p["threshold"] for p in e.record["prompts"] if p["text"] == prompt)
            check(((scores > np.float32(threshold)) == mask).all(), "masks are scores above the threshold")
    check(worst <= 1 / 65535, f"score pictures are right to 1/65535, not {worst}")
    return f"largest error of 16-bit scores {worst * 65535:.3f}/65535"


def check_coco(e):
    """pycocotools."""
    # The reader prints how long it takes.
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO(str(one(e.folder, "coco")))
    found = 0
    for p, prompt in enumerate(e.prompts):
        for i, frame in enumerate(e.frames):
            mask = e.masks[p][i]
            ids = coco.getAnnIds(imgIds=[frame], catIds=[p + 1])
            check(len(ids) == int(mask.any()), "one annotation where something was found")
            for annotation in coco.loadAnns(ids):
                own = coco_mask.encode(np.asfortranarray(mask.astype(np.uint8)))
                check(annotation["segmentation"]["counts"] == own["counts"].decode(), "the text is pycocotools' own")
                check((coco.annToMask(annotation) == mask).all(), "the mask reads back")
                check(annotation["area"] == coco_mask.area(own), "area")
                check(annotation["bbox"] == coco_mask.toBbox(own).tolist(), "box")
                found += 1
    check([c["name"] for c in coco.loadCats(coco.getCatIds())] == e.prompts, "categories")
    return f"{found} annotations equal to pycocotools' text, area and box"


def check_tables(e):
    """csv, json."""
    with open(one(e.folder, "csv"), encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    table = json.loads(one(e.folder, "json").read_text("utf-8"))
    check(len(rows) == len(table["measurements"]) == len(e.prompts) * len(e.frames), "a row per prompt and frame")
    same = lambda text, value: text == "" if value is None else text == value or float(text) == value
    for row, twin in zip(rows, table["measurements"]):
        number, time = list(row)[:2]
        check(number == "frame_from_1" and int(row[number]) == twin["frame"] + 1, "CSV counts frames from 1")
        check(time.startswith("time_s") and (time != "time_s" or same(row[time], twin["time_s"])), "times")
        rest = list(row)[2:]
        check(all(same(row[k], twin[k]) for k in rest) and rest == list(twin)[2:], "CSV and JSON agree")
    last = {}
    for row in table["measurements"]:
        p, i = e.prompts.index(row["prompt"]), e.frames.index(row["frame"])
        mask, scores = e.masks[p][i], e.scores[p][i].astype(np.float64)
        check(row["area_px"] == mask.sum() and abs(row["area_fraction"] - mask.mean()) < 1e-12, "area")
        check(abs(row["max_score"] - scores.max()) < 1e-6, "best score")
        check((row["mean_score"] is None) == (not mask.any()), "a mean where something was found")
        if mask.any():
            y, x = np.nonzero(mask)
            place = np.array([x.mean() + 0.5, y.mean() + 0.5])
            check(np.allclose([row["centroid_x_px"], row["centroid_y_px"]], place, atol=1e-9), "centroid")
            check(abs(row["mean_score"] - scores[mask].mean()) < 1e-9, "mean score")
            moved = np.hypot(*(place - last[p])) if p in last else None
            check(moved is row["moved_px"] or abs(moved - row["moved_px"]) < 1e-9, "motion")
            last[p] = place
    return f"{len(rows)} rows of CSV and JSON equal to what NumPy measures"


def check_nrrd(e):
    """pynrrd, slicerio."""
    path = one(e.folder, "nrrd")
    voxels, header = nrrd.read(str(path))
    size = (*e.masks[0][0].T.shape, len(e.frames))
    check(voxels.shape[-3:] == size, f"x, y, frame are {size}, not {voxels.shape}")
    check("millimetres" in header["axis_units"], "a field says what the axes are")
    segmentation = slicerio.read_segmentation(str(path))
    check([s["name"] for s in segmentation["segments"]] == e.prompts, "names of segments")
    colours = [tuple(round(255 * c) for c in s["color"]) for s in segmentation["segments"]]
    check(colours == [tuple(p["colour"]) for p in e.record["prompts"]], "colours of segments")
    for p, segment in enumerate(segmentation["segments"]):
        layer = voxels[segment.get("layer", 0)] if voxels.ndim == 4 else voxels
        for i in range(len(e.frames)):
            check(((layer[:, :, i].T == segment["labelValue"]) == e.masks[p][i]).all(), "voxels are the masks")
    kind = "layers" if voxels.ndim == 4 else "labels"
    return f"{len(e.prompts)} segments as {kind}, volume {voxels.shape}"


def check_index(e):
    """Pillow."""
    if e.is_exclusive:
        for i in range(len(e.frames)):
            owners = sum((p + 1) * e.masks[p][i].astype(int) for p in range(len(e.prompts)))
            check((e.labels(i) == owners).all(), "label pictures are the masks")
    return "label pictures agree"


def check_svg(e):
    """cairosvg: the paths filled are the masks."""
    namespace = "{http://www.w3.org/2000/svg}"
    for i, frame in enumerate(e.frames):
        root = ElementTree.parse(e.folder / f"outline/frame_{frame:06}.svg").getroot()
        for path in root.findall(f"{namespace}path"):
            p = e.prompts.index(path.find(f"{namespace}title").text)
            lone = ElementTree.Element(f"{namespace}svg", root.attrib)
            ElementTree.SubElement(lone, f"{namespace}path", {"d": path.get("d"), "fill-rule": "evenodd"})
            drawn = cairosvg.svg2png(bytestring=ElementTree.tostring(lone))
            alpha = np.asarray(Image.open(io.BytesIO(drawn)).convert("RGBA"))[..., 3]
            check(((alpha == 255) == e.masks[p][i]).all(), "outlines filled are the masks")
    return "outlines filled are the masks"


def check_moving(e):
    """FFmpeg through PyAV, Pillow."""
    with av.open(str(one(e.folder, "video"))) as video:
        speed = video.streams.video[0].average_rate
        shown = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    check(len(shown) == len(e.frames), "a picture of the video per frame")
    check(speed == e.record["frames_per_second"], "the recording's speed")
    light = lambda picture: picture.astype(float) @ [0.299, 0.587, 0.114]
    overlays = [e.image(f"overlay/frame_{frame:06}.png") for frame in e.frames]
    errors = [np.sqrt(((light(a) - light(b)) ** 2).mean()) for a, b in zip(shown, overlays)]
    check(max(errors) < 6, f"brightness of the video is right to 6 of 255, not {max(errors)}")
    animation = Image.open(one(e.folder, "gif"))
    delays = [frame.info["duration"] for frame in ImageSequence.Iterator(animation)]
    check(len(delays) == len(e.frames), "a picture of the GIF per frame")
    sheet = Image.open(one(e.folder, "sheet"))
    return (
        f"video of {len(shown)} pictures at {speed}/s, brightness right to {max(errors):.1f} of 255; "
        f"GIF of {len(delays)}, {sum(delays)} ms; sheet {sheet.size[0]}x{sheet.size[1]}"
    )


def print_fixtures():
    """Prints the texts in crates/core/src/mask/rle.rs."""
    fixtures = [
        (7, 5, lambda x, y: y > x or x == 6),
        (40, 24, lambda x, y: 3 * x + 5 * y < 90 and (x + 2 * y) % 7 > 1),
        (130, 90, lambda x, y: x * x + 3 * y * y < 9000 and (x < 40 or y > 20)),
        (6, 4, lambda x, y: True),
        (6, 4, lambda x, y: False),
    ]
    for width, height, is_set in fixtures:
        mask = np.array([[is_set(x, y) for x in range(width)] for y in range(height)], np.uint8)
        print(coco_mask.encode(np.asfortranarray(mask))["counts"].decode())


if __name__ == "__main__":
    print(", ".join(f"{name} {version(name)}" for name in ["numpy", "pillow", "av", "pycocotools", "pynrrd", "slicerio", "cairosvg"]))
    print_fixtures()
    for folder in map(Path, sys.argv[1:]):
        export = Export(folder)
        print("exclusive" if export.is_exclusive else "overlapping", *export.prompts, sep=", ")
        for test in [check_pictures, check_index, check_coco, check_tables, check_nrrd, check_svg, check_moving]:
            print("  " + test(export))
