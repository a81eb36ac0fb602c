"use strict";
// Histogram of the deviations along the cutting path; a line marks the chosen place.
(() => {
  const view = document.getElementById("histogram-view");
  if (!view) return;
  const { at, count, values } = places;
  const ROUNDING = 1e-4; // mm, of the numbers in the text: a deviation below it is noise
  const measures = Object.keys(facts.histograms).filter((name) => name === "before" || at[name][facts.worst[name]] >= ROUNDING);
  const NARROW = 520; // pixels: if narrower, one histogram is below the other

  function figure() {
    const wide = theme.printing || view.clientWidth >= NARROW || measures.length === 1;
    const [across, down] = wide ? [measures.length, 1] : [1, measures.length];
    const height = 250 * down;
    view.style.minHeight = `${height}px`;
    const layout = theme.layout({ height, bargap: 0.05, margin: { l: 50, r: 10, t: 10, b: 44 } });
    const data = measures.map((name, k) => {
      const suffix = k ? String(k + 1) : "";
      const { edges, percent } = facts.histograms[name];
      const [column, row] = wide ? [k, 0] : [0, k];
      layout[`xaxis${suffix}`] = theme.axis({ domain: [(column + 0.07 * (column > 0)) / across, (column + 1) / across], anchor: `y${suffix}`,
        fixedrange: true, title: { text: `${values[name].title}, mm` }, nticks: 5, tickangle: 0 });
      layout[`yaxis${suffix}`] = theme.axis({ domain: [1 - (row + 1 - 0.2 * (row + 1 < down)) / down, 1 - row / down], anchor: `x${suffix}`,
        fixedrange: true, title: column ? undefined : { text: "cutting path, %" } });
      return { type: "bar", x: percent.map((_, i) => (edges[i] + edges[i + 1]) / 2), y: percent, xaxis: `x${suffix}`, yaxis: `y${suffix}`,
        customdata: percent.map((_, i) => [edges[i], edges[i + 1]]), marker: { color: theme.colour(name) },
        hovertemplate: "%{y:.3g} % of the cutting path, %{customdata[0]:.4f} … %{customdata[1]:.4f} mm<extra></extra>" };
    });
    return [data, layout];
  }
  const draw = () => Plotly.react(view, ...figure(), theme.config);

  // The worst place in a bar; where the page holds none of it, the one that comes nearest.
  function worst(name, low, high) {
    const value = at[name];
    const off = (i) => Math.max(value[i] - high, low - value[i], 0);
    let best = null;
    for (let i = 0; i < count; i++) {
      if (at.rapid[i]) continue;
      if (best === null || off(i) < off(best) || (off(i) === 0 && off(best) === 0 && value[i] > value[best])) best = i;
    }
    return best;
  }
  stage.add(view, () => draw().then(() => {
    view.on("plotly_click", ({ points: [point] }) => selection.choose(worst(measures[point.curveNumber], ...point.customdata)));
    theme.onChange(draw);
    measures.forEach((name, k) => cursor.follow(view, () => {
      const place = selection.place;
      return place === null || at.rapid[place] ? null : at[name][place];
    }, k ? String(k + 1) : ""));
  }));
})();
