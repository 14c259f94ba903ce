// Restores what `view/models.py` packs: tables of whole numbers, of which the differences from
// predictions are kept.
"use strict";
const Unpacking = (() => {
  async function inflated(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  }

  async function loaded({ data, columns, bytes }) {
    return { packed: new Uint8Array(await inflated(data)), columns, bytes };
  }

  // Rows of numbers: of each column, the bytes of one rank lie together; 0, 1, 2, 3, ... stand for 0, -1, 1, -2, ...
  function joined({ packed, columns, bytes }) {
    const count = packed.length / columns / bytes, rows = new Int32Array(columns * count);
    for (let column = 0; column < columns; column++)
      for (let row = 0; row < count; row++) {
        let number = 0;
        for (let rank = 0; rank < bytes; rank++) number |= packed[(column * bytes + rank) * count + row] << (8 * rank);
        rows[row * columns + column] = (number >>> 1) ^ -(number & 1);
      }
    return rows;
  }

  const known = new WeakMap(); // by the triangles

  // For each vertex, those before it that are in triangles with it: where they begin in a list, and the list.
  function earlier(index, count) {
    if (!index) return { begin: new Uint32Array(count + 1), list: [] };
    if (!known.has(index)) known.set(index, listed(index, count));
    return known.get(index);
  }

  function listed(index, count) {
    const begin = new Uint32Array(count + 1), sides = [[0, 1], [1, 2], [2, 0]];
    const each = (found) => {
      for (let at = 0; at < index.length; at += 3)
        for (const [one, other] of sides) {
          const low = Math.min(index[at + one], index[at + other]), high = Math.max(index[at + one], index[at + other]);
          if (low < high) found(low, high);
        }
    };
    each((low, high) => { begin[high + 1] += 1; });
    for (let at = 0; at < count; at++) begin[at + 1] += begin[at];
    const list = new Uint32Array(begin[count]), next = begin.slice();
    each((low, high) => { list[next[high]++] = low; });
    return { begin, list };
  }

  function restored(table, index) {
    const rows = joined(table), { columns } = table, count = rows.length / columns;
    const { begin, list } = earlier(index, count);
    for (let row = 0; row < count; row++)
      for (let column = 0; column < columns; column++) {
        let mean = row ? rows[(row - 1) * columns + column] : 0;
        const held = begin[row + 1] - begin[row];
        if (held) {
          let sum = 0;
          for (let at = begin[row]; at < begin[row + 1]; at++) sum += rows[list[at] * columns + column];
          mean = Math.floor(sum / held);
        }
        rows[row * columns + column] += mean;
      }
    return rows;
  }

  // Of triangles, the second and third vertex are given by how far they are from the first.
  function triangles(table) {
    const rows = restored(table, null);
    for (let at = 0; at < rows.length; at += 3) {
      rows[at + 1] += rows[at];
      rows[at + 2] += rows[at];
    }
    return new Uint32Array(rows.buffer);
  }

  return { inflated, loaded, restored, triangles };
})();
