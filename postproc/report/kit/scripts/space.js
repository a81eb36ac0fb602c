"use strict";
// What all views in space share: turning by keys, clicks, and a picture for paper.
const space = (() => {
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
  const keys = {
    ArrowLeft: { turn: -10 }, ArrowRight: { turn: 10 }, ArrowUp: { rise: 10 }, ArrowDown: { rise: -10 },
    "+": { nearer: 1.2 }, "-": { nearer: 1 / 1.2 },
  };

  // Has keys turn a view; `others` are what further keys do.
  function hear(view, others = {}) {
    view.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const other = others[event.key.toLowerCase()];
      if (!keys[event.key] && !other) return;
      event.preventDefault();
      if (other) other(); else look(view, keys[event.key]);
    });
  }

  // Calls back with a click, which is a press that did not turn the view. (The library tells of one only if it lasts
  // until it has drawn again.)
  function clicked(view, act) {
    let pressed = null;
    view.addEventListener("pointerdown", ({ clientX, clientY }) => { pressed = [clientX, clientY]; }, true);
    view.addEventListener("click", ({ clientX, clientY }) => {
      if (pressed && Math.hypot(clientX - pressed[0], clientY - pressed[1]) < 4) act();
    }, true);
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
  const wanted = new Map();
  function photograph(view) {
    if (theme.printing) expose(view); // there is no later
    clearTimeout(wanted.get(view));
    wanted.set(view, setTimeout(() => stage.later(() => expose(view)), 1500));
  }
  return { look, hear, clicked, photograph };
})();
