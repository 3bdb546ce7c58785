/** An occupancy grid in the contract's frame: row grows with y, column with x, metres outside. */

export const FREE = 0;
export const OCCUPIED = 1;
/** Unknown space of a ROS map; it is sent as occupied. */
export const UNKNOWN = 2;

export class Grid {
  /**
   * @param {number} rows, columns  16 to 512 each
   * @param {number} resolution  m/cell
   * @param {number[]} origin  [2] m, outer corner of cell (0, 0); centred on (0, 0) by default
   */
  constructor(rows, columns, resolution, origin = [(-columns * resolution) / 2, (-rows * resolution) / 2]) {
    Object.assign(this, { rows, columns, resolution, origin, cells: new Uint8Array(rows * columns) });
  }

  /** Width and height in m. */
  get size() {
    return [this.columns * this.resolution, this.rows * this.resolution];
  }

  /** Cell coordinates of a point in m, not rounded: [row, column]. */
  toCells(x, y) {
    return [(y - this.origin[1]) / this.resolution, (x - this.origin[0]) / this.resolution];
  }

  /** The middle of a cell, in m: [x, y]. */
  centre(row, column) {
    const at = (index, axis) => this.origin[axis] + (index + 0.5) * this.resolution;
    return [at(column, 0), at(row, 1)];
  }

  contains(row, column) {
    return row >= 0 && column >= 0 && row < this.rows && column < this.columns;
  }

  /** What lies there; beyond the map everything is occupied. */
  at(row, column) {
    return this.contains(row, column) ? this.cells[row * this.columns + column] : OCCUPIED;
  }

  set(row, column, value) {
    if (this.contains(row, column)) this.cells[row * this.columns + column] = value;
  }

  /** m from a point to the nearest obstacle; to the edge of its cell, 0 inside it. */
  gap(x, y) {
    const [row, column] = this.toCells(x, y);
    let nearest = Infinity;
    this.cells.forEach((cell, k) => {
      if (!cell) return;
      const dr = Math.max(0, Math.abs(row - Math.floor(k / this.columns) - 0.5) - 0.5);
      const dc = Math.max(0, Math.abs(column - (k % this.columns) - 0.5) - 0.5);
      nearest = Math.min(nearest, dr * dr + dc * dc);
    });
    return this.resolution * Math.sqrt(nearest);
  }

  /** The point inside the map that is nearest, half a cell off its edge. */
  inside(x, y) {
    const half = this.resolution / 2;
    return [x, y].map((value, axis) => {
      const low = this.origin[axis];
      return Math.min(low + this.size[axis] - half, Math.max(low + half, value));
    });
  }

  /** Fills all cells whose middle is within `radius` m of the segment from a to b ([x, y] each). */
  stroke(a, b, radius, value) {
    const [rowA, columnA] = this.toCells(...a);
    const [rowB, columnB] = this.toCells(...b);
    const reach = Math.max(radius / this.resolution, 0.5);
    const [dr, dc] = [rowB - rowA, columnB - columnA];
    const length2 = dr * dr + dc * dc || 1;
    for (let row = Math.floor(Math.min(rowA, rowB) - reach); row <= Math.max(rowA, rowB) + reach; row++) {
      for (let column = Math.floor(Math.min(columnA, columnB) - reach); column <= Math.max(columnA, columnB) + reach; column++) {
        const [r, c] = [row + 0.5 - rowA, column + 0.5 - columnA];
        const along = Math.min(1, Math.max(0, (r * dr + c * dc) / length2));
        if (Math.hypot(r - along * dr, c - along * dc) <= reach) this.set(row, column, value);
      }
    }
  }

  /** The cells [[row, column]] of the obstacle at a cell, joined by edges or corners. */
  obstacleAt(row, column) {
    if (this.at(row, column) !== OCCUPIED || !this.contains(row, column)) return [];
    const seen = new Set([row * this.columns + column]);
    const found = [[row, column]];
    for (const [r, c] of found) {
      for (let k = 0; k < 9; k++) {
        const [nr, nc] = [r - 1 + Math.floor(k / 3), c - 1 + (k % 3)];
        const index = nr * this.columns + nc;
        if (!this.contains(nr, nc) || this.cells[index] !== OCCUPIED || seen.has(index)) continue;
        seen.add(index);
        found.push([nr, nc]);
      }
    }
    return found;
  }

  /** [H][W] of 0 and 1, as `cost_map.data` wants one channel. */
  occupancy() {
    const row = (r) => this.cells.subarray(r * this.columns, (r + 1) * this.columns);
    return Array.from({ length: this.rows }, (_, r) => Array.from(row(r), (cell) => (cell ? 1 : 0)));
  }
}
