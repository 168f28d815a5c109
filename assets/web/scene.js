"use strict";
// The scene: unpacks the numbers in the page and moves the Gaussians to a frame.

const CHANNELS = 13; // of motion: centre 3, quaternion 4, log-scale 3, colour 3
const STRIDE = 16; // floats of a moved Gaussian: centre, opacity; quaternion; scale, 0; colour, 0
const TEXELS = 2048; // of a row of textures, four for each Gaussian
const SH_C0 = 0.28209479;

const decoded = (text) => Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Numbers offset + step · n of each column, as crates/core/src/scene/file/compact.rs packs them.
async function unpacked({ start, bytes, steps, offsets }, data) {
  const planes = await inflated(data.subarray(start, start + bytes));
  const length = planes.length / 4, columns = steps.length, rows = length / columns;
  const values = new Float32Array(length);
  for (let c = 0, at = 0; c < columns; c++) {
    for (let row = 0; row < rows; row++, at++) {
      const n = planes[at] | (planes[at + length] << 8) | (planes[at + 2 * length] << 16) | (planes[at + 3 * length] << 24);
      values[row * columns + c] = offsets[c] + steps[c] * (n & 1 ? -(n >>> 1) - 1 : n >>> 1);
    }
  }
  return values;
}

// Undoes the cosine transform over the bases, the first axis.
function unmixed(values, bases) {
  const length = values.length / bases, sums = new Float32Array(values.length);
  for (let k = 0; k < bases; k++) {
    const row = values.subarray(k * length, (k + 1) * length);
    for (let b = 0; b < bases; b++) {
      const factor = Math.sqrt((k ? 2 : 1) / bases) * Math.cos((Math.PI * k * (b + 0.5)) / bases);
      const sum = sums.subarray(b * length, (b + 1) * length);
      for (let i = 0; i < length; i++) sum[i] += factor * row[i];
    }
  }
  return sums;
}

// Spherical harmonics above degree 0 for a unit direction, as crates/core/src/raster/sh.rs.
function harmonics(x, y, z) {
  const xx = x * x, yy = y * y, zz = z * z;
  return [
    -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
    1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy),
    -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy),
    -0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4 * zz - xx - yy),
    0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy), -0.4570457994644658 * x * (4 * zz - xx - yy),
    1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3 * yy),
  ];
}

class Scene {
  static async open(header, text) {
    const scene = Object.assign(new Scene(), header), data = decoded(text), { tensors } = header;
    const tensor = (name) => (tensors[name] ? unpacked(tensors[name], data) : new Float32Array());
    scene.means = await tensor("means");
    scene.rotations = await tensor("rotations");
    scene.logScales = await tensor("log_scales");
    scene.logits = await tensor("opacity_logits");
    scene.colours = await tensor("colours");
    scene.harmonics = await tensor("sh_rest");
    scene.weights = unmixed(await tensor("basis_weights"), header.bases);
    const plain = ({ start, bytes }) => inflated(data.subarray(start, start + bytes));
    scene.fieldOfView = await plain(tensors.field_of_view);
    for (const [k, prompt] of header.prompts.entries()) prompt.shares = await plain(tensors[`shares.${k}`]);
    scene.count = scene.logits.length;
    scene.rows = Math.max(1, Math.ceil(scene.count / (TEXELS / 4)));
    scene.now = new Float32Array(scene.rows * TEXELS * 4);
    scene.motion = new Float32Array(scene.count * CHANNELS);
    scene.sorting = [new Uint32Array(scene.count), new Uint32Array(scene.count), new Float32Array(scene.count)];
    return scene;
  }

  // Moves all Gaussians to a frame; higher bands of their colours are those seen from `position`.
  move(frame, position) {
    const { first, values } = this.frames[frame].bases, { motion, weights, now } = this;
    motion.fill(0);
    values.forEach((value, k) => {
      const plane = weights.subarray((first + k) * motion.length, (first + k + 1) * motion.length);
      for (let i = 0; i < motion.length; i++) motion[i] += value * plane[i];
    });
    for (let i = 0; i < this.count; i++) this.place(i, position);
  }

  place(i, position) {
    const { now, motion, means, logScales, colours, rotations } = this, at = i * CHANNELS, out = i * STRIDE;
    let squares = 0;
    for (let k = 0; k < 3; k++) {
      now[out + k] = means[3 * i + k] + motion[at + k];
      now[out + 8 + k] = Math.exp(Math.max(-15, Math.min(15, logScales[3 * i + k] + motion[at + 7 + k])));
      now[out + 12 + k] = 0.5 + SH_C0 * (colours[3 * i + k] + motion[at + 10 + k]);
    }
    for (let k = 0; k < 4; k++) {
      const value = rotations[4 * i + k] + motion[at + 3 + k];
      now[out + 4 + k] = value;
      squares += value * value;
    }
    const length = Math.sqrt(squares);
    for (let k = 4; k < 8; k++) now[out + k] = length > 1e-12 ? now[out + k] / length : Number(k === 4);
    now[out + 3] = 1 / (1 + Math.exp(-this.logits[i]));
    if (this.bands) this.colour(i, out, position);
    for (let k = 12; k < 15; k++) now[out + k] = Math.max(0, now[out + k]) || 0;
  }

  // Adds what the higher bands of a colour show in the direction from `position`.
  colour(i, out, position) {
    const { now, bands } = this;
    const x = now[out] - position[0], y = now[out + 1] - position[1], z = now[out + 2] - position[2];
    const length = Math.sqrt(x * x + y * y + z * z);
    const values = length > 1e-12 ? harmonics(x / length, y / length, z / length) : harmonics(0, 0, 1);
    for (let band = 0; band < bands; band++) {
      for (let k = 0; k < 3; k++) now[out + 12 + k] += values[band] * this.harmonics[(i * bands + band) * 3 + k];
    }
  }

  // The Gaussians before a camera, from far to near.
  order({ rotation, translation }) {
    const [order, spare, depths] = this.sorting, { now } = this, [x, y, z] = rotation.slice(6);
    let count = 0;
    for (let i = 0; i < this.count; i++) {
      const at = i * STRIDE, depth = x * now[at] + y * now[at + 1] + z * now[at + 2] + translation[2];
      depths[i] = depth;
      if (depth > this.limits.NEAR) order[count++] = i;
    }
    // Bits of positive numbers are in the numbers' own order.
    const bits = new Uint32Array(depths.buffer);
    for (const [from, to, shift] of [[order, spare, 0], [spare, order, 16]]) {
      const ends = new Uint32Array(65537);
      for (let k = 0; k < count; k++) ends[((bits[from[k]] >>> shift) & 65535) + 1]++;
      for (let k = 0; k < 65536; k++) ends[k + 1] += ends[k];
      for (let k = 0; k < count; k++) to[ends[(bits[from[k]] >>> shift) & 65535]++] = from[k];
    }
    return order.subarray(0, count).reverse();
  }
}
