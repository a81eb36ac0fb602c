"use strict";
// An upright line over a plot at the place that is shown: it moves at once, where the library would draw the plot anew.
const cursor = (() => {
  const lines = new Map();

  // Has the line of a plot stand at x, or nowhere (null).
  function put(plot, x) {
    const { xaxis, _size: size } = plot._fullLayout ?? {};
    if (!xaxis) return;
    if (!lines.has(plot)) lines.set(plot, Object.assign(document.createElement("div"), { className: "cursor" }));
    const line = lines.get(plot);
    if (line.parentNode !== plot) plot.append(line);
    const at = x === null ? NaN : xaxis.d2p(x);
    line.hidden = !(at >= 0 && at <= xaxis._length);
    line.dataset.x = String(x);
    Object.assign(line.style, { left: `${xaxis._offset + at}px`, top: `${size.t}px`, height: `${size.h}px` });
  }

  // Follows the place that is shown; `at` says where on x it is.
  function follow(plot, at) {
    const move = () => put(plot, at());
    let asked = false;
    selection.subscribe(() => {
      if (asked) return;
      asked = true;
      requestAnimationFrame(() => { asked = false; move(); });
    });
    plot.on("plotly_afterplot", move);
    move();
  }
  return { follow };
})();
