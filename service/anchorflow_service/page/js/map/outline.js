/** The outline of all cells of one kind, so that they are drawn without seams. */

/** A Path2D in cell units (x = column, y = row) round the cells that hold `value`. */
export function outline(grid, value) {
  const { rows, columns } = grid;
  const holds = (row, column) => grid.contains(row, column) && grid.at(row, column) === value;
  // Edges run with the inside on their left; a corner where two blocks touch has two of them.
  const width = columns + 1;
  const next = new Map();
  const edge = (rowA, columnA, rowB, columnB) => {
    const from = rowA * width + columnA;
    if (!next.has(from)) next.set(from, []);
    next.get(from).push(rowB * width + columnB);
  };
  for (let r = 0; r < rows; r++) {
    for (let c = 0; c < columns; c++) {
      if (!holds(r, c)) continue;
      if (!holds(r - 1, c)) edge(r, c, r, c + 1);
      if (!holds(r, c + 1)) edge(r, c + 1, r + 1, c + 1);
      if (!holds(r + 1, c)) edge(r + 1, c + 1, r + 1, c);
      if (!holds(r, c - 1)) edge(r + 1, c, r, c);
    }
  }
  const path = new Path2D();
  for (const first of next.keys()) {
    while (next.get(first).length) trace(path, next, first, width);
  }
  return path;
}

/** Walks one loop of edges and takes them out. */
function trace(path, next, first, width) {
  const loop = [first];
  for (let here = next.get(first).pop(); here !== first; here = next.get(here).pop()) loop.push(here);
  const straight = (k) => {
    const [before, here, after] = [loop.at(k - 1), loop[k], loop[(k + 1) % loop.length]];
    return here - before === after - here;
  };
  const corners = loop.filter((_, k) => !straight(k));
  corners.forEach((vertex, k) => {
    path[k ? "lineTo" : "moveTo"](vertex % width, Math.floor(vertex / width));
  });
  path.closePath();
}
