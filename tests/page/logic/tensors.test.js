/** Tensors: their JSON, their pictures, and recorded drives. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateSync } from "node:zlib";
import { BirdsEye, Street } from "../../../service/anchorflow_service/page/js/tensors/birds_eye.js";
import { DriveFile, InputMismatch } from "../../../service/anchorflow_service/page/js/tensors/drive_file.js";
import { filled, toPicture, unnest, unpack } from "../../../service/anchorflow_service/page/js/tensors/tensor.js";
import { close, range } from "./shared.js";

for (const [dtype, limits, value] of [
  ["float32", null, 0],
  ["uint8", [3, null], 3],
  ["int64", [null, -2], -2n],
  ["float64", [-1, 1], 0],
  ["bool", null, 0],
]) {
  test(`an input of ${dtype} that is not filled in has a value in its range`, () => {
    const sent = filled({ dtype, shape: ["B", 2, 70, "W"], range: limits });
    assert.deepEqual([sent.dtype, sent.shape], [dtype, [2, 70, 1]]);
    assert.deepEqual(Array.from(unpack(sent).values), Array(140).fill(value));
  });
}

test("nested lists become flat", () => {
  assert.deepEqual(unnest([[[1, 2]], [[3, 4]]]), { shape: [2, 1, 2], values: Float64Array.of(1, 2, 3, 4) });
  assert.deepEqual(unnest([5, 6]), { shape: [2], values: Float64Array.of(5, 6) });
});

/** Repeatable numbers from 0 to 1. */
const numbers = (count) => range(count).map((k) => Math.abs(Math.sin(12.9898 * k) * 43758.5453) % 1);
const rgb = (pixels) => range(pixels.length / 4).map((k) => Array.from(pixels.slice(4 * k, 4 * k + 3)));

test("a picture shows the strongest class", () => {
  const [values, palette] = [numbers(5 * 24), range(5).map((k) => [10 * k, 20 * k, 30 * k])];
  const { width, height, pixels, classes } = toPicture({ range: null }, { shape: [5, 4, 6], values }, palette);

  const strongest = range(24).map((k) => range(5).reduce((best, c) => (values[24 * c + k] > values[24 * best + k] ? c : best)));
  assert.deepEqual([width, height], [6, 4]);
  assert.deepEqual(rgb(pixels), strongest.map((c) => palette[c]));
  assert.deepEqual(classes, [...new Set(strongest)].sort());
});

test("layers cover each other by their values", () => {
  const [values, palette] = [numbers(4 * 15).map((value) => Math.round(255 * value)), [[10, 250, 30], [200, 20, 90]]];
  const { pixels } = toPicture({ range: [0, 255] }, { shape: [4, 3, 5], values }, palette, true);

  const expected = range(15).map((k) => range(4).reduce((mixed, c) => {
    return mixed.map((value, axis) => value + (values[15 * c + k] / 255) * (palette[c % 2][axis] - value));
  }, [0, 0, 0]));
  close(rgb(pixels).flat(), expected.flat(), 0.51);
});

test("three channels are colours, and one is grey over its range", () => {
  assert.deepEqual(rgb(toPicture({ range: [0, 255] }, { shape: [3, 1, 2], values: [1, 2, 3, 4, 5, 6] }, []).pixels), [[1, 3, 5], [2, 4, 6]]);
  assert.deepEqual(rgb(toPicture({ range: null }, { shape: [1, 1, 3], values: [-1, 0, 1] }, []).pixels), [[0, 0, 0], [128, 128, 128], [255, 255, 255]]);
});

test("x is up and y is to the left", () => {
  const at = (x, y) => BirdsEye.prototype.toScreen.call({ width: 400, height: 300, scale: 10, middle: 5 }, x, y);
  assert.deepEqual([at(0, 0), at(1, 0), at(0, 1)], [[200, 200], [200, 190], [190, 200]]);
});

test("a route runs through its places", () => {
  const points = [];
  const context = { save() {}, restore() {}, setLineDash() {}, beginPath() {}, stroke() {}, lineTo: (...point) => points.push(point) };
  const drive = { ego: [], map: { drivable: [], crosswalk: [], line: [], centre: [] }, extent: [] };
  globalThis.Path2D ??= class {};
  const eye = { context, colours: {}, toScreen: (x, y) => [50 - 10 * y, 90 - 10 * x] };

  new Street(drive).paintTraffic(eye, { boxes: [] }, [Float32Array.of(0, 0, 4, 0, 4, -4)]);

  assert.deepEqual(points, [[50, 90], [50, 50], [90, 50]]);
});

const bev = Uint8Array.from(range(24));
const drive = () => ({
  format: "anchorflow-drive",
  version: 1,
  bundle: "goalflow",
  inputs: [{ name: "bev", dtype: "uint8", shape: [2, 3, 4] }, { name: "ego_status", dtype: "float32", shape: [2] }],
  map: { drivable: [[0, 0, 1, 0, 1, 1]], crosswalk: [], line: [], centre: [] },
  ego: [1.5, 0, 0, 4.6, 1.9],
  frames: range(2).map((k) => ({
    time_s: k / 2, pose: [0, 0, 0], recorded: [[40 + k, 0, 0]], boxes: [], command: "left",
    inputs: { bev: { dtype: "uint8", shape: [2, 3, 4], zlib: deflateSync(bev).toString("base64") }, ego_status: [1, k] },
  })),
});
const card = {
  inputs: [
    { name: "bev", dtype: "uint8", shape: ["B", 2, 3, 4], unit: "", range: null },
    { name: "ego_status", dtype: "float32", shape: ["B", "L"], unit: "", range: null },
  ],
};

test("a frame of a drive has the inputs of the card", async () => {
  const file = new DriveFile(JSON.stringify(drive()), "cut.json");
  file.checkFits(card);
  const values = await file.values(1, card);

  assert.deepEqual(values.ego_status, [1, 1]);
  assert.deepEqual(unpack(values.bev).values, bev);
  close(file.extent, [-12, 1.3 * 41, -20, 20]);
});

test("a drive for another planner names the input", () => {
  const file = new DriveFile(JSON.stringify(drive()), "cut.json");
  const [first] = card.inputs;
  const camera = { ...first, name: "camera" };
  const larger = { ...first, shape: ["B", 2, 6, 4] };
  for (const [spec, message] of [
    [camera, "camera: the drive has no such input; it was made for goalflow, with bev, ego_status."],
    [larger, "bev: expected uint8 [2, 6, 4], the drive has uint8 [2, 3, 4]; it was made for goalflow."],
  ]) {
    assert.throws(() => file.checkFits({ inputs: [spec] }), (error) => error instanceof InputMismatch && error.message === message);
  }
});

for (const [damage, message] of [
  [(held) => { held.format = "scene"; }, "expected a drive that \"anchorflow data frames\" has made"],
  [(held) => { held.map = null; }, "map: expected an object."],
  [(held) => { delete held.map.line; }, "map: line: expected lists of numbers."],
  [(held) => { held.frames = []; }, "frames: expected a list of frames."],
  [(held) => { held.frames = [{}]; }, "frame 0: time_s: expected a number."],
  [(held) => { held.inputs = {}; }, "inputs: expected a list of name, dtype and shape."],
  [(held) => { held.ego = {}; }, "ego: expected 5 numbers."],
  [(held) => { held.frames[1].pose = ["a", null, 0]; }, "frame 1: pose: expected 3 numbers."],
  [(held) => { delete held.frames[0].boxes; }, "frame 0: boxes: expected a list of 6 numbers each."],
  [(held) => { delete held.frames[0].inputs.bev; }, "frame 0: bev: expected a value, got none."],
  [(held) => { held.frames[0].inputs.bev.dtype = "odd"; }, "frame 0: bev: expected dtype and shape of a tensor."],
  [(held) => { held.frames[0].inputs.bev.shape = [2, 3, 5]; }, "frame 0: bev: expected 30 bytes, got 24."],
  [(held) => { held.frames[0].inputs.bev.zlib = "%"; }, "frame 0: bev: expected deflated bytes in base64."],
  [(held) => { held.frames[0].inputs.bev.zlib = "AAAA"; }, "frame 0: bev: expected deflated bytes in base64."],
]) {
  test(`a broken drive is explained: ${message}`, async () => {
    const broken = drive();
    damage(broken);
    const read = async () => new DriveFile(JSON.stringify(broken), "cut.json").values(0, card);
    await assert.rejects(read, (error) => error.message.startsWith(`cut.json: ${message}`));
  });
}
