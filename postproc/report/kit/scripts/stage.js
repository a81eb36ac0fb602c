"use strict";
// When views are drawn: as soon as the library that draws them is there, the first and those in sight at once, the others one
// by one while nothing else is to be done; on paper all. What needs no drawing does not wait for the library.
const stage = (() => {
  const waiting = new Map(); // element → what draws it
  const seen = new Set();
  const later = window.requestIdleCallback?.bind(window) ?? ((act) => setTimeout(act, 100));
  let ready = false;

  function show(element) {
    const draw = waiting.get(element);
    if (!draw || !ready) return;
    waiting.delete(element);
    watch.unobserve(element);
    draw();
  }
  const watch = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) seen.add(target); else seen.delete(target);
      if (isIntersecting) setTimeout(show, 0, target); // one at a time: what is clicked meanwhile is heard
    }
  });
  function next() {
    const [element] = waiting.keys();
    if (element === undefined) return;
    show(element);
    later(next);
  }
  function begin() {
    ready = true;
    if (theme.printing) [...waiting.keys()].forEach(show);
    const [first] = waiting.keys();
    for (const element of waiting.keys()) if (element === first || seen.has(element)) setTimeout(show, 0, element);
    setTimeout(() => later(next), 300);
  }
  addEventListener("beforeprint", () => [...waiting.keys()].forEach(show));

  // The library is a text of the page, made a script of its own: it is read while the page can be used already.
  function load() {
    const { textContent } = document.getElementById("library");
    const script = Object.assign(document.createElement("script"), {
      src: URL.createObjectURL(new Blob([textContent], { type: "text/javascript" })), onload: begin,
      onerror: () => { document.head.append(Object.assign(document.createElement("script"), { textContent })); begin(); },
    });
    document.head.append(script);
  }

  return {
    // Has an element drawn once, when its turn comes.
    add(element, draw) {
      waiting.set(element, draw);
      watch.observe(element);
    },
    load,
    get empty() { return waiting.size === 0; },
    later,
  };
})();
