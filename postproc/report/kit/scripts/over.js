"use strict";
// SVG over a view in space: marks, the numbers along its box, the bar of its colours; and its picture on paper.
const over = (() => {
  const WIDE = 38; // pixels that a number takes
  const [NUMBERS, TITLES] = [14, 42]; // pixels off the box
  const { projected } = camera;
  const minus = (text) => text.replace("-", "−");
  const text = (value) => minus(String(Number(value.toPrecision(6))));

  // Numbers along three edges of the box that lie outside of the picture: the lowest ones, and the leftmost upright one.
  function numbers(how, step, unit, names) {
    const { box } = how;
    const centre = projected(how, ...box[0].map((value, r) => (value + box[1][r]) / 2));
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
      const each = Math.ceil(((high - low + 1) * WIDE) / Math.max(length, 1));
      if (length < 30) continue; // seen from its end
      // square to the edge, away from the box
      let away = [(ends[1][1] - ends[0][1]) / length, (ends[0][0] - ends[1][0]) / length];
      const inward = away[0] * (centre[0] - ends[0][0]) + away[1] * (centre[1] - ends[0][1]);
      if (inward > 0) away = away.map((value) => -value);
      const put = (value, text, off) => out.push({ text, at: corner.with(r, value), by: [away[0] * off, away[1] * off + 4],
        anchor: Math.abs(away[0]) < 0.3 ? "middle" : away[0] < 0 ? "end" : "start", soft: true });
      for (let k = low; k <= high; k++) if (k % each === 0) put(k * step, text(k * step), NUMBERS);
      const title = `${names[r]}, ${unit}`;
      if (r < 2) put((box[0][r] + box[1][r]) / 2, title, TITLES);
      else out.push({ text: title, at: corner.with(2, box[1][2]), by: [0, -8], soft: true });
    }
    return out;
  }

  // { text, at, by?, anchor?, soft? }, { dot, colour, size, hollow? } or { line, colour }.
  const number = (value) => value.toFixed(1);
  function shape(how, mark) {
    if (mark.line) {
      const points = mark.line.map((point) => projected(how, ...point)).filter(([, , w]) => w > 0);
      return `<polyline points="${points.map(([x, y]) => `${number(x)},${number(y)}`).join(" ")}" fill="none" stroke="${mark.colour}" stroke-width="${mark.width ?? 2}" stroke-linejoin="round"/>`;
    }
    const [x, y, w] = projected(how, ...(mark.dot ?? mark.at));
    if (!(w > 0) || !Number.isFinite(x)) return "";
    if (mark.dot)
      return `<circle data-at="${mark.dot.map((value) => value.toFixed(4)).join(" ")}" cx="${number(x)}" cy="${number(y)}" r="${mark.size}" stroke="${mark.colour}" stroke-width="2" fill="${mark.hollow ? "none" : mark.colour}"/>`;
    const [right, below] = mark.by ?? [0, 0];
    return `<text${mark.soft ? "" : ' data-mark=""'} x="${number(x + right)}" y="${number(y + below)}" text-anchor="${mark.anchor ?? "middle"}" fill="${theme.colour(mark.soft ? "soft" : "ink")}">${mark.text}</text>`;
  }

  // The colour bar, at the right of the picture.
  let count = 0;
  function colours({ width, height }, { title, stops, low, high }, id) {
    const [left, top, tall] = [width - 62, 30, Math.max(0.7 * height - 30, 60)];
    const step = [1, 2, 5, 10].map((each) => each * 10 ** Math.floor(Math.log10((high - low) / 5))).find((each) => (high - low) / each <= 6);
    const ticks = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
    return `<linearGradient id="${id}" x1="0" x2="0" y1="1" y2="0">${stops.map((colour, k) =>
      `<stop offset="${k / (stops.length - 1)}" stop-color="${colour}"/>`).join("")}</linearGradient>
      <g fill="${theme.colour("soft")}" class="colours"><text x="${width - 4}" y="16" text-anchor="end">${title}</text>
      <rect x="${left}" y="${top}" width="12" height="${tall}" fill="url(#${id})"/>${ticks.map((value) =>
        `<text x="${left + 17}" y="${number(top + tall * (1 - (value - low) / (high - low)) + 4)}">${text(value)}</text>`).join("")}</g>`;
  }

  // The sheet that lies over a view.
  function sheet(view) {
    const id = `colours-${count++}`;
    const element = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    element.setAttribute("class", "over");
    view.append(element);
    return { element,
      draw(how, { step, unit, names, marks, bar }) {
        const shapes = [...numbers(how, step, unit, names), ...marks];
        element.innerHTML = (bar ? colours(how, bar, id) : "") + shapes.map((mark) => shape(how, mark)).join("");
      } };
  }

  // A picture replaces the canvas on paper: browsers do not print the pictures of the graphics card.
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
  return { sheet, expose };
})();
