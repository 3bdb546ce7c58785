/** Sample maps of 96 × 96 cells of 0.1 m, drawn from a seed. */

import { FREE, Grid, OCCUPIED } from "./grid.js";

const CELLS = 96;
const RESOLUTION = 0.1;
/** Radius and shift of a post, in cells. */
const POSTS = [[1.6, 0], [1.6, 0.5], [2.3, 0]];

/** The map of a kind (forest, rooms, city, maze or empty) with this number. */
export function sampleMap(kind, number) {
  const grid = new Grid(CELLS, CELLS, RESOLUTION);
  LAYOUTS[kind](new Pen(grid, number));
  return grid;
}

/** A generator of numbers from 0 to 1 (mulberry32). */
function randomNumbers(seed) {
  let state = (seed + 1) * 0x9e3779b9;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

/** Draws on a grid, in cells. */
class Pen {
  constructor(grid, seed) {
    this.grid = grid;
    this.random = randomNumbers(seed);
  }

  between(low, high) {
    return low + (high - low) * this.random();
  }

  /** A whole number from low to high, both included. */
  whole(low, high) {
    return Math.floor(this.between(low, high + 1));
  }

  box(row, column, rows, columns, value = OCCUPIED) {
    for (let r = row; r < row + rows; r++) {
      for (let c = column; c < column + columns; c++) this.grid.set(r, c, value);
    }
  }

  disc(row, column, radius, value = OCCUPIED) {
    const centre = this.grid.centre(row, column);
    this.grid.stroke(centre, centre, radius * this.grid.resolution, value);
  }
}

/** Posts clumped by a cellular automaton, like the worlds of BARN (Perille et al., 2020). */
function forest(pen) {
  const count = 24;
  const share = pen.between(0.17, 0.23);
  const seeds = new Grid(count, count, 1);
  seeds.cells.forEach((_, index) => { seeds.cells[index] = pen.random() < share; });
  seeds.cells.forEach((on, index) => {
    const crowd = [...seeds.neighbours(index)].filter(([next]) => seeds.cells[next]).length;
    if (crowd < (on ? 2 : 5)) return;
    const [row, column] = [Math.floor(index / count), index % count].map((k) => 4 * k + 2 + pen.whole(-1, 1));
    // Around the middle or the corner of a cell: three discs of 9, 12 and 21 cells.
    const [radius, shift] = POSTS[pen.whole(0, POSTS.length - 1)];
    pen.disc(row + shift, column + shift, radius);
  });
}

/** A house cut into rooms, with a door in every wall and some tables. */
function rooms(pen) {
  pen.box(0, 0, CELLS, CELLS);
  pen.box(2, 2, CELLS - 4, CELLS - 4, FREE);
  divide(pen, 2, 2, CELLS - 4, CELLS - 4);
}

const SMALLEST_ROOM = 26;
const DOOR = 12;

function divide(pen, row, column, rows, columns) {
  const across = rows >= columns;
  const [extent, span] = across ? [rows, columns] : [columns, rows];
  if (extent < 2 * SMALLEST_ROOM) {
    if (pen.random() < 0.6) pen.box(row + pen.whole(9, rows - 16), column + pen.whole(9, columns - 16), pen.whole(4, 7), pen.whole(4, 7));
    return;
  }
  /** [row, column, rows, columns] of a box: from `at` along the extent, from `from` along the wall. */
  const part = (at, depth, from = 0, width = span) => (across ? [row + at, column + from, depth, width] : [row + from, column + at, width, depth]);
  // A wall must not end in a door.
  const solid = (cut, beside) => Array.from({ length: 12 }, (_, k) => pen.grid.at(...part(cut - 5 + k, 1, beside))).every(Boolean);
  let cut;
  for (let tries = 0; tries < 30; tries++) {
    cut = pen.whole(SMALLEST_ROOM, extent - SMALLEST_ROOM);
    if (solid(cut, -1) && solid(cut, span)) break;
  }
  const door = pen.whole(5, span - DOOR - 5);
  pen.box(...part(cut, 2));
  pen.box(...part(cut, 2, door, DOOR), FREE);
  divide(pen, ...part(0, cut));
  divide(pen, ...part(cut + 2, extent - cut - 2));
}

/** Buildings between streets: whole blocks, blocks with a corner cut off, yards, open squares. */
function city(pen) {
  const streets = () => {
    const built = [];
    for (let at = pen.whole(-8, 8); at < CELLS - 4; ) {
      const depth = pen.whole(14, 27);
      built.push([at, depth]);
      at += depth + pen.whole(9, 14);
    }
    return built;
  };
  const columns = streets();
  for (const [row, rows] of streets()) {
    for (const [column, width] of columns) {
      const kind = pen.random();
      if (kind < 0.1) continue;
      pen.box(row, column, rows, width);
      if (kind < 0.4) pen.box(row + pen.whole(0, 1) * 8, column + pen.whole(0, 1) * 8, rows - 8, width - 8, FREE);
      else if (kind < 0.6) pen.disc(row + pen.whole(0, 1) * rows, column + pen.whole(0, 1) * width, pen.between(6, 10), FREE);
    }
  }
}

/** A spanning tree of corridors, with some more walls removed. */
function maze(pen) {
  const count = 6;
  const pitch = CELLS / count;
  const open = new Set();
  const wall = (a, b) => `${Math.min(a, b)}-${Math.max(a, b)}`;
  const seen = new Set([0]);
  const way = [0];
  while (way.length) {
    const here = way.at(-1);
    const beside = [here - count, here + count, here % count ? here - 1 : -1, (here + 1) % count ? here + 1 : -1];
    const fresh = beside.filter((next) => next >= 0 && next < count * count && !seen.has(next));
    if (!fresh.length) {
      way.pop();
      continue;
    }
    const next = fresh[pen.whole(0, fresh.length - 1)];
    open.add(wall(here, next));
    seen.add(next);
    way.push(next);
  }
  for (let cell = 0; cell < count * count; cell++) {
    const [row, column] = [Math.floor(cell / count), cell % count];
    const stands = (next) => !open.has(wall(cell, next)) && pen.random() > 0.22;
    if (column + 1 < count && stands(cell + 1)) pen.box(row * pitch - 1, (column + 1) * pitch - 1, pitch + 2, 2);
    if (row + 1 < count && stands(cell + count)) pen.box((row + 1) * pitch - 1, column * pitch - 1, 2, pitch + 2);
  }
}

const LAYOUTS = { forest, rooms, city, maze, empty() {} };
