"""Reads scene files and conversions with Python's own readers and compares them with each other.

The scene at the time of a frame is computed here from the scene file, by the formulas; the .ply, the .glb and
the deforming .ply must say the same. Exits with 1 at the first thing that does not. See README.md beside this
file.
"""

import json
import re
import struct
import sys
from importlib.metadata import version
from pathlib import Path

import gsply
import numpy as np
import pygltflib
from plyfile import PlyData
from safetensors import safe_open


def check(is_right, what):
    if not is_right:
        sys.exit(f"wrong: {what}")


def snippet(scene):
    """Runs the Python of crates/app/README.md on a scene; returns the names that it defines."""
    text = (Path(__file__).parents[2] / "crates/app/README.md").read_text("utf-8")
    code = re.search(r"```python\n(.*?)```", text, re.S)[1].replace('"scene.safetensors"', repr(str(scene)))
    names = {}
    exec(code, names)
    return names


def spline(u):
    u = np.abs(u)
    return (np.maximum(2 - u, 0) ** 3 - 4 * np.maximum(1 - u, 0) ** 3) / 6


class Scene:
    def __init__(self, path):
        names = snippet(path)
        with safe_open(path, "np") as f:
            wanted = ["means", "rotations", "log_scales", "opacity_logits", "colours", "basis_weights"]
            self.tensors = {n: names["read"](f, n).astype(np.float64) for n in wanted + ["basis_centres", "basis_widths"]}
        self.tensors["moving"] = names["moving"]
        check(names["header"]["basis_shape"] == "spline", "the demo's bases are splines")
        check(len(self.tensors["means"]) == names["header"]["gaussians"], "the number of Gaussians")
        check((names["means"] == self.tensors["means"].astype(names["means"].dtype)).all(), "means")

    def at(self, time):
        """Places, unit quaternions, log-scales and colours."""
        t = self.tensors
        basis = spline((time - t["basis_centres"]) / t["basis_widths"])
        psi = np.zeros((len(t["means"]), t["basis_weights"].shape[2]))
        psi[t["moving"].astype(int)] = np.tensordot(basis, t["basis_weights"], 1)
        turned = t["rotations"] + psi[:, 3:7]
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return t["means"] + psi[:, :3], turned, t["log_scales"] + psi[:, 7:10], t["colours"] + psi[:, 10:13]


def columns(vertex, *names):
    return np.stack([vertex[n] for n in names], -1).astype(np.float64)


def numbered(name, n):
    return [f"{name}_{i}" for i in range(n)]


def worst(a, b):
    check(a.shape == b.shape, f"shapes {a.shape} and {b.shape}")
    return np.abs(a - b).max()


def check_ply(scene, path, time):
    vertex = PlyData.read(path)["vertex"]
    places, turned, log_scales, colours = scene.at(time)
    found = [columns(vertex, *"xyz"), columns(vertex, *numbered("rot", 4)), columns(vertex, *numbered("scale", 3))]
    errors = [worst(a, b) for a, b in zip([*found, columns(vertex, *numbered("f_dc", 3))], [places, turned, log_scales, colours])]
    check(max(errors) < 1e-4, f"the .ply is the scene at that time, not {errors} away")
    check(worst(vertex["opacity"], scene.tensors["opacity_logits"]) < 1e-6, "opacity")
    return f"{len(vertex)} Gaussians of the .ply are those that NumPy computes from the scene"


def check_glb(path, ply):
    gltf, vertex = pygltflib.GLTF2().load(path), PlyData.read(ply)["vertex"]
    blob, primitive = gltf.binary_blob(), gltf.meshes[0].primitives[0]
    check(primitive.extensions["KHR_gaussian_splatting"]["kernel"] == "ellipse", "the extension is there")
    check(gltf.extensionsUsed == ["KHR_gaussian_splatting"] and primitive.mode == pygltflib.POINTS, "points")
    attributes = json.loads(primitive.attributes.to_json())

    def values(name):
        accessor = gltf.accessors[attributes[name]]
        view = gltf.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        check(view.byteLength == accessor.count * width * 4, f"length of {name}")
        return np.frombuffer(blob, "<f4", accessor.count * width, view.byteOffset).reshape(-1, width).astype(np.float64)

    prefix = "KHR_gaussian_splatting:"
    check((values("POSITION") == columns(vertex, *"xyz")).all(), "places")
    check((gltf.accessors[attributes["POSITION"]].min == values("POSITION").min(0)).all(), "least place")
    rotation = columns(vertex, "rot_1", "rot_2", "rot_3", "rot_0")
    check(worst(values(prefix + "ROTATION"), rotation) < 1e-6, "quaternions x, y, z, w")
    scale = np.exp(columns(vertex, *numbered("scale", 3)))
    check((np.abs(values(prefix + "SCALE") / scale - 1) < 1e-5).all(), "scales are linear")
    opacity = 1 / (1 + np.exp(-columns(vertex, "opacity")))
    check(worst(values(prefix + "OPACITY"), opacity) < 1e-6, "opacity is linear")
    check((values(prefix + "SH_DEGREE_0_COEF_0") == columns(vertex, *numbered("f_dc", 3))).all(), "colours")
    check(struct.unpack("<I", Path(path).read_bytes()[8:12])[0] == Path(path).stat().st_size, "length of the file")
    return "the .glb holds the same numbers, as glTF has them"


def check_reference(scene, path, times):
    vertex = PlyData.read(path)["vertex"]
    names = [p.name for p in vertex.properties]
    check(len(names) == 576, f"576 properties, not {len(names)}")
    coefficients = columns(vertex, *numbered("coefs", 510)).reshape(-1, 10, 3, 17)
    weights, centres, widths = (coefficients[:, :, k] for k in range(3))
    errors = []
    for time in times:
        e = (time - centres) ** 2 / (widths**2 + 1e-4)
        psi = (weights * np.exp(-(e**2))).sum(-1)
        errors.append(np.sqrt(((columns(vertex, *"xyz") + psi[:, :3] - scene.at(time)[0]) ** 2).sum(1).mean()))
    check((columns(vertex, "opacity", "nx")[:, 1] == 0).all(), "normals are zero")
    spread = np.linalg.norm(scene.tensors["means"].std(0))
    # 17 bases that lie apart stand in for ours, worst at the ends: less than a fiftieth of the scene.
    check(max(errors) < 2e-2 * spread, f"centres deform as ours, not {max(errors)} of {spread} away")
    return f"576 properties, motion right to {1e3 * max(errors) / spread:.1f} thousandths of the scene"


def alike(a, b):
    """Cosines between quaternions, whatever their signs."""
    return np.abs((a * b).sum(1)).min()


def check_spz(scene, path, time):
    """The axes of .spz are right, up and back."""
    read, flip = gsply.read_spz(path), np.array([1.0, -1, -1])
    places, turned, log_scales, colours = scene.at(time)
    check(worst(read.means * flip, places) < 1e-4, "places of the .spz")
    check(worst(read.scales, log_scales.clip(-10, -10 + 255 / 16)) < 0.51 / 16, "log-scales of the .spz")
    check(worst(read.sh0, colours) < 0.51 / (255 * 0.15), "colours of the .spz")
    opacities = [1 / (1 + np.exp(-v)) for v in (read.opacities, scene.tensors["opacity_logits"])]
    check(worst(*opacities) < 0.51 / 255 + 1e-4, "opacities of the .spz")
    check(alike(read.quats * np.array([1.0, 1, -1, -1]), turned) > 0.999, "quaternions of the .spz")
    return f"{len(read.means)} Gaussians of the .spz are those that NumPy computes, to half a step"


def check_third_version(path, ply):
    """The .ply that the program made of an .spz of version 3, which gsply wrote."""
    read, vertex = gsply.read_spz(path), PlyData.read(ply)["vertex"]
    flip = np.array([1.0, -1, -1])
    check(worst(columns(vertex, *"xyz"), read.means * flip) < 1e-5, "places of version 3")
    turned = columns(vertex, *numbered("rot", 4)) * np.array([1.0, 1, -1, -1])
    check(alike(turned, read.quats) > 1 - 1e-5, "quaternions of version 3")
    check(worst(columns(vertex, *numbered("scale", 3)), read.scales) < 1e-5, "log-scales of version 3")
    return "an .spz of version 3 is read as gsply reads it"


def check_quantised(scene, small):
    steps = {"means": None, "rotations": 0.01, "log_scales": 0.02, "opacity_logits": 0.03, "colours": 0.01}
    for name, step in steps.items():
        if step:
            error = worst(scene.tensors[name], small.tensors[name])
            check(error < 0.51 * step, f"{name} are right to half a step, not {error}")
    return "the quantised scene is right to half a step"


if __name__ == "__main__":
    print(", ".join(f"{n} {version(n)}" for n in ["numpy", "safetensors", "plyfile", "pygltflib", "gsply"]))
    folder, time = Path(sys.argv[1]), float(sys.argv[2])
    scene, small = Scene(folder / "scene.safetensors"), Scene(folder / "small.safetensors")
    print(check_ply(scene, folder / "frame.ply", time))
    print(check_glb(folder / "frame.glb", folder / "frame.ply"))
    print(check_reference(scene, folder / "point_cloud.ply", np.arange(10) / 10))
    print(check_quantised(scene, small))
    print(check_spz(scene, folder / "frame.spz", time))
    print(check_third_version(folder / "third.spz", folder / "third.ply"))
