/** Anchors: their figures, their lines on a canvas, and a robot that follows one. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Anchors } from "../../../service/anchorflow_service/page/js/anchors.js";
import { figure } from "../../../service/anchorflow_service/page/js/dom.js";
import { pick, toScreen } from "../../../service/anchorflow_service/page/js/drawing.js";
import { Plan, Stop } from "../../../service/anchorflow_service/page/js/map/robot.js";
import { close, range } from "./shared.js";

const tensor = (shape, values) => ({ shape, values: Float32Array.from(values) });

test("the curvature is that of a circle, and its limit what a_max allows", () => {
  const angles = range(16).map((k) => (2 * k) / 15);
  const ring = (radius, shift = 0) => tensor([1, 16, 2], angles.flatMap((angle) => [radius * Math.cos(angle + shift), radius * Math.sin(angle + shift)]));
  const limits = { a_max: 3, v_max: 2, horizon_s: 8 };
  const answer = {
    trajectories: ring(2),
    velocities: ring(1.5, Math.PI / 2),
    accelerations: ring(1.5 ** 2 / 2, Math.PI),
    scores: tensor([1], [-1]),
    clearance: tensor([1], [0.3]),
    safe: tensor([1], [1]),
    dt: 0.1,
  };

  const anchors = new Anchors(answer, { conditioning: { limits } });

  close(anchors.curvature(0), Array(16).fill(0.5), 1e-5);
  close(anchors.curvatureLimit(0), Array(16).fill(3 / 1.5 ** 2), 1e-5);
  close([anchors.length(0)], [4], 0.01);
  assert.equal(anchors.reason, "");
  assert.equal(new Anchors({ ...answer, reason: "no way" }, { conditioning: { limits } }).reason, "no way");
});

for (const [dt, first, durations, text, isOwn] of [
  [0.5, 0, [2, 2, 2], "2.0 s", false],
  [0.5, 0.5, [2.5, 2.5, 2.5], "2.5 s", false],
  [{ shape: [3], values: Float64Array.of(1, 2, 3) }, 0, [4, 8, 12], "4.0 to 8.0 s", true],
  [[1, 2, 3], 0, [4, 8, 12], "4.0 to 8.0 s", true],
]) {
  test(`anchors last ${text} with dt ${JSON.stringify(dt)}`, () => {
    const answer = { trajectories: tensor([3, 5, 2], Array(30).fill(0)), safe: tensor([3], [1, 1, 0]), dt, first_s: first };
    const anchors = new Anchors(answer, { conditioning: { limits: { v_max: 2 } } });

    close(range(3).map((n) => anchors.duration(n)), durations);
    assert.deepEqual([anchors.durationsText, anchors.hasOwnTime], [text, isOwn]);
    assert.equal(anchors.time(1, 4), durations[1]);
    assert.deepEqual(anchors.at(1, 1e3), { x: 0, y: 0, vx: 0, vy: 0 });
  });
}

test("an anchor is where it is at a time", () => {
  const answer = { trajectories: tensor([2, 3, 2], [...Array(6).fill(9), 0, 0, 1, 2, 1, 6]), dt: [9, 0.5] };
  const anchors = new Anchors(answer, { conditioning: { limits: { v_max: 2 } } });

  assert.deepEqual(anchors.at(1, 0.25), { x: 0.5, y: 1, vx: 2, vy: 4 });
  assert.deepEqual(anchors.at(1, 0.75), { x: 1, y: 4, vx: 0, vy: 8 });
  assert.deepEqual(anchors.at(1, 7), { x: 1, y: 6, vx: 0, vy: 8 });
});

test("a plan runs through its samples and is smooth between them", () => {
  const rows = (value) => Float32Array.from(range(9).flatMap((k) => value(k / 2)));
  const motion = {
    positions: rows((t) => [t ** 3 - 2 * t, t ** 2 / 2]),
    velocities: rows((t) => [3 * t ** 2 - 2, t]),
    accelerations: rows((t) => [6 * t, 1]),
  };
  const plan = new Plan({ steps: 9, dts: [0.5], safe: [true], ...motion }, 0);

  for (const t of range(37).map((k) => k / 9)) {
    // Cubic polynomials between the samples give a cubic motion back exactly.
    close(Object.values(plan.at(t)), [t ** 3 - 2 * t, t ** 2 / 2, 3 * t ** 2 - 2, t, 6 * t, 1], 1e-4);
  }
});

for (const [hasOwnTime, dt] of [[true, 1.5 / 8], [false, 0.25]]) {
  test(`the rest of a plan is a warm start ${hasOwnTime ? "in its own time" : "up to the horizon"}`, () => {
    const line = (x) => range(18).map((k) => (k % 2 ? 0 : x(k / 2)));
    const both = (x) => Float32Array.from([...line(() => 0), ...line(x)]);
    const motion = { positions: both((t) => 0.5 * t), velocities: both(() => 2), accelerations: both(() => 0) };

    const warm = new Plan({ steps: 9, hasOwnTime, dts: [1, 0.25], safe: [true, true], ...motion }, 1).rest(0.5);

    // Half a second and 1 m of 2 s and 4 m are over.
    close([warm.dt], [dt]);
    close(warm.trajectory.map(([x]) => x), range(9).map((k) => Math.min(1 + 2 * dt * k, 4)), 1e-4);
    close(warm.trajectory.map(([, , vx]) => vx), Array(9).fill(2), 1e-4);
  });
}

test("a robot that brakes comes to rest within its limit", () => {
  const stop = new Stop({ x: 1, y: 2, vx: 0, vy: 2 }, { a_max: 3 });
  const states = range(41).map((k) => stop.at(k / 20));
  const pull = Math.max(...states.map(({ ay }) => Math.abs(ay)));

  for (const { x, vx, ax } of states) close([x, vx, ax], [1, 0, 0]);
  assert.ok(pull <= 3);
  close([states[40].y, states[40].vy], [2 + 2 ** 2 / (2 * pull), 0]);
  for (const k of range(14)) close([states[k + 1].y - states[k].y], [(0.05 * (states[k].vy + states[k + 1].vy)) / 2]);
});

test("only the line near the pointer is picked", () => {
  const line = (y) => range(5).flatMap((t) => [t, y]);
  const anchors = { count: 2, steps: 5, positions: Float32Array.from([...line(0), ...line(1)]) };
  const surface = { toScreen: (x, y) => [100 * x, 500 - 100 * y] };

  assert.deepEqual(pick(surface, anchors, 310, 405), { anchor: 1, step: 3 });
  assert.deepEqual(pick(surface, anchors, 90, 490), { anchor: 0, step: 1 });
  assert.equal(pick(surface, anchors, 200, 450), null);
});

for (const metres of [0, 5e6]) {
  test(`lines lie where single points do, ${metres} m from the origin`, () => {
    const points = [0, 0, 3, -4, -2.5, 7].map((value) => value + metres);
    const surface = { toScreen: (x, y) => [200 - 50 * (y - metres), 100 - 50 * (x - metres)] };

    close(toScreen(surface, Float64Array.from(points)), [200, 100, 400, -50, -150, 225], 1e-3);
  });
}

for (const [value, all, text] of [
  [1.84e-11, [1.84e-11, 0], "1.8e−11"],
  [0, [1.84e-11, 0], "0.00"],
  [-0.00456, [-0.00456, 0.001], "−0.0046"],
  [0.00456, [0.00456, -0.01], "0.00"],
  [0.00456, null, "0.00"],
  [-1.234, [-1.234], "−1.23"],
  [-0.004, null, "0.00"],
  [-12.5, null, "−12.50"],
]) {
  test(`${value} among ${JSON.stringify(all)} is written ${text}`, () => assert.equal(figure(value, 2, all), text));
}
