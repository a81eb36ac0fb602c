"use strict";
// The path in space: coloured by a value, with enlarged deviations, the part frame and the robot.
(() => {
  const view = document.getElementById("view3d-view");
  if (!view) return;
  const { at, values } = places;
  const drawn = columns.drawn;
  const points = drawn.x.length;
  const MOST = 8000;
  const dense = points > MOST; // overlays would hide the path
  const paths = {
    b: { title: places.compared ? "tool without correction" : "tool as programmed", colour: "before" },
    ...(places.compared && { a: { title: "tool with the program as written", colour: "after" } }),
    ...(places.compared && { c: { title: "commanded path", colour: "correction" } }),
  };
  // The view frames what is cut; of rapid moves only what is near it is drawn.
  const cuts = (() => {
    const keep = Array.from(drawn.place, (place) => !at.rapid[place]);
    const of = (axis) => drawn[axis].filter((_, k) => keep[k]);
    return keep.includes(true) ? { x: of("x"), y: of("y"), z: of("z") } : drawn;
  })();
  const [low, high] = space.reach([cuts]);
  const extent = Math.max(...high.map((value, r) => value - low[r]), 1e-6);
  const largest = Math.max(at.before[facts.worst.before], 1e-9);
  const shown = { colour: "before", enlarged: Math.min(Math.max(space.round((0.06 * extent) / largest), 1), 10000),
    paths: { b: !dense, a: false, c: places.compared && !dense }, robot: false };

  // The points that are drawn: all of a few thousands; of more, from each bit of the path its first and its last, the
  // worst, so that no peak of the value shown is lost, and the one farthest from the line between them, where it turns.
  function kept() {
    if (!dense) return Array.from({ length: points }, (_, k) => k);
    const size = Math.ceil((4 * points) / MOST);
    const column = at[shown.colour];
    const sign = values[shown.colour].low ? -1 : 1;
    const out = [];
    for (let begin = 0; begin < points; ) {
      const rapid = at.rapid[drawn.place[begin]];
      let [worst, most, end] = [begin, -Infinity, begin];
      for (; end < points && end - begin < size && at.rapid[drawn.place[end]] === rapid; end++) {
        const value = sign * column[drawn.place[end]];
        if (value > most) [worst, most] = [end, value];
      }
      const turn = farthest(begin, end - 1);
      let last = -1;
      for (const k of [begin, Math.min(worst, turn), Math.max(worst, turn), end - 1]) if (k !== last) out.push(last = k);
      begin = end;
    }
    return out;
  }

  // Between two points of the path the one farthest from the line that joins them.
  function farthest(first, last) {
    const { x, y, z } = drawn;
    const [u, v, w] = [x[last] - x[first], y[last] - y[first], z[last] - z[first]];
    const whole = u * u + v * v + w * w || 1;
    let [best, most] = [first, 0];
    for (let k = first + 1; k < last; k++) {
      const a = x[k] - x[first];
      const b = y[k] - y[first];
      const c = z[k] - z[first];
      const share = Math.min(Math.max((a * u + b * v + c * w) / whole, 0), 1);
      const off = (a - share * u) ** 2 + (b - share * v) ** 2 + (c - share * w) ** 2;
      if (off > most) { best = k; most = off; }
    }
    return best;
  }

  // Pieces that cut and rapid ones, each a line with gaps, and the place that each of its points leads to.
  let keep = kept();
  let runs = cut();
  let range = ranged();
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
    return { cut: out.cut, rapid: near(out.rapid) };
  }

  // The parts of a line with gaps that are within the box of the cuts and a tenth of it around.
  function near(line) {
    const out = { x: [], y: [], z: [], place: [] };
    const axes = ["x", "y", "z"];
    const [from, to] = [low.map((value) => value - 0.1 * extent), high.map((value) => value + 0.1 * extent)];
    const push = (p, place) => { axes.forEach((axis, r) => out[axis].push(p ? p[r] : null)); out.place.push(place); };
    for (let k = 1; k < line.x.length; k++) {
      if (line.x[k] === null || line.x[k - 1] === null) continue;
      const [a, b] = [k - 1, k].map((i) => axes.map((axis) => line[axis][i]));
      let [first, last] = [0, 1];
      for (let r = 0; r < 3; r++) {
        const way = b[r] - a[r];
        if (way === 0) {
          if (a[r] < from[r] || a[r] > to[r]) last = -1;
          continue;
        }
        const [enter, leave] = [(from[r] - a[r]) / way, (to[r] - a[r]) / way].sort((one, other) => one - other);
        first = Math.max(first, enter);
        last = Math.min(last, leave);
      }
      if (first > last) continue;
      const point = (share) => a.map((value, r) => value + share * (b[r] - value));
      push(point(first), line.place[k]);
      push(point(last), line.place[k]);
      push(null, line.place[k]);
    }
    if (!out.x.length) push(null, 0);
    return out;
  }

  // Smallest and largest of what the colours show.
  function ranged() {
    const column = at[shown.colour];
    let [low, high] = [Infinity, -Infinity];
    for (const place of runs.cut.place) {
      const value = column[place];
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (!values[shown.colour].low) low = Math.min(low, 0);
    return [low, high > low ? high : low + 1e-9];
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

  const frame = places.inRoot ? places.bases[0] : [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];
  function traces() {
    const { colour } = theme;
    const column = at[shown.colour];
    const lines = { type: "scatter3d", mode: "lines", hoverinfo: "skip", connectgaps: false };
    const out = [
      { ...lines, ...runs.cut,
        line: { width: 5, colorscale: theme.scale("rising"), color: runs.cut.place.map((place) => column[place]), cmin: range[0], cmax: range[1] } },
      { ...lines, ...runs.rapid, line: { width: 1, color: colour("soft") } },
    ];
    for (const [prefix, path] of Object.entries(paths))
      out.push({ ...lines, ...(shown.paths[prefix] ? displaced(prefix) : { x: [null], y: [null], z: [null] }),
        visible: shown.paths[prefix], line: { width: 2, color: colour(path.colour) } });
    if (shown.robot)
      out.push({ type: "mesh3d", meta: "beyond", ...robot.vertices(here()), ...robot.faces, flatshading: facts.links.length + facts.bodies.length > 0, hoverinfo: "skip",
        lighting: { ambient: 0.55, diffuse: 0.6, specular: 0.15, roughness: 0.7 } });
    return out;
  }

  const here = () => selection.place ?? facts.worst.before;
  let [room, shape] = [null, -1];
  const beyond = () => (shown.robot ? [room ??= robot.room()] : []);

  // The frames, the worst places, the place itself; without the library the arm as lines.
  function frames() {
    const of = [{ m: frame, length: 0.12 * extent, name: "$BASE" }, ...(shown.robot ? [{ m: robot.root, length: 300, name: "robot" }] : [])];
    return of.flatMap(({ m, length, name }) => ["X", "Y", "Z"].flatMap((axis, c) => {
      const origin = m.map((row) => row[3]);
      const end = origin.map((value, r) => value + length * m[r][c]);
      return [{ line: [origin, end], colour: theme.colour("ink") }, { text: c ? axis : `${axis} ${name}`, at: end, by: [0, -4] }];
    }));
  }
  function marks() {
    const out = frames();
    if (shown.robot) {
      const box = space.reach([cuts]);
      for (let k = 0; k < 8; k++) for (let r = 0; r < 3; r++) if (!((k >> r) & 1)) {
        const corner = (n) => [0, 1, 2].map((axis) => box[(n >> axis) & 1][axis]);
        out.push({ line: [corner(k), corner(k | (1 << r))], colour: theme.colour("rule"), width: 1 });
      }
      if (!document.querySelector("#view3d-view .gl-container")) out.push({ line: robot.points(here()), colour: theme.colour("soft"), width: 6 });
    }
    for (const [name, place] of Object.entries(facts.worst))
      out.push({ dot: places.position(place), colour: theme.colour(name), size: 6, hollow: true });
    if (selection.place !== null) out.push({ dot: places.position(selection.place), colour: theme.colour("chosen"), size: 5 });
    return out;
  }

  const of = places.inRoot ? "root" : "$BASE";
  const { draw, look, move } = space.add(view, {
    unit: "mm", names: ["X", "Y", "Z"].map((axis) => `${axis} ${of}`), traces, beyond, marks,
    bar: () => ({ title: `${values[shown.colour].title}, ${values[shown.colour].unit}`, stops: theme.scales.rising, low: range[0], high: range[1] }),
    points: () => ({ ...runs.cut, joined: true }),
    keys: {
      n: () => selection.choose(places.step(selection.chosen, 1)),
      p: () => selection.choose(places.step(selection.chosen, -1)),
      w: () => selection.choose(facts.worst.before),
    },
  });

  // Controls.
  const controls = document.getElementById("view3d-controls");
  const sides = { Oblique: camera.OBLIQUE.eye, Top: { x: 0, y: -0.01, z: 2.2 }, Front: { x: 0, y: -2.2, z: 0 }, Right: { x: 2.2, y: 0, z: 0 }, Robot: null };
  const tick = (prefix) => `<label><input type="checkbox" data-path="${prefix}"${shown.paths[prefix] ? " checked" : ""}>
    <span style="color:var(--${paths[prefix].colour})">${paths[prefix].title}</span></label>`;
  controls.innerHTML = `
    <label>Colour <select id="view3d-colour">${Object.entries(values).map(([name, { title }]) =>
      `<option value="${name}">${title}</option>`).join("")}</select></label>
    <span role="group" aria-label="Paths that are drawn enlarged"><span>Enlarged</span>${Object.keys(paths).map(tick).join("")}</span>
    <label>by <input type="range" id="view3d-enlarged" min="0" max="4" step="0.05" value="${Math.log10(shown.enlarged)}">
      <output id="view3d-factor">${shown.enlarged} ×</output></label>
    <label><input type="checkbox" id="view3d-robot"> robot</label>
    <span role="group" aria-label="Simulation along the program"><button type="button" id="view3d-run" aria-label="Run along the program">▶</button>
      <input type="range" id="view3d-time" min="0" max="1" step="0.0005" value="0" aria-label="Time along the program">
      <output id="view3d-now"></output></span>
    <span role="group" aria-label="Where it is looked at from"><span>View</span>${Object.keys(sides).map((name) => `<button type="button">${name}</button>`).join("")}</span>`;
  document.getElementById("view3d-colour").addEventListener("change", (event) => {
    shown.colour = event.target.value;
    keep = kept();
    runs = cut();
    range = ranged();
    draw();
  });
  for (const box of controls.querySelectorAll("[data-path]"))
    box.addEventListener("change", () => { shown.paths[box.dataset.path] = box.checked; draw(); });
  document.getElementById("view3d-enlarged").addEventListener("input", (event) => {
    shown.enlarged = Number((10 ** Number(event.target.value)).toPrecision(2));
    document.getElementById("view3d-factor").textContent = `${shown.enlarged} ×`;
    draw();
  });
  const showRobot = (checked) => {
    document.getElementById("view3d-robot").checked = shown.robot = checked;
    draw();
  };
  document.getElementById("view3d-robot").addEventListener("change", (event) => showRobot(event.target.checked));
  // The whole robot in sight: the path is in the middle, and as small as that makes it.
  function lookAtRobot() {
    showRobot(true);
    const [from, to] = space.reach([room]);
    const far = Math.max((2.2 * Math.max(...to.map((value, r) => value - from[r]))) / extent, 1);
    look({ to: Object.fromEntries(Object.entries(camera.OBLIQUE.eye).map(([axis, value]) => [axis, value * far])) });
  }
  for (const button of controls.querySelectorAll("button"))
    if (button.textContent in sides)
      button.addEventListener("click", () => { if (button.textContent === "Robot") lookAtRobot(); else look({ to: sides[button.textContent] }); });

  // Along the program, like a simulation: the whole of it in half a minute, or in its own time if that is shorter.
  const slider = document.getElementById("view3d-time");
  const run = document.getElementById("view3d-run");
  const last = at.time.at(-1) || 1;
  const LONGEST = 30; // s
  let running = null;
  function placeAt(seconds) {
    let [low, high] = [0, at.time.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (at.time[middle] < seconds) low = middle + 1; else high = middle;
    }
    return low;
  }
  const stop = () => {
    cancelAnimationFrame(running);
    running = null;
    run.textContent = "▶";
  };
  function start() {
    const speed = Math.max(last / LONGEST, 1);
    const from = selection.chosen === null || at.time[selection.chosen] >= last ? 0 : at.time[selection.chosen];
    const began = performance.now();
    run.textContent = "❚❚";
    const frame = (now) => {
      const seconds = from + ((now - began) / 1000) * speed;
      selection.choose(placeAt(Math.min(seconds, last)));
      if (seconds >= last) stop(); else running = requestAnimationFrame(frame);
    };
    running = requestAnimationFrame(frame);
  }
  run.addEventListener("click", () => { if (running === null) start(); else stop(); });
  slider.addEventListener("input", () => {
    if (running !== null) stop();
    selection.choose(placeAt(slider.value * last));
  });
  let asked = false;
  selection.subscribe((place) => {
    if (place === null) return;
    slider.value = at.time[place] / last;
    document.getElementById("view3d-now").textContent = `${fixed(at.time[place], 1)} s, line ${at.source_line[place]}`;
    if (!shown.robot || asked || place === shape) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      shape = here();
      move(2 + Object.keys(paths).length, robot.vertices(shape));
    });
  });
})();
