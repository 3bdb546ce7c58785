/** A robot with an outline and wheels: its request, its scene file, its headings and what is drawn of it. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Anchors } from "../../../service/anchorflow_service/page/js/anchors.js";
import { RequestFields } from "../../../service/anchorflow_service/page/js/fields.js";
import { DISC, bodyOf, cornersOf, placed, posesAlong, radiiOf } from "../../../service/anchorflow_service/page/js/map/body.js";
import { Grid, OCCUPIED, placeEnds } from "../../../service/anchorflow_service/page/js/map/grid.js";
import { Plan, Stop } from "../../../service/anchorflow_service/page/js/map/robot.js";
import { Scene } from "../../../service/anchorflow_service/page/js/map/scene.js";
import { readScene, toJson } from "../../../service/anchorflow_service/page/js/map/scene_file.js";
import { pack } from "../../../service/anchorflow_service/page/js/service.js";
import { close, mapCard, range, references } from "./shared.js";

const fields = new RequestFields(references.openapi);
const bundles = { like: () => mapCard };
const FORKLIFT = { ...DISC, shape: "rectangle", length: 1, width: 0.6, behind: 0.3 };
const CORNERS = [[0.7, 0.3], [-0.3, 0.3], [-0.3, -0.3], [0.7, -0.3]];

function sceneOf(body, wheels = {}) {
  const scene = new Scene(fields);
  scene.useCard(mapCard);
  scene.body = body;
  scene.choose(Object.fromEntries(Object.entries(wheels).map(([name, value]) => [`kinematics.${name}`, value])));
  scene.useMap(new Grid(50, 60, 0.1), { start: { x: -2, y: 0, vx: 0, vy: 0, heading: 1.5 }, goal: { x: 2, y: 0, vx: 0, vy: 0 } });
  return scene;
}

test("a rectangle is sent as its corners, with headings and without a sampler", () => {
  const request = sceneOf(FORKLIFT).request();
  assert.deepEqual(request.footprint, CORNERS);
  assert.deepEqual(request.x_curr, [-2, 0, 1.5, 0, 0, 0, 0, 0, 0]);
  assert.deepEqual(request.x_goal, [2, 0, 0, 0, 0, 0]);
  assert.ok(!("sampler" in request) && !("kinematics" in request));
  assert.ok("sampler" in sceneOf(DISC).request());
  assert.equal(sceneOf(DISC).request().x_curr.length, 6);
});

test("wheels alone have a heading, and a car gets a turning radius", () => {
  const cart = sceneOf(DISC, { kind: "differential", omega_max: 2 }).request();
  assert.deepEqual(cart.kinematics, { kind: "differential", min_turning_radius: 0, omega_max: 2, reverse: false });
  assert.equal(cart.x_curr.length, 9);
  assert.ok(!("footprint" in cart));
  const { kinematics } = sceneOf(DISC, { kind: "ackermann", reverse: true }).request();
  assert.deepEqual([kinematics.min_turning_radius, kinematics.reverse], [0.8, true]);
  assert.deepEqual(sceneOf(FORKLIFT, { kind: "omni" }).request().kinematics, { kind: "omni" });
});

test("what means nothing to a body is hidden, and wheels stay when the bundle changes", () => {
  const scene = sceneOf(FORKLIFT, { kind: "differential" });
  for (const path of ["sampler.method", "refine.guidance", "robot_radius"]) assert.ok(scene.unused.includes(path));
  assert.ok(!scene.unused.includes("refine.certified_margin"));
  assert.deepEqual(sceneOf(DISC).unused, []);
  assert.equal(scene.hasFlow, false);
  scene.useCard(mapCard);
  assert.equal(scene.request().kinematics.kind, "differential");
});

test("the binary form has the footprint as a tensor", () => {
  const { header, tensors } = pack(sceneOf(FORKLIFT, { kind: "differential" }).request());
  const { inputs, parameters } = JSON.parse(new TextDecoder().decode(header));
  const at = inputs.findIndex(({ name }) => name === "footprint");
  assert.deepEqual(inputs[at].shape, [4, 2]);
  close(new Float64Array(tensors[at].buffer), CORNERS.flat());
  assert.equal(parameters["kinematics.kind"], "differential");
});

const open = (request) => readScene("a.json", JSON.stringify(request), mapCard, bundles, fields);

test("a saved body opens as it was", () => {
  const request = sceneOf(FORKLIFT, { kind: "ackermann", min_turning_radius: 1.2, reverse: true }).request();
  const { ends, body, options, left } = open(JSON.parse(toJson(request)));
  assert.deepEqual(left, []);
  assert.equal(ends.start.heading, 1.5);
  const again = sceneOf(body);
  Object.assign(again.options, options);
  again.useMap(new Grid(50, 60, 0.1), ends);
  assert.deepEqual(again.request(), request);
});

test("another outline than a rectangle is kept as a polygon, and a bad one is explained", () => {
  const triangle = [[0.5, 0], [-0.2, 0.3], [-0.2, -0.3]];
  const body = bodyOf(triangle);
  assert.deepEqual([body.shape, cornersOf(body)], ["polygon", triangle]);
  assert.deepEqual(bodyOf(undefined), DISC);
  const request = { ...sceneOf(FORKLIFT).request(), footprint: [[1, 2]] };
  assert.throws(() => open(request), { message: "a.json: footprint: expected corners [K,2] in m." });
});

test("an outline is placed by its pose, and has a disc inside it and one around it", () => {
  close(placed([[1, 0.5]], { x: 2, y: 3, heading: Math.PI / 2 })[0], [1.5, 4]);
  close(radiiOf(CORNERS), [0.3, Math.hypot(0.7, 0.3)]);
});

test("the ends of a new map have room for the outline", () => {
  const grid = new Grid(60, 60, 0.1);
  grid.stroke([-3, 0], [3, 0], 0.1, OCCUPIED);
  const { start, goal } = placeEnds(grid, { radius: 0.3, reach: 20, room: 0.8 });
  for (const { x, y } of [start, goal]) assert.ok(grid.gap(x, y) > 0.8);
  const near = placeEnds(grid, { radius: 0.3, reach: 20 });
  assert.ok([near.start, near.goal].some(({ x, y }) => grid.gap(x, y) < 0.8));
});

/** One anchor of 9 s: 3 s forwards along x, 3 s back, and 3 s of a turn. */
function backed() {
  const rates = range(10).map((t) => (t < 3 ? [1, 0, 0] : t < 6 ? [-1, 0, 0] : [0, 0, 0.5]));
  const poses = [[0, 0, 0]];
  for (const rate of rates.slice(0, -1)) poses.push(poses.at(-1).map((value, axis) => value + rate[axis]));
  const array = (rows) => ({ shape: [1, 10, 3], values: Float32Array.from(rows.flat()) });
  const answer = { trajectories: array(poses), velocities: array(rates), accelerations: array(range(10).map(() => [0, 0, 0])), dt: 1, seed: 0, timing_ms: {} };
  return new Anchors(answer, mapCard);
}

test("outlines along an anchor have a gear, and a cusp is where it changes", () => {
  const anchors = backed();
  assert.deepEqual(range(10).map((t) => anchors.gear(0, t)), [1, 1, 1, -1, -1, -1, 0, 0, 0, 0]);
  const { poses, cusps } = posesAlong(anchors, 0, 1);
  assert.deepEqual(cusps, [{ x: 2, y: 0, heading: 0 }]);
  assert.deepEqual(poses.map(({ x }) => x).slice(0, 7), [0, 1, 2, 3, 2, 1, 0]);
  close([poses.at(-1).heading], [1.5]);
  assert.ok(posesAlong(anchors, 0, 4).poses.length < poses.length);
});

test("a drive follows the heading, and a stop keeps it", () => {
  const plan = new Plan(backed(), 0);
  const { x, heading, turn, spin } = plan.at(7);
  close([x, heading, turn, spin], [0, 0.5, 0.5, 0]);
  const stop = new Stop(plan.at(1), { a_max: 1 });
  assert.equal(stop.at(0.1).heading, 0);
  assert.ok(!("heading" in new Stop({ x: 0, y: 0, vx: 1, vy: 0 }, { a_max: 1 }).at(0.1)));
});
