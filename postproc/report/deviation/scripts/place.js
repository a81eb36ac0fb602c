"use strict";
// Details of the chosen place, or of the one pointed at, and buttons to go to others.
(() => {
  const view = document.getElementById("place-view");
  const { at, values } = places;
  view.setAttribute("aria-live", "polite");
  view.removeAttribute("tabindex");

  const list = (i, names, decimals) => names.map((name) => fixed(at[name][i], decimals)).join(", ");
  function rows(i) {
    const margins = places.margins(i);
    const axes = ["X", "Y", "Z"];
    const moment = ["Mx", "My", "Mz"].some((name) => at[name][i]) ? [["Moment Mx, My, Mz", `${list(i, ["Mx", "My", "Mz"], 2)} N·m`]] : [];
    const parts = (prefix) => (Number.isFinite(at[`${prefix}_along`][i])
      ? [["– along, across, normal", `${list(i, ["along", "across", "normal"].map((name) => `${prefix}_${name}`), 4)} mm`]] : []);
    return [
      ["Source line", at.source_line[i]],
      [places.compared ? "Output line" : "Line", at.output_line[i]],
      ["On the move", `${fixed(at.t[i], 3)}${at.rapid[i] ? " (rapid)" : ""}`],
      [values.before.title, `${fixed(at.before[i], 4)} mm`],
      ["– X, Y, Z", `${list(i, axes.map((axis) => `b${axis}`), 4)} mm`],
      ...parts("b"),
      ...(places.compared ? [["Deviation after", `${fixed(at.after[i], 4)} mm`]] : []),
      ["Expected on the part (95 %)", facts.bounded ? `${fixed(at.u95[i], 4)} mm` : "unknown"],
      ...(places.compared ? [["Correction", `${fixed(at.correction[i], 4)} mm`], ["– X, Y, Z", `${list(i, axes.map((axis) => `c${axis}`), 4)} mm`]] : []),
      ["Force", `${fixed(at.force[i], 1)} N`],
      ["– Fx, Fy, Fz", `${list(i, ["Fx", "Fy", "Fz"], 1)} N`],
      ...moment,
      ["X, Y, Z", `${list(i, axes, 3)} mm`],
      ["A, B, C", `${list(i, ["A", "B", "C"], 3)}°`],
      ...places.joints.map((name, k) => [name, `${fixed(at[name][i], 2)}° (margin ${fixed(margins[k], 1)}°)`]),
      ["Smallest singular value", `${fixed(at.singular[i], 3)} m/rad`],
      ["Speed", `${fixed(at.speed[i], 1)} mm/s`],
      ["Path, time", `${fixed(at.length[i], 1)} mm, ${fixed(at.time[i], 2)} s`],
    ];
  }

  const details = document.createElement("dl");
  details.className = "facts";
  view.append(details);
  const controls = document.getElementById("place-controls");
  controls.innerHTML = `<button type="button" data-go="-1" aria-label="Previous place">◀</button><button type="button" data-go="1" aria-label="Next place">▶</button>
    <button type="button" data-go="worst">worst</button>
    <label>line <input type="number" id="place-line" min="1" style="width:6em"></label><output class="said" for="place-line"></output>`;
  for (const button of controls.querySelectorAll("[data-go]"))
    button.addEventListener("click", () => selection.choose(button.dataset.go === "worst" ? facts.worst.before
      : places.step(selection.chosen, Number(button.dataset.go))));
  document.getElementById("place-line").addEventListener("change", (event) => {
    const wanted = Number(event.target.value);
    const found = places.ofLine(wanted);
    const line = at.source_line[found];
    controls.querySelector("output").textContent = line === wanted ? "" : `no target on line ${wanted}: nearest is line ${line}`;
    selection.choose(found);
  });

  selection.subscribe((place) => {
    details.replaceChildren(...(place === null ? [] : rows(place).map(([name, text]) => {
      const row = document.createElement("div");
      row.append(Object.assign(document.createElement("dt"), { textContent: name }), Object.assign(document.createElement("dd"), { textContent: text }));
      return row;
    })));
  });
  selection.choose(facts.worst.before);
})();
