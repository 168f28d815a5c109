"""Reads scene files and conversions with Python's own readers and compares them with each other.

The scene at the time of a frame is computed here from the scene file, by the formulas; the .ply, the .glb and
the deforming .ply must say the same. Exits with 1 at the first thing that does not. See README.md beside this
file.
"""

import contextlib
import io
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

ASSETS = Path(__file__).parents[2] / "assets"
sys.path.insert(0, str(ASSETS))

from read_scene import BAND_0, Scene, chapters  # noqa: E402


def check(is_right, what):
    if not is_right:
        sys.exit(f"wrong: {what}")


def must_fail(test, *arguments):
    """A check that nothing can fail checks nothing."""
    try:
        test(*arguments)
    except SystemExit:
        return
    sys.exit(f"wrong: {test.__name__} does not see what was changed")


def open_scene(path):
    """Opens a scene with the reader of assets/, whose tensors must be those of the safetensors package."""
    scene = Scene(path)
    with safe_open(path, "np") as f:
        check(set(f.keys()) == set(scene.tensors.entries), "names of tensors")
        check(all((f.get_tensor(n) == scene.tensors.raw(n)).all() for n in f.keys()), "tensors")
        check(f.metadata() == scene.tensors.metadata, "metadata")
    check(scene.header["basis_shape"] == "spline", "the demo's bases are splines")
    check(len(scene.rest["means"]) == scene.header["gaussians"], "the number of Gaussians")
    return scene


def run_example(path):
    """Runs the Python of crates/app/README.md on a scene."""
    text = (ASSETS.parent / "crates/app/README.md").read_text("utf-8")
    code = re.search(r"```python\n(.*?)```", text, re.S)[1].replace('"scene.safetensors"', repr(str(path)))
    names = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, names)
    check(names["liver"].any(), "the example finds liver")
    return "the example of the manual runs"


def columns(vertex, *names):
    return np.stack([vertex[n] for n in names], -1).astype(np.float64)


def numbered(name, n):
    return [f"{name}_{i}" for i in range(n)]


def worst(a, b):
    check(a.shape == b.shape, f"shapes {a.shape} and {b.shape}")
    return np.abs(a - b).max()


def check_ply(scene, path, time):
    vertex, now = PlyData.read(path)["vertex"], scene.at(time)
    rgb = np.maximum(0.5 + BAND_0 * columns(vertex, *numbered("f_dc", 3)), 0)
    pairs = {
        "places": (columns(vertex, *"xyz"), now.positions),
        "quaternions": (columns(vertex, *numbered("rot", 4)), now.rotations),
        "log-scales": (columns(vertex, *numbered("scale", 3)), np.log(now.scales)),
        "colours": (rgb, now.colours),
        "opacities": (1 / (1 + np.exp(-columns(vertex, "opacity")[:, 0])), now.opacities),
    }
    for name, (written, computed) in pairs.items():
        error = worst(written, computed)
        check(error < 2e-5 * max(1, np.abs(computed).max()), f"{name} of the .ply are the scene's, not {error} away")
    return f"{len(vertex)} Gaussians of the .ply are those that NumPy computes from the scene"


def check_scores(scene, folder, answers):
    """The Gaussians that `query --gaussians` found are those whose scores NumPy computes above one half. The
    program looks scores up to 1/255."""
    found = 0
    for prompt in json.loads(answers.read_text("utf-8"))["prompts"]:
        written = prompt["gaussians"]
        now = scene.at(scene.times[written["frame"]])
        scores = scene.class_scores(now)[:, scene.classes.index(prompt["text"])]
        scores = np.where(now.opacities >= 0.5, scores, 0)
        vertex = PlyData.read(folder / Path(written["file"]).name)["vertex"]
        check(len(vertex) == written["count"], "count")
        distances = np.linalg.norm(columns(vertex, *"xyz")[:, None] - now.positions, axis=2)
        check(distances.min(1).max() < 1e-3, "what was found lies where the scene has it")
        is_found = np.zeros(len(scores), bool)
        is_found[distances.argmin(1)] = True
        check(is_found.sum() == len(vertex), "each Gaussian is written once")
        is_clear = np.abs(scores - 0.5) > 1 / 255
        check((is_found == (scores > 0.5))[is_clear].all(), f"scores of {prompt['text']}")
        found += len(vertex)
    check(found > 0, "something was found")
    return f"{found} Gaussians that prompts found are those that NumPy scores above one half"


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


def check_reference(scene, read_back, path, times):
    """The released code's formula on the .ply gives the places of the scene that the program reads from it, and
    those are near to the original's; pictures are fitted, so that single Gaussians may go elsewhere."""
    vertex = PlyData.read(path)["vertex"]
    names = [p.name for p in vertex.properties]
    check(len(names) == 576, f"576 properties, not {len(names)}")
    check((columns(vertex, "nx") == 0).all(), "normals are zero")
    coefficients = columns(vertex, *numbered("coefs", 510)).reshape(-1, 10, 3, 17)
    weights, centres, widths = (coefficients[:, :, k] for k in range(3))
    spread = np.linalg.norm(scene.rest["means"].std(0))
    for time in times:
        e = (time - centres) ** 2 / (widths**2 + 1e-4)
        psi = (weights * np.exp(-(e**2))).sum(-1)
        now = read_back.at(time)
        error = worst(columns(vertex, *"xyz") + psi[:, :3], now.positions)
        # The program leaves out values below 1e-4.
        check(error < 1e-3 * spread, f"centres deform as the formula says, not {error} of {spread} away")
        error = worst(columns(vertex, *numbered("scale", 3)) + psi[:, 7:10], np.log(now.scales))
        check(error < 1e-2, f"scales deform as the formula says, not {error} away")
        away = np.median(np.linalg.norm(now.positions - scene.at(time).positions, axis=1))
        check(away < 0.05 * spread, f"centres are near to the scene's, not {away} of {spread} away")
    return "576 properties, which deform as the released code does"


def alike(a, b):
    """Cosines between quaternions, whatever their signs."""
    return np.abs((a * b).sum(1)).min()


def check_spz(scene, path, time):
    """The axes of .spz are right, up and back."""
    read, flip = gsply.read_spz(path), np.array([1.0, -1, -1])
    now = scene.at(time)
    check(worst(read.means * flip, now.positions) < 1e-4, "places of the .spz")
    log_scales = np.log(now.scales).clip(-10, -10 + 255 / 16)
    check(worst(read.scales, log_scales) < 0.51 / 16, "log-scales of the .spz")
    colours = np.maximum(0.5 + BAND_0 * read.sh0, 0)
    check(worst(colours, now.colours) < BAND_0 * 0.51 / (255 * 0.15), "colours of the .spz")
    opacities = 1 / (1 + np.exp(-read.opacities))
    check(worst(opacities, now.opacities) < 0.51 / 255 + 1e-4, "opacities of the .spz")
    check(alike(read.quats * np.array([1.0, 1, -1, -1]), now.rotations) > 0.999, "quaternions of the .spz")
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
    steps = {"rotations": 0.01, "log_scales": 0.02, "opacity_logits": 0.03, "colours": 0.01}
    for name, step in steps.items():
        error = worst(scene.rest[name], small.rest[name])
        check(error < 0.51 * step, f"{name} are right to half a step, not {error}")
    times = np.arange(10) / 10
    spread = np.linalg.norm(scene.rest["means"].std(0))
    error = max(worst(scene.at(t).positions, small.at(t).positions) for t in times)
    check(error < 5e-3 * spread, f"it moves as the scene does, not {error} of {spread} away")
    return "the quantised scene is right to half a step, and moves as the scene does"


def check_chapters(path, ply):
    """Every frame is shown by one chapter; the last one has the Gaussians of the last frame."""
    shown = [range(c["shown"]["start"], c["shown"]["end"]) for c in chapters(path)]
    last = Scene(path, len(shown) - 1)
    check([i for frames in shown for i in frames] == list(range(len(last.cameras))), "every frame is shown once")
    check_ply(last, ply, last.times[-1])
    must_fail(check_ply, last, ply, last.times[0])
    return f"{len(shown)} chapters, of which the last shows the last frame"


def check_that_checks_fail(folder, time):
    """Changes one number each time; the check that it is of must see it."""
    def changed(change):
        scene = Scene(folder / "scene.safetensors")
        change(scene)
        return scene

    def weight(scene):
        basis = int(scene.basis(time).ravel().argmax())
        scene.bases["weights"] = scene.bases["weights"].copy()
        scene.bases["weights"][basis, 7, 0] += 0.1

    def colour(scene):
        scene.rest["colours"] = scene.rest["colours"] + np.eye(len(scene.rest["colours"]), 3) * 1e-3

    def classes(scene):
        scene.class_embeddings = scene.class_embeddings[::-1]

    for change in [weight, colour]:
        must_fail(check_ply, changed(change), folder / "frame.ply", time)
    must_fail(check_reference, scene, scene, folder / "point_cloud.ply", [time])
    must_fail(check_scores, changed(classes), folder / "objects", folder / "answers.json")
    must_fail(check_quantised, changed(lambda s: None), changed(lambda s: s.rest.update(means=s.rest["means"] + 1)))
    return "each check fails where a number is changed"


if __name__ == "__main__":
    print(", ".join(f"{n} {version(n)}" for n in ["numpy", "safetensors", "plyfile", "pygltflib", "gsply"]))
    folder, time = Path(sys.argv[1]), float(sys.argv[2])
    scene, small = open_scene(folder / "scene.safetensors"), open_scene(folder / "small.safetensors")
    print(f"{len(scene.rest['means'])} Gaussians, {len(scene.moving)} of them move")
    print(check_ply(scene, folder / "frame.ply", time))
    print(check_ply(scene, folder / "between.ply", 0.4321))
    print(check_glb(folder / "frame.glb", folder / "frame.ply"))
    read_back = Scene(folder / "released.safetensors")
    print(check_reference(scene, read_back, folder / "point_cloud.ply", np.arange(10) / 10))
    print(check_quantised(scene, small))
    print(check_spz(scene, folder / "frame.spz", time))
    print(check_third_version(folder / "third.spz", folder / "third.ply"))
    print(check_scores(scene, folder / "objects", folder / "answers.json"))
    print(check_chapters(folder / "long.safetensors", folder / "last.ply"))
    print(run_example(folder / "small.safetensors"))
    print(check_that_checks_fail(folder, time))
