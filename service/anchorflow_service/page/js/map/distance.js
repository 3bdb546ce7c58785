/** Exact distances on a grid: for each cell, how far its middle is from the nearest obstacle. */

/** m from each cell's middle to the edge of the nearest cell that is not free; Float32Array. */
export function distanceField(grid) {
  const { rows, columns, cells, resolution } = grid;
  const far = 1e9;
  const squared = Float64Array.from(cells, (cell) => (cell ? 0 : far));
  for (let column = 0; column < columns; column++) envelope(squared, column, columns, rows);
  for (let row = 0; row < rows; row++) envelope(squared, row * columns, 1, columns);
  // The middle of a cell is half a cell away from its edge.
  return Float32Array.from(squared, (d) => resolution * Math.max(0, Math.sqrt(d) - 0.5));
}

/** Lower envelope of parabolas along one line, in place (Felzenszwalb and Huttenlocher, 2012). */
function envelope(values, offset, stride, count) {
  const line = Float64Array.from({ length: count }, (_, k) => values[offset + k * stride]);
  const apex = new Int32Array(count);
  const from = new Float64Array(count + 1);
  let last = 0;
  from[0] = -Infinity;
  from[1] = Infinity;
  for (let k = 1; k < count; k++) {
    const crossing = (i) => (line[k] + k * k - line[i] - i * i) / (2 * (k - i));
    while (crossing(apex[last]) <= from[last]) last--;
    from[last + 1] = crossing(apex[last]);
    apex[++last] = k;
    from[last + 1] = Infinity;
  }
  for (let k = 0, piece = 0; k < count; k++) {
    while (from[piece + 1] < k) piece++;
    values[offset + k * stride] = (k - apex[piece]) ** 2 + line[apex[piece]];
  }
}
