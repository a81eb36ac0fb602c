"use strict";
// Views in space. The library draws lines and surfaces; marks, names and numbers are drawn over them, and the place under
// the pointer is found here: both are exact at once, where the library would have to draw its picture anew.
const space = (() => {
  const NEAR = 10; // pixels from the pointer
  const PAPER = 0.52; // height of a view on paper, of its width
  const LINES = 6; // of the box around, along its longest side
  const { projected } = camera;

  // The library makes the texts of its own from pictures that it reads back: those are kept by the processor.
  const context = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function get(kind, options) {
    return context.call(this, kind, kind === "2d" ? { ...options, willReadFrequently: true } : options);
  };

  // Whether the browser draws in space.
  const able = () => {
    const drawing = document.createElement("canvas").getContext("webgl");
    drawing?.getExtension("WEBGL_lose_context")?.loseContext();
    return drawing !== null;
  };

  const turning = {
    ArrowLeft: { turn: -10 }, ArrowRight: { turn: 10 }, ArrowUp: { rise: 10 }, ArrowDown: { rise: -10 },
    "+": { nearer: 1.2 }, "-": { nearer: 1 / 1.2 },
  };

  const times = (a, b) => Array.from({ length: 16 }, (_, k) => [0, 1, 2, 3].reduce((sum, j) => sum + a[4 * j + (k % 4)] * b[4 * (k >> 2) + j], 0));

  // What the library shows the box by, as of its picture; null before the first one.
  function shownBy(view, box) {
    const scene = view._fullLayout?.scene?._scene;
    if (!scene?.glplot?.cameraParams?.view) return null;
    const { cameraParams: { projection, view: eye, model } } = scene.glplot;
    const { dataScale, container: { clientWidth: width, clientHeight: height } } = scene;
    const m = times(projection, times(eye, model)).map((value, k) => value * (k < 12 ? dataScale[k >> 2] : 1));
    const row = (r, factor) => [0, 4, 8, 12].map((k) => m[r + k] * factor);
    return { rows: [row(0, width / 2), row(1, -height / 2), row(3, 1)], width, height, box };
  }

  // Which of points {x, y, z} is under the pointer; `joined`: a line, of which pieces are pointed at, else loose points.
  // Of those that are equally near it is the foremost.
  function under(how, { x, y, z, joined }, across, down) {
    let [best, off, deep] = [null, Infinity, Infinity];
    let [a, b] = [NaN, NaN];
    for (let k = 0; k < x.length; k++) {
      const [c, d, w] = x[k] === null ? [NaN, NaN, NaN] : projected(how, x[k], y[k], z[k]);
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

  // Distance of the lines of a box.
  const spacing = ([low, high]) => round(Math.max(...high.map((value, r) => value - low[r]), 1e-9) / LINES);

  // The box as the library draws it: lines, without text.
  function scene(box, size, step, from, grid) {
    const [x, y, z] = camera.lengths(box, size);
    const axis = (r) => {
      const first = Math.ceil(box[0][r] / step);
      const tickvals = Array.from({ length: Math.max(Math.floor(box[1][r] / step) - first + 1, 0) }, (_, k) => (first + k) * step);
      return theme.axis({ title: { text: " " }, backgroundcolor: "rgba(0,0,0,0)", showspikes: false, automargin: undefined,
        showgrid: grid, range: [box[0][r], box[1][r]], tickmode: "array", tickvals, ticktext: tickvals.map(() => ""), showticklabels: false });
    };
    return { aspectmode: "manual", aspectratio: { x, y, z }, uirevision: 1, dragmode: "turntable", camera: from,
      xaxis: axis(0), yaxis: axis(1), zaxis: axis(2) };
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

  // A view in space in an element, from:
  // unit, names of the axes
  // traces    () → what the library draws
  // room      () → further lines { x, y, z } that the box has room for
  // beyond    () → room { x, y, z } for traces with meta "beyond": the box does not grow for them, the rest keeps its size
  // marks     () → shapes drawn over it, see over.js
  // bar       () → { title, stops, low, high } of the colours, or null
  // points    () → { x, y, z, place, joined }: what can be pointed at, and the place that each is; or nothing
  // keys      what further keys do
  function add(view, { unit, names = ["X", "Y", "Z"], traces, room = () => [], beyond = () => [], marks = () => [], bar = () => null, points = null, keys = {} }) {
    const canvas = Object.assign(document.createElement("canvas"), { className: "sketch" });
    const picture = over.sheet(view);
    let from = camera.OBLIQUE; // where it is seen from, as long as the library has drawn nothing
    let started = false; // to be drawn by the library
    let drawn = false;
    let [content, box, size, step] = [[], null, 1, 1];
    let [outer, outerSize, offset] = [null, 1, [0, 0, 0]]; // what the library draws in, and where the middle of the box is in it
    const middle = ([low, high]) => low.map((value, r) => (value + high[r]) / 2);
    const shifted = ({ eye, up, center }, sign) => {
      const by = ({ x, y, z }) => ({ x: x + sign * offset[0], y: y + sign * offset[1], z: z + sign * offset[2] });
      return { eye: by(eye), up, center: by(center) };
    };

    function prepare() {
      content = traces().filter(({ visible }) => visible !== false);
      box = camera.box(reach([...content.filter(({ meta }) => meta !== "beyond"), ...room()]));
      const wide = theme.width(view);
      size = camera.size(box, wide, theme.printing ? PAPER * wide : view.clientHeight);
      step = spacing(box);
      const more = beyond();
      if (more.length) {
        const [low, high] = reach(more);
        outer = [low.map((value, r) => Math.min(value, box[0][r])), high.map((value, r) => Math.max(value, box[1][r]))];
      } else outer = box;
      const scale = camera.lengths(box, size).reduce((most, value, r) => Math.max(most, value / (box[1][r] - box[0][r])), 0);
      outerSize = scale * Math.hypot(...outer[1].map((value, r) => value - outer[0][r]));
      offset = middle(box).map((value, r) => scale * (value - middle(outer)[r]));
    }
    const how = () => (drawn ? shownBy(view, box) : box && camera.seen(from, box, size, view.clientWidth, view.clientHeight));
    function mark() {
      const shown = how();
      if (shown) picture.draw(shown, { step, unit, names, marks: marks(), bar: bar() });
    }
    function outline() {
      prepare();
      const lines = content.filter(({ type }) => type === "scatter3d");
      sketch.draw(canvas, how(), step, lines);
      if (lines.length) view.classList.remove("waiting");
      mark();
    }

    // After each picture of the library the marks are drawn anew; its second picture, which finds the point under the pointer, is not
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
      plot.onrender = () => {
        onrender();
        drawn = true;
        canvas.remove();
        mark();
      };
    }
    function draw() {
      const before = offset.join();
      if (drawn) from = shifted(view._fullLayout.scene.camera, -1);
      prepare();
      Plotly.react(view, traces(), theme.layout({ margin: { l: 0, r: 0, t: 0, b: 0 }, hovermode: false, uirevision: 1,
        height: theme.printing ? PAPER * theme.width(view) : undefined,
        scene: scene(outer, outerSize, step, shifted(from, 1), outer === box) }), theme.config);
      if (drawn && before !== offset.join()) Plotly.relayout(view, { "scene.camera": shifted(from, 1) });
      follow();
      if (theme.printing) over.expose(view);
      mark();
    }
    const again = () => { if (started) draw(); else outline(); };
    function look(how) {
      from = camera.moved(drawn ? shifted(view._fullLayout.scene.camera, -1) : from, how);
      if (drawn) Plotly.relayout(view, { "scene.camera": shifted(from, 1) }); else outline();
    }

    function at({ clientX, clientY }) {
      const shown = points && how();
      if (!shown) return null;
      const { left, top } = view.getBoundingClientRect();
      const pointed = points();
      const found = under(shown, pointed, clientX - left, clientY - top);
      return found === null ? null : pointed.place[found];
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
    view.addEventListener("pointerdown", () => view.focus({ preventScroll: true }), true); // the library would prevent it
    view.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const other = keys[event.key.toLowerCase()];
      if (!turning[event.key] && !other) return;
      event.preventDefault();
      if (other) other(); else look(turning[event.key]);
    });
    let asked = false;
    selection.subscribe(() => {
      if (asked) return;
      asked = true;
      requestAnimationFrame(() => { asked = false; mark(); });
    });

    // As long as the library has drawn nothing, the mouse turns the sketch.
    canvas.addEventListener("pointermove", ({ buttons, movementX, movementY }) => {
      if (buttons & 1) look({ turn: -0.4 * movementX, rise: 0.4 * movementY });
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      look({ nearer: 1.1 ** -Math.sign(event.deltaY) });
    });
    view.classList.add("space");
    view.prepend(canvas);
    new ResizeObserver(() => { if (!drawn) outline(); }).observe(view);
    theme.onChange(again);
    stage.add(view, () => {
      started = able();
      if (started) draw();
      else if (content.some(({ type }) => type === "mesh3d"))
        view.append("This browser cannot draw surfaces in space. The tables show the same numbers.");
    });
    // Moves the points of one trace.
    function move(trace, { x, y, z }) {
      if (!drawn) return;
      Plotly.restyle(view, { x: [x], y: [y], z: [z] }, [trace]);
      follow();
    }
    return { draw: again, look, move };
  }
  return { add, reach, round };
})();
