"use strict";
// Plots that are plain data (`kit/plots.py`) become figures of the plot library.
const plots = (() => {
  const { colour } = theme;

  const traced = {
    curve: ({ x, y, name, colour: of, dots, dashed }) => ({
      type: "scatter", x, y, name, mode: dots ? "lines+markers" : "lines",
      line: { color: colour(of), width: 2, dash: dashed ? "dash" : "solid" }, marker: { size: 6 },
    }),
    points: ({ x, y, name, colour: of, half, across, hollow, texts }) => ({
      type: "scatter", x, y, name, mode: "markers", text: texts, hovertemplate: texts ? "%{text}<extra></extra>" : undefined,
      marker: { color: colour(of), size: 9, symbol: hollow ? "circle-open" : "circle" },
      [across ? "error_x" : "error_y"]: half ? { type: "data", array: half, color: colour(of), thickness: 2 } : undefined,
    }),
    span: ({ x, low, high }) => ({
      type: "scatter", mode: "lines", hoverinfo: "skip", showlegend: false, line: { color: colour("soft"), width: 1 },
      x: x.flatMap((at) => [at, at, null]), y: low.flatMap((from, i) => [from, high[i], null]),
    }),
    bars: ({ lengths, texts, chosen }) => ({
      type: "bar", orientation: "h", x: lengths, y: lengths.map((_, i) => i), text: texts, textposition: "outside",
      hoverinfo: "text", cliponaxis: false, marker: { color: chosen.map((is) => colour(is ? "after" : "rule")) },
    }),
    counts: ({ edges, counts, name }) => ({
      type: "bar", name, x: counts.map((_, i) => (edges[i] + edges[i + 1]) / 2), y: counts, marker: { color: colour("soft") },
      width: counts.map((_, i) => edges[i + 1] - edges[i]), opacity: 0.6,
    }),
    matrix: ({ names: of, values }) => ({
      type: "heatmap", x: of, y: of, z: values, zmin: -1, zmax: 1, xgap: 1, ygap: 1,
      colorscale: [[0, colour("before")], [0.5, colour("card")], [1, colour("after")]],
      texttemplate: of.length <= 14 ? "%{z:.2f}" : undefined, textfont: { color: colour("ink") },
      hovertemplate: "%{y} – %{x}: %{z:.2f}<extra></extra>",
      colorbar: { title: { text: "correlation" }, tickvals: [-1, 0, 1], thickness: 12 },
    }),
    lines: ({ x, y, z, name, colour: of, width, dots }) => ({
      type: "scatter3d", x, y, z, name, mode: dots ? "markers" : "lines", hoverinfo: "name", connectgaps: false,
      line: { color: colour(of), width }, marker: { color: colour(of), size: width },
    }),
  };

  function axis({ title, logarithmic, range, categories }, square) {
    return theme.axis({
      title: { text: title }, type: categories || square ? undefined : logarithmic ? "log" : "linear",
      range: range && logarithmic ? range.map(Math.log10) : range ?? undefined,
      tickvals: categories?.map((_, i) => i), ticktext: categories ?? undefined, dtick: logarithmic ? undefined : null,
    });
  }

  function figure(plot) {
    const space = plot.traces.some(({ type }) => type === "lines");
    const square = plot.traces.some(({ type }) => type === "matrix");
    const layout = theme.layout({ showlegend: plot.traces.filter(({ name }) => name).length > 1 });
    layout.legend = { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 };
    layout.hovermode = "closest";
    const data = plot.traces.map((trace) => traced[trace.type](trace));
    if (space) {
      const of = (title) => theme.axis({ title: { text: title }, backgroundcolor: "rgba(0,0,0,0)" });
      layout.scene = { aspectmode: "data", xaxis: of("X, m"), yaxis: of("Y, m"), zaxis: of("Z, m") };
      layout.margin = { l: 0, r: 0, t: 0, b: 0 };
    } else {
      layout.xaxis = axis(plot.x, square);
      layout.yaxis = axis(plot.y, square);
      if (square || plot.y.categories) layout.yaxis.autorange = "reversed";
      if (square) Object.assign(layout.xaxis, { tickangle: -60 });
    }
    const along = (mark) => (mark.level
      ? { x0: 0, x1: 1, xref: "paper", y0: mark.at, y1: mark.at, yref: "y" }
      : { x0: mark.at, x1: mark.at, xref: "x", y0: 0, y1: 1, yref: "paper" });
    layout.shapes = plot.marks.map((mark) => ({
      type: "line", ...along(mark), line: { color: colour(mark.colour), width: 1.5, dash: "dash" },
    }));
    layout.annotations = plot.marks.map((mark, i) => {
      const log = (mark.level ? plot.y : plot.x).logarithmic;
      const at = log ? Math.log10(mark.at) : mark.at;
      return {
        text: mark.text, showarrow: false, font: { color: colour(mark.colour) },
        ...(mark.level ? { x: 1, xref: "paper", xanchor: "right", y: at, yanchor: "bottom" }
          : { x: at, xanchor: "left", y: 1 - 0.09 * i, yref: "paper", yanchor: "top" }),
      };
    });
    if (plot.steps) {
      data.forEach((trace, i) => { trace.visible = plot.steps[0].includes(i); });
      layout.sliders = [{
        pad: { t: 20, b: 30 }, currentvalue: { prefix: "shown: " },
        steps: plot.steps.map((shown, i) => ({
          label: plot.step_names[i], method: "restyle", args: [{ visible: data.map((_, k) => shown.includes(k)) }],
        })),
      }];
    }
    return [data, layout];
  }

  for (const element of document.querySelectorAll(".plot")) {
    const plot = JSON.parse(element.nextElementSibling.textContent);
    const draw = () => Plotly.react(element, ...figure(plot), theme.config);
    stage.add(element, () => {
      draw();
      theme.onChange(draw);
    });
  }
})();
