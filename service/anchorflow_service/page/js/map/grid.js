/** A cost map in the contract's frame (row grows with y, column with x) and what is measured on it. */

import { clamp } from "../dom.js";

export const FREE = 0;
export const OCCUPIED = 1;
/** Unknown space of a ROS map; requests carry it as occupied. */
export const UNKNOWN = 2;

/** The channels of a cost map that make ground dear, each with its neutral value in requests. */
export const SOFT_LAYERS = { traversability: 1, risk: 0, further: 0 };
/** Soft costs are kept in hundredths. */
const WHOLE = 100;

/** m between the robot and an obstacle at the start and the goal that the page chooses. */
const SPARE = 0.12;
/** Way over distance up to which a detour makes a goal more interesting. */
const LONGEST_DETOUR = 1.3;

export class Grid {
  /**
   * @param {number} rows, columns  16 to 512 each
   * @param {number} resolution  m/cell
   * @param {number[]} origin  [2] m, outer corner of cell (0, 0); by default the map is centred on (0, 0)
   */
  constructor(rows, columns, resolution, origin = [(-columns * resolution) / 2, (-rows * resolution) / 2]) {
    Object.assign(this, { rows, columns, resolution, origin, cells: new Uint8Array(rows * columns) });
    /** {layer: hundredths of soft cost by cell}, of the layers that were painted. */
    this.soft = {};
  }

  /** A copy of all cells, for `restore`. */
  snapshot() {
    const soft = Object.entries(this.soft).map(([name, cells]) => [name, cells.slice()]);
    return { cells: this.cells.slice(), soft: Object.fromEntries(soft) };
  }

  restore({ cells, soft }) {
    this.cells.set(cells);
    this.soft = soft;
  }

  /** The soft cost of a cell from 0 to 1: its dearest layer. */
  softCost(index) {
    return Math.max(0, ...Object.values(this.soft).map((cells) => cells[index])) / WHOLE;
  }

  /** The soft cost of a cell in a layer, from 0 to 1. */
  softAt(layer, row, column) {
    return (this.soft[layer]?.[row * this.columns + column] ?? 0) / WHOLE;
  }

  /** Set the soft cost of a cell in a layer, from 0 to 1. */
  setSoft(layer, row, column, cost) {
    if (!this.contains(row, column)) return;
    this.soft[layer] ??= new Uint8Array(this.cells.length);
    this.soft[layer][row * this.columns + column] = Math.round(WHOLE * cost);
  }

  /** Width and height in m. */
  get size() {
    return [this.columns * this.resolution, this.rows * this.resolution];
  }

  /** [row, column] of a point in m, not rounded. */
  toCells(x, y) {
    return [(y - this.origin[1]) / this.resolution, (x - this.origin[0]) / this.resolution];
  }

  /** [x, y] in m of the middle of a cell. */
  centre(row, column) {
    const at = (index, axis) => this.origin[axis] + (index + 0.5) * this.resolution;
    return [at(column, 0), at(row, 1)];
  }

  contains(row, column) {
    return row >= 0 && column >= 0 && row < this.rows && column < this.columns;
  }

  /** The value of a cell; beyond the map everything is occupied. */
  at(row, column) {
    return this.contains(row, column) ? this.cells[row * this.columns + column] : OCCUPIED;
  }

  set(row, column, value) {
    if (this.contains(row, column)) this.cells[row * this.columns + column] = value;
  }

  /** m from a point to the edge of the nearest cell that is not free; 0 inside it. */
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

  /** The nearest point that is half a cell inside the edge of the map. */
  inside(x, y) {
    const half = this.resolution / 2;
    return [x, y].map((value, axis) => clamp(value, this.origin[axis] + half, this.origin[axis] + this.size[axis] - half));
  }

  /**
   * Set all cells whose middle is within `radius` m of the segment from a to b ([x, y] each): to a
   * value, or in a soft layer to a cost from 0 to 1.
   */
  stroke(a, b, radius, value, layer = null) {
    const [rowA, columnA] = this.toCells(...a);
    const [rowB, columnB] = this.toCells(...b);
    const reach = Math.max(radius / this.resolution, 0.5);
    const [dr, dc] = [rowB - rowA, columnB - columnA];
    const length2 = dr * dr + dc * dc || 1;
    for (let row = Math.floor(Math.min(rowA, rowB) - reach); row <= Math.max(rowA, rowB) + reach; row++) {
      for (let column = Math.floor(Math.min(columnA, columnB) - reach); column <= Math.max(columnA, columnB) + reach; column++) {
        const [r, c] = [row + 0.5 - rowA, column + 0.5 - columnA];
        const along = clamp((r * dr + c * dc) / length2, 0, 1);
        if (Math.hypot(r - along * dr, c - along * dc) > reach) continue;
        if (layer) this.setSoft(layer, row, column, value);
        else this.set(row, column, value);
      }
    }
  }

  /** The grid with all cells set whose middle is within `radius` m of the edge of one that is not free. */
  inflated(radius) {
    const wide = new Grid(this.rows, this.columns, this.resolution, this.origin);
    this.cells.forEach((cell, k) => {
      const middle = this.centre(Math.floor(k / this.columns), k % this.columns);
      if (cell) wide.stroke(middle, middle, radius + this.resolution / 2, OCCUPIED);
    });
    return wide;
  }

  /** Indices and distances in cells of the cells beside one, those across a corner included. */
  *neighbours(index) {
    const [row, column] = [Math.floor(index / this.columns), index % this.columns];
    for (let k = 0; k < 9; k++) {
      const [dr, dc] = [Math.floor(k / 3) - 1, (k % 3) - 1];
      if (k === 4 || !this.contains(row + dr, column + dc)) continue;
      yield [index + dr * this.columns + dc, Math.hypot(dr, dc)];
    }
  }

  /** Indices of the obstacle at a cell, joined by edges or corners. */
  obstacleAt(row, column) {
    if (!this.contains(row, column)) return [];
    return region(this, row * this.columns + column, (index) => this.cells[index] === OCCUPIED, 2);
  }

  /** [C][H][W] of `cost_map.data`: the occupancy, and further channels up to the last that was painted. */
  channels() {
    const names = Object.keys(SOFT_LAYERS);
    const painted = names.filter((name) => this.soft[name]?.some(Boolean));
    const soft = names.slice(0, names.indexOf(painted.at(-1)) + 1).map((name) => {
      const cells = this.soft[name] ?? new Uint8Array(this.cells.length);
      const neutral = SOFT_LAYERS[name];
      return this.#rows(cells, (cost) => Math.abs(neutral * WHOLE - cost) / WHOLE);
    });
    return [this.#rows(this.cells, (cell) => (cell ? 1 : 0)), ...soft];
  }

  /** [H][W] of values made from cells. */
  #rows(cells, toValue) {
    const row = (r) => cells.subarray(r * this.columns, (r + 1) * this.columns);
    return Array.from({ length: this.rows }, (_, r) => Array.from(row(r), toValue));
  }
}

/** Indices of the admissible cells that are joined to the first by steps of at most `step` cells. */
function region(grid, first, admissible, step, seen = new Uint8Array(grid.cells.length)) {
  if (seen[first] || !admissible(first)) return [];
  seen[first] = 1;
  const found = [first];
  for (const index of found) {
    for (const [next, cells] of grid.neighbours(index)) {
      if (cells > step || seen[next] || !admissible(next)) continue;
      seen[next] = 1;
      found.push(next);
    }
  }
  return found;
}

/**
 * Choose a start near a corner and a goal far from it, clear of obstacles and joined by a way.
 *
 * @param {{radius: number, reach: number, room: number}} robot  its radius, the longest way, and the room
 *   around its middle at both ends, m
 * @returns {{start: object, goal: object}}  {x, y, vx, vy} each, at rest
 */
export function placeEnds(grid, { radius, reach, room = radius }) {
  const blocked = grid.inflated(radius + SPARE);
  const seen = new Uint8Array(grid.cells.length);
  let joined = [];
  for (let first = 0; first < seen.length; first++) {
    const found = region(grid, first, (index) => !blocked.cells[index], 1, seen);
    if (found.length > joined.length) joined = found;
  }
  const point = (index) => {
    const [x, y] = grid.centre(Math.floor(index / grid.columns), index % grid.columns);
    return { x, y, vx: 0, vy: 0 };
  };
  if (!joined.length) return { start: point(0), goal: point(grid.cells.length - 1) };
  const tight = room > radius ? grid.inflated(room + SPARE) : blocked;
  const roomy = joined.filter((index) => !tight.cells[index]);
  const ends = roomy.length ? roomy : joined;
  const distance = (a, b) => Math.hypot(a.x - b.x, a.y - b.y);
  const [width, height] = grid.size;
  const corner = { x: grid.origin[0] + 0.1 * width, y: grid.origin[1] + 0.12 * height };
  const nearest = (best, index) => (distance(point(index), corner) < distance(point(best), corner) ? index : best);
  const first = ends.reduce(nearest);
  const start = point(first);
  const ways = wayLengths(grid, joined, first);
  const worth = (index) => Math.min(ways.get(index), LONGEST_DETOUR * distance(point(index), start));
  const goal = ends.reduce((best, index) => (ways.get(index) <= reach && worth(index) > worth(best) ? index : best), first);
  return { start, goal: point(goal) };
}

/** Length in m of the shortest way along edges and diagonals from one cell to each of a region. */
function wayLengths(grid, cells, start) {
  const lengths = new Map(cells.map((index) => [index, Infinity]));
  lengths.set(start, 0);
  const queue = [start];
  for (const index of queue) {
    for (const [next, step] of grid.neighbours(index)) {
      const there = lengths.get(index) + step * grid.resolution;
      if (!(there < (lengths.get(next) ?? -1) - 1e-9)) continue;
      lengths.set(next, there);
      queue.push(next);
    }
  }
  return lengths;
}
