"""Reads DICOM segmentations with pydicom and highdicom and compares them with the PNGs of the same export.

    python segmentations.py PROGRAM FOLDER PICTURES SCENE [SCENE …]

PICTURES has the recorded frames of the first scene. Makes a DICOM recording of these, too, learns a scene of it with the first export as
its labels, and treats it like the others. Kinds are binary, fractional and labelmap. Where `dciodvfy` is
installed, it must find no error in binary and fractional ones; it is older than label maps.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import highdicom
import numpy as np
import pydicom
from PIL import Image
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

KINDS = ["binary", "fractional", "labelmap"]
VL_ENDOSCOPIC = "1.2.840.10008.5.1.4.1.1.77.1.1.1"


def run(program, *arguments):
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{arguments}: {done.stderr}")
    return done.stdout


def dicom_of(pictures, out):
    """Writes pictures as one uncompressed endoscopic video."""
    frames = np.stack([np.array(Image.open(path).convert("RGB")) for path in pictures])
    video = pydicom.Dataset()
    video.file_meta = pydicom.dataset.FileMetaDataset()
    video.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    video.file_meta.MediaStorageSOPClassUID = video.SOPClassUID = VL_ENDOSCOPIC
    video.file_meta.MediaStorageSOPInstanceUID = video.SOPInstanceUID = generate_uid()
    video.StudyInstanceUID, video.SeriesInstanceUID = generate_uid(), generate_uid()
    video.Modality, video.PatientName, video.PatientID = "ES", "Doe^Jane", "4711"
    video.SamplesPerPixel, video.PhotometricInterpretation, video.PlanarConfiguration = 3, "RGB", 0
    video.NumberOfFrames, video.Rows, video.Columns = frames.shape[:3]
    video.BitsAllocated = video.BitsStored = 8
    video.HighBit, video.PixelRepresentation, video.FrameTime = 7, 0, "40"
    video.PixelData = frames.tobytes()
    video.save_as(out, enforce_file_format=True)


def pixels(seg):
    """Pictures of a segmentation by number of segment and of frame."""
    frames = seg.pixel_array.reshape(-1, seg.Rows, seg.Columns)
    for frame, about in zip(frames, seg.PerFrameFunctionalGroupsSequence):
        at = about.FrameContentSequence[0].TemporalPositionIndex - 1
        if seg.SegmentationType == "LABELMAP":
            yield None, at, frame
        else:
            yield about.SegmentIdentificationSequence[0].ReferencedSegmentNumber, at, frame


def expected(out, kind, name, frame):
    """The same picture by the other formats of the export; `None` where nothing was found."""
    if kind == "labelmap":
        return np.array(Image.open(out / f"index/frame_{frame:06}.png"))
    if kind == "fractional":
        scores = np.load(out / f"npy/frame_{frame:06}_{name}.npy")
        return np.floor(scores * 255 + np.float32(0.5)).astype(np.uint8)
    path = out / f"binary/frame_{frame:06}_{name}.png"
    return (np.array(Image.open(path)) > 0).astype(np.uint8) if path.exists() else None


def compare(out, kind):
    """Compares one export; returns the number of pictures."""
    path = next(out.rglob("*.dcm"))
    seg = pydicom.dcmread(path)
    names = {s.SegmentNumber: s.SegmentLabel.replace(" ", "-") for s in seg.SegmentSequence}
    compared = 0
    for number, frame, picture in pixels(seg):
        other = expected(out, kind, names.get(number), frame)
        if other is None or not np.array_equal(picture, other):
            sys.exit(f"{path}: segment {number} of frame {frame} is not as in the other format")
        compared += 1
    if kind == "binary":
        found = [p for p in out.glob("binary/*.png") if np.array(Image.open(p)).any()]
        if len(found) != compared:
            sys.exit(f"{path}: {compared} frames, but {len(found)} masks")
    read = highdicom.seg.segread(path)
    # Zero is the background of label maps.
    if list(read.segment_numbers) != [number for number in names if number] or read.segmentation_type.value != kind.upper():
        sys.exit(f"{path}: highdicom reads segments {list(read.segment_numbers)}, {read.segmentation_type}")
    return compared


def errors(out):
    """Errors that dciodvfy finds; `None` where it is not installed."""
    if not shutil.which("dciodvfy"):
        return None
    said = subprocess.run(["dciodvfy", next(out.rglob("*.dcm"))], capture_output=True, text=True)
    found = [line for line in (said.stdout + said.stderr).splitlines() if line.startswith("Error")]
    for line in found:
        print(line)
    return len(found)


def export(program, scene, out, kind, prompts):
    formats = {"binary": "binary", "fractional": "npy", "labelmap": "index"}[kind]
    exclusive = ["--exclusive"] if kind == "labelmap" else []
    run(program, "export", scene, "-o", out, "--format", f"{formats},dicom-seg", "--seg-type", kind, "--raw",
        "--prompt", *prompts, *exclusive)  # fmt: skip


def main(program, folder, pictures, *scenes):
    folder, pictures = Path(folder), Path(pictures)
    folder.mkdir(parents=True, exist_ok=True)
    prompts = ["liver", "grasper", "gallbladder"]
    recordings = {Path(scene).stem: scene for scene in scenes}
    failed = False
    for kind in KINDS:
        export(program, scenes[0], folder / "first" / kind, kind, prompts)
    record = json.loads((folder / "first/binary/provenance.json").read_text("utf-8"))
    dicom_of([pictures / name for name in record["sequence_frame_names"]], folder / "recording.dcm")
    labels = next((folder / "first/labelmap").rglob("*.dcm"))
    run(program, "prepare", folder / "recording.dcm", "-o", folder / "prepared", "--labels-from", labels)
    run(program, "train", folder / "prepared", "-o", folder / "dicom.safetensors", "--iterations", "400")
    recordings["dicom"] = folder / "dicom.safetensors"
    for name, scene in recordings.items():
        for kind in KINDS:
            out = folder / name / kind
            export(program, scene, out, kind, prompts)
            equal, wrong = compare(out, kind), errors(out)
            failed |= bool(wrong) and kind != "labelmap"
            print(f"{name}, {kind}: {equal} pictures equal, {wrong} errors by dciodvfy")
    sys.exit(failed)


if __name__ == "__main__":
    main(*sys.argv[1:])
