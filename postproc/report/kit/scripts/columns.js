"use strict";
// The numbers of the page: `facts`, what the page says of itself, and `columns`, tables of typed arrays by name.
const facts = JSON.parse(document.getElementById("page-facts").textContent);

const columns = (() => {
  const kinds = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };

  function decoded(base64) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64); // not in every browser yet
    const text = atob(base64);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return bytes;
  }

  function unpacked(described, base64) {
    const bytes = decoded(base64);
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

// A number with fixed decimals; what is smaller than the text can say is told as that.
function fixed(value, decimals) {
  if (!Number.isFinite(value)) return "–";
  const least = 10 ** -decimals;
  if (decimals >= 4 && value !== 0 && Math.abs(value) < least) return value > 0 ? `<${least.toFixed(decimals)}` : "0.0000";
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? (0).toFixed(decimals) : text;
}
