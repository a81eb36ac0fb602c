"use strict";
// Strips along the path. Of many places each column of pixels shows its smallest and largest value: no peak is lost.
(() => {
  const view = document.getElementById("along-view");
  if (!view) return;
  const { at, count, values } = places;
  const COLUMNS = 500;
  const ROUNDING = 1e-4; // mm, of the numbers in the text: a deviation below it is noise
  const three = (prefix, names) => names.map((name, k) => ({ column: prefix + name, name, colour: ["before", "after", "force"][k] }));
  const one = (column, colour) => [{ column, name: "", colour }];
  const strips = {
    before: { title: `${values.before.title}, mm`, series: one("before", "before"), on: true, zero: true },
    ...(facts.worst.after !== undefined && { after: { title: "Deviation after, at targets, mm (own scale)", series: one("after", "after"),
      on: at.after[facts.worst.after] >= ROUNDING, zero: true } }),
    ...(facts.bounded && { u95: { title: "Expected on the part (95 %), mm", series: one("u95", "ink"), on: true, zero: true } }),
    feed: { title: "Deviation, mm", label: "along, across, normal", series: three("b_", ["along", "across", "normal"]), on: true },
    xyz: { title: "Deviation, mm", label: "X, Y, Z", series: three("b", ["X", "Y", "Z"]), on: false },
    force: { title: "Force, N", series: one("force", "force"), on: true, zero: true },
    ...(places.compared && { correction: { title: "Correction, mm", series: one("correction", "correction"), on: true, zero: true } }),
    margin: { title: "Smallest joint margin, °", series: one("margin", "ink"), on: false },
    singular: { title: "Smallest singular value, m/rad", series: one("singular", "ink"), on: false },
    speed: { title: "Speed, mm/s", series: one("speed", "ink"), on: false, zero: true },
  };
  let over = "length"; // or "time"
  let range = null; // of x, or null for all

  // The first place at or after x.
  function search(x) {
    const along = at[over];
    let [low, high] = [0, count];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (along[middle] < x) low = middle + 1; else high = middle;
    }
    return low;
  }

  // x, y and place of a column, thinned to the columns of pixels in sight; gaps at rapid moves.
  function line(column) {
    const y = at[column];
    const along = at[over];
    const first = range ? Math.max(search(range[0]) - 1, 0) : 0;
    const last = range ? Math.min(search(range[1]) + 1, count) : count;
    const size = Math.max(Math.ceil((last - first) / COLUMNS), 1);
    const out = { x: [], y: [], customdata: [] };
    const push = (i) => {
      out.x.push(along[i]);
      out.y.push(at.rapid[i] || !Number.isFinite(y[i]) ? null : y[i]);
      out.customdata.push(i);
    };
    for (let begin = first; begin < last; begin += size) {
      const end = Math.min(begin + size, last);
      if (size === 1) { push(begin); continue; }
      let [low, high, gap] = [-1, -1, -1];
      for (let i = begin; i < end; i++) {
        if (at.rapid[i] || !Number.isFinite(y[i])) { gap = i; continue; }
        if (low < 0 || y[i] < y[low]) low = i;
        if (high < 0 || y[i] > y[high]) high = i;
      }
      for (const i of [...new Set([low, high, gap])].filter((i) => i >= 0).sort((a, b) => a - b)) push(i);
    }
    return out;
  }

  const on = () => Object.values(strips).filter((strip) => strip.on);
  const tall = () => 120 * on().length + 60;
  function figure() {
    const shownStrips = on();
    const height = tall();
    const layout = theme.layout({ height, hovermode: "x", hoverdistance: -1, dragmode: "zoom", annotations: [],
      margin: { l: 60, r: 12, t: 6, b: 40 } });
    const gap = 26 / height;
    const data = [];
    shownStrips.forEach((strip, k) => {
      const suffix = k ? String(k + 1) : "";
      const top = 1 - (k * (1 + gap)) / shownStrips.length;
      layout[`yaxis${suffix}`] = theme.axis({ domain: [Math.max(top - 1 / shownStrips.length + gap, 0), top - gap], fixedrange: true, automargin: false,
        rangemode: strip.zero ? "tozero" : "normal", nticks: 4 });
      const named = strip.series.filter(({ name }) => name)
        .map(({ name, colour }) => `<span style="color:${theme.colour(colour)}">${name}</span>`).join(" · ");
      layout.annotations.push({ text: `<b>${strip.title}</b>${named ? ` ${named}` : ""}`, showarrow: false, xref: "paper", x: 0, yref: "paper",
        y: top - gap, xanchor: "left", yanchor: "bottom", font: { color: theme.colour("ink") } });
      strip.series.forEach(({ column, name, colour }, s) => data.push({ type: "scatter", mode: "lines", ...line(column), connectgaps: false,
        yaxis: `y${suffix}`, name: name || strip.title, hoverinfo: "none",
        line: { color: theme.colour(colour), width: 1.3, dash: ["solid", "dash", "dot"][s] } }));
    });
    layout.shapes = facts.reversals.map(([place]) => ({ type: "line", xref: "x", yref: "paper", y0: 0, y1: 1, x0: at[over][place], x1: at[over][place],
      line: { color: theme.colour("soft"), width: 1, dash: "dot" } })); // a joint changes the direction of its torque
    layout.xaxis = theme.axis({ title: { text: over === "length" ? "length of the path, mm" : "time, s" }, range: range ?? undefined, automargin: false,
      anchor: shownStrips.length > 1 ? `y${shownStrips.length}` : "y" });
    return [data, layout];
  }
  const draw = () => {
    view.style.minHeight = `${tall()}px`;
    return Plotly.react(view, ...figure(), theme.config);
  };

  const controls = document.getElementById("along-controls");
  controls.innerHTML = `<label>Over <select id="along-over"><option value="length">length</option><option value="time">time</option></select></label>
    <span role="group" aria-label="Curves along the path"><span>Show</span>${Object.entries(strips).map(([name, { title, label, on: ticked }]) =>
      `<label><input type="checkbox" data-strip="${name}"${ticked ? " checked" : ""}>${label ?? title.split(",")[0]}</label>`).join("")}</span>`;
  document.getElementById("along-over").addEventListener("change", (event) => {
    over = event.target.value;
    range = null;
    draw();
  });
  for (const box of controls.querySelectorAll("[data-strip]"))
    box.addEventListener("change", () => { strips[box.dataset.strip].on = box.checked; draw(); });

  view.addEventListener("pointerdown", () => view.focus({ preventScroll: true }), true); // the library would prevent it
  view.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1, PageUp: -50, PageDown: 50 }[event.key];
    if (!by) return;
    event.preventDefault();
    selection.choose(places.step(selection.chosen, by * (event.shiftKey ? 10 : 1)));
  });
  view.style.minHeight = `${tall()}px`; // reserves the room until it is drawn
  stage.add(view, () => draw().then(() => {
    cursor.follow(view, () => (selection.place === null ? null : at[over][selection.place]));
    view.on("plotly_hover", ({ points: [point] }) => selection.point(point.customdata));
    view.on("plotly_unhover", () => selection.point(null));
    view.on("plotly_click", ({ points: [point] }) => selection.choose(point.customdata));
    view.on("plotly_relayout", (change) => {
      if ("xaxis.range[0]" in change) range = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
      else if (change["xaxis.autorange"]) range = null;
      else return;
      draw();
    });
    theme.onChange(draw);
  }));
})();
