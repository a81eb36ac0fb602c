"use strict";
// What is left of the stock.
(() => {
  const view = document.getElementById("stock-view");
  if (!view) return;
  const { x, y, z } = columns.stock_points;
  const { i, j, k } = columns.stock_faces;
  const draw = () => {
    const axis = (title) => theme.axis({ title: { text: title }, backgroundcolor: "rgba(0,0,0,0)", showspikes: false, automargin: undefined });
    const layout = theme.layout({ height: 480, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: 1,
      scene: { aspectmode: "data", uirevision: 1, dragmode: "turntable", camera: { eye: { x: -1.5, y: -1.5, z: 1.5 } }, xaxis: axis("X, mm"), yaxis: axis("Y, mm"), zaxis: axis("Z, mm") } });
    const mesh = { type: "mesh3d", x, y, z, i, j, k, color: "#a9b4bf", flatshading: true, hoverinfo: "skip",
      lighting: { ambient: 0.7, diffuse: 0.5, specular: 0.1 } };
    const drawn = Plotly.react(view, [mesh], layout, theme.config);
    space.photograph(view);
    return drawn;
  };
  view.style.minHeight = "480px";
  stage.add(view, () => draw().then(() => {
    theme.onChange(draw);
    space.hear(view);
    view.on("plotly_relayout", () => space.photograph(view));
  }));
})();
