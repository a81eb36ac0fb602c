"use strict";
// The path in space: coloured by a value, with enlarged deviations, the part frame and the robot.
(() => {
  const view = document.getElementById("view3d-view");
  if (!view) return;
  const { at, values, number } = places;
  const drawn = columns.drawn;
  const points = drawn.x.length;
  const MOST = 12000;
  const dense = points > MOST; // overlays would hide the path
  const paths = {
    b: { title: places.compared ? "tool without correction" : "tool as it stands", colour: "before", dash: "solid" },
    ...(places.compared && { a: { title: "tool with the program as written", colour: "after", dash: "solid" } }),
    ...(places.compared && { c: { title: "commanded path", colour: "correction", dash: "dash" } }),
  };
  const extent = Math.max(...["x", "y", "z"].map((axis) => {
    let [low, high] = [Infinity, -Infinity];
    for (const value of drawn[axis]) { if (value < low) low = value; if (value > high) high = value; }
    return high - low;
  }), 1e-6);
  const round = (value) => {
    const power = 10 ** Math.floor(Math.log10(value));
    return [1, 2, 5, 10].map((step) => step * power).reduce((a, b) => (Math.abs(b - value) < Math.abs(a - value) ? b : a));
  };
  const largest = Math.max(at.before[facts.worst.before], 1e-9);
  const shown = { colour: "before", enlarged: Math.min(Math.max(round((0.06 * extent) / largest), 1), 10000),
    paths: { b: !dense, a: false, c: places.compared && !dense }, robot: false };

  // The points that are drawn: all of a few thousands; of more, from each bit of the path its first and its last, the
  // worst, so that no peak of the value shown is lost, and the one farthest from the line between them, where it turns.
  function kept() {
    if (!dense) return Array.from({ length: points }, (_, k) => k);
    const size = Math.ceil((4 * points) / MOST);
    const column = at[shown.colour];
    const worse = values[shown.colour].low ? (a, b) => a < b : (a, b) => a > b;
    const out = [];
    for (let begin = 0; begin < points; ) {
      const rapid = at.rapid[drawn.place[begin]];
      let [worst, end] = [begin, begin];
      for (; end < points && end - begin < size && at.rapid[drawn.place[end]] === rapid; end++)
        if (worse(column[drawn.place[end]], column[drawn.place[worst]])) worst = end;
      out.push(...[...new Set([begin, worst, farthest(begin, end - 1), end - 1])].sort((a, b) => a - b));
      begin = end;
    }
    return out;
  }

  function farthest(first, last) {
    const at = (k) => [drawn.x[k], drawn.y[k], drawn.z[k]];
    const [begin, end] = [at(first), at(last)];
    const along = end.map((value, r) => value - begin[r]);
    const whole = along.reduce((sum, value) => sum + value * value, 0) || 1;
    let [best, most] = [first, 0];
    for (let k = first + 1; k < last; k++) {
      const way = at(k).map((value, r) => value - begin[r]);
      const share = Math.min(Math.max(way.reduce((sum, value, r) => sum + value * along[r], 0) / whole, 0), 1);
      const off = way.reduce((sum, value, r) => sum + (value - share * along[r]) ** 2, 0);
      if (off > most) [best, most] = [k, off];
    }
    return best;
  }

  // Pieces that cut and rapid ones, each a line with gaps, and the place that each of its points leads to.
  let keep = kept();
  let runs = cut();
  function cut() {
    const line = () => ({ x: [], y: [], z: [], place: [] });
    const out = { cut: line(), rapid: line() };
    let [last, before] = [null, null];
    const push = (to, k, place) => {
      to.x.push(k === null ? null : drawn.x[k]);
      to.y.push(k === null ? null : drawn.y[k]);
      to.z.push(k === null ? null : drawn.z[k]);
      to.place.push(place);
    };
    for (const k of keep) {
      const place = drawn.place[k];
      const to = at.rapid[place] ? out.rapid : out.cut;
      if (to !== last) {
        if (to.x.length) push(to, null, place);
        if (before !== null) push(to, before, place);
        last = to;
      }
      push(to, k, place);
      before = k;
    }
    return out;
  }

  // Values at the gaps do not count.
  function coloured() {
    const column = at[shown.colour];
    let [low, high] = [Infinity, -Infinity];
    for (const place of runs.cut.place) {
      const value = column[place];
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (!values[shown.colour].low) low = Math.min(low, 0);
    return { color: runs.cut.place.map((place) => column[place]), cmin: low, cmax: high > low ? high : low + 1e-9 };
  }

  // The path with deviations enlarged; between two places of an arc they change in proportion.
  function displaced(prefix) {
    const line = { x: [], y: [], z: [] };
    const push = (p) => ["x", "y", "z"].forEach((axis, r) => line[axis].push(p ? p[r] : null));
    for (const k of keep) {
      const place = drawn.place[k];
      if (at.rapid[place]) { push(null); continue; }
      let [first, end] = [k, k];
      while (first > 0 && drawn.place[first - 1] === place) first--;
      while (end + 1 < points && drawn.place[end + 1] === place) end++;
      const share = end === first ? 1 : (k - first + 1) / (end - first + 1);
      const to = places.vector(prefix, place);
      const from = place > 0 && share < 1 ? places.vector(prefix, place - 1) : to;
      push([drawn.x[k], drawn.y[k], drawn.z[k]].map((value, r) =>
        value + shown.enlarged * ((1 - share) * from[r] + share * to[r])));
    }
    return line;
  }

  const axes = (m, length) => {
    const line = { x: [], y: [], z: [] };
    for (let axis = 0; axis < 3; axis++)
      for (const reach of [0, length, null])
        ["x", "y", "z"].forEach((name, r) => line[name].push(reach === null ? null : m[r][3] + reach * m[r][axis]));
    return line;
  };
  const frame = places.inRoot ? places.bases[0] : [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];

  // The traces in a fixed order, so that single ones can be changed.
  const CHOSEN = 1 + 1 + Object.keys(paths).length + 1;
  function traces() {
    const { title, unit } = values[shown.colour];
    const colour = theme.colour;
    const lines = { type: "scatter3d", mode: "lines", hoverinfo: "skip", connectgaps: false };
    const out = [
      { ...lines, ...runs.cut, hoverinfo: "none",
        line: { width: 5, colorscale: "Cividis", showscale: true, ...coloured(),
          colorbar: { title: { text: `${title}, ${unit}`, side: "right" }, thickness: 12, len: 0.8, exponentformat: "none",
            tickfont: { color: colour("soft") }, outlinewidth: 0 } } },
      { ...lines, ...runs.rapid, line: { width: 1, color: colour("soft") } },
    ];
    for (const [prefix, path] of Object.entries(paths))
      out.push({ ...lines, ...(shown.paths[prefix] ? displaced(prefix) : { x: [null], y: [null], z: [null] }),
        hoverinfo: "none", visible: shown.paths[prefix], line: { width: 2, color: colour(path.colour), dash: path.dash } });
    const worst = Object.entries(facts.worst).filter(([, place]) => place !== null);
    const where = worst.map(([, place]) => places.position(place));
    out.push({ type: "scatter3d", mode: "markers", hoverinfo: "text", x: where.map((p) => p[0]), y: where.map((p) => p[1]),
      z: where.map((p) => p[2]), text: worst.map(([name]) => `worst ${name}`),
      marker: { size: 6, symbol: "diamond-open", color: colour("before") } });
    out.push(marker(), arm());
    for (const { m, length } of frames()) out.push({ ...lines, ...axes(m, length), line: { width: 4, color: colour("ink") } });
    return out;
  }
  const frames = () => [{ m: frame, length: 0.12 * extent, name: "$BASE" },
    ...(shown.robot ? [{ m: robot.root, length: 300, name: "robot" }] : [])];
  const names = () => frames().flatMap(({ m, length, name }) => ["X", "Y", "Z"].map((axis, c) => ({
    x: m[0][3] + length * m[0][c], y: m[1][3] + length * m[1][c], z: m[2][3] + length * m[2][c],
    text: `${axis} ${name}`, showarrow: false, font: { color: theme.colour("ink"), size: 11 } })));
  function marker() {
    const p = selection.place === null ? [null, null, null] : places.position(selection.place);
    return { type: "scatter3d", mode: "markers", hoverinfo: "skip", x: [p[0]], y: [p[1]], z: [p[2]],
      marker: { size: 8, color: theme.colour("chosen"), symbol: "circle" } };
  }
  function arm() {
    const on = shown.robot && selection.place !== null;
    const line = on ? robot.points(selection.place) : [[null, null, null]];
    return { type: "scatter3d", mode: "lines+markers", hoverinfo: "skip", visible: shown.robot,
      x: line.map((p) => p[0]), y: line.map((p) => p[1]), z: line.map((p) => p[2]),
      line: { width: 8, color: theme.colour("soft") }, marker: { size: 4, color: theme.colour("ink") } };
  }

  const eye = { x: -1.1, y: -1.5, z: 1.1 };
  const camera = { eye: { ...eye }, up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 } };
  function layout() {
    const axis = (title) => theme.axis({ title: { text: title }, backgroundcolor: "rgba(0,0,0,0)", showspikes: false,
      color: theme.colour("soft"), automargin: undefined });
    const of = places.inRoot ? "root" : "$BASE";
    return theme.layout({ margin: { l: 0, r: 0, t: 0, b: 0 }, hovermode: "closest", uirevision: 1,
      scene: { aspectmode: "data", camera, xaxis: axis(`X ${of}, mm`), yaxis: axis(`Y ${of}, mm`), zaxis: axis(`Z ${of}, mm`),
        dragmode: "turntable", uirevision: 1, annotations: names() } });
  }
  function draw() {
    const drawn = Plotly.react(view, traces(), layout(), theme.config);
    space.photograph(view);
    return drawn;
  }

  space.hear(view, {
    n: () => selection.choose(places.step(selection.chosen, 1)),
    p: () => selection.choose(places.step(selection.chosen, -1)),
    w: () => selection.choose(facts.worst.before),
  });

  // Controls.
  const controls = document.getElementById("view3d-controls");
  const sides = { Oblique: eye, Top: { x: 0, y: -0.01, z: 2.2 }, Front: { x: 0, y: -2.2, z: 0 }, Right: { x: 2.2, y: 0, z: 0 } };
  const tick = (prefix) => `<label><input type="checkbox" data-path="${prefix}"${shown.paths[prefix] ? " checked" : ""}>
    <span style="color:var(--${paths[prefix].colour})">${paths[prefix].title}</span></label>`;
  controls.innerHTML = `
    <label>Colour <select id="view3d-colour">${Object.entries(values).map(([name, { title }]) =>
      `<option value="${name}">${title}</option>`).join("")}</select></label>
    <fieldset><legend>Enlarged</legend>${Object.keys(paths).map(tick).join("")}</fieldset>
    <label>by <input type="range" id="view3d-enlarged" min="0" max="4" step="0.05" value="${Math.log10(shown.enlarged)}">
      <output id="view3d-factor">${shown.enlarged} ×</output></label>
    <label><input type="checkbox" id="view3d-robot"> robot</label>
    <fieldset><legend>View</legend>${Object.keys(sides).map((name) => `<button type="button">${name}</button>`).join("")}</fieldset>`;
  document.getElementById("view3d-colour").addEventListener("change", (event) => {
    shown.colour = event.target.value;
    keep = kept();
    runs = cut();
    draw();
  });
  for (const box of controls.querySelectorAll("[data-path]"))
    box.addEventListener("change", () => { shown.paths[box.dataset.path] = box.checked; draw(); });
  document.getElementById("view3d-enlarged").addEventListener("input", (event) => {
    shown.enlarged = Number((10 ** Number(event.target.value)).toPrecision(2));
    document.getElementById("view3d-factor").textContent = `${shown.enlarged} ×`;
    draw();
  });
  document.getElementById("view3d-robot").addEventListener("change", (event) => {
    shown.robot = event.target.checked;
    draw();
  });
  for (const button of controls.querySelectorAll("button"))
    button.addEventListener("click", () => space.look(view, { to: sides[button.textContent] }));

  view.style.height = "min(70vh, 640px)";
  stage.add(view, () => draw().then(() => {
      view.on("plotly_hover", ({ points: [{ curveNumber, pointNumber }] }) => {
        const overlay = curveNumber >= 2 && curveNumber < CHOSEN - 1;
        if (curveNumber !== 0 && !overlay) return;
        under = overlay ? drawn.place[keep[pointNumber]] : runs.cut.place[pointNumber];
        selection.point(under);
      });
      view.on("plotly_unhover", () => {
        under = null;
        selection.point(null);
      });
      view.on("plotly_relayout", () => space.photograph(view));
      theme.onChange(draw);
      ready = true;
    }).catch(({ message }) => {
      view.textContent = `This browser cannot draw in three dimensions (${message}). The plots below show the same numbers.`;
    }));

  let under = null;
  space.clicked(view, () => { if (under !== null) selection.choose(under); });

  let ready = false;
  let asked = false;
  selection.subscribe(() => {
    if (asked || !ready) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      const [dot, line] = [marker(), arm()];
      const of = (key) => [dot[key], line[key]];
      Plotly.restyle(view, { x: of("x"), y: of("y"), z: of("z") }, [CHOSEN, CHOSEN + 1]);
    });
  });
})();
