"use strict";
// An upright line over a plot at the place that is shown: it moves at once, where the library would draw the plot anew.
const cursor = (() => {
  // Puts the line of a plot at x of an axis, or hides it (null); as high as the axis or the whole plot.
  function put(plot, line, x, suffix) {
    const { _size: size, [`xaxis${suffix ?? ""}`]: xaxis, [`yaxis${suffix}`]: yaxis } = plot._fullLayout ?? {};
    if (!xaxis) return;
    if (line.parentNode !== plot) plot.append(line);
    const at = x === null ? NaN : xaxis.d2p(x);
    line.hidden = !(at >= 0 && at <= xaxis._length);
    line.dataset.x = String(x);
    Object.assign(line.style, { left: `${xaxis._offset + at}px`, top: `${yaxis?._offset ?? size.t}px`, height: `${yaxis?._length ?? size.h}px` });
  }

  // Follows the place that is shown; `at` says where on x it is, `suffix` of which axes, if there are several of x.
  function follow(plot, at, suffix = null) {
    const line = Object.assign(document.createElement("div"), { className: "cursor" });
    const move = () => put(plot, line, at(), suffix);
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
