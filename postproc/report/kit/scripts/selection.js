"use strict";
// The one place that all views look at: chosen (stays) or pointed at (until the pointer leaves).
const selection = (() => {
  const heard = [];
  let chosen = null;
  let pointed = null;
  const tell = () => heard.forEach((hear) => hear(pointed ?? chosen, chosen));
  return {
    get chosen() { return chosen; },
    get place() { return pointed ?? chosen; },
    choose(place) {
      chosen = place;
      pointed = null;
      tell();
    },
    point(place) {
      if (place === pointed) return;
      pointed = place;
      tell();
    },
    // Calls back with (place to show, chosen place), either of which may be null.
    subscribe(hear) { heard.push(hear); },
  };
})();
