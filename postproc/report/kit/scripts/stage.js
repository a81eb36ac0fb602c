"use strict";
// When views are drawn: by the library, as soon as it is there, the first of the page first, then those in sight, then the
// others; on paper all. All of it is heavy: it waits for a moment in which nothing is pointed at, pressed or scrolled, so that
// requests to the page meanwhile are done at once.
const stage = (() => {
  const waiting = new Map(); // element → what draws it
  const seen = new Set();
  const PATIENCE = 2000; // ms
  let last = 0;
  for (const kind of ["pointermove", "pointerdown", "keydown", "wheel", "scroll"])
    addEventListener(kind, () => { last = performance.now(); }, { capture: true, passive: true });
  function calm(act, pause, since = performance.now()) {
    const left = Math.min(Math.max(last, since) + pause, since + PATIENCE) - performance.now();
    if (left > 0 && !theme.printing) setTimeout(calm, left, act, pause, since); else act();
  }
  const painted = (act) => (document.hidden ? setTimeout(act) : requestAnimationFrame(() => setTimeout(act)));
  const follows = (one, other) => one.compareDocumentPosition(other) & Node.DOCUMENT_POSITION_FOLLOWING;

  const watch = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries)
      if (isIntersecting) seen.add(target); else seen.delete(target);
  });
  function show(element) {
    const draw = waiting.get(element);
    waiting.delete(element);
    element.classList.remove("waiting");
    watch.unobserve(element);
    draw();
  }
  // One at a time: clicks in between are handled.
  function next(first) {
    const all = [...waiting.keys()].sort((one, other) => (follows(one, other) ? -1 : 1));
    const sight = first ? all[0] : all.find((element) => seen.has(element));
    if (all.length) show(sight ?? all[0]);
    if (all.length > 1) painted(() => calm(() => next(false), 50));
  }
  const rest = () => [...waiting.keys()].forEach(show);
  function begin() {
    addEventListener("beforeprint", rest);
    if (theme.printing) rest(); else calm(() => next(true), 50);
  }

  // The library is in the page, deflated. It becomes a script of its own: it is read while the page can be used already.
  async function load() {
    const text = await packed.inflated(document.getElementById("library").textContent);
    const script = Object.assign(document.createElement("script"), {
      src: URL.createObjectURL(new Blob([text], { type: "text/javascript" })), onload: begin,
      onerror: () => {
        document.head.append(Object.assign(document.createElement("script"), { textContent: new TextDecoder().decode(text) }));
        begin();
      },
    });
    document.head.append(script);
  }

  return {
    // Has an element drawn once, when its turn comes.
    add(element, draw) {
      waiting.set(element, draw);
      element.classList.add("waiting"); // which says so; a sketch takes it away
      watch.observe(element);
    },
    load() { painted(() => calm(load, 250)); },
    get empty() { return waiting.size === 0; },
  };
})();
