"""Makes recordings of a moving scope whose path is known, and compares the path that the program finds.

    scope_path.py PROGRAM FOLDER

A tube with folds, as a bowel, and a cavity, each seen by a scope that carries its light: brightness and glare
change with every frame. They share nothing with the program's own demo. In some the tissue breathes, here more
and there less. The program is given the pictures alone, then with the lens, then with lens and poses.
Nothing was tuned on them but what the figures say.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[2] / "assets"))
from read_scene import Scene

WIDTH, HEIGHT, FRAMES = 320, 256, 60


class Recording:
    """A surface, seen along a path."""

    def __init__(self, seed, is_tube, fov_degrees, breath_frames=None):
        self.random = np.random.default_rng(seed)
        self.is_tube = is_tube
        self.breath_frames = breath_frames
        self.lattice = self.random.random((64, 64, 64)).astype(np.float32)
        self.phases = self.random.random(8) * 2 * np.pi
        self.focal = WIDTH / 2 / np.tan(np.radians(fov_degrees / 2))

    def noise(self, points):
        """Smooth noise in space, 0 to 1."""
        cell = np.floor(points).astype(int)
        share = (points - cell).astype(np.float32)
        share = share * share * (3 - 2 * share)
        total = 0
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, share, 1 - share), axis=-1)
            total = total + weight * self.lattice[tuple((cell[..., k] + corner[k]) % 64 for k in range(3))]
        return total

    def centre(self, z):
        a, b, c, d = self.phases[:4]
        return (
            6 * np.sin(z / 45 + a) + 2 * np.sin(z / 17 + b),
            5 * np.sin(z / 38 + c) + 2 * np.cos(z / 21 + d),
        )

    def distance(self, p):
        """Signed distance to the surface, about."""
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        phases = self.phases
        if not self.is_tube:
            small = 5 * np.sin(x / 13 + phases[0]) * np.cos(y / 11 + phases[1])
            return 60 + small + 8 * np.sin(x / 31 + phases[2]) + 6 * np.cos(y / 27 + phases[3]) - z
        middle = self.centre(z)
        x, y = x - middle[0], y - middle[1]
        angle = np.arctan2(y, x)
        fold = 2.2 * np.exp(-((np.mod(z + 3 * np.sin(angle + phases[4]), 14) - 7) ** 2) / 3)
        waves = 1.2 * np.sin(3 * angle + phases[5] + z / 30) + 0.8 * np.sin(2 * angle - z / 12 + phases[6])
        return 13 - fold + waves - np.hypot(x, y)

    def colour(self, p):
        mottled = 0.5 * self.noise(p / 6) + 0.3 * self.noise(p / 2.5 + 9) + 0.2 * self.noise(p / 1.1 + 5)
        vessel = 0.5 * np.exp(-(((self.noise(p / 5 + 30) - 0.5) / 0.03) ** 2))
        return np.stack(
            [
                0.75 + 0.25 * mottled,
                0.35 + 0.3 * mottled - 0.25 * vessel,
                0.30 + 0.25 * mottled - 0.2 * vessel,
            ],
            -1,
        )

    def at_rest(self, p, frame):
        """Where the tissue that is at p on a frame was before it breathed in."""
        if self.breath_frames is None:
            return p
        strength = (0.5 - 0.5 * np.cos(2 * np.pi * frame / self.breath_frames)) ** 1.5
        here = 0.55 + 0.45 * np.sin(p[..., 0] / 25 + self.phases[7]) * np.cos(p[..., 1] / 30)
        return p - strength * here[..., None] * np.array([0.6, 2.8, -2.4])

    def sway(self, size, period):
        t = np.arange(FRAMES) / period
        waves = [np.sin(1.3 * (k + 1) * t + self.random.random() * 6.28) / (k + 1) for k in range(3)]
        return size * sum(waves) / 1.5

    def poses(self):
        """World from camera of every frame; the camera looks along z, y down."""
        turns = np.stack([self.sway(0.12, period) for period in (10, 12, 14)], -1)
        if self.is_tube:
            z = 60 * np.sin(np.linspace(0, 0.75 * np.pi, FRAMES)) + self.sway(1, 9)
            aside = np.stack([self.sway(3, 11), self.sway(3, 12)], -1)
            middle, ahead = (np.stack(self.centre(at), -1) for at in (z, z + 15))
            places = np.concatenate([middle + aside, z[:, None]], -1)
            forward = np.concatenate([ahead - places[:, :2], np.full((FRAMES, 1), 15.0)], -1)
        else:
            places = np.stack([self.sway(14, 11), self.sway(12, 13), self.sway(8, 12)], -1)
            forward = np.tile([0.0, 0.0, 1.0], (FRAMES, 1))
        poses = np.tile(np.eye(4), (FRAMES, 1, 1))
        for pose, place, along, turn in zip(poses, places, forward, turns):
            along = along / np.linalg.norm(along)
            right = np.cross([0, 1, 0], along)
            right /= np.linalg.norm(right)
            pose[:3, :3] = np.stack([right, np.cross(along, right), along], 1) @ turned(turn)
            pose[:3, 3] = place
        return poses

    def picture(self, pose, frame):
        u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        rays = np.stack(
            [(u - WIDTH / 2) / self.focal, (v - HEIGHT / 2) / self.focal, np.ones_like(u)], -1
        )
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ pose[:3, :3].T
        far = np.full((HEIGHT, WIDTH), 0.5)
        for _ in range(60):
            here = self.at_rest(pose[:3, 3] + rays * far[..., None], frame)
            far = np.clip(far + 0.6 * self.distance(here), 0.2, 200)
        points = self.at_rest(pose[:3, 3] + rays * far[..., None], frame)
        step = 0.05 * np.eye(3)
        normal = np.stack(
            [self.distance(points + step[k]) - self.distance(points - step[k]) for k in range(3)], -1
        )
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True) + 1e-9
        facing = np.clip(-(normal * rays).sum(-1), 0, 1)
        light = np.clip(facing, 0.02, 1) * ((14 if self.is_tube else 60) / np.maximum(far, 3)) ** 1.4
        glare = 0.6 * np.where(self.noise(points / 1.5) > 0.45, facing**60, 0)
        seen = np.clip(self.colour(points) * light[..., None] + glare[..., None], 0, 1) ** (1 / 1.8)
        seen += self.random.normal(0, 0.008, seen.shape)
        return Image.fromarray((np.clip(seen, 0, 1) * 255).astype(np.uint8))


def turned(vector):
    angle = np.linalg.norm(vector) + 1e-12
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def write(recording, folder):
    """Writes the pictures, beside them the lens, and beside both the poses; returns the camera's places."""
    frames = []
    poses = recording.poses()
    for part in ("pictures", "lens", "poses"):
        (folder / part).mkdir(parents=True)
    (folder / "pictures/images").mkdir()
    for i, pose in enumerate(poses):
        name = f"images/{i:05d}.png"
        recording.picture(pose, i).save(folder / "pictures" / name)
        # The format's cameras look along -z, y up.
        matrix = pose @ np.diag([1, -1, -1, 1])
        frames.append({"file_path": name, "transform_matrix": matrix.tolist()})
    for part in ("lens", "poses"):
        (folder / part / "images").symlink_to("../pictures/images")
    fov = np.degrees(2 * np.arctan(WIDTH / 2 / recording.focal))
    (folder / "lens/sequence.toml").write_text(f"[camera]\nfov_x_degrees = {fov:.3f}\n")
    lens = {"fl_x": recording.focal, "fl_y": recording.focal, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    lens |= {"w": WIDTH, "h": HEIGHT, "frames": frames}
    (folder / "poses/transforms.json").write_text(json.dumps(lens))
    return poses[:, :3, 3]


def error(places, cameras):
    """Root mean square distance after alignment, as a share of the path's length and of its spread."""
    found = np.array([-(c.camera_from_world[:, :3].T @ c.camera_from_world[:, 3]) for c in cameras])
    a, b = places - places.mean(0), found - found.mean(0)
    if not b.any():
        return None
    u, s, v = np.linalg.svd(a.T @ b)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    left = a - (s * np.diag(sign)).sum() / (b**2).sum() * (b @ (u @ sign @ v).T)
    rms = np.sqrt((left**2).sum(1).mean())
    length = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    return rms / length, rms / np.sqrt((a**2).sum(1).mean())


def main(program, folder):
    for name, seed, is_tube, fov, breath_frames in [
        ("tube", 1, True, 80, None),
        ("tube, wide", 3, True, 100, None),
        ("cavity", 2, False, 70, None),
        ("cavity, narrow", 4, False, 50, None),
        ("cavity, breath of 17 frames", 5, False, 70, 17),
        ("cavity, breath of 26 frames", 6, False, 60, 26),
    ]:
        at = Path(folder) / name.replace(", ", "-").replace(" ", "-")
        places = write(Recording(seed, is_tube, fov, breath_frames), at)
        for part in ("pictures", "lens", "poses"):
            scene = at / f"{part}.safetensors"
            train = [program, "train", at / part, "-o", scene, "--eval", "--iterations", "1500"]
            said = subprocess.run(train, check=True, capture_output=True, text=True).stdout
            psnr = said.split("PSNR ")[1].split(" dB")[0]
            cameras = Scene(scene).cameras
            shares = error(places, cameras)
            path = "no path"
            if shares:
                path = f"path off by {shares[0]:.2%}, {shares[1]:.1%} of its spread"
            found = np.degrees(2 * np.arctan(WIDTH / 2 / cameras[0].fx))
            print(f"{name} ({fov}°), {part}: {found:.0f}°, {path}, {psnr} dB held out", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
