"use strict";
// How a box in space is seen: in perspective from an eye outside of it, upright. The eye is given as in the plot library:
// counted from the middle of the box, in a unit in which the box is `size` across: as large as the picture has room for.
const camera = (() => {
  const SLOPE = Math.tan(Math.PI / 8); // half of the angle of view
  const OBLIQUE = { eye: { x: -1.42, y: -1.9, z: 1.4 }, up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: -0.12 } };

  const vector = ({ x, y, z }) => [x, y, z];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((value) => value / Math.hypot(...a));
  const diagonal = ([low, high]) => Math.hypot(...high.map((value, r) => value - low[r]));

  // A box a little larger than [low, high]; a flat one gets some height.
  function box([low, high]) {
    const most = Math.max(...high.map((value, r) => value - low[r]), 1e-6);
    const room = high.map((value, r) => Math.max(0.03 * (value - low[r]), (0.1 * most - (value - low[r])) / 2));
    return [low.map((value, r) => value - room[r]), high.map((value, r) => value + room[r])];
  }

  // Size of a box that fits a picture, seen at first, with its numbers around it.
  const AROUND = { left: 92, right: 76, top: 24, bottom: 52 }; // pixels
  function size(box, width, height) {
    for (let tried = 4; tried > 0.5; tried *= 0.97) {
      const how = seen(OBLIQUE, box, tried, width, height);
      const corners = Array.from({ length: 8 }, (_, k) => projected(how, box[k & 1][0], box[(k >> 1) & 1][1], box[k >> 2][2]));
      if (corners.every(([x, y, deep]) => deep > 0 && x > AROUND.left && x < width - AROUND.right && y > AROUND.top && y < height - AROUND.bottom))
        return tried;
    }
    return 0.5;
  }

  // Lengths of a box in that unit.
  const lengths = (box, size) => box[1].map((value, r) => ((value - box[0][r]) * size) / diagonal(box));

  // Projection into a picture: three rows [x, y, z, 1] for across and down, both to be divided by depth, and for depth.
  function seen({ eye, center }, box, size, width, height) {
    const scale = size / diagonal(box);
    const from = vector(eye).map((value, r) => value + (scale * (box[0][r] + box[1][r])) / 2);
    const front = unit(vector(center).map((value, r) => value - vector(eye)[r]));
    const right = unit(cross(front, [0, 0, 1]));
    const row = (axis, factor) => [...axis.map((value) => value * scale * factor), -factor * dot(axis, from)];
    const pixels = height / 2 / SLOPE;
    return { rows: [row(right, pixels), row(cross(right, front), -pixels), row(front, 1)], width, height, box };
  }

  // Where a point is seen, in pixels, and how deep.
  function projected({ rows: [a, d, w], width, height }, x, y, z) {
    const deep = w[0] * x + w[1] * y + w[2] * z + w[3];
    return [width / 2 + (a[0] * x + a[1] * y + a[2] * z + a[3]) / deep,
      height / 2 + (d[0] * x + d[1] * y + d[2] * z + d[3]) / deep, deep];
  }

  // From elsewhere: turned by degrees about the upright axis and in height, nearer by a factor, or from a place of its own.
  function moved(from, { turn = 0, rise = 0, nearer = 1, to = null }) {
    const { x, y, z } = to ?? from.eye;
    const radius = Math.hypot(x, y, z) / nearer;
    const azimuth = Math.atan2(y, x) + (turn * Math.PI) / 180;
    const height = Math.min(Math.max(Math.atan2(z, Math.hypot(x, y)) + (rise * Math.PI) / 180, -1.55), 1.55);
    return { ...from, eye: { x: radius * Math.cos(height) * Math.cos(azimuth), y: radius * Math.cos(height) * Math.sin(azimuth),
      z: radius * Math.sin(height) } };
  }
  return { OBLIQUE, box, size, lengths, seen, projected, moved };
})();
