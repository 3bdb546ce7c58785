/** Finds a start and a goal on any map: clear of obstacles, joined by a way of a fair length. */

import { distanceField } from "./distance.js";

/** m between the robot and an obstacle at either end. */
const SPARE = 0.12;
/** Way over distance up to which a way round something is welcome. */
const LONGEST_DETOUR = 1.3;

/**
 * @param {Grid} grid
 * @param {{radius: number, reach: number}} robot  its radius, and the longest way it should need, m
 * @returns {{start: object, goal: object}}  {x, y, vx, vy} each, at rest
 */
export function placeEnds(grid, { radius, reach }) {
  const clear = distanceField(grid);
  const region = largestRegion(grid, (index) => clear[index] > radius + SPARE);
  const [width, height] = grid.size;
  const corner = [grid.origin[0] + 0.1 * width, grid.origin[1] + 0.12 * height];
  const point = (index) => {
    const [x, y] = grid.centre(Math.floor(index / grid.columns), index % grid.columns);
    return { x, y, vx: 0, vy: 0 };
  };
  if (!region.length) return { start: point(0), goal: point(grid.cells.length - 1) };
  const gap = (index) => Math.hypot(point(index).x - corner[0], point(index).y - corner[1]);
  const start = region.reduce((best, index) => (gap(index) < gap(best) ? index : best));
  const ways = wayLengths(grid, region, start);
  const from = point(start);
  const apart = (index) => Math.hypot(point(index).x - from.x, point(index).y - from.y);
  // Far away, and rather round a corner than straight on.
  const worth = (index) => Math.min(ways.get(index), LONGEST_DETOUR * apart(index));
  const goal = region.reduce((best, index) => {
    return ways.get(index) <= reach && worth(index) > worth(best) ? index : best;
  }, start);
  return { start: from, goal: point(goal) };
}

/** Indices of the largest set of admissible cells that are joined by edges. */
function largestRegion(grid, admissible) {
  const seen = new Uint8Array(grid.cells.length);
  let largest = [];
  for (let first = 0; first < seen.length; first++) {
    if (seen[first] || !admissible(first)) continue;
    const region = [first];
    seen[first] = 1;
    for (const index of region) {
      for (const [next] of neighbours(grid, index)) {
        if (seen[next] || !admissible(next)) continue;
        seen[next] = 1;
        region.push(next);
      }
    }
    if (region.length > largest.length) largest = region;
  }
  return largest;
}

/** Length in m of the shortest way along edges and diagonals from one cell to each of a region. */
function wayLengths(grid, region, start) {
  const lengths = new Map(region.map((index) => [index, Infinity]));
  // A bucket a tenth of a cell wide holds what is due next.
  const buckets = [[start]];
  lengths.set(start, 0);
  for (let due = 0; due < buckets.length; due++) {
    for (const index of buckets[due] ?? []) {
      const here = lengths.get(index);
      if (Math.round((10 * here) / grid.resolution) !== due) continue;
      for (const [next, cells] of neighbours(grid, index, true)) {
        const there = here + cells * grid.resolution;
        if (!(there < (lengths.get(next) ?? -1) - 1e-9)) continue;
        lengths.set(next, there);
        (buckets[Math.round((10 * there) / grid.resolution)] ??= []).push(next);
      }
    }
  }
  return lengths;
}

/** Indices beside a cell, and how many cells away their middles are. */
function* neighbours(grid, index, diagonal = false) {
  const [row, column] = [Math.floor(index / grid.columns), index % grid.columns];
  for (let dr = -1; dr <= 1; dr++) {
    for (let dc = -1; dc <= 1; dc++) {
      const corner = dr && dc;
      if ((!dr && !dc) || (corner && !diagonal) || !grid.contains(row + dr, column + dc)) continue;
      yield [index + dr * grid.columns + dc, corner ? Math.SQRT2 : 1];
    }
  }
}
