"use strict";
// The values at each place of the path, with titles and units. `places.at` are the columns of numbers.
const places = (() => {
  const at = columns.places;
  const count = at.before.length;
  const joints = ["A1", "A2", "A3", "A4", "A5", "A6"];

  const margins = (i) => joints.map((name, k) => Math.min(at[name][i] - facts.lower[k], facts.upper[k] - at[name][i]));
  at.margin = new Float32Array(count).fill(Infinity);
  joints.forEach((name, k) => {
    const angle = at[name];
    for (let i = 0; i < count; i++) at.margin[i] = Math.min(at.margin[i], angle[i] - facts.lower[k], facts.upper[k] - angle[i]);
  });

  const compared = facts.mode !== "predict";
  // Values that paths and plots can be coloured by: title, unit and decimals.
  const values = {
    before: { title: compared ? "Deviation before" : "Predicted deviation", unit: "mm", decimals: 4 },
    ...(compared && { after: { title: "Deviation after", unit: "mm", decimals: 4 } }),
    ...(facts.bounded && { u95: { title: "Expected on the part (95 %)", unit: "mm", decimals: 4 } }),
    force: { title: "Force", unit: "N", decimals: 0 },
    ...(compared && { correction: { title: "Correction", unit: "mm", decimals: 4 } }),
    margin: { title: "Smallest joint margin", unit: "°", decimals: 1, low: true },
    singular: { title: "Smallest singular value", unit: "m/rad", decimals: 3, low: true },
    speed: { title: "Speed", unit: "mm/s", decimals: 1 },
  };

  const matrix = (rows) => [0, 1, 2].map((r) => rows.slice(4 * r, 4 * r + 4));
  const turned = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const moved = (m, v) => turned(m, v).map((value, r) => value + m[r][3]);
  const bases = facts.bases.map(matrix);
  const inRoot = bases.length > 1; // several $BASE: all is drawn in the robot root

  // Vector of columns (prefix + X, Y, Z) in the axes in which the path is drawn.
  function vector(prefix, i) {
    const v = ["X", "Y", "Z"].map((axis) => at[prefix + axis][i]);
    return inRoot ? turned(bases[at.base[i]], v) : v;
  }
  function position(i) {
    const v = ["X", "Y", "Z"].map((axis) => at[axis][i]);
    return inRoot ? moved(bases[at.base[i]], v) : v;
  }

  // The next place in a direction that cuts, or the last one there is.
  function step(from, by) {
    if (from === null) return facts.worst.before;
    let i = Math.min(Math.max(from + by, 0), count - 1);
    while (at.rapid[i] && i + Math.sign(by) >= 0 && i + Math.sign(by) < count) i += Math.sign(by);
    return i;
  }

  // The worst place of a line, or of the nearest line that has one.
  function ofLine(line) {
    let best = null;
    let off = Infinity;
    for (let i = 0; i < count; i++) {
      const distance = Math.abs(at.source_line[i] - line);
      if (distance < off || (distance === off && at.before[i] > at.before[best])) [best, off] = [i, distance];
    }
    return best;
  }

  return { at, count, joints, margins, compared, values, matrix, turned, moved, bases, inRoot, vector, position, step,
    ofLine };
})();
