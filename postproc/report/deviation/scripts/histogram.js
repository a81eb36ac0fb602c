"use strict";
// How many cutting targets deviate by how much; the bar of the chosen place stands out.
(() => {
  const view = document.getElementById("histogram-view");
  if (!view) return;
  const { at, count, values } = places;
  const measures = Object.keys(facts.histograms);
  const bin = (name, place) => {
    const { edges, counts } = facts.histograms[name];
    return Math.min(Math.floor(at[name][place] / (edges[1] - edges[0])), counts.length - 1);
  };

  function figure() {
    const place = selection.place;
    const layout = theme.layout({ height: 300, bargap: 0.05, margin: { l: 50, r: 10, t: 26, b: 44 }, annotations: [] });
    const data = measures.map((name, k) => {
      const suffix = k ? String(k + 1) : "";
      const { edges, counts } = facts.histograms[name];
      const width = 1 / measures.length;
      layout[`xaxis${suffix}`] = theme.axis({ domain: [k * width + (k ? 0.06 : 0), (k + 1) * width], anchor: `y${suffix}`, fixedrange: true,
        title: { text: `${values[name].title}, mm` }, nticks: 5 });
      layout[`yaxis${suffix}`] = theme.axis({ anchor: `x${suffix}`, fixedrange: true, title: k ? undefined : { text: "targets" } });
      const chosen = place === null || at.rapid[place] ? -1 : bin(name, place);
      return { type: "bar", x: counts.map((_, i) => (edges[i] + edges[i + 1]) / 2), y: counts, xaxis: `x${suffix}`, yaxis: `y${suffix}`,
        customdata: counts.map((_, i) => [edges[i], edges[i + 1]]), marker: { color: counts.map((_, i) => theme.colour(i === chosen ? "chosen" : name)) },
        hovertemplate: "%{y} targets, %{customdata[0]:.4f} … %{customdata[1]:.4f} mm<extra></extra>" };
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
  view.style.minHeight = "300px";
  stage.add(view, () => draw().then(() => {
    view.on("plotly_click", ({ points: [point] }) => selection.choose(worst(measures[point.curveNumber], ...point.customdata)));
    theme.onChange(draw);
    let shown = "";
    selection.subscribe((place) => {
      const bins = place === null || at.rapid[place] ? "" : String(measures.map((name) => bin(name, place)));
      if (bins !== shown) requestAnimationFrame(draw);
      shown = bins;
    });
  }));
})();
