"use strict";
// Details of the chosen pair of targets, and buttons to go to others.
(() => {
  const view = document.getElementById("place-view");
  if (!view) return;
  const at = columns.places;
  const count = at.offset.length;
  view.setAttribute("aria-live", "polite");
  view.removeAttribute("tabindex");
  const list = (i, names, decimals) => names.map((name) => fixed(at[name][i], decimals)).join(", ");

  const line = (i, side) => {
    const files = facts[`${side}_files`], own = at[`${side}_line`][i];
    return files.length ? `${files[at[`${side}_file`][i]]}:${own}` : own;
  };

  function rows(i) {
    return [
      [`Line of ${facts.nominal}`, line(i, "nominal")],
      [`Line of ${facts.corrected}`, line(i, "corrected")],
      ["Nominal X, Y, Z", `${list(i, ["X", "Y", "Z"], 3)} mm`],
      ["Nominal A, B, C", `${list(i, ["A", "B", "C"], 3)}°`],
      ["Offset", `${fixed(at.offset[i], 4)} mm${at.rapid[i] ? " (rapid)" : ""}`],
      ["– X, Y, Z", `${list(i, ["oX", "oY", "oZ"], 4)} mm`],
      ["Turned by", `${fixed(at.turned[i], 4)}°`],
      ["On the segment to it, largest", Number.isFinite(at.between[i]) ? `${fixed(at.between[i], 4)} mm` : "unknown"],
      ["Speeds", `${fixed(at.nominal_speed[i], 1)}, ${fixed(at.corrected_speed[i], 1)} mm/s`],
      ...(at.force ? [["Force", `${fixed(at.force[i], 1)} N`], ["Nominal cuts", `${fixed(at.nominal_cuts[i], 4)} mm`],
        ["Corrected cuts", `${fixed(at.corrected_cuts[i], 4)} mm`]] : []),
    ];
  }

  const step = (by) => Math.min(Math.max((selection.chosen ?? 0) + by, 0), count - 1);
  const details = Object.assign(document.createElement("dl"), { className: "facts" });
  view.append(details);
  document.getElementById("place-controls").innerHTML = `<button type="button" data-go="-1" aria-label="Previous place">◀</button>
    <button type="button" data-go="1" aria-label="Next place">▶</button><button type="button" data-go="worst">largest</button>
    <label>line <input type="number" id="place-line" min="1" style="width:6em"></label><output class="said" for="place-line"></output>`;
  for (const button of document.querySelectorAll("#place-controls [data-go]"))
    button.addEventListener("click", () => selection.choose(button.dataset.go === "worst" ? facts.worst : step(Number(button.dataset.go))));
  document.getElementById("place-line").addEventListener("change", (event) => {
    const wanted = Number(event.target.value);
    const off = (i) => Math.abs(at.nominal_line[i] - wanted);
    const found = at.nominal_line.reduce((best, _, i) => (off(i) < off(best) ? i : best), 0);
    document.querySelector("#place-controls output").textContent = off(found) ? `no pair shown on line ${wanted}: nearest is line ${at.nominal_line[found]}` : "";
    selection.choose(found);
  });
  selection.subscribe((place) => {
    details.replaceChildren(...(place === null ? [] : rows(place).map(([name, text]) => {
      const row = document.createElement("div");
      row.append(Object.assign(document.createElement("dt"), { textContent: name }), Object.assign(document.createElement("dd"), { textContent: text }));
      return row;
    })));
  });
  selection.choose(facts.worst);
})();
