// Cameras: the recorded ones, and those turned around what they look at.

const product = (a, b) => a.map((_, k) => [0, 1, 2].reduce((sum, j) => sum + a[3 * Math.floor(k / 3) + j] * b[3 * j + (k % 3)], 0));
const applied = (m, [x, y, z]) => [0, 3, 6].map((row) => m[row] * x + m[row + 1] * y + m[row + 2] * z);

// A camera of a row of numbers: width, height, fx, fy, cx, cy and camera_from_world as 3×4.
function cameraOf(row) {
  const pose = row.slice(6), rotation = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((k) => pose[k]);
  return { size: row.slice(0, 2), lens: row.slice(2, 6), rotation, translation: [pose[3], pose[7], pose[11]] };
}

// The camera turned by two angles around the point at this depth before it.
function turned(camera, { yaw, pitch }, depth) {
  const [a, b, c, d] = [Math.cos(yaw), Math.sin(yaw), Math.cos(-pitch), Math.sin(-pitch)];
  const turn = product([1, 0, 0, 0, c, -d, 0, d, c], [a, 0, b, 0, 1, 0, -b, 0, a]);
  const [x, y, z] = camera.translation, moved = applied(turn, [x, y, z - depth]);
  return { ...camera, rotation: product(turn, camera.rotation), translation: [moved[0], moved[1], moved[2] + depth] };
}

// The same view with another number of pixels.
function resized(camera, width, height) {
  const [x, y] = [width / camera.size[0], height / camera.size[1]], [fx, fy, cx, cy] = camera.lens;
  return { ...camera, size: [width, height], lens: [fx * x, fy * y, cx * x, cy * y] };
}

// The camera's place in the world.
function positionOf({ rotation: r, translation: t }) {
  return [0, 1, 2].map((k) => -(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]));
}
