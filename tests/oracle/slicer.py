"""Reads an export as 3D Slicer's and MONAI Label's libraries do, corrects it with them, and has it read back.

    python slicer.py PROGRAM WORK      WORK is an empty folder

Needs numpy, pillow, pynrrd, slicerio, SimpleITK, pydicom, highdicom, monai (with torch) and monailabel. Exits with
1 at the first thing that does not agree. See README.md beside this file.
"""

import json
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import highdicom
import monai.transforms as mt
import nrrd
import numpy as np
import pydicom
import SimpleITK
import slicerio
from monai.data import DataLoader, Dataset
from monailabel.datastore.local import LocalDatastore
from PIL import Image

LAY_OUT = Path(__file__).parents[2] / "assets/slicer/lay_out.py"
PROMPTS = ["liver", "gallbladder", "grasping tool"]
NAMES = ['Gallenblase ü, "links"', "a:=b\\new: 胆囊 🫀", "two\nlines"]


def check(is_right, what):
    if not is_right:
        sys.exit(f"wrong: {what}")


def one(folder):
    files = list(folder.iterdir())
    check(len(files) == 1, f"one file in {folder}")
    return files[0]


def label_pictures(export):
    """[frame, row, column] of label ids, the reference."""
    return np.stack([np.asarray(Image.open(p)) for p in sorted((export / "index").glob("*.png"))])


def check_volumes(export, laid, labels):
    """The segmentation and the pictures as Slicer's reader, ITK, has them: [frame, row, column]."""
    segmentation = SimpleITK.ReadImage(str(one(export / "nrrd")))
    frames = SimpleITK.ReadImage(str(laid / "frames.nrrd"))
    check((SimpleITK.GetArrayFromImage(segmentation) == labels).all(), "SimpleITK's voxels are the label pictures")
    for about in ["GetSize", "GetSpacing", "GetOrigin", "GetDirection"]:
        check(getattr(frames, about)() == getattr(segmentation, about)(), f"{about}: the pictures lie as the labels do")
    picture = np.asarray(Image.open(sorted((laid / "dataset").glob("*.png"))[7]))
    check((SimpleITK.GetArrayFromImage(frames)[7] == picture).all(), "the pictures are in their places")
    names = [s["name"] for s in slicerio.read_segmentation(str(one(export / "nrrd")))["segments"]]
    check(names == PROMPTS, "slicerio's names")
    return "volumes: SimpleITK and slicerio agree with the label pictures"


def check_dicom(export, labels):
    """The DICOM segmentation by pydicom and highdicom."""
    path = one(export / "dicom-seg")
    check([s.SegmentLabel for s in pydicom.dcmread(path).SegmentSequence] == PROMPTS, "names of segments")
    volume = highdicom.seg.segread(path).get_volume(combine_segments=False)
    check(volume.shape == (*labels.shape, len(PROMPTS)), f"volume of {volume.shape}")
    # It may list frames from the last one; its affine transform says so.
    array = volume.array[::-1] if volume.affine[2, 0] < 0 else volume.array
    for k in range(len(PROMPTS)):
        check(((array[..., k] == 1) == (labels == k + 1)).all(), "highdicom's voxels are the label pictures")
    return "DICOM SEG: pydicom and highdicom agree with the label pictures"


def check_monai(laid, labels):
    """MONAI Label's own local datastore, and MONAI's transforms on what it lists, up to a batch."""
    datalist = LocalDatastore(str(laid / "dataset"), extensions=["*.png"]).datalist()
    check(len(datalist) == len(labels), f"{len(datalist)} pairs of {len(labels)}")
    datalist.sort(key=lambda pair: pair["image"])
    load = mt.Compose([
        mt.LoadImaged(keys=["image", "label"]),
        mt.EnsureChannelFirstd(keys="image", channel_dim=-1),
        mt.EnsureChannelFirstd(keys="label", channel_dim="no_channel"),
        mt.ScaleIntensityd(keys="image"),
    ])
    for pair, truth in zip(Dataset(datalist, load), labels):
        # MONAI's reader of pictures has columns first.
        check((pair["label"][0].numpy().T == truth).all(), "MONAI's labels are the label pictures")
        check(pair["image"].shape == (3, *truth.T.shape), "MONAI's pictures")
    batch = next(iter(DataLoader(Dataset(datalist, load), batch_size=4)))
    check(batch["image"].shape[:2] == (4, 3), "a batch")
    return f"MONAI: {len(datalist)} pairs of picture and labels"


def recording_with(work, labels):
    """A copy of the recording whose labels are those of a file."""
    copy = work / f"recording-{labels.name.split('.')[0]}"
    shutil.copytree(work / "recording", copy)
    shutil.copy(labels, copy)
    with (copy / "sequence.toml").open("a", encoding="utf-8") as settings:
        settings.write(f'\n[labels]\nfile = "{labels.name}"\n')
    return copy


def fit(program, recording, pictures):
    """Strict IoU of label pictures with the labels of a recording, and how often these have a class on a frame."""
    report = json.loads(run(program, "eval", recording, "--masks", pictures, "--json"))
    return report["iou"]["strict"]["mean"], report["masks"]["threshold"]["labelled"]


def pairs_in(labels):
    """How often label pictures have a class on a frame."""
    return sum(len(set(np.unique(frame)) - {0}) for frame in labels)


def check_corrections(program, work, export, laid):
    """A square is corrected in three programs; each file comes back as labels with exactly this change."""
    square, at = (10, slice(30, 50), slice(40, 70)), [work / f"{name}.seg.nrrd" for name in ["itk", "pynrrd", "monai"]]
    image = SimpleITK.ReadImage(str(one(export / "nrrd")))
    for x in range(40, 70):
        for y in range(30, 50):
            image[x, y, 10] = 2
    SimpleITK.WriteImage(image, str(at[0]), True)
    voxels, header = nrrd.read(str(one(export / "nrrd")))
    voxels[40:70, 30:50, 10] = 2
    nrrd.write(str(at[1]), voxels, header)
    pictures = laid / "dataset/labels/final"
    label = sorted(pictures.glob("*.png"))[10]
    pixels = np.asarray(Image.open(label)).copy()
    pixels[30:50, 40:70] = 2
    Image.fromarray(pixels).save(label)
    lay_out("--back", export, laid, at[2])
    truth = label_pictures(export)
    truth[square] = 2
    for path in at:
        copy = recording_with(work, path)
        found = fit(program, copy, pictures)
        check(found == (1, pairs_in(truth)), f"{path.name} is read as the corrected labels: {found}")
        prepared = [work / f"prepared-{path.name}-{k}" for k in range(2)]
        run(program, "prepare", copy, "-o", prepared[0], "--labels")
        run(program, "prepare", work / "recording", "-o", prepared[1], "--labels-from", path)
        features = [(folder / "features.safetensors").read_bytes() for folder in prepared]
        check(features[0] == features[1], f"features of {path.name} by --labels-from")
    # What differs by a frame, or by the correction, must be seen.
    nrrd.write(str(work / "shifted.seg.nrrd"), np.roll(voxels, 1, -1), header)
    for path in [work / "shifted.seg.nrrd", shutil.copy(one(export / "nrrd"), work / "uncorrected.seg.nrrd")]:
        check(fit(program, recording_with(work, path), pictures)[0] < 1, f"{path.name} is told from the corrected labels")
    return "corrections by SimpleITK, pynrrd and in MONAI Label's dataset are read as labels"


def check_gap(program, work):
    """Of a scene without its second chapter, pictures and labels stay on their frames, there and back."""
    chapters = [work / f"chapter{k}.safetensors" for k in [0, 2]]
    for k, chapter in zip([0, 2], chapters):
        settings = ["--iterations", 200, "--chapter-frames", 4, "--chapter", k]
        run(program, "train", work / "prepared", "-o", chapter, *settings)
    run(program, "join", "-o", work / "gap.safetensors", *chapters)
    export, laid, back = work / "gap", work / "laid-gap", work / "back.seg.nrrd"
    write_export(program, work / "gap.safetensors", export, "nrrd,index")
    lay_out(export, work / "recording/images", laid)
    shown = [i for i in range(12) if (export / f"index/frame_{i:06}.png").is_file()]
    check(shown == [0, 1, 2, 3, 8, 9, 10, 11], f"the frames {shown} are shown")
    truth = np.zeros((12, 72, 96), np.uint8)
    truth[shown] = label_pictures(export)
    frames = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(laid / "frames.nrrd")))
    segmentation = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(one(export / "nrrd"))))
    check((segmentation == truth).all(), "the segmentation is empty where nothing is shown")
    for i, picture in enumerate(sorted((work / "recording/images").glob("*.png"))):
        expected = np.asarray(Image.open(picture)) if i in shown else 0
        check((frames[i] == expected).all(), f"the picture of frame {i} is in its place")
    names = [f"frame_{i:06}.png" for i in shown]
    for folder in [laid / "dataset", laid / "dataset/labels/final"]:
        check([p.name for p in sorted(folder.glob("*.png"))] == names, f"{folder} has the frames that are shown")
    lay_out("--back", export, laid, back)
    found = fit(program, recording_with(work, back), laid / "dataset/labels/final")
    check(found == (1, pairs_in(truth)), f"labels come back on their frames: {found}")
    return "of a scene that shows 8 of 12 frames, pictures and labels keep their frames"


def check_hidden(program, work):
    """What a recording hides is black in the pictures and in the dataset, and nothing else changes."""
    hide = ["--hide", "5,3,20,8"]
    run(program, "prepare", work / "recording", "-o", work / "prepared-hidden", "--labels", *hide)
    run(program, "train", work / "prepared-hidden", "-o", work / "hidden.safetensors", "--iterations", 100)
    export, laid = work / "hidden", work / "laid-hidden"
    write_export(program, work / "hidden.safetensors", export, "nrrd,index")
    lay_out(export, work / "recording/images", laid)
    frames = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(laid / "frames.nrrd")))
    for i, picture in enumerate(sorted((work / "recording/images").glob("*.png"))):
        expected = np.asarray(Image.open(picture)).copy()
        expected[3:11, 5:25] = 0
        check((frames[i] == expected).all(), f"frame {i} of the volume is black where it is hidden")
        copied = np.asarray(Image.open(laid / "dataset" / picture.name))
        check((copied == expected).all(), f"frame {i} of the dataset is black where it is hidden")
    return "what is hidden is black in the volume and in the dataset"


def check_names(program, work):
    """Names of any letters: in ASCII for pynrrd, and back after it has dropped letters."""
    corners = [[[2, 2], [45, 35]], [[50, 2], [94, 35]], [[2, 38], [94, 70]]]
    marks = [{"frame": 4, "name": n, "kind": "box", "points_px": c} for n, c in zip(NAMES, corners)]
    (work / "marks.json").write_text(json.dumps({"marks": marks}), "utf-8")
    prompts = [text for name in NAMES for text in ("--prompt", name)]
    out, scene = work / "names", work / "scene.safetensors"
    run(program, "export", scene, "--marks", work / "marks.json", *prompts, "-o", out, "--format", "nrrd")
    voxels, header = nrrd.read(str(one(out / "nrrd")))
    check(json.loads(header["segment_names"]) == NAMES, "pynrrd's names")
    itk = SimpleITK.ReadImage(str(one(out / "nrrd")))
    check([itk.GetMetaData(f"Segment{i}_Name") for i in range(3)] == NAMES, "SimpleITK's names")
    check(json.loads(itk.GetMetaData("segment_names")) == NAMES, "SimpleITK's names in ASCII")
    nrrd.write(str(work / "again.seg.nrrd"), voxels, header)
    run(program, "export", scene, "--marks", work / "again.seg.nrrd", *prompts, "-o", work / "again", "--format", "nrrd")
    header = nrrd.read_header(str(one(work / "again/nrrd")))
    check(json.loads(header["segment_names"]) == NAMES, "names after pynrrd")
    return "names of any letters come back, also after pynrrd"


def run(program, *arguments):
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)
    check(done.returncode == 0, f"{arguments[0]}: {done.stderr}")
    return done.stdout


def write_export(program, scene, folder, formats):
    prompts = [text for name in PROMPTS for text in ("--prompt", name)]
    run(program, "export", scene, *prompts, "-o", folder, "--format", formats, "--exclusive")


def lay_out(*arguments):
    subprocess.run([sys.executable, LAY_OUT, *arguments], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    program, work = sys.argv[1], Path(sys.argv[2])
    print(", ".join(f"{n} {version(n)}" for n in ["pynrrd", "slicerio", "SimpleITK", "pydicom", "highdicom", "monai", "monailabel"]))
    run(program, "demo", "-o", work / "recording", "--width", 96, "--height", 72, "--frames", 12)
    run(program, "prepare", work / "recording", "-o", work / "prepared", "--labels")
    run(program, "train", work / "prepared", "-o", work / "scene.safetensors", "--iterations", 400)
    export, laid = work / "export", work / "laid"
    write_export(program, work / "scene.safetensors", export, "nrrd,index,dicom-seg")
    lay_out(export, work / "recording/images", laid)
    labels = label_pictures(export)
    print(check_volumes(export, laid, labels))
    print(check_dicom(export, labels))
    print(check_monai(laid, labels))
    print(check_corrections(program, work, export, laid))
    print(check_gap(program, work))
    print(check_hidden(program, work))
    print(check_names(program, work))
