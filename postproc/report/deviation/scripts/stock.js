"use strict";
// What is left of the stock.
(() => {
  const view = document.getElementById("stock-view");
  if (!view) return;
  const { x, y, z } = columns.stock_points;
  const { i, j, k } = columns.stock_faces;
  view.style.maxHeight = "480px";
  space.add(view, {
    unit: "mm",
    traces: () => [{ type: "mesh3d", x, y, z, i, j, k, color: "#a9b4bf", flatshading: true, hoverinfo: "skip",
      lighting: { ambient: 0.7, diffuse: 0.5, specular: 0.1 } }],
  });
})();
