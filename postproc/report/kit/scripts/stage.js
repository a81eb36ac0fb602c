"use strict";
// When views are drawn: those in sight at once, the others one by one while nothing else is to be done; on paper all.
const stage = (() => {
  const waiting = new Map(); // element → what draws it
  const later = window.requestIdleCallback?.bind(window) ?? ((act) => setTimeout(act, 100));

  function show(element) {
    const draw = waiting.get(element);
    if (!draw) return;
    waiting.delete(element);
    watch.unobserve(element);
    draw();
  }
  const watch = new IntersectionObserver((seen) => {
    for (const { target, isIntersecting } of seen) if (isIntersecting) show(target);
  });
  function next() {
    const [element] = waiting.keys();
    if (element === undefined) return;
    show(element);
    later(next);
  }
  addEventListener("load", () => setTimeout(() => later(next), 300));
  addEventListener("beforeprint", () => [...waiting.keys()].forEach(show));

  return {
    // Has an element drawn once, when its turn comes.
    add(element, draw) {
      waiting.set(element, draw);
      watch.observe(element);
    },
    get empty() { return waiting.size === 0; },
    later,
  };
})();
