/** Maps: grids, samples, ends, and files. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { FREE, Grid, OCCUPIED, placeEnds } from "../../../service/anchorflow_service/page/js/map/grid.js";
import { readMap, readYaml } from "../../../service/anchorflow_service/page/js/map/map_files.js";
import { sampleMap } from "../../../service/anchorflow_service/page/js/map/samples.js";
import { close, range, references } from "./shared.js";

const KINDS = ["forest", "rooms", "city", "maze", "empty"];
const file = (name, ...parts) => new File(parts, name);

test("a grid is inflated by distances of SciPy", () => {
  const { occupied, resolution, radius, inflated } = references.distances;
  const grid = new Grid(occupied.length, occupied[0].length, resolution);
  occupied.forEach((row, r) => row.forEach((cell, c) => grid.set(r, c, cell ? OCCUPIED : FREE)));

  assert.deepEqual(grid.inflated(radius).channels()[0], inflated);
  const [x, y] = grid.centre(3, 4);
  assert.ok(grid.gap(x, y) === 0 && grid.gap(x, y + 0.15) <= 0.05 + 1e-9);
});

for (const kind of KINDS) {
  test(`samples of ${kind} repeat and differ`, () => {
    const [one, again, another] = [1, 1, 2].map((number) => sampleMap(kind, number));

    assert.deepEqual([one.rows, one.columns], [96, 96]);
    assert.deepEqual(one.cells, again.cells);
    if (kind !== "empty") assert.notDeepEqual(one.cells, another.cells);
    assert.ok(one.cells.filter(Boolean).length < 0.6 * one.cells.length);
  });

  test(`start and goal in ${kind} are clear and joined`, () => {
    for (const number of range(4)) {
      const grid = sampleMap(kind, number);
      const { start, goal } = placeEnds(grid, { radius: 0.25, reach: 8 });
      const blocked = grid.inflated(0.25);
      const [from, to] = [start, goal].map(({ x, y }) => {
        const [row, column] = grid.toCells(x, y).map(Math.floor);
        return row * grid.columns + column;
      });
      const reached = new Set([from]);
      for (const index of reached) {
        for (const [next] of grid.neighbours(index)) if (!blocked.cells[next]) reached.add(next);
      }

      assert.ok(grid.gap(start.x, start.y) > 0.25 && grid.gap(goal.x, goal.y) > 0.25);
      assert.ok(reached.has(to));
      const gap = Math.hypot(goal.x - start.x, goal.y - start.y);
      assert.ok(gap > 3 && gap <= 8);
    }
  });
}

test("a stroke fills what is near it, and an obstacle is what is joined", () => {
  const grid = new Grid(20, 20, 0.1);
  grid.stroke([-0.5, 0], [0.5, 0], 0.05, OCCUPIED);
  grid.stroke([0, 0.8], [0, 0.8], 0.01, OCCUPIED);

  const [row, column] = grid.toCells(0, 0).map(Math.floor);
  const found = grid.obstacleAt(row, column);
  assert.ok(found.length >= 10);
  assert.equal(found.length, grid.cells.filter(Boolean).length - grid.obstacleAt(18, 10).length);
  assert.deepEqual(grid.obstacleAt(0, 0), []);
  assert.deepEqual(grid.obstacleAt(-1, 0), []);
});

for (const [k, { yaml, picture, occupied, resolution, origin }] of references.maps.entries()) {
  test(`ROS map ${k} is read as the command line reads it`, async () => {
    const others = file("0.pgm", "P5\n2 2\n255\n\0\0\0\0");
    const { grid, note } = await readMap([others, file("a.pgm", Buffer.from(picture, "base64")), file("map.yaml", yaml)]);

    assert.deepEqual(grid.channels()[0], occupied);
    assert.equal(grid.resolution, resolution);
    close(grid.origin, origin);
    assert.match(note, /^a\.pgm: 5\.0 × 4\.0 m/);
  });
}

for (const { yaml, message } of references.refusals) {
  test(`a ROS map is refused as the command line refuses it: ${message}`, () => {
    assert.throws(() => readYaml(yaml, "map.yaml"), (error) => error.message.split(", got ")[0] === message);
  });
}

test("a large map loses no obstacle", async () => {
  const pixels = Buffer.alloc(400 * 500, 254);
  pixels[200 * 500 + 250] = 0;
  const { grid } = await readMap([file("large.pgm", "P5\n500 400\n255\n", pixels)]);

  assert.ok(Math.max(grid.rows, grid.columns) <= 160);
  close([grid.resolution], [0.2]);
  // The row of a pixel counts from the top.
  const at = Math.floor((399 - 200) / 4) * grid.columns + Math.floor(250 / 4);
  assert.deepEqual([...grid.cells.keys()].filter((k) => grid.cells[k] === OCCUPIED), [at]);
});

test("a map of 100 million pixels is read", async () => {
  const pixels = Buffer.alloc(10_000 * 10_000, 254);
  pixels[9_999 * 10_000 + 5_000] = 0;
  const { grid } = await readMap([file("large.pgm", "P5\n10000 10000\n255\n", pixels)]);

  assert.ok(Math.max(grid.rows, grid.columns) <= 160);
  assert.deepEqual([...grid.cells.keys()].filter((k) => grid.cells[k] === OCCUPIED), [Math.floor(5_000 / 63)]);
});

const pngHead = (width, height) => {
  const head = Buffer.from("89504e470d0a1a0a0000000d494844520000000000000000", "hex");
  head.writeUInt32BE(width, 16);
  head.writeUInt32BE(height, 20);
  return head;
};

for (const [files, message] of [
  [{ "map.yaml": references.maps[0].yaml }, "map.yaml names the picture a.pgm: choose both files together."],
  [{ "map.yaml": references.maps[0].yaml, "b.pgm": "P5" }, "map.yaml names the picture a.pgm"],
  [{ "a.pgm": "P6\n1 1\n255\n..." }, "a.pgm: expected a PGM picture"],
  [{ "a.pgm": "P5\n100 100\n255\nshort" }, "a.pgm: expected 100 × 100 pixels, but the file ends before"],
  [{ "a.pgm": "P2\n2 2\n255\n1 2 3" }, "a.pgm: expected 2 × 2 numbers"],
  [{ "a.pgm": "P2\n100000 100000\n255\n0" }, "a.pgm: expected at most 128 million pixels, got 100000 × 100000."],
  [{ "a.pgm": `P2\n4 4\n100\n${"50 ".repeat(16)}` }, "a.pgm: every cell of this map is unknown."],
  [{ "a.png": "no picture" }, "a.png: expected a PNG picture"],
  [{ "a.png": pngHead(16001, 8000) }, "a.png: expected at most 128 million pixels, got 16001 × 8000."],
  [{ "a.png": pngHead(200000, 4000) }, "a.png: expected at most 128 million pixels, got 200000 × 4000."],
  [
    { "map.yaml": "# a map\n--- {image: a.pgm,\nresolution: 0.1}\n", "a.pgm": "P2" },
    "map.yaml: expected a line for each field; a flow mapping, {…}, is not read here.",
  ],
]) {
  test(`a map that cannot be read is explained: ${message}`, async () => {
    const given = Object.entries(files).map(([name, content]) => file(name, content));
    await assert.rejects(readMap(given), (error) => error.message.startsWith(message));
  });
}
