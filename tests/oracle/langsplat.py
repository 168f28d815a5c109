"""Asks a scene of LangSplat by words: checkpoint and autoencoder as its code saves them, and what is found.

    python langsplat.py PROGRAM SCENE FOLDER

SCENE has Gaussians and class embeddings. Needs numpy, torch, safetensors and plyfile.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData
from torch import nn

ASSETS = Path(__file__).parents[2] / "assets"
sys.path.insert(0, str(ASSETS))
from read_scene import BAND_0, Scene  # noqa: E402

ENCODER, DECODER = [256, 128, 64, 32, 3], [16, 32, 64, 128, 256, 256]


class Autoencoder(nn.Module):
    """Parts and names as in LangSplat."""

    def __init__(self, dim):
        super().__init__()
        encoder, decoder = [nn.Linear(dim, ENCODER[0])], [nn.Linear(ENCODER[-1], DECODER[0])]
        for before, after in zip(ENCODER, ENCODER[1:]):
            encoder += [nn.BatchNorm1d(before), nn.ReLU(), nn.Linear(before, after)]
        for before, after in zip(DECODER, [*DECODER[1:], dim]):
            decoder += [nn.ReLU(), nn.Linear(before, after)]
        self.encoder, self.decoder = nn.ModuleList(encoder), nn.ModuleList(decoder)

    def through(self, parts, x):
        for part in parts:
            x = part(x)
        return x / x.norm(dim=-1, keepdim=True)


def train(rows):
    """Trains until latents with noise decode to their class."""
    model = Autoencoder(rows.shape[1])
    optimiser = torch.optim.Adam(model.parameters(), lr=2e-3)
    for _ in range(1500):
        batch = rows[torch.randint(len(rows), (64,))]
        latents = model.through(model.encoder, batch)
        decoded = model.through(model.decoder, latents + 0.05 * torch.randn_like(latents))
        loss = (1 - (decoded * batch).sum(-1)).mean() + (decoded - batch).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return model.eval()


def checkpoint(now, features):
    """The Gaussians as `GaussianModel.capture` returns them."""
    n = len(now.positions)
    colour = ((now.colours - 0.5) / BAND_0)[:, None]
    logits = np.log(now.opacities / (1 - now.opacities))[:, None]
    parts = [now.positions, colour, np.zeros((n, 15, 3)), np.log(now.scales), now.rotations, logits]
    parts = [nn.Parameter(torch.tensor(np.ascontiguousarray(part)).float()) for part in parts]
    rest = [torch.zeros(n), torch.zeros(n, 1), torch.zeros(n, 1), {"state": {}, "param_groups": []}, 1.0]
    return (3, *parts, nn.Parameter(features), *rest)


def main(program, scene, folder):
    torch.manual_seed(0)
    scene, folder = Scene(scene), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    now = scene.at(scene.times[0])
    rows = nn.functional.normalize(torch.tensor(np.array(scene.class_embeddings)).float(), dim=-1)
    best = scene.class_scores(now).argmax(1)
    model = train(rows)
    with torch.no_grad():
        # Lengths do not count: LangSplat divides by them before it renders.
        features = model.through(model.encoder, rows)[best] * (0.5 + torch.rand(len(best), 1))
    torch.save((checkpoint(now, features), 30000), folder / "chkpnt30000.pth")
    torch.save(model.state_dict(), folder / "best_ckpt.pth")
    out = folder / "langsplat.ply"
    made_of = [folder / "chkpnt30000.pth", folder / "best_ckpt.pth", out]
    subprocess.run([sys.executable, ASSETS / "langsplat_ply.py", *made_of], check=True)
    objects = folder / "langsplat"
    ask = [program, "query", out, "--prompt", *scene.classes, "--gaussians", objects, "--threshold", "0.5"]
    subprocess.run(ask, check=True, stdout=subprocess.DEVNULL)
    for k, name in enumerate(scene.classes):
        rows = PlyData.read(objects / f"{name.replace(' ', '-')}.ply")["vertex"]
        found = {tuple(row) for row in np.stack([rows[axis] for axis in "xyz"], 1)}
        # The program lists what can be seen.
        meant = now.positions[(best == k) & (now.opacities >= 0.5)].astype(np.float32)
        meant = {tuple(row) for row in meant}
        share = len(found & meant) / max(len(found | meant), 1)
        print(f"{name}: {len(found)} Gaussians found, {len(meant)} meant, {share:.3f} of both in common")
        if share < 0.95:
            sys.exit(f"{name} is not what was meant")


if __name__ == "__main__":
    main(*sys.argv[1:])
