"use strict";
// Where the joints of the robot are: forward kinematics of the controller's geometry, in millimetres.
const robot = (() => {
  const times = (a, b) => [0, 1, 2].map((r) => [0, 1, 2, 3].map((c) =>
    a[r][0] * b[0][c] + a[r][1] * b[1][c] + a[r][2] * b[2][c] + (c === 3 ? a[r][3] : 0)));
  const placement = facts.placement.map(places.matrix);
  const flange = places.matrix(facts.flange);
  const tools = facts.tools.map(places.matrix);

  // Rotation by an angle about a unit axis (Rodrigues).
  function rotation([x, y, z], angle) {
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const u = 1 - c;
    return [[c + x * x * u, x * y * u - z * s, x * z * u + y * s, 0],
      [y * x * u + z * s, c + y * y * u, y * z * u - x * s, 0],
      [z * x * u - y * s, z * y * u + x * s, c + z * z * u, 0]];
  }

  // The root of the robot as it lies in the frame of the picture.
  const root = (() => {
    if (places.inRoot) return [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];
    const base = places.bases[0];
    const back = [0, 1, 2].map((r) => [base[0][r], base[1][r], base[2][r], 0]);
    const shift = places.turned(back, [base[0][3], base[1][3], base[2][3]]);
    return back.map((row, r) => [row[0], row[1], row[2], -shift[r]]);
  })();

  // Frames at a place: the base, each link behind its joint, the flange, the tool tip.
  function frames(i) {
    let here = root;
    const out = [here];
    placement.forEach((joint, k) => {
      here = times(times(here, joint), rotation(facts.axis[k], (places.at[places.joints[k]][i] * Math.PI) / 180));
      out.push(here);
    });
    out.push(times(here, flange));
    out.push(times(out.at(-1), tools[places.at.tool[i]] ?? tools[0]));
    return out;
  }
  const points = (i) => frames(i).map((m) => [m[0][3], m[1][3], m[2][3]]);

  // The body of each link in its own frame: its mesh, else solids of revolution: a column along the axis of its joint, an arm from there
  // to the next joint, and a drum around the axis of that joint.
  const SIDES = 24;
  const WIDE = [0.075, 0.07, 0.055, 0.045, 0.034, 0.03, 0.026]; // radii, of the reach of the arm
  const scaled = (v, factor) => v.map((value) => value * factor);
  const sum = (a, b) => a.map((value, r) => value + b[r]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const origin = (m) => [m[0][3], m[1][3], m[2][3]];
  const next = [...placement, flange];
  const reach = next.reduce((length, m) => length + Math.hypot(...origin(m)), 0);

  // Vertices and faces of a frustum with closed ends.
  function frustum(from, to, wide, narrow) {
    const long = sum(to, scaled(from, -1));
    const length = Math.hypot(...long);
    const axis = scaled(long, 1 / length);
    const side = Math.abs(axis[2]) < 0.9 ? cross(axis, [0, 0, 1]) : cross(axis, [1, 0, 0]);
    const u = scaled(side, 1 / Math.hypot(...side));
    const v = cross(axis, u);
    const vertices = [from, to];
    const faces = [];
    for (let k = 0; k < SIDES; k++) {
      const angle = (2 * Math.PI * k) / SIDES;
      const out = sum(scaled(u, Math.cos(angle)), scaled(v, Math.sin(angle)));
      vertices.push(sum(from, scaled(out, wide)), sum(to, scaled(out, narrow)));
      const [a, b] = [2 + 2 * k, 2 + 2 * ((k + 1) % SIDES)];
      faces.push([0, b, a], [1, a + 1, b + 1], [a, b, b + 1], [a, b + 1, a + 1]);
    }
    return { vertices, faces };
  }
  function solids(k) {
    const out = [];
    const add = (from, to, wide, narrow) => {
      if (Math.hypot(...sum(to, scaled(from, -1))) > 0.05 * wide) out.push(frustum(from, to, wide, narrow));
    };
    const own = k ? facts.axis[k - 1] : [0, 0, 1];
    const end = origin(next[k]);
    const bend = scaled(own, dot(end, own));
    const [wide, narrow] = [WIDE[k] * reach, (WIDE[k + 1] ?? 0.8 * WIDE[k]) * reach];
    add([0, 0, 0], bend, wide, wide);
    add(bend, end, wide, narrow);
    if (k < placement.length) {
      const axis = places.turned(next[k], facts.axis[k]);
      add(sum(end, scaled(axis, -1.1 * narrow)), sum(end, scaled(axis, 1.1 * narrow)), 1.15 * narrow, 1.15 * narrow);
    }
    return out;
  }
  // Meshes of links in millimetres, by number of the link; and those of tool and obstacles.
  const [meshes, added] = (() => {
    const [out, more] = [{}, []];
    const ofLinks = facts.links.reduce((sum, [, , faces]) => sum + faces, 0);
    let [point, face] = [0, 0];
    for (const [link, points, faces] of [...facts.links, ...facts.bodies]) {
      const { link_points: p, link_faces: f } = columns;
      const rows = (count, from, row) => Array.from({ length: count }, (_, k) => row(from + k));
      const mesh = { vertices: rows(points, point, (k) => [p.x[k], p.y[k], p.z[k]]), faces: rows(faces, face, (k) => [f.i[k], f.j[k], f.k[k]]) };
      if (more.length || face >= ofLinks) more.push([link, mesh]); else out[link] = mesh;
      point += points;
      face += faces;
    }
    return [out, more];
  })();
  const bodies = Array.from({ length: placement.length + 2 }, (_, k) => [
    ...(k > placement.length ? [] : meshes[k] ? [meshes[k]] : solids(k)),
    ...added.filter(([link]) => link === k).map(([, mesh]) => mesh)]);
  const faces = { i: [], j: [], k: [], facecolor: [] };
  let count = 0;
  const held = added.some(([link]) => link === placement.length + 1); // else the tool is a cone
  const colour = (part) => {
    const found = added.find(([, mesh]) => mesh === part);
    return found === undefined ? "#e8853a" : found[0] === 0 ? "#a9b1b8" : "#66727d";
  };
  for (const part of [...bodies.flat(), ...(held ? [] : [frustum([0, 0, 0], [0, 0, 1], 1, 1)])]) {
    const own = colour(part);
    for (const [a, b, c] of part.faces) {
      faces.facecolor.push(own);
      faces.i.push(a + count);
      faces.j.push(b + count);
      faces.k.push(c + count);
    }
    count += part.vertices.length;
  }

  // Vertices of the robot at a place: links, and the tool as a cone.
  function vertices(i) {
    const at = frames(i);
    const out = { x: [], y: [], z: [] };
    const push = (point) => ["x", "y", "z"].forEach((axis, r) => out[axis].push(point[r]));
    bodies.forEach((parts, k) => parts.forEach((part) => part.vertices.forEach((point) => push(places.moved(at[k], point)))));
    if (held) return out;
    const [from, tip] = [origin(at.at(-2)), origin(at.at(-1))];
    const apart = Math.hypot(...sum(tip, scaled(from, -1))) > 1e-3;
    frustum(from, apart ? tip : sum(from, [0, 0, 1]), 0.018 * reach, 0.003 * reach).vertices.forEach(push);
    return out;
  }

  // Smallest and largest of x, y and z that the robot takes on its path.
  function room() {
    const out = { x: [], y: [], z: [] };
    const each = Math.max(Math.floor(places.count / 60), 1);
    for (let i = 0; i < places.count; i += each)
      for (const point of points(i))
        ["x", "y", "z"].forEach((axis, r) => out[axis].push(point[r] - 0.1 * reach, point[r] + 0.1 * reach));
    for (const [link, { vertices: corners }] of added)
      if (link === 0) for (const point of corners) ["x", "y", "z"].forEach((axis, r) => out[axis].push(places.moved(root, point)[r]));
    return out;
  }
  return { root, points, frames, faces, vertices, room };
})();
