"""Writes a scene of LangSplat as a .ply that `surgtpgs query` asks by words. Needs numpy, torch and safetensors.

    python langsplat_ply.py output/SCENE_1/chkpnt30000.pth autoencoder/ckpt/SCENE/best_ckpt.pth OUT/scene.ply

writes OUT/scene.ply, with the features that LangSplat keeps in its checkpoint alone, and
OUT/autoencoder.safetensors beside it.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

# What `GaussianModel.capture` returns once features are learned begins with these.
PARTS = ["sh_degree", "xyz", "f_dc", "f_rest", "scale", "rot", "opacity", "language_feature"]
NUM_PARTS = 13


def columns(checkpoint):
    """Columns of the .ply by name, each [N]."""
    model, _ = torch.load(checkpoint, map_location="cpu", weights_only=True)
    if len(model) != NUM_PARTS:
        sys.exit(f"{checkpoint} has no features: give the checkpoint of the second training, chkpnt30000.pth of SCENE_1")
    part = {name: values.detach().float() for name, values in list(zip(PARTS, model))[1:]}
    found = dict(zip("xyz", part.pop("xyz").T.numpy()))
    found |= {name: np.zeros_like(found["x"]) for name in ["nx", "ny", "nz"]}
    # Colours are [N, bands, channels]; files hold them channel by channel.
    for name in ["f_dc", "f_rest"]:
        part[name] = part[name].transpose(1, 2).flatten(start_dim=1)
    found["opacity"] = part.pop("opacity")[:, 0].numpy()
    for name, values in part.items():
        found |= {f"{name}_{k}": column for k, column in enumerate(values.T.numpy())}
    return found


def main(checkpoint, autoencoder, out):
    found = columns(checkpoint)
    rows = np.empty(len(found["x"]), dtype=[(name, "<f4") for name in found])
    for name, column in found.items():
        rows[name] = column
    properties = "".join(f"property float {name}\n" for name in found)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    out = Path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(header.encode() + rows.tobytes())
    layers = torch.load(autoencoder, map_location="cpu", weights_only=True)
    # Counters of batches are whole numbers, and of no use.
    layers = {name: values.float().contiguous() for name, values in layers.items() if values.is_floating_point()}
    save_file(layers, out.with_name("autoencoder.safetensors"))


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
