"use strict";
// Tables: columns that sort, rows that choose a place.
const tables = (() => {
  const number = (cell) => parseFloat(cell.dataset.sort ?? cell.textContent.replace("−", "-").replace("<", ""));

  function sort(table, column, head) {
    const descending = head.getAttribute("aria-sort") !== "descending";
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const key = (row) => number(row.cells[column]);
    const rows = [...table.tBodies[0].rows];
    const numeric = rows.some((row) => !Number.isNaN(key(row)));
    rows.sort((one, other) => {
      const [a, b] = [key(one), key(other)];
      const order = numeric
        ? (Number.isNaN(a) ? -Infinity : a) - (Number.isNaN(b) ? -Infinity : b) || 0
        : one.cells[column].textContent.localeCompare(other.cells[column].textContent);
      return descending ? -order : order;
    });
    table.tBodies[0].append(...rows);
  }

  for (const table of document.querySelectorAll("table.sortable"))
    [...table.tHead.rows[0].cells].forEach((head, column) =>
      head.querySelector("button").addEventListener("click", () => sort(table, column, head)));

  const rows = [...document.querySelectorAll("tr[data-place]")];
  for (const row of rows) {
    const place = Number(row.dataset.place);
    row.addEventListener("click", () => selection.choose(place));
    row.addEventListener("pointerenter", () => selection.point(place));
    row.addEventListener("pointerleave", () => selection.point(null));
    row.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      selection.choose(place);
    });
  }
  selection.subscribe((place, chosen) => {
    for (const row of rows) row.classList.toggle("chosen", Number(row.dataset.place) === chosen);
  });
})();
