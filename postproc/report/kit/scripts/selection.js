"use strict";
// The one place that all views look at: chosen (stays) or pointed at (until the pointer leaves).
const selection = (() => {
  const listeners = [];
  let chosen = null;
  let pointed = null;
  const notify = () => listeners.forEach((listener) => listener(pointed ?? chosen, chosen));
  return {
    get chosen() { return chosen; },
    get place() { return pointed ?? chosen; },
    choose(place) {
      chosen = place;
      pointed = null;
      notify();
    },
    point(place) {
      if (place === pointed) return;
      pointed = place;
      notify();
    },
    // Calls back with (place to show, chosen place), either of which may be null.
    subscribe(listener) { listeners.push(listener); },
  };
})();
