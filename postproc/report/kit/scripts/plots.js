"use strict";
// Plots that are plain data (`kit/plots.py`) become figures of the plot library.
const plots = (() => {
  const { colour } = theme;
  const REFUSED = ["#26262b", "#8c3b2a", "#6f6fd0", "#e69f00", "#f2b8d4", "#fdf0c8"]; // of cells of a map, by reason: each lighter than the one before

  const traced = {
    curve: ({ x, y, name, colour: of, dots, dashed, places }) => ({
      type: "scatter", x, y, name, customdata: places, mode: dots ? "lines+markers" : "lines",
      line: { color: colour(of), width: 2, dash: dashed ? "dash" : "solid" }, marker: { size: 6 },
    }),
    points: ({ x, y, name, colour: of, half, across, hollow, texts }) => ({
      type: "scatter", x, y, name, mode: "markers", text: texts, hovertemplate: texts ? "%{text}<extra></extra>" : undefined,
      marker: { color: colour(of), size: hollow ? 11 : 9, symbol: hollow ? "circle-open" : "circle", line: { width: hollow ? 3 : 0 } },
      [across ? "error_x" : "error_y"]: half ? { type: "data", array: half, color: colour(of), thickness: 2 } : undefined,
    }),
    span: ({ x, low, high }) => ({
      type: "scatter", mode: "lines", hoverinfo: "skip", showlegend: false, line: { color: colour("soft"), width: 1 },
      x: x.flatMap((at) => [at, at, null]), y: low.flatMap((from, i) => [from, high[i], null]),
    }),
    bars: ({ lengths, texts, chosen }) => ({
      type: "bar", orientation: "h", x: lengths, y: lengths.map((_, i) => i), hovertext: texts, hoverinfo: "text",
      marker: { color: chosen.map((is) => colour(is ? "after" : "rule")), opacity: 0.45 },
    }),
    histogram: ({ edges, heights, name, places }) => ({
      type: "bar", name, customdata: places, x: heights.map((_, i) => (edges[i] + edges[i + 1]) / 2), y: heights, marker: { color: colour("soft") },
      width: heights.map((_, i) => edges[i + 1] - edges[i]), opacity: 0.6,
    }),
    matrix: ({ names: of, values }) => ({
      type: "heatmap", x: of, y: of, z: values, zmin: -1, zmax: 1, xgap: 1, ygap: 1,
      colorscale: [[0, colour("before")], [0.5, colour("card")], [1, colour("after")]],
      texttemplate: of.length <= 14 ? "%{z:.2f}" : undefined, // black or white, whichever is read on the cell
      hovertemplate: "%{y} – %{x}: %{z:.2f}<extra></extra>",
      colorbar: { title: { text: "correlation" }, tickvals: [-1, 0, 1], thickness: 12 },
    }),
    map: ({ x, y, values, reasons, names, title }) => {
      const known = new Set(reasons.flat());
      return [
        { type: "heatmap", x, y, z: values, colorscale: theme.scale("rising"), hoverongaps: false,
          hovertemplate: `%{x:.4~r}, %{y:.4~r}: %{z:.3~r}<extra>${title}</extra>`,
          colorbar: { title: { text: title, side: "right" }, thickness: 12 } },
        { type: "heatmap", x, y, z: reasons.map((row) => row.map((reason) => reason || null)), showscale: false, hoverongaps: false,
          zmin: 0.5, zmax: names.length - 0.5, text: reasons.map((row) => row.map((reason) => names[reason])),
          colorscale: REFUSED.slice(0, names.length - 1).flatMap((of, k, all) => [[k / all.length, of], [(k + 1) / all.length, of]]),
          hovertemplate: "%{x:.4~r}, %{y:.4~r}: %{text}<extra></extra>" },
        ...names.map((name, k) => ({ name, k })).filter(({ k }) => k && known.has(k)).map(({ name, k }) => ({
          type: "scatter", mode: "markers", x: [null], y: [null], name, showlegend: true, hoverinfo: "skip",
          marker: { symbol: "square", size: 11, color: REFUSED[k - 1] } })),
      ];
    },
    lines: ({ x, y, z, name, colour: of, width, dots }) => ({
      type: "scatter3d", x, y, z, name, mode: dots ? "markers" : "lines", hoverinfo: "skip", connectgaps: false,
      line: { color: colour(of), width }, marker: { color: colour(of), size: width },
    }),
  };

  // Where the chosen place is: on the first trace that has places.
  function chosen(plot) {
    const trace = plot.traces.find(({ type, places }) => places && type !== "histogram");
    const index = trace && selection.place !== null ? trace.places.findLastIndex((place) => place <= selection.place) : -1;
    return index < 0 ? null : { x: trace.x[index], y: trace.y[index], z: trace.z?.[index] };
  }
  const stepping = (plot) => {
    const last = Math.max(...plot.traces.flatMap(({ places }) => places ?? []));
    return (by) => selection.choose(Math.min(Math.max((selection.chosen ?? 0) + by, 0), last));
  };

  // Points of the plot are places: pointing at one and a click show it in all views, keys step.
  function link(element, plot) {
    const step = stepping(plot);
    element.on("plotly_hover", ({ points: [{ customdata }] }) => { if (typeof customdata === "number") selection.point(customdata); });
    element.on("plotly_unhover", () => selection.point(null));
    element.on("plotly_click", ({ points: [{ customdata }] }) => { if (typeof customdata === "number") selection.choose(customdata); });
    element.addEventListener("pointerdown", () => element.focus({ preventScroll: true }), true); // the library would prevent it
    element.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -1, ArrowRight: 1, PageUp: -50, PageDown: 50 }[event.key];
      if (!by) return;
      event.preventDefault();
      step(by * (event.shiftKey ? 10 : 1));
    });
    if (plot.traces.some(({ type, places }) => places && type !== "histogram")) cursor.follow(element, () => chosen(plot)?.x ?? null);
  }

  // Smallest and largest value of a plot on x or y.
  function reach(plot, name) {
    if (plot[name].range) return plot[name].range;
    const values = plot.traces.flatMap((trace) => (name === "x" ? trace.edges ?? trace.lengths ?? trace.x : trace.y ?? trace.high) ?? []);
    const known = values.filter((value) => value !== null && (value > 0 || !plot[name].logarithmic));
    return [Math.min(...known), Math.max(...known)];
  }
  // Decades, or 1, 2 and 5 of each where there are few.
  function decades([low, high]) {
    const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    const steps = Math.log10(high / low) < 1.6 ? [1, 2, 5] : [1];
    return Array.from({ length: last - first + 1 }, (_, k) => first + k).flatMap((power) => steps.map((step) => Number(`${step}e${power}`)));
  }

  function axis(plot, name, square) {
    const { title, logarithmic, range, categories } = plot[name];
    const ticks = categories ? { tickvals: categories.map((_, i) => i), ticktext: categories, range: [categories.length - 0.5, -0.5] }
      : logarithmic ? { tickvals: decades(reach(plot, name)), ticktext: decades(reach(plot, name)).map(String), range: range?.map(Math.log10) }
        : { range: range ?? undefined };
    return theme.axis({ title: { text: title }, type: categories || square ? undefined : logarithmic ? "log" : "linear", ...ticks });
  }

  // Where a place on x is in the width of a plot, 0 … 1.
  function share(plot, at) {
    const [low, high] = reach(plot, "x");
    return plot.x.logarithmic ? Math.log(at / low) / Math.log(high / low) : (at - low) / (high - low);
  }

  const [LINE, PAGE] = [15, 900]; // pixels
  const NARROW = 14; // pixels for a letter of a name left of a plot
  function figure(plot, width) {
    const square = plot.traces.some(({ type }) => type === "matrix");
    const layout = theme.layout({ height: theme.printing ? Math.min(plot.height, PAGE) : plot.height, showlegend: plot.traces.filter(({ name }) => name).length > 1 || plot.traces.some(({ type }) => type === "map") });
    const upright = plot.marks.filter(({ level }) => !level); // their texts are above the plot, the legend above them
    const titles = plot.traces.flatMap(({ name, names, type }) => (type === "map" ? names.slice(1) : name ? [name] : []));
    const wide = titles.reduce((sum, name) => sum + 7 * name.length + 45, 0);
    layout.margin.t = LINE * (upright.length + layout.showlegend * 1.3 * Math.ceil(wide / width)) + 12;
    layout.legend = { orientation: "h", yref: "container", y: 1, yanchor: "top", x: 0 };
    layout.hovermode = "closest";
    const data = plot.traces.flatMap((trace) => traced[trace.type](trace));
    layout.xaxis = axis(plot, "x", square);
    layout.yaxis = axis(plot, "y", square);
    if (square) {
      const names = plot.traces[0].names;
      const each = Math.ceil((1.3 * LINE * names.length) / Math.max(width - 150, 100)); // names that have room
      layout.yaxis.autorange = "reversed";
      Object.assign(layout.xaxis, { tickangle: -90, tickvals: names.filter((_, k) => k % each === 0) });
    }
    const along = (mark) => (mark.level
      ? { x0: 0, x1: 1, xref: "paper", y0: mark.at, y1: mark.at, yref: "y" }
      : { x0: mark.at, x1: mark.at, xref: "x", y0: 0, y1: 1, yref: "paper" });
    layout.shapes = plot.marks.map((mark) => ({
      type: "line", ...along(mark), line: { color: colour(mark.colour), width: 1.5, dash: "dash" },
    }));
    layout.annotations = plot.marks.map((mark) => {
      const log = (mark.level ? plot.y : plot.x).logarithmic;
      const at = log ? Math.log10(mark.at) : mark.at;
      return {
        text: mark.text, showarrow: false, font: { color: colour(mark.colour) },
        ...(mark.level ? { x: 1, xref: "paper", xanchor: "right", y: at, yanchor: "bottom" }
          : { x: at, xanchor: share(plot, mark.at) < 0.3 ? "left" : share(plot, mark.at) > 0.7 ? "right" : "center",
            y: 1, yref: "paper", yanchor: "bottom", yshift: LINE * upright.indexOf(mark) }),
      };
    });
    if (plot.traces[0].type === "bars") label(plot, layout, width);
    return [data, layout];
  }

  // Texts of lying bars begin where the bars do; in a narrow plot with the name of each before them.
  function label({ y: { categories }, traces: [{ texts }] }, layout, width) {
    const narrow = width < NARROW * Math.max(...categories.map((name) => name.length));
    const letters = Math.floor(width / 8);
    const lines = Math.ceil(Math.max(...categories.map((name) => name.length)) / (letters - 12)) + 1;
    if (narrow) Object.assign(layout, { height: LINE * (lines + 1) * texts.length + 80, yaxis: { ...layout.yaxis, showticklabels: false } });
    layout.annotations.push(...texts.map((text, i) => ({
      text: narrow ? `${categories[i].replace(RegExp(`(.{1,${letters}})(\\s|$)`, "g"), "$1<br>")}${text}` : text, showarrow: false, font: { color: colour("ink"), size: narrow ? 11 : 12 },
      x: 0, xref: "paper", xanchor: "left", xshift: 4, y: i, yanchor: "middle", align: "left",
    })));
  }

  // Lines in space; the chosen place is marked on the first of those that have places. A slider shows some of many.
  function inSpace(element, plot) {
    const linked = plot.traces.filter(({ places }) => places);
    const step = linked.length ? stepping(plot) : null;
    const all = plot.traces.map((_, i) => i);
    let shown = plot.steps?.[0] ?? all;
    Object.assign(element.style, { height: "", maxHeight: `${plot.height}px` });
    const view = space.add(element, {
      unit: plot.unit, room: () => plot.traces,
      traces: () => plot.traces.map((trace, i) => ({ ...traced.lines(trace), visible: shown.includes(i) })),
      marks() {
        const at = chosen(plot);
        return at ? [{ dot: [at.x, at.y, at.z], colour: colour("chosen"), size: 5 }] : [];
      },
      points: linked.length ? () => ({ ...linked.at(-1), place: linked.at(-1).places, joined: true }) : null,
      keys: step ? { n: () => step(1), p: () => step(-1) } : {},
    });
    const controls = Object.assign(document.createElement("div"), { className: "controls" });
    const names = () => {
      const named = new Map(shown.map((i) => plot.traces[i]).filter(({ name }) => name).map(({ name, colour: of }) => [name, of]));
      return named.size > 1 || plot.steps ? [...named].map(([name, of]) => `<span style="color:var(--${of})">━ ${name}</span>`).join("") : "";
    };
    const legend = Object.assign(document.createElement("span"), { className: "names", innerHTML: names() });
    controls.append(legend);
    if (plot.steps) {
      const slider = document.createElement("label");
      slider.innerHTML = `Shown <input type="range" min="0" max="${plot.steps.length - 1}" value="0"> <output>${plot.step_names[0]}</output>`;
      slider.firstElementChild.addEventListener("input", ({ target: { value } }) => {
        shown = plot.steps[value];
        slider.lastElementChild.textContent = plot.step_names[value];
        legend.innerHTML = names();
        view.draw();
      });
      controls.prepend(slider);
    }
    if (controls.textContent) element.before(controls);
  }

  for (const element of document.querySelectorAll(".plot")) {
    const plot = JSON.parse(element.nextElementSibling.textContent);
    if (plot.traces.some(({ type }) => type === "lines")) { inSpace(element, plot); continue; }
    const draw = () => {
      const [data, layout] = figure(plot, theme.width(element));
      element.style.height = `${layout.height}px`;
      return Plotly.react(element, data, layout, theme.config);
    };
    stage.add(element, () => draw().then(() => {
      theme.onChange(draw);
      if (plot.traces.some(({ places }) => places)) link(element, plot);
    }));
  }
})();
