#!/usr/bin/env python3
"""Turns a CLIP checkpoint into the folders that surgtpgs takes as --text-encoder and --image-encoder.

    pip install torch onnx            # torch only to read checkpoints; the CPU build will do
    python export_clip.py model_final_cholecseg.pth -o encoders --tokenizer tokenizer.json
    surgtpgs prepare RECORDING -o PREP --masks-model SAM --image-encoder encoders/image --text-encoder encoders/text

Checkpoints of vision transformers are read as these programs write them:

  OpenAI     ViT-B-16.pt and the like: TorchScript archives, or their state as a plain file
  open_clip  .pt or .safetensors; most of them need --activation gelu (those named "quickgelu" or "openai" do not)
  SurgTPGS   the CLIP inside of a CAT-Seg checkpoint (model_final_*.pth), with q, k and v projected separately

Text and image half must come from one checkpoint: what fine-tuning has moved fits nothing else. --tokenizer is CLIP's
tokenizer.json, the same for all of these, for example from openai/clip-vit-base-patch16 on Hugging Face.

Written are encoders/text (model.onnx, tokenizer.json, encoder.toml) and encoders/image (model.onnx, encoder.toml), in f32
and ONNX operator set 17; with --dense-side 384 also encoders/dense for --dense-encoder, which gives the embeddings of the
picture's patches as CAT-Seg takes them: the last block without mixing, positions interpolated. Checkpoints are pickles: use --trust only with files from a source you trust.
"""

import argparse
import pathlib
import shutil
import sys
import zipfile

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 17
# Larger models keep their weights in a file beside them: protobuf ends at 2 GB.
INSIDE_BYTES = 1_500_000_000
# What a checkpoint may put before the names of OpenAI's model.
PREFIXES = ["sem_seg_head.predictor.clip_model.", "predictor.clip_model.", "clip_model.", "module.", "model.", "text."]
# Numbers per attention head, which checkpoints do not tell: those of open_clip's wide image halves, by their width,
# and those of all others.
WIDE_HEADS, HEAD_WIDTH = {1280: 80, 1408: 88, 1664: 104, 1792: 112}, 64
MEAN, STD = [0.48145466, 0.4578275, 0.40821073], [0.26862954, 0.26130258, 0.27577711]


def fail(what, hint):
    sys.exit(f"error: {what}. {hint}")


def read_checkpoint(path, trust):
    """The checkpoint's tensors in f32 under OpenAI's names."""
    if path.suffix == ".safetensors":
        from safetensors.torch import load_file

        state = load_file(path)
    else:
        state = unpickled(path, trust)
    tensors = {}
    for name, tensor in state.items():
        while prefix := next((p for p in PREFIXES if name.startswith(p)), None):
            name = name[len(prefix):]
        if hasattr(tensor, "detach"):
            tensors[name] = tensor.detach().float().cpu().numpy()
    if "visual.conv1.weight" not in tensors or "visual.proj" not in tensors:
        fail(f"{path} holds no vision transformer of CLIP's kind", "It has no visual.conv1.weight or no visual.proj")
    if any(name.startswith("visual.attn_pool") for name in tensors):
        fail(f"{path} pools its patches by attention", "Only models that take the class token can be exported")
    return join_projections(tensors)


def unpickled(path, trust):
    import torch

    # Only TorchScript archives hold constants.
    if zipfile.is_zipfile(path) and any(n.endswith("/constants.pkl") for n in zipfile.ZipFile(path).namelist()):
        return torch.jit.load(path, map_location="cpu").state_dict()
    try:
        state = torch.load(path, map_location="cpu", weights_only=not trust)
    except Exception as error:
        fail(f"{path} could not be read ({str(error).splitlines()[0]})", "If you trust where it is from, try --trust")
    for key in ["model", "state_dict", "model_state_dict"]:
        if isinstance(state.get(key), dict):
            state = state[key]
    return state


def join_projections(tensors):
    """Separate projections of q, k and v become OpenAI's in_proj_weight."""
    for name in [n for n in tensors if n.endswith(".attn.q_proj_weight")]:
        block = name.removesuffix("q_proj_weight")
        tensors[block + "in_proj_weight"] = np.concatenate([tensors.pop(f"{block}{p}_proj_weight") for p in "qkv"])
    return tensors


class Graph:
    """An ONNX graph under construction; every method gives the name of a value."""

    def __init__(self, tensors):
        self.tensors, self.nodes, self.constants, self.bytes = tensors, [], {}, 0

    def op(self, kind, *inputs, **settings):
        name = f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], name=name, **settings))
        return name

    def constant(self, name, values):
        if name not in self.constants:
            self.constants[name] = numpy_helper.from_array(np.asarray(values, order="C"), name)
            self.bytes += values.nbytes
        return name

    def weight(self, name):
        if name not in self.tensors:
            fail(f"the checkpoint has no {name}", "It is of another architecture than CLIP's vision transformers")
        return self.constant(name, self.tensors[name])

    def number(self, value):
        return self.constant(f"number_{value}", np.array(value, np.float32))

    def shape(self, *axes):
        return self.constant("shape_" + "_".join(map(str, axes)), np.array(axes, np.int64))

    def linear(self, x, weight, bias):
        """weight is [out, in], as PyTorch has it."""
        transposed = self.constant(weight + ".T", self.tensors[weight].T)
        return self.op("Add", self.op("MatMul", x, transposed), self.weight(bias))

    def norm(self, x, name):
        return self.op("LayerNormalization", x, self.weight(name + ".weight"), self.weight(name + ".bias"), epsilon=1e-5)

    def layer_scaled(self, x, name):
        """Scales what a block adds, in models that do (open_clip's -alt)."""
        return self.op("Mul", x, self.weight(name + ".gamma")) if name + ".gamma" in self.tensors else x

    def activation(self, x, kind):
        if kind == "quick_gelu":
            return self.op("Mul", x, self.op("Sigmoid", self.op("Mul", x, self.number(1.702))))
        inner = self.op("Erf", self.op("Mul", x, self.number(0.5**0.5)))
        return self.op("Mul", self.op("Mul", x, self.number(0.5)), self.op("Add", inner, self.number(1.0)))

    def projected(self, x, name, part, scale=1.0):
        """The queries, keys or values (part: q, k, v) of all heads, side by side."""
        weight, bias = self.tensors[name + ".in_proj_weight"], self.tensors[name + ".in_proj_bias"]
        width = weight.shape[1]
        at = slice("qkv".index(part) * width, ("qkv".index(part) + 1) * width)
        w = self.constant(f"{name}.{part}.weight", (scale * weight[at]).T.astype(np.float32))
        b = self.constant(f"{name}.{part}.bias", (scale * bias[at]).astype(np.float32))
        return self.op("Add", self.op("MatMul", x, w), b)

    def attention(self, x, name, heads, mask):
        width = self.tensors[name + ".in_proj_weight"].shape[1]

        def projected(part, order):
            # Folding the scale into q's projection saves an operation on every pair of tokens.
            y = self.projected(x, name, part, (width // heads) ** -0.5 if part == "q" else 1.0)
            return self.op("Transpose", self.op("Reshape", y, self.shape(0, 0, heads, width // heads)), perm=order)

        scores = self.op("MatMul", projected("q", [0, 2, 1, 3]), projected("k", [0, 2, 3, 1]))
        if mask is not None:
            scores = self.op("Add", scores, mask)
        mixed = self.op("MatMul", self.op("Softmax", scores, axis=-1), projected("v", [0, 2, 1, 3]))
        mixed = self.op("Reshape", self.op("Transpose", mixed, perm=[0, 2, 1, 3]), self.shape(0, 0, width))
        return self.linear(mixed, name + ".out_proj.weight", name + ".out_proj.bias")

    def blocks(self, name):
        """Names of a transformer's blocks in order."""
        found = {n.split("resblocks.")[1].split(".")[0] for n in self.tensors if n.startswith(name + ".resblocks.")}
        return [f"{name}.resblocks.{i}" for i in range(len(found))]

    def heads(self, block, options):
        """Number of attention heads of a block."""
        width, head_width = self.tensors[block + ".attn.in_proj_weight"].shape[1], HEAD_WIDTH
        if block.startswith("visual."):
            head_width = options.head_width or WIDE_HEADS.get(width, HEAD_WIDTH)
        if width % head_width:
            fail(f"{block} is {width} wide, no multiple of {head_width}", "--head-width gives that of the image half's heads")
        return width // head_width

    def run_block(self, x, block, options, mask=None):
        heads = self.heads(block, options)
        attended = self.attention(self.norm(x, block + ".ln_1"), block + ".attn", heads, mask)
        x = self.op("Add", x, self.layer_scaled(attended, block + ".ls_1"))
        return self.run_mlp(x, block, options)

    def run_mlp(self, x, block, options):
        hidden = self.linear(self.norm(x, block + ".ln_2"), block + ".mlp.c_fc.weight", block + ".mlp.c_fc.bias")
        hidden = self.activation(hidden, options.activation)
        out = self.linear(hidden, block + ".mlp.c_proj.weight", block + ".mlp.c_proj.bias")
        return self.op("Add", x, self.layer_scaled(out, block + ".ls_2"))

    def save(self, path, source, result):
        """source and result are (name, type, axes) of the input, and (name, value, axes) of the output."""
        name, kind, axes = source
        inputs = [helper.make_tensor_value_info(name, kind, axes)]
        name, value, axes = result
        self.nodes.append(helper.make_node("Identity", [value], [name], name=name))
        outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, axes)]
        graph = helper.make_graph(self.nodes, "clip", inputs, outputs, list(self.constants.values()))
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="surgtpgs")
        model.ir_version = 8
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = self.bytes > INSIDE_BYTES
        onnx.save(model, str(path), save_as_external_data=beside, location="weights.bin" if beside else None)


def export_text(tensors, folder, options):
    graph = Graph(tensors)
    length, _ = tensors["positional_embedding"].shape
    mask = graph.constant("mask", np.triu(np.full((length, length), -np.inf, np.float32), 1))
    x = graph.op("Gather", graph.weight("token_embedding.weight"), "input_ids")
    x = graph.op("Add", x, graph.weight("positional_embedding"))
    for block in graph.blocks("transformer"):
        x = graph.run_block(x, block, options, mask)
    x = graph.norm(x, "ln_final")
    # The end mark has the largest id; [batch, length] of one 1 a row picks its token.
    ends = graph.op("ArgMax", "input_ids", axis=1, keepdims=0)
    count = graph.constant("length", np.array(length, np.int64))
    values = graph.constant("off_on", np.array([0, 1], np.float32))
    picked = graph.op("Unsqueeze", graph.op("OneHot", ends, count, values, axis=-1), graph.shape(1))
    x = graph.op("Squeeze", graph.op("MatMul", picked, x), graph.shape(1))
    x = graph.op("MatMul", x, graph.weight("text_projection"))
    dim = tensors["text_projection"].shape[1]
    source = ("input_ids", TensorProto.INT64, ["batch", length])
    graph.save(folder / "model.onnx", source, ("text_embeds", x, ["batch", dim]))
    shutil.copyfile(options.tokenizer, folder / "tokenizer.json")
    (folder / "encoder.toml").write_text('pooling = "output:text_embeds"\npad_id = 0\n')


def picture_tokens(graph, positions):
    """The class token and a token for every patch, [batch, 1 + patches, width]."""
    width, _, patch, _ = graph.tensors["visual.conv1.weight"].shape
    x = graph.op("Conv", "pixel_values", graph.weight("visual.conv1.weight"), strides=[patch, patch])
    x = graph.op("Transpose", graph.op("Reshape", x, graph.shape(0, 0, len(positions) - 1)), perm=[0, 2, 1])
    # The class token for every picture of the batch: zeros of the batch's shape, and the token on them.
    zeros = graph.op("Mul", graph.op("Slice", x, graph.shape(0), graph.shape(1), graph.shape(1)), graph.number(0.0))
    token = graph.constant("class_token", graph.tensors["visual.class_embedding"].reshape(1, 1, width))
    x = graph.op("Concat", graph.op("Add", zeros, token), x, axis=1)
    return graph.norm(graph.op("Add", x, graph.constant("positions", positions)), "visual.ln_pre")


def write_settings(folder, side):
    (folder / "encoder.toml").write_text(f"size = {side}\nmean = {MEAN}\nstd = {STD}\n")


def export_image(tensors, folder, options):
    graph = Graph(tensors)
    positions = tensors["visual.positional_embedding"]
    side = round((len(positions) - 1) ** 0.5) * tensors["visual.conv1.weight"].shape[2]
    x = picture_tokens(graph, positions)
    for block in graph.blocks("visual.transformer"):
        x = graph.run_block(x, block, options)
    x = graph.op("Gather", x, graph.constant("first", np.array(0, np.int64)), axis=1)
    x = graph.op("MatMul", graph.norm(x, "visual.ln_post"), graph.weight("visual.proj"))
    dim = tensors["visual.proj"].shape[1]
    source = ("pixel_values", TensorProto.FLOAT, ["batch", 3, side, side])
    graph.save(folder / "model.onnx", source, ("image_embeds", x, ["batch", dim]))
    write_settings(folder, side)


def resized_positions(positions, places):
    """Positions of places x places patches, interpolated from those of training."""
    import torch

    trained = round((len(positions) - 1) ** 0.5)
    grid = torch.from_numpy(positions[1:].T.reshape(1, -1, trained, trained).copy())
    grid = torch.nn.functional.interpolate(grid, size=(places, places), mode="bicubic", align_corners=False)
    return np.concatenate([positions[:1], grid.reshape(positions.shape[1], -1).T.numpy()])


def export_maps(tensors, folder, options):
    graph = Graph(tensors)
    side, patch = options.dense_side, tensors["visual.conv1.weight"].shape[2]
    places = side // patch
    x = picture_tokens(graph, resized_positions(tensors["visual.positional_embedding"], places))
    *blocks, last = graph.blocks("visual.transformer")
    for block in blocks:
        x = graph.run_block(x, block, options)
    # CAT-Seg: each token keeps its own value, and the class token stands in for what it would have been added to.
    values = graph.projected(graph.norm(x, last + ".ln_1"), last + ".attn", "v")
    values = graph.linear(values, last + ".attn.out_proj.weight", last + ".attn.out_proj.bias")
    values = graph.layer_scaled(values, last + ".ls_1")
    token = graph.op("Slice", x, graph.shape(0), graph.shape(1), graph.shape(1))
    x = graph.run_mlp(graph.op("Add", values, token), last, options)
    x = graph.op("MatMul", graph.norm(x, "visual.ln_post"), graph.weight("visual.proj"))
    x = graph.op("Slice", x, graph.shape(1), graph.shape(1 + places**2), graph.shape(1))
    dim = tensors["visual.proj"].shape[1]
    x = graph.op("Reshape", graph.op("Transpose", x, perm=[0, 2, 1]), graph.shape(0, dim, places, places))
    source = ("pixel_values", TensorProto.FLOAT, ["batch", 3, side, side])
    graph.save(folder / "model.onnx", source, ("features", x, ["batch", dim, places, places]))
    write_settings(folder, side)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True, help="folder to write text/ and image/ into")
    parser.add_argument("--tokenizer", type=pathlib.Path, required=True, help="CLIP's tokenizer.json")
    parser.add_argument("--activation", choices=["quick_gelu", "gelu"], default="quick_gelu")
    parser.add_argument("--head-width", type=int, help="numbers per attention head of the image half, unless "
                        "they are those of OpenAI's and open_clip's models: 64, and more where it is 1280 wide or wider")
    parser.add_argument("--dense-side", type=int, help="also write dense/: a multiple of the patches' side, such as 384")
    parser.add_argument("--trust", action="store_true", help="read pickles that may run code")
    options = parser.parse_args()
    for file in [options.checkpoint, options.tokenizer]:
        if not file.is_file():
            fail(f"there is no file {file}", "Give the checkpoint, and tokenizer.json with --tokenizer")
    tensors = read_checkpoint(options.checkpoint, options.trust)
    export_text(tensors, options.output / "text", options)
    export_image(tensors, options.output / "image", options)
    halves = ["text", "image"]
    if options.dense_side:
        if options.dense_side % tensors["visual.conv1.weight"].shape[2]:
            fail(f"--dense-side {options.dense_side} is no multiple of the patches' side", "CAT-Seg has 384")
        export_maps(tensors, options.output / "dense", options)
        halves.append("dense")
    print("wrote", ", ".join(str(options.output / half) for half in halves))


if __name__ == "__main__":
    main()
