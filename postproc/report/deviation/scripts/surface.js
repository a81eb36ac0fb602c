"use strict";
// The part, each facet coloured by the deviation along its normal.
(() => {
  const view = document.getElementById("surface-view");
  if (!view) return;
  const facets = columns.facets;
  const { x, y, z } = columns.corners;
  const count = facets.place.length;
  const titles = { before: places.compared ? "Before" : "Predicted", ...(places.compared && { after: "After" }),
    ...(facts.bounded && { u95: "Expected (95 %)" }) };
  const touched = [];
  const untouched = [];
  for (let f = 0; f < count; f++) (facets.place[f] < 0 ? untouched : touched).push(f);
  let shown = "before";

  const mesh = (of) => ({ type: "mesh3d", x, y, z, i: of.map((f) => 3 * f), j: of.map((f) => 3 * f + 1),
    k: of.map((f) => 3 * f + 2), flatshading: true, lighting: { ambient: 0.75, diffuse: 0.4, specular: 0.05 } });
  function traces() {
    const values = touched.map((f) => facets[shown][f]);
    const most = values.reduce((largest, value) => Math.max(largest, Math.abs(value)), 1e-9);
    const scale = shown === "u95" ? { colorscale: "Cividis", cmin: 0 }
      : { colorscale: [[0, "rgb(179,88,6)"], [0.5, "rgb(247,247,247)"], [1, "rgb(5,48,97)"]], cmin: -most };
    return [
      { ...mesh(touched), intensitymode: "cell", intensity: values, cmax: most, ...scale, hoverinfo: "none",
        colorbar: { title: { text: `${titles[shown]}, mm`, side: "right" }, thickness: 12, len: 0.8, exponentformat: "none" } },
      { ...mesh(untouched), color: theme.colour("soft"), opacity: 0.35, hoverinfo: "skip" },
    ];
  }
  function layout() {
    const axis = (title) => theme.axis({ title: { text: title }, backgroundcolor: "rgba(0,0,0,0)", showspikes: false, automargin: undefined });
    return theme.layout({ height: 520, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: 1,
      scene: { aspectmode: "data", uirevision: 1, dragmode: "turntable", xaxis: axis("X, mm"), yaxis: axis("Y, mm"), zaxis: axis("Z, mm") } });
  }
  const draw = () => {
    const drawn = Plotly.react(view, traces(), layout(), theme.config);
    space.photograph(view);
    return drawn;
  };
  document.getElementById("surface-controls").innerHTML = `<label>Colour <select id="surface-colour">${Object.entries(titles)
    .map(([name, title]) => `<option value="${name}">${title}</option>`).join("")}</select></label>`;
  document.getElementById("surface-colour").addEventListener("change", (event) => {
    shown = event.target.value;
    draw();
  });
  // Corners stand three by three: a facet is known by any of its corners.
  let under = null;
  view.style.minHeight = "520px";
  stage.add(view, () => draw().then(() => {
    view.on("plotly_hover", ({ points: [{ curveNumber, pointNumber }] }) => {
      if (curveNumber !== 0) return;
      under = facets.place[Math.floor(pointNumber / 3)];
      selection.point(under);
    });
    view.on("plotly_unhover", () => {
      under = null;
      selection.point(null);
    });
    space.clicked(view, () => { if (under !== null) selection.choose(under); });
    space.hear(view);
    view.on("plotly_relayout", () => space.photograph(view));
    theme.onChange(draw);
  }));
})();
