// Restores what `view/pages/models.py` packs: a compressed file whose tables are kept as differences, byte by byte.
"use strict";
const Unpacking = (() => {
  async function inflated(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  }

  // Of each table, the bytes of one rank lie together, each as its difference from that of the element before.
  async function restored({ tables, data }) {
    const bytes = new Uint8Array(await inflated(data));
    for (const [start, length, stride] of tables) {
      const packed = bytes.slice(start, start + length), count = length / stride;
      for (let rank = 0; rank < stride; rank++)
        for (let row = 0, value = 0; row < count; row++)
          bytes[start + row * stride + rank] = value = (value + packed[rank * count + row]) & 255;
    }
    return bytes.buffer;
  }

  return { inflated, restored };
})();
