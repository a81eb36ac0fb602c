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

  // Points of the arm at a place: root, joints, flange, tool tip.
  function points(i) {
    let here = root;
    const origin = (m) => [m[0][3], m[1][3], m[2][3]];
    const out = [origin(here)];
    placement.forEach((joint, k) => {
      here = times(here, joint);
      out.push(origin(here));
      here = times(here, rotation(facts.axis[k], (places.at[places.joints[k]][i] * Math.PI) / 180));
    });
    here = times(here, flange);
    out.push(origin(here));
    out.push(origin(times(here, tools[places.at.tool[i]] ?? tools[0])));
    return out;
  }
  return { root, points };
})();
