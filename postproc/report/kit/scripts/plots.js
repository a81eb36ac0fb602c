"use strict";
// Plots that are plain data (`kit/plots.py`) become figures of the plot library.
const plots = (() => {
  const { colour } = theme;

  const traced = {
    curve: ({ x, y, name, colour: of, dots, dashed, places }) => ({
      type: "scatter", x, y, name, customdata: places, mode: dots ? "lines+markers" : "lines",
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
    counts: ({ edges, counts, name, places }) => ({
      type: "bar", name, customdata: places, x: counts.map((_, i) => (edges[i] + edges[i + 1]) / 2), y: counts, marker: { color: colour("soft") },
      width: counts.map((_, i) => edges[i + 1] - edges[i]), opacity: 0.6,
    }),
    matrix: ({ names: of, values }) => ({
      type: "heatmap", x: of, y: of, z: values, zmin: -1, zmax: 1, xgap: 1, ygap: 1,
      colorscale: [[0, colour("before")], [0.5, colour("card")], [1, colour("after")]],
      texttemplate: of.length <= 14 ? "%{z:.2f}" : undefined, // black or white, whichever is read on the cell
      hovertemplate: "%{y} – %{x}: %{z:.2f}<extra></extra>",
      colorbar: { title: { text: "correlation" }, tickvals: [-1, 0, 1], thickness: 12 },
    }),
    lines: ({ x, y, z, name, colour: of, width, dots, places }) => ({
      type: "scatter3d", x, y, z, name, customdata: places, mode: dots ? "markers" : "lines", hoverinfo: "name", connectgaps: false,
      line: { color: colour(of), width }, marker: { color: colour(of), size: width },
    }),
  };

  // Where the chosen place is: on the first trace that has places.
  function chosen(plot) {
    const trace = plot.traces.find(({ type, places }) => places && type !== "counts");
    const index = trace && selection.place !== null ? trace.places.findIndex((place) => place >= selection.place) : -1;
    return index < 0 ? null : { x: trace.x[index], y: trace.y[index], z: trace.z?.[index] };
  }
  function cursor(plot) {
    const at = chosen(plot);
    return at ? [{ type: "line", xref: "x", yref: "paper", x0: at.x, x1: at.x, y0: 0, y1: 1, line: { color: colour("chosen"), width: 1.5 } }] : [];
  }
  function marker(plot) {
    const at = chosen(plot);
    return { type: "scatter3d", mode: "markers", hoverinfo: "skip", showlegend: false, x: [at?.x ?? null], y: [at?.y ?? null],
      z: [at?.z ?? null], marker: { size: 7, color: colour("chosen") } };
  }

  // Points of the plot are places: pointing at one and a click show it in all views, keys step.
  function link(element, plot, inSpace) {
    const last = Math.max(...plot.traces.flatMap(({ places }) => places ?? []));
    const step = (by) => selection.choose(Math.min(Math.max((selection.chosen ?? 0) + by, 0), last));
    let under = null;
    element.on("plotly_hover", ({ points: [{ customdata }] }) => {
      if (typeof customdata !== "number") return;
      under = customdata;
      selection.point(under);
    });
    element.on("plotly_unhover", () => {
      under = null;
      selection.point(null);
    });
    if (inSpace) {
      space.clicked(element, () => { if (under !== null) selection.choose(under); });
      space.hear(element, { n: () => step(1), p: () => step(-1) });
    } else {
      element.on("plotly_click", ({ points: [{ customdata }] }) => { if (typeof customdata === "number") selection.choose(customdata); });
      element.addEventListener("keydown", (event) => {
        const by = { ArrowLeft: -1, ArrowRight: 1, PageUp: -50, PageDown: 50 }[event.key];
        if (!by) return;
        event.preventDefault();
        step(by * (event.shiftKey ? 10 : 1));
      });
    }
    let asked = false;
    selection.subscribe(() => {
      if (asked) return;
      asked = true;
      requestAnimationFrame(() => {
        asked = false;
        const { x, y, z } = marker(plot);
        if (inSpace) Plotly.restyle(element, { x: [x], y: [y], z: [z] }, [plot.traces.length]);
        else Plotly.relayout(element, { shapes: figure(plot)[1].shapes });
      });
    });
  }

  function axis({ title, logarithmic, range, categories }, square) {
    return theme.axis({
      title: { text: title }, type: categories || square ? undefined : logarithmic ? "log" : "linear",
      range: range && logarithmic ? range.map(Math.log10) : range ?? undefined,
      tickvals: categories?.map((_, i) => i), ticktext: categories ?? undefined, dtick: logarithmic ? undefined : null,
    });
  }

  function figure(plot) {
    const inSpace = plot.traces.some(({ type }) => type === "lines");
    const square = plot.traces.some(({ type }) => type === "matrix");
    const layout = theme.layout({ showlegend: plot.traces.filter(({ name }) => name).length > 1 });
    layout.legend = { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 };
    layout.hovermode = "closest";
    const data = plot.traces.map((trace) => traced[trace.type](trace));
    if (inSpace) {
      if (plot.traces.some(({ places }) => places)) data.push(marker(plot));
      const of = (title) => theme.axis({ title: { text: title }, backgroundcolor: "rgba(0,0,0,0)" });
      layout.scene = { aspectmode: "data", ...Object.fromEntries(["X", "Y", "Z"].map((name) => [`${name.toLowerCase()}axis`, of(`${name}, ${plot.unit}`)])) };
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
    })).concat(inSpace ? [] : cursor(plot));
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
    const inSpace = plot.traces.some(({ type }) => type === "lines");
    const draw = () => {
      const drawn = Plotly.react(element, ...figure(plot), theme.config);
      if (inSpace) space.photograph(element);
      return drawn;
    };
    stage.add(element, () => draw().then(() => {
      theme.onChange(draw);
      if (inSpace) element.on("plotly_relayout", () => space.photograph(element));
      if (plot.traces.some(({ places }) => places)) link(element, plot, inSpace);
    }));
  }
})();
