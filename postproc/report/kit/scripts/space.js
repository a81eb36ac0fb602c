"use strict";
// Views in space. The library draws lines and surfaces; marks, names and numbers are drawn over them, and what is under
// the pointer is found here: both are exact at once, where the library would have to draw its picture anew.
const space = (() => {
  const NEAR = 10; // pixels from what is pointed at
  const OBLIQUE = { eye: { x: -1.42, y: -1.9, z: 1.4 }, up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: -0.12 } };
  const LINES = 6; // of the box around, along its longest side

  // The library makes the texts of its own from pictures that it reads back: those are kept by the processor.
  const context = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function get(kind, options) {
    return context.call(this, kind, kind === "2d" ? { ...options, willReadFrequently: true } : options);
  };

  // Turning by degrees about the upright axis and in height, and coming nearer by a factor.
  function look(view, { turn = 0, rise = 0, nearer = 1, to = null }) {
    const { camera } = view._fullLayout.scene;
    const { x, y, z } = to ?? camera.eye;
    const radius = Math.hypot(x, y, z) / nearer;
    const azimuth = Math.atan2(y, x) + (turn * Math.PI) / 180;
    const height = Math.min(Math.max(Math.atan2(z, Math.hypot(x, y)) + (rise * Math.PI) / 180, -1.55), 1.55);
    const eye = { x: radius * Math.cos(height) * Math.cos(azimuth), y: radius * Math.cos(height) * Math.sin(azimuth),
      z: radius * Math.sin(height) };
    return Plotly.relayout(view, { "scene.camera": { ...camera, eye } });
  }
  const turning = {
    ArrowLeft: { turn: -10 }, ArrowRight: { turn: 10 }, ArrowUp: { rise: 10 }, ArrowDown: { rise: -10 },
    "+": { nearer: 1.2 }, "-": { nearer: 1 / 1.2 },
  };

  // Has keys turn a view; `others` are what further keys do.
  function hear(view, others) {
    view.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const other = others[event.key.toLowerCase()];
      if (!turning[event.key] && !other) return;
      event.preventDefault();
      if (other) other(); else look(view, turning[event.key]);
    });
  }

  const times = (a, b) => Array.from({ length: 16 }, (_, k) => [0, 1, 2, 3].reduce((sum, j) => sum + a[4 * j + (k % 4)] * b[4 * (k >> 2) + j], 0));

  // How the picture shows points: the matrix to the screen, its size, the corners of the box around; null if not drawn.
  function seen(view) {
    const scene = view._fullLayout?.scene?._scene;
    if (!scene?.glplot?.cameraParams?.view) return null;
    const { cameraParams: { projection, view: eye, model }, bounds } = scene.glplot;
    const { dataScale, container } = scene;
    const m = times(projection, times(eye, model)).map((value, k) => value * (k < 12 ? dataScale[k >> 2] : 1));
    return { m, width: container.clientWidth, height: container.clientHeight,
      box: bounds.map((corner) => Array.from(corner, (value, r) => value / dataScale[r])) };
  }
  // Where a point is seen, in pixels, and how deep.
  function projected({ m, width, height }, x, y, z) {
    const w = m[3] * x + m[7] * y + m[11] * z + m[15];
    return [((m[0] * x + m[4] * y + m[8] * z + m[12]) / w + 1) * 0.5 * width,
      (1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / w) * 0.5 * height, w];
  }

  // Which of points {x, y, z} is under the pointer; `joined`: a line, of which pieces are pointed at, else loose points.
  // Of those that are equally near it is the foremost.
  function under(how, { x, y, z, joined }, across, down) {
    let [best, off, deep] = [null, Infinity, Infinity];
    let [a, b] = [NaN, NaN];
    for (let k = 0; k < x.length; k++) {
      const [c, d, w] = projected(how, x[k], y[k], z[k]);
      let at = k;
      let distance = Math.hypot(c - across, d - down);
      if (joined && Number.isFinite(a) && Number.isFinite(c)) {
        const [u, v] = [c - a, d - b];
        const share = Math.min(Math.max(((across - a) * u + (down - b) * v) / (u * u + v * v || 1), 0), 1);
        distance = Math.hypot(a + share * u - across, b + share * v - down);
        if (share < 0.5) at = k - 1;
      }
      [a, b] = [c, d];
      if (!(distance < NEAR) || !(w > 0)) continue;
      const step = Math.round(distance / 3);
      if (step < off || (step === off && w < deep)) [best, off, deep] = [at, step, w];
    }
    return best;
  }

  const round = (value) => {
    const power = 10 ** Math.floor(Math.log10(value));
    return [1, 2, 5, 10].map((step) => step * power).reduce((a, b) => (Math.abs(b - value) < Math.abs(a - value) ? b : a));
  };

  // Distance of the lines of the box for what reaches over low … high [3].
  const spacing = (low, high) => round(Math.max(...high.map((value, r) => value - low[r]), 1e-9) / LINES);

  // What the library is told of the box: lines, and no text of its own.
  function scene(low, high, step, camera) {
    const axis = (r) => {
      const from = Math.floor((2 * low[r] - high[r]) / step);
      const count = Math.min(Math.ceil((2 * high[r] - low[r]) / step) - from + 1, 200);
      const tickvals = Array.from({ length: Math.max(count, 1) }, (_, k) => (from + k) * step);
      return theme.axis({ title: { text: " " }, backgroundcolor: "rgba(0,0,0,0)", showspikes: false, automargin: undefined,
        tickmode: "array", tickvals, ticktext: tickvals.map(() => ""), showticklabels: false });
    };
    return { aspectmode: "data", uirevision: 1, dragmode: "turntable", camera, xaxis: axis(0), yaxis: axis(1), zaxis: axis(2) };
  }

  // Numbers along three edges of the box that lie outside of the picture: the lowest ones, and the leftmost upright one.
  function numbers(how, step, unit, names) {
    const { box } = how;
    const out = [];
    for (let r = 0; r < 3; r++) {
      const [s, t] = [0, 1, 2].filter((other) => other !== r);
      const edges = [0, 1, 2, 3].map((k) => {
        const corner = [0, 0, 0];
        corner[s] = box[k & 1][s];
        corner[t] = box[k >> 1][t];
        const middle = [...corner];
        middle[r] = (box[0][r] + box[1][r]) / 2;
        const [across, down] = projected(how, ...middle);
        return { corner, outside: r === 2 ? -across : down };
      });
      const { corner } = edges.reduce((one, other) => (other.outside > one.outside ? other : one));
      const ends = [0, 1].map((k) => projected(how, ...corner.with(r, box[k][r])));
      const length = Math.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]);
      const [low, high] = [Math.ceil(box[0][r] / step), Math.floor(box[1][r] / step)];
      const each = Math.ceil(((high - low + 1) * 38) / Math.max(length, 1)); // 38 pixels for a number
      const put = (value, text) => {
        const at = corner.with(r, value);
        out.push({ text, at, by: r === 2 ? [-6, 4] : [0, 15], anchor: r === 2 ? "end" : "middle", soft: true });
      };
      if (length < 30) continue; // seen from its end
      for (let k = low; k <= high; k++) if (k % each === 0) put(k * step, String(Number((k * step).toPrecision(6))).replace("-", "−"));
      const middle = (box[0][r] + box[1][r]) / 2;
      out.push({ text: `${names[r]}, ${unit}`, at: corner.with(r, middle), by: r === 2 ? [-34, 4] : [0, 32], anchor: r === 2 ? "end" : "middle", soft: true });
    }
    return out;
  }

  // Marks, names and numbers as SVG: { text, at, by?, anchor?, soft? }, { dot, colour, size, hollow? } or { line, colour }.
  function picture(how, marks) {
    const number = (value) => value.toFixed(1);
    const shape = (mark) => {
      if (mark.line) {
        const points = mark.line.map((point) => projected(how, ...point)).filter(([, , w]) => w > 0);
        return `<polyline points="${points.map(([x, y]) => `${number(x)},${number(y)}`).join(" ")}" fill="none" stroke="${mark.colour}" stroke-width="${mark.width ?? 2}" stroke-linejoin="round"/>`;
      }
      const [x, y, w] = projected(how, ...(mark.dot ?? mark.at));
      if (!(w > 0) || !Number.isFinite(x)) return "";
      if (mark.dot)
        return `<circle data-at="${mark.dot.map((value) => value.toFixed(4)).join(" ")}" cx="${number(x)}" cy="${number(y)}" r="${mark.size}" stroke="${mark.colour}" stroke-width="2" fill="${mark.hollow ? "none" : mark.colour}"/>`;
      const [right, below] = mark.by ?? [0, 0];
      return `<text x="${number(x + right)}" y="${number(y + below)}" text-anchor="${mark.anchor ?? "middle"}" fill="${theme.colour(mark.soft ? "soft" : "ink")}">${mark.text}</text>`;
    };
    return marks.map(shape).join("");
  }

  // A picture stands in for the canvas on paper: browsers do not print what the graphics card drew.
  const pictures = new Map();
  function expose(view) {
    const canvas = view.querySelector(".gl-container canvas");
    if (!canvas) return;
    if (!pictures.has(view))
      pictures.set(view, Object.assign(new Image(), { alt: view.getAttribute("aria-label"), className: "only-print" }));
    view._fullLayout.scene._scene.glplot.redraw(); // what it drew is gone when it has been shown
    pictures.get(view).src = canvas.toDataURL();
    canvas.after(pictures.get(view));
  }

  // A view in space in an element. Told are:
  // reach     () → [low, high] of what is drawn, in the unit
  // unit, names of the axes
  // traces    () → what the library draws
  // marks     () → what is drawn over it
  // points    () → { x, y, z, place, joined }: what can be pointed at, and the place that each is; or nothing
  // keys      what further keys do; camera, layout: where it is seen from at first, further layout
  function add(view, { reach, unit, names = ["X", "Y", "Z"], traces, marks = () => [], points = null, keys = {}, camera = OBLIQUE, layout = {} }) {
    let step = 1;
    let over = null;
    let drawn = false;

    function mark() {
      const how = drawn && seen(view);
      if (!how) return;
      if (!over?.isConnected) {
        over = document.createElementNS("http://www.w3.org/2000/svg", "svg");
        over.setAttribute("class", "over");
        view.querySelector(".gl-container").append(over);
      }
      over.innerHTML = picture(how, [...numbers(how, step, unit, names), ...marks()]);
    }
    // After each picture of the library the marks are drawn anew; its second picture, to find what is pointed at, is not
    // needed and is left out.
    function follow() {
      const plot = view._fullLayout?.scene?._scene?.glplot;
      if (!plot) return;
      if (plot.objects.some(({ pickSlots }) => pickSlots)) {
        plot.objects.forEach((object) => { object.pickSlots = 0; });
        const last = plot.objects.at(-1);
        plot.remove(last);
        plot.add(last);
      }
      if (plot.marked) return;
      plot.marked = true;
      const { onrender } = plot;
      plot.onrender = () => { onrender(); mark(); };
    }
    function draw() {
      const [low, high] = reach();
      step = spacing(low, high);
      const done = Plotly.react(view, traces(), theme.layout({ margin: { l: 0, r: 0, t: 0, b: 0 }, hovermode: false, uirevision: 1,
        ...layout, scene: scene(low, high, step, camera) }), theme.config);
      drawn = true;
      follow();
      if (theme.printing) expose(view);
      mark();
      return done;
    }

    function at({ clientX, clientY }) {
      const how = points && drawn && seen(view);
      if (!how) return null;
      const { left, top } = view.querySelector(".gl-container").getBoundingClientRect();
      const shown = points();
      const found = under(how, shown, clientX - left, clientY - top);
      return found === null ? null : shown.place[found];
    }
    if (points) {
      let moved = null;
      view.addEventListener("pointermove", (event) => {
        if (event.buttons) return;
        if (moved === null) requestAnimationFrame(() => { selection.point(at(moved)); moved = null; });
        moved = event;
      });
      view.addEventListener("pointerleave", () => requestAnimationFrame(() => selection.point(null)));
      // A click is a press that did not turn the view.
      let pressed = null;
      view.addEventListener("pointerdown", ({ clientX, clientY }) => { pressed = [clientX, clientY]; }, true);
      view.addEventListener("click", (event) => {
        if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) >= 4) return;
        const place = at(event);
        if (place !== null) selection.choose(place);
      }, true);
    }
    hear(view, keys);
    let asked = false;
    selection.subscribe(() => {
      if (asked) return;
      asked = true;
      requestAnimationFrame(() => { asked = false; mark(); });
    });
    stage.add(view, () => draw().then(() => theme.onChange(draw)).catch(({ message }) => {
      view.textContent = `This browser cannot draw in three dimensions (${message}). The plots and tables show the same numbers.`;
    }));
    return { draw: () => { if (drawn) draw(); }, look: (to) => look(view, to), mark };
  }

  // Smallest and largest of x, y and z.
  function reach(lines) {
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (const line of lines)
      ["x", "y", "z"].forEach((axis, r) => {
        for (const value of line[axis]) {
          if (value === null) continue; // a gap
          if (value < low[r]) low[r] = value;
          if (value > high[r]) high[r] = value;
        }
      });
    return [low, high];
  }
  return { add, reach, round, OBLIQUE };
})();
