"use strict";
// The text of the program beside the path: a click on a line shows its place, the place that is chosen shows its line.
// Only the lines in sight are elements, so that a program may have a hundred thousand.
(() => {
  const view = document.getElementById("source-view");
  if (!view) return;
  const HEIGHT = 20; // px of a line, as in the style sheet
  const BEYOND = 10; // lines drawn above and below
  const { at } = places;
  const first = new Map(); // line → the worst of its places
  for (let i = 0; i < places.count; i++) {
    const known = first.get(at.source_line[i]);
    if (known === undefined || at.before[i] > at.before[known]) first.set(at.source_line[i], i);
  }
  const withPlaces = [...first.keys()].sort((one, other) => one - other);
  const whole = Object.assign(document.createElement("div"), { className: "lines" });
  view.append(whole);
  view.classList.add("source");
  let lines = [];
  let chosen = null;
  let drawn = [0, 0];

  function row(number) {
    const element = document.createElement("div");
    element.style.top = `${(number - 1) * HEIGHT}px`;
    element.dataset.line = number;
    element.className = `${first.has(number) ? "leads" : ""}${number === chosen ? " chosen" : ""}`;
    element.append(Object.assign(document.createElement("span"), { textContent: number }), lines[number - 1]);
    return element;
  }
  function draw() {
    const from = Math.max(Math.floor(view.scrollTop / HEIGHT) - BEYOND, 0);
    const to = Math.min(Math.ceil((view.scrollTop + view.clientHeight) / HEIGHT) + BEYOND, lines.length);
    drawn = [from, to];
    whole.replaceChildren(...Array.from({ length: to - from }, (_, k) => row(from + k + 1)));
  }
  function reveal(number) {
    const top = (number - 1) * HEIGHT;
    if (top < view.scrollTop || top + HEIGHT > view.scrollTop + view.clientHeight)
      view.scrollTop = Math.max(top - view.clientHeight / 2, 0);
  }

  view.addEventListener("scroll", () => {
    const from = Math.floor(view.scrollTop / HEIGHT);
    const to = Math.ceil((view.scrollTop + view.clientHeight) / HEIGHT);
    if (from < drawn[0] || to > drawn[1]) draw();
  });
  view.addEventListener("click", (event) => {
    const number = Number(event.target.closest("[data-line]")?.dataset.line);
    if (number) selection.choose(first.get(number) ?? places.ofLine(number));
  });
  view.addEventListener("keydown", (event) => {
    const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!by) return;
    event.preventDefault();
    const k = withPlaces.findIndex((line) => line >= (chosen ?? 0)) + by;
    selection.choose(first.get(withPlaces[Math.min(Math.max(k, 0), withPlaces.length - 1)]));
  });
  let stays = null;
  selection.subscribe((place, kept) => {
    chosen = place === null ? null : at.source_line[place];
    if (kept !== stays && kept !== null && lines.length) reveal(at.source_line[kept]);
    stays = kept;
    if (lines.length) draw();
  });

  packed.inflated(document.getElementById("source-text").textContent).then((bytes) => {
    lines = new TextDecoder().decode(bytes).split("\n");
    whole.style.height = `${lines.length * HEIGHT}px`;
    if (chosen !== null) reveal(chosen);
    draw();
  });
  new ResizeObserver(() => { if (lines.length) draw(); }).observe(view);
})();
