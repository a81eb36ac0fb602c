"use strict";
// The part, each facet coloured by the deviation along its normal.
(() => {
  const view = document.getElementById("surface-view");
  if (!view) return;
  const facets = columns.facets;
  const { x, y, z } = columns.corners;
  const count = facets.place.length;
  const titles = { before: places.compared ? "Before" : "Predicted", ...(places.compared && { after: "After" }),
    ...(facts.bounded && { u95: "Expected (95 %)" }), programmed: "Programmed path" };
  const all = Array.from({ length: count }, (_, f) => f);
  const reached = all.filter((f) => facets.place[f] >= 0);
  const programmed = facets.programmed.reduce((least, value) => Math.min(least, Number.isFinite(value) ? value : 0), 0);
  let shown = programmed < -(facts.tolerance_mm ?? 0.01) ? "programmed" : "before"; // a part that does not fit comes first
  let bar = null; // of its colours

  const mesh = (of) => ({ type: "mesh3d", x, y, z, i: of.map((f) => 3 * f), j: of.map((f) => 3 * f + 1),
    k: of.map((f) => 3 * f + 2), flatshading: true, lighting: { ambient: 0.75, diffuse: 0.4, specular: 0.05 } });
  function traces() {
    const known = all.filter((f) => Number.isFinite(facets[shown][f]));
    const values = known.map((f) => facets[shown][f]);
    const most = values.reduce((largest, value) => Math.max(largest, Math.abs(value)), 1e-9);
    const scale = shown === "u95" ? "rising" : "about";
    bar = { title: `${titles[shown]}, mm`, stops: theme.scales[scale], low: shown === "u95" ? 0 : -most, high: most };
    return [
      { ...mesh(known), intensitymode: "cell", intensity: values, cmin: bar.low, cmax: most, colorscale: theme.scale(scale), showscale: false, hoverinfo: "none" },
      { ...mesh(all.filter((f) => !Number.isFinite(facets[shown][f]))), color: theme.colour("soft"), opacity: 0.35, hoverinfo: "skip" },
    ];
  }
  // A facet is pointed at by its middle.
  const middles = { x: new Float32Array(reached.length), y: new Float32Array(reached.length), z: new Float32Array(reached.length),
    place: reached.map((f) => facets.place[f]), joined: false };
  reached.forEach((f, k) => {
    for (const axis of ["x", "y", "z"]) for (let c = 0; c < 3; c++) middles[axis][k] += columns.corners[axis][3 * f + c] / 3;
  });
  view.style.maxHeight = "520px";
  const { draw } = space.add(view, { unit: "mm", traces, bar: () => bar, points: () => middles, marks: () =>
    (selection.place === null ? [] : [{ dot: places.position(selection.place), colour: theme.colour("chosen"), size: 5 }]) });
  document.getElementById("surface-controls").innerHTML = `<label>Colour <select id="surface-colour">${Object.entries(titles)
    .map(([name, title]) => `<option value="${name}"${name === shown ? " selected" : ""}>${title}</option>`).join("")}</select></label>`;
  document.getElementById("surface-colour").addEventListener("change", (event) => {
    shown = event.target.value;
    draw();
  });
})();
