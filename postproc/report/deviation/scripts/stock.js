"use strict";
// The remaining stock, coloured by its depth below the top, with its edges.
(() => {
  const view = document.getElementById("stock-view");
  if (!view) return;
  const { x, y, z, depth } = columns.stock_points;
  const { i, j, k } = columns.stock_faces;
  const { begin, end } = columns.stock_edges;
  const deepest = depth.reduce((most, value) => Math.max(most, value), 1e-6);
  const edges = { x: [], y: [], z: [] };
  begin.forEach((from, e) => {
    for (const [axis, values] of Object.entries({ x, y, z })) edges[axis].push(values[from], values[end[e]], null);
  });
  view.style.maxHeight = "480px";
  const falling = theme.scale("rising").map(([at], n, all) => [at, all[all.length - 1 - n][1]]); // light at the top
  space.add(view, {
    unit: "mm",
    bar: () => ({ title: "Depth below the top, mm", stops: [...theme.scales.rising].reverse(), low: 0, high: deepest }),
    traces: () => [
      { type: "mesh3d", x, y, z, i, j, k, intensity: depth, cmin: 0, cmax: deepest, colorscale: falling, showscale: false,
        flatshading: true, hoverinfo: "skip", lighting: { ambient: 0.75, diffuse: 0.45, specular: 0.05 } },
      { type: "scatter3d", mode: "lines", ...edges, hoverinfo: "skip", connectgaps: false, line: { color: "#26303c", width: 2 } },
    ],
  });
})();
