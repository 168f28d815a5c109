"""Reads scenes of SurgTPGS with NumPy alone, plain or quantised: Gaussians at any time, cameras, classes, and
scores of what the scene knows by name.

    from read_scene import Scene
    scene = Scene("scene.safetensors")
    now = scene.at(scene.times[12])                     # .positions, .colours, .scales ... of all Gaussians
    liver = scene.class_scores(now)[:, scene.classes.index("liver")]
    mine = now.positions[(liver > 0.5) & (now.opacities >= 0.5)]

    for chapter in chapters("long.safetensors"):        # a long scene has Gaussians of its own in each chapter
        part = Scene("long.safetensors", chapter["index"])

    python read_scene.py scene.safetensors 0.25 2       # prints what is in its third chapter, at this time

The file is an ordinary safetensors file. `crates/core/src/scene/file/mod.rs` lists its tensors, and
`crates/core/README.md` has the formulas (sections 3, 7 and 9.2). Words that are no class of the scene need the
text encoder, which is not here: give the unit embedding of your own encoder's text to `scores`.
"""

import json
import sys
import zlib
from collections import namedtuple

import numpy as np

BAND_0 = 0.28209479  # the constant spherical harmonic
TEMPERATURE = 10.0
DTYPES = {"F32": "<f4", "F16": "<f2", "U32": "<u4", "U8": "u1"}

# positions, scales (standard deviations) and colours (RGB, 1 = white, at degree 0) are [N, 3], rotations unit
# quaternions (w, x, y, z), opacities [N], features [N, latent numbers].
Gaussians = namedtuple("Gaussians", "positions rotations scales opacities colours features")
# fx, fy, cx, cy are pixels; camera_from_world is 3×4, with x right, y down and z forward.
Camera = namedtuple("Camera", "width height fx fy cx cy camera_from_world")


def sigmoid(x):
    return 0.5 * (1 + np.tanh(0.5 * x))


def unit_rows(rows, without_direction=0.0):
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.where(length > 1e-12, rows / np.maximum(length, 1e-12), without_direction)


class Tensors:
    """The tensors of a safetensors file by name, as float64 where they are numbers of the scene."""

    def __init__(self, data):
        start = 8 + int.from_bytes(data[:8], "little")
        self.entries = json.loads(data[8:start])
        self.metadata = self.entries.pop("__metadata__", {})
        self.data = memoryview(data)[start:]

    def __contains__(self, name):
        return name in self.entries

    def raw(self, name):
        entry = self.entries[name]
        begin, end = entry["data_offsets"]
        return np.frombuffer(self.data[begin:end], DTYPES[entry["dtype"]]).reshape(entry["shape"])

    def __getitem__(self, name):
        """Values as they were before `--quantize`, which stores whole numbers of small steps, deflated."""
        values = self.raw(name)
        if name + ".shape" not in self:
            return values.astype(np.float64)
        shape, step, offset = (self.raw(name + end) for end in (".shape", ".step", ".offset"))
        planes = np.frombuffer(zlib.decompress(values.tobytes()), "u1").reshape(4, len(step), -1).astype("i8")
        n = sum(plane << 8 * k for k, plane in enumerate(planes))
        whole = np.where(n & 1, -(n >> 1) - 1, n >> 1)
        values = (offset.astype(np.float64) + step.astype(np.float64) * whole.T).reshape(shape)
        # What changes over time is stored as its cosine transform.
        return np.tensordot(self[name + ".mix"], values, 1) if name + ".mix" in self else values


def read(path):
    with open(path, "rb") as file:
        return Tensors(file.read())


def chapters(path):
    """The chapters of a scene, each with its `index` and the frames from `shown.start` to before `shown.end`; none
    if it is one whole."""
    known = read(path).metadata.get("surgtpgs_chapters")
    return json.loads(known)["chapters"] if known else []


class Scene:
    """A scene, or a chapter of one; `header` has everything that is not a tensor, such as who made it from what."""

    def __init__(self, path, chapter=0):
        t = part = read(path)
        if "surgtpgs_chapters" in t.metadata:
            # Chapters are scene files inside of the file; what they share is in another one.
            t, part = (Tensors(t.raw(name).tobytes()) for name in ["index", f"chapter.{chapter}"])
        self.tensors, self.part = t, part
        if "surgtpgs" not in t.metadata:
            raise ValueError(f"{path} is no scene of SurgTPGS")
        self.header = json.loads(t.metadata["surgtpgs"])
        if self.header["version"] > 1:
            raise ValueError(f"{path} has version {self.header['version']}, this reads version 1")
        self.cameras = [Camera(int(r[0]), int(r[1]), *r[2:6], r[6:].reshape(3, 4)) for r in t["cameras"]]
        frames = len(self.cameras)
        self.times = t["times"] if "times" in t else np.arange(frames) / frames
        bits = np.unpackbits(t.raw("field_of_view"), axis=1)
        self.field_of_view = bits[:, : self.cameras[0].width].astype(bool)
        self.classes = [c["name"] for c in self.header["classes"]]
        self.class_embeddings = t["class_embeddings"]
        self.encoder, self.decoder = self._layers("encoder"), self._layers("decoder")
        self.gates = json.loads(part.metadata["surgtpgs"])
        self.rest = {n: part[n] for n in ["means", "rotations", "log_scales", "opacity_logits", "colours", "features"]}
        self.bases = {n: part["basis_" + n] for n in ["weights", "centres", "widths"]}
        n = len(self.rest["means"])
        self.moving = part.raw("moving").astype(int) if "moving" in part else np.arange(n)

    def _layers(self, half):
        layers = []
        while f"{half}.{len(layers)}.weight" in self.tensors:
            layers.append(tuple(self.tensors[f"{half}.{len(layers)}.{part}"] for part in ("weight", "bias")))
        return layers

    def basis(self, time):
        """Values of the basis functions: [B, 1, 1] where all Gaussians share them, else [B, M, channels]."""
        centres, widths = self.bases["centres"], self.bases["widths"]
        if centres.ndim == 1:
            centres, widths = centres[:, None, None], widths[:, None, None]
        d, width = time - centres, np.maximum(np.abs(widths), 1e-7)
        shape = self.gates["basis_shape"]
        if shape == "spline":
            u = np.abs(d / width)
            value = (np.maximum(2 - u, 0) ** 3 - 4 * np.maximum(1 - u, 0) ** 3) / 6
        elif shape == "gaussian":
            value = np.exp(-(d**2) / (2 * width**2))
        else:
            value = np.exp(-((d**2 / (widths**2 + 1e-4)) ** 2))
        return np.where(value > 1e-4, value, 0)

    def motion(self, time):
        """What is added at a time, [N, channels]: centre, quaternion, log-scale, colour, gate of features."""
        weights = self.bases["weights"]
        psi = np.zeros((len(self.rest["means"]), weights.shape[2]))
        psi[self.moving] = (self.basis(time) * weights).sum(0)
        return psi

    def at(self, time):
        """All Gaussians at a time of 0 to 1; `times` has those of the frames."""
        g, psi = self.rest, self.motion(time)
        return Gaussians(
            positions=g["means"] + psi[:, :3],
            rotations=unit_rows(g["rotations"] + psi[:, 3:7], [1.0, 0.0, 0.0, 0.0]),
            scales=np.exp(np.clip(g["log_scales"] + psi[:, 7:10], -15, 15)),
            opacities=sigmoid(g["opacity_logits"]),
            colours=np.maximum(0.5 + BAND_0 * (g["colours"] + psi[:, 10:13]), 0),
            features=self._features(time, psi),
        )

    def _features(self, time, psi):
        rest, first = self.rest["features"], self.gates.get("gate_channel", 13)
        weight, bias = self.part["feature_net_weight"], self.part["feature_net_bias"]
        change = np.column_stack([rest, np.full(len(rest), time)]) @ weight.T + bias
        gate = sigmoid(self.gates["gate_slope"] * psi[:, first : first + rest.shape[1]])
        return rest + change * gate

    def decode(self, features):
        """Unit embeddings of features, in the space of the text encoder that `header["encoder"]` names."""
        for k, (weight, bias) in enumerate(self.decoder):
            features = features @ weight.T + bias
            if k + 1 < len(self.decoder):
                features = np.maximum(features, 0)
        return unit_rows(features)

    def scores(self, gaussians, meant, others):
        """Score of each Gaussian, 0 to 1: above one half it is nearer to one of the unit embeddings `meant`
        than to any of `others`."""
        if not self.decoder:
            raise ValueError("this scene was trained without features")
        embeddings = self.decode(gaussians.features)
        margin = (embeddings @ np.atleast_2d(meant).T).max(1)
        if len(others):
            margin = margin - (embeddings @ np.atleast_2d(others).T).max(1)
        return sigmoid(TEMPERATURE * margin)

    def class_scores(self, gaussians):
        """Scores of the scene's own classes, [N, classes], each against all others."""
        rows = self.class_embeddings
        each = [self.scores(gaussians, rows[k], np.delete(rows, k, 0)) for k in range(len(rows))]
        return np.stack(each, 1) if each else np.zeros((len(gaussians.positions), 0))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python read_scene.py SCENE.safetensors [TIME [CHAPTER]]")
    scene = Scene(sys.argv[1], int(sys.argv[3]) if len(sys.argv) > 3 else 0)
    now = scene.at(float(sys.argv[2]) if len(sys.argv) > 2 else scene.times[0])
    camera = scene.cameras[0]
    print(f"{len(now.positions)} Gaussians, {len(scene.moving)} of them move")
    print(f"{len(scene.cameras)} frames of {camera.width}×{camera.height}")
    is_found = (scene.class_scores(now) > 0.5) & (now.opacities >= 0.5)[:, None]
    for name, number in zip(scene.classes, is_found.sum(0)):
        print(f"{name}: {number} Gaussians")
