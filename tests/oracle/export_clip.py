"""Exports CLIP checkpoints of every kind with assets/export_clip.py and compares with PyTorch's attention.

Needs torch, onnx, onnxruntime; the argument is CLIP's tokenizer.json. Weights are random, shapes those of ViT-B/16,
then those of the first blocks of ViT-H's image half, whose heads are wider, and of a few blocks with layer scale.
"""

import pathlib
import subprocess
import sys
import tempfile
import warnings

import numpy as np
import onnxruntime
import torch
from torch import nn

PATCH, SIDE, DIM, DENSE_SIDE = 16, 224, 512, 384
TEXT_WIDTH, TEXT_LAYERS, LENGTH, VOCABULARY = 512, 12, 77, 49408
# Width, blocks and numbers per head of the image half.
SHAPE, WIDE_SHAPE, SCALED_SHAPE = (768, 12, 64), (1280, 2, 80), (768, 3, 64)
SCRIPT = pathlib.Path(__file__).parents[2] / "assets" / "export_clip.py"


class QuickGelu(nn.Module):
    def forward(self, x):
        return x * torch.sigmoid(1.702 * x)


class LayerScale(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.gamma = random(width)

    def forward(self, x):
        return x * self.gamma


class Block(nn.Module):
    def __init__(self, width, head_width, gelu, scales):
        super().__init__()
        self.ls_1, self.ls_2 = (LayerScale(width) if scales else nn.Identity() for _ in range(2))
        self.attn = nn.MultiheadAttention(width, width // head_width, batch_first=True)
        self.ln_1, self.ln_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.mlp = nn.Sequential()
        self.mlp.add_module("c_fc", nn.Linear(width, 4 * width))
        self.mlp.add_module("gelu", gelu())
        self.mlp.add_module("c_proj", nn.Linear(4 * width, width))

    def forward(self, x, mask):
        y = self.ln_1(x)
        x = x + self.ls_1(self.attn(y, y, y, need_weights=False, attn_mask=mask)[0])
        return x + self.ls_2(self.mlp(self.ln_2(x)))


class Transformer(nn.Module):
    def __init__(self, width, layers, head_width, gelu, scales):
        super().__init__()
        self.resblocks = nn.ModuleList([Block(width, head_width, gelu, scales) for _ in range(layers)])

    def forward(self, x, mask=None):
        for block in self.resblocks:
            x = block(x, mask)
        return x


def random(*shape):
    return nn.Parameter(0.05 * torch.randn(*shape))


class Visual(nn.Module):
    def __init__(self, shape, gelu, scales):
        super().__init__()
        width = shape[0]
        self.conv1 = nn.Conv2d(3, width, PATCH, PATCH, bias=False)
        self.class_embedding = random(width)
        self.positional_embedding = random((SIDE // PATCH) ** 2 + 1, width)
        self.ln_pre, self.ln_post = nn.LayerNorm(width), nn.LayerNorm(width)
        self.transformer = Transformer(*shape, gelu, scales)
        self.proj = random(width, DIM)

    def forward(self, pictures):
        x = self.conv1(pictures).flatten(2).transpose(1, 2)
        first = self.class_embedding.expand(len(x), 1, -1)
        x = self.ln_pre(torch.cat([first, x], 1) + self.positional_embedding)
        return self.ln_post(self.transformer(x)[:, 0]) @ self.proj

    def dense(self, pictures):
        """Does the same as CAT-Seg: the last block takes each token's own value and adds the class token."""
        x = self.conv1(pictures)
        places = x.shape[-1]
        x = x.flatten(2).transpose(1, 2)
        trained = self.positional_embedding[1:].T.reshape(1, -1, SIDE // PATCH, SIDE // PATCH)
        resized = nn.functional.interpolate(trained, (places, places), mode="bicubic", align_corners=False)
        positions = torch.cat([self.positional_embedding[:1], resized.flatten(2)[0].T])
        x = self.ln_pre(torch.cat([self.class_embedding.expand(len(x), 1, -1), x], 1) + positions)
        *blocks, last = self.transformer.resblocks
        for block in blocks:
            x = block(x, None)
        joined = nn.functional.linear(last.ln_1(x), last.attn.in_proj_weight, last.attn.in_proj_bias)
        v = last.ls_1(last.attn.out_proj(joined.chunk(3, dim=-1)[2])) + x[:, :1]
        v = self.ln_post(v + last.ls_2(last.mlp(last.ln_2(v)))) @ self.proj
        return v[:, 1:].transpose(1, 2).reshape(len(x), DIM, places, places)


class Clip(nn.Module):
    def __init__(self, shape, gelu, scales):
        super().__init__()
        self.visual = Visual(shape, gelu, scales)
        self.transformer = Transformer(TEXT_WIDTH, TEXT_LAYERS, 64, gelu, scales)
        self.token_embedding = nn.Embedding(VOCABULARY, TEXT_WIDTH)
        self.positional_embedding = random(LENGTH, TEXT_WIDTH)
        self.ln_final = nn.LayerNorm(TEXT_WIDTH)
        self.text_projection = random(TEXT_WIDTH, DIM)
        # Norms and biases get values as after training, not those that they start with.
        for name, parameter in self.named_parameters():
            if parameter.ndim == 1:
                parameter.data.add_(0.1 * torch.randn_like(parameter))

    def text(self, ids):
        mask = torch.full((LENGTH, LENGTH), float("-inf")).triu(1)
        x = self.transformer(self.token_embedding(ids) + self.positional_embedding, mask)
        return self.ln_final(x)[torch.arange(len(ids)), ids.argmax(1)] @ self.text_projection


def checkpoint(model, kind, path):
    """Writes a checkpoint as the programs do."""
    state = model.state_dict()
    if kind == "OpenAI":
        model.load_state_dict({name: tensor.half().float() for name, tensor in state.items()})
        ids = torch.zeros(1, LENGTH, dtype=torch.int64)
        torch.jit.trace_module(model, {"text": ids}).half().save(path)
        model.float()
    elif kind == "open_clip":
        torch.save({"epoch": 3, "state_dict": {f"module.{name}": tensor for name, tensor in state.items()}}, path)
    else:
        separate = {}
        for name, tensor in state.items():
            if name.endswith("in_proj_weight"):
                for part, weight in zip("qkv", tensor.chunk(3)):
                    separate[name.replace("in_proj", f"{part}_proj")] = weight
            else:
                separate[name] = tensor
        prefix = "sem_seg_head.predictor.clip_model."
        torch.save({"model": {prefix + name: tensor for name, tensor in separate.items()}, "iteration": 80000}, path)


def compare(kind, shape, scales, folder, tokenizer):
    torch.manual_seed(len(kind))
    gelu = nn.GELU if kind == "open_clip" else QuickGelu
    model = Clip(shape, gelu, scales).eval()
    checkpoint(model, kind, folder / "checkpoint.pt")
    command = [sys.executable, SCRIPT, folder / "checkpoint.pt", "-o", folder, "--tokenizer", tokenizer]
    command += ["--dense-side", str(DENSE_SIDE)]
    if kind == "open_clip":
        command += ["--activation", "gelu"]
    subprocess.run([command[0], "-W", "ignore", *command[1:]], check=True, stdout=subprocess.DEVNULL)
    pictures, large = torch.randn(2, 3, SIDE, SIDE), torch.randn(1, 3, DENSE_SIDE, DENSE_SIDE)
    ids = torch.zeros(3, LENGTH, dtype=torch.int64)
    for row, length in enumerate([4, 9, 77]):
        ids[row, :length] = torch.randint(1, 49000, (length,))
        ids[row, 0], ids[row, length - 1] = 49406, 49407
    with torch.no_grad():
        expected = {"image": model.visual(pictures), "dense": model.visual.dense(large), "text": model.text(ids)}
    given = {"image": {"pixel_values": pictures.numpy()}, "dense": {"pixel_values": large.numpy()}}
    given["text"] = {"input_ids": ids.numpy()}
    for half in expected:
        session = onnxruntime.InferenceSession(folder / half / "model.onnx", providers=["CPUExecutionProvider"])
        found = session.run(None, given[half])[0]
        unit = [e / np.linalg.norm(e, axis=1, keepdims=True) for e in (found, expected[half].numpy())]
        apart = np.abs(unit[0] - unit[1]).max()
        scaled = ", layer scale" if scales else ""
        print(f"{kind}, {shape[0]} wide{scaled}, {half}: {'as PyTorch has it' if apart < 1e-5 else f'off by {apart:.1e}'}")


def main():
    # OpenAI's checkpoints are TorchScript, which PyTorch now advises against.
    warnings.simplefilter("ignore", (FutureWarning, DeprecationWarning, torch.jit.TracerWarning))
    tokenizer = pathlib.Path(sys.argv[1]).resolve()
    kinds = [("OpenAI", SHAPE, False), ("open_clip", SHAPE, False), ("SurgTPGS", SHAPE, False)]
    kinds += [("open_clip", WIDE_SHAPE, False), ("open_clip", SCALED_SHAPE, True)]
    for kind, shape, scales in kinds:
        with tempfile.TemporaryDirectory() as folder:
            compare(kind, shape, scales, pathlib.Path(folder), tokenizer)


if __name__ == "__main__":
    main()
