"use strict";
// The numbers of the page: `facts`, what the page says of itself, and `columns`, tables of typed arrays by name.
const facts = JSON.parse(document.getElementById("page-facts").textContent);

const columns = (() => {
  const kinds = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };

  function unpacked(described, base64) {
    const bytes = packed.bytes(base64);
    const length = Math.max(0, ...described.map((column) => column.count));
    const table = {};
    let at = 0;
    for (const { name, type, count } of described) {
      const values = new kinds[type](bytes.buffer, at, count);
      at += values.byteLength;
      table[name] = count === 1 ? new kinds[type](length).fill(values[0]) : values; // one: the same everywhere
    }
    return table;
  }

  const tables = {};
  for (const element of document.querySelectorAll("script.columns"))
    tables[element.dataset.name] = unpacked(JSON.parse(element.textContent), element.nextElementSibling.textContent);
  return tables;
})();

// A number with fixed decimals; a value below the last decimal is shown as "<" that decimal.
function fixed(value, decimals) {
  if (!Number.isFinite(value)) return "–";
  const least = 10 ** -decimals;
  if (decimals >= 4 && value !== 0 && Math.abs(value) < least) return value > 0 ? `<${least.toFixed(decimals)}` : "0.0000";
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? (0).toFixed(decimals) : text;
}
