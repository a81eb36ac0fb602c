"use strict";
// Bytes in the page: base64, and deflated (zlib) bytes in base64.
const packed = (() => {
  function bytes(base64) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64); // not in every browser yet
    const text = atob(base64);
    const out = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
    return out;
  }

  // Inflates zlib data where the browser cannot (RFC 1950, 1951); checksums are not looked at.
  function inflate(data) {
    let [at, hold, held] = [2, 0, 0];
    let out = new Uint8Array(4 * data.length);
    let size = 0;
    const bits = (count) => {
      while (held < count) { hold |= data[at++] << held; held += 8; }
      const value = hold & ((1 << count) - 1);
      hold >>>= count;
      held -= count;
      return value;
    };
    const room = (more) => {
      if (size + more <= out.length) return;
      const larger = new Uint8Array(2 * (size + more));
      larger.set(out.subarray(0, size));
      out = larger;
    };
    // Canonical Huffman code: how many codes of each length, and the symbols in order.
    function code(lengths) {
      const count = new Uint16Array(16);
      for (const length of lengths) count[length]++;
      count[0] = 0;
      const next = new Uint16Array(17);
      for (let n = 1; n < 16; n++) next[n + 1] = next[n] + count[n];
      const symbols = new Uint16Array(lengths.length);
      lengths.forEach((length, symbol) => { if (length) symbols[next[length]++] = symbol; });
      return { count, symbols };
    }
    function symbol({ count, symbols }) {
      let [value, first, index] = [0, 0, 0];
      for (let length = 1; length < 16; length++) {
        value |= bits(1);
        if (value - count[length] < first) return symbols[index + (value - first)];
        index += count[length];
        first = (first + count[length]) << 1;
        value <<= 1;
      }
      throw new Error("the library in this page is damaged");
    }
    const lengthBase = [3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258];
    const lengthBits = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
    const farBase = [1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577];
    const farBits = farBase.map((_, k) => Math.max(0, (k >> 1) - 1));
    const order = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
    const fixedLengths = Array.from({ length: 288 }, (_, k) => (k < 144 ? 8 : k < 256 ? 9 : k < 280 ? 7 : 8));
    for (let last = 0; !last; ) {
      last = bits(1);
      const kind = bits(2);
      if (kind === 0) {
        hold = held = 0;
        const length = data[at] | (data[at + 1] << 8);
        at += 4;
        room(length);
        out.set(data.subarray(at, at + length), size);
        size += length;
        at += length;
        continue;
      }
      let literals = code(fixedLengths);
      let distances = code(new Array(30).fill(5));
      if (kind === 2) {
        const [own, far, few] = [bits(5) + 257, bits(5) + 1, bits(4) + 4];
        const lengths = new Array(19).fill(0);
        for (let k = 0; k < few; k++) lengths[order[k]] = bits(3);
        const short = code(lengths);
        const all = [];
        while (all.length < own + far) {
          const found = symbol(short);
          if (found < 16) { all.push(found); continue; }
          const [value, times] = found === 16 ? [all.at(-1), 3 + bits(2)] : [0, found === 17 ? 3 + bits(3) : 11 + bits(7)];
          for (let k = 0; k < times; k++) all.push(value);
        }
        literals = code(all.slice(0, own));
        distances = code(all.slice(own));
      }
      for (let found = symbol(literals); found !== 256; found = symbol(literals)) {
        if (found < 256) { room(1); out[size++] = found; continue; }
        const length = lengthBase[found - 257] + bits(lengthBits[found - 257]);
        const far = symbol(distances);
        const back = farBase[far] + bits(farBits[far]);
        room(length);
        for (let k = 0; k < length; k++, size++) out[size] = out[size - back];
      }
    }
    return out.subarray(0, size);
  }

  // Promises the bytes of a deflated text.
  async function inflated(base64) {
    const data = bytes(base64);
    if (typeof DecompressionStream === "undefined") return inflate(data);
    const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }
  return { bytes, inflated };
})();
