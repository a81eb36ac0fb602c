"use strict";
// The first picture of a view in space: box and lines as the processor draws them, within a tenth of a second. It is there
// until the library has drawn its own, and where a browser cannot draw with the library at all.
const sketch = (() => {
  const { projected } = camera;

  // Lines of the box on the three walls behind the lines, `step` apart.
  function walls(pen, how, step) {
    const { box } = how;
    pen.strokeStyle = theme.colour("rule");
    pen.lineWidth = 1;
    pen.beginPath();
    for (let r = 0; r < 3; r++) {
      const deep = [0, 1].map((k) => projected(how, ...[0, 1, 2].map((s) => (s === r ? box[k][s] : (box[0][s] + box[1][s]) / 2)))[2]);
      const wall = box[deep[0] > deep[1] ? 0 : 1][r];
      for (const [s, t] of [[(r + 1) % 3, (r + 2) % 3], [(r + 2) % 3, (r + 1) % 3]])
        for (let k = Math.ceil(box[0][s] / step); k * step <= box[1][s]; k++)
          [box[0][t], box[1][t]].forEach((end, first) => {
            const point = [];
            point[r] = wall;
            point[s] = k * step;
            point[t] = end;
            const [x, y] = projected(how, ...point);
            if (first) pen.lineTo(x, y); else pen.moveTo(x, y);
          });
    }
    pen.stroke();
  }

  // Colour of the piece that ends in point k of a line of the library.
  function colours({ line }) {
    if (!Array.isArray(line.color)) return () => line.color;
    const shades = Array.from({ length: 65 }, (_, k) => theme.shade(line.colorscale, k / 64));
    return (k) => shades[Math.round((64 * (line.color[k] - line.cmin)) / (line.cmax - line.cmin))] ?? shades[0];
  }

  // Draws lines of the library, about as wide as it does, far ones first.
  function draw(canvas, how, step, lines) {
    const ratio = Math.min(devicePixelRatio, 2);
    canvas.width = how.width * ratio;
    canvas.height = how.height * ratio;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    walls(pen, how, step);
    const pieces = [];
    for (const trace of lines) {
      const { x, y, z, line: { width }, mode } = trace;
      const colour = colours(trace);
      let before = null;
      for (let k = 0; k < x.length; k++) {
        const here = x[k] === null || Number.isNaN(x[k]) ? null : projected(how, x[k], y[k], z[k]);
        if (here && mode === "markers") pieces.push([here, here, colour(k), width]);
        else if (here && before) pieces.push([before, here, colour(k), 0.6 * width]);
        before = here;
      }
    }
    pieces.sort(([, [, , one]], [, [, , other]]) => other - one);
    pen.lineCap = "round";
    for (const [[a, b], [c, d], colour, width] of pieces) {
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.beginPath();
      pen.moveTo(a, b);
      pen.lineTo(c, d);
      pen.stroke();
    }
  }
  return { draw };
})();
