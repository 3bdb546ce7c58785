/** Requests: the fields of the form, scenes and their files, the binary form, and the planner. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { RequestFields, rangeOf } from "../../../service/anchorflow_service/page/js/fields.js";
import { Grid, OCCUPIED } from "../../../service/anchorflow_service/page/js/map/grid.js";
import { walk } from "../../../service/anchorflow_service/page/js/map/people.js";
import { STYLES, Scene } from "../../../service/anchorflow_service/page/js/map/scene.js";
import { readScene, toJson } from "../../../service/anchorflow_service/page/js/map/scene_file.js";
import { styleName, weightsAt } from "../../../service/anchorflow_service/page/js/map/style.js";
import { Planner } from "../../../service/anchorflow_service/page/js/planner.js";
import { pack } from "../../../service/anchorflow_service/page/js/service.js";
import { close, mapCard, range, references, tensorCard } from "./shared.js";

const fields = new RequestFields(references.openapi);
const named = (path, all = fields) => all.all.find((field) => field.path === path);

/** The schema with one more property of the request's body. */
function schemaWith(name, property) {
  const openapi = structuredClone(references.openapi);
  const body = openapi.paths["/anchors"].post.requestBody.content["application/json"].schema;
  openapi.components.schemas[body.$ref.split("/").at(-1)].properties[name] = property;
  return openapi;
}

for (const [path, ...expected] of [
  ["num_samples", "integer", 1, 512, "", "sampling"],
  ["sampler.schedule.uniform", "integer", 1, 100, "", "sampling"],
  ["robot_radius", "number", 0, 5, "m", "robot"],
  ["v_max", "number", 0, 100, "m/s", "robot"],
  ["a_max", "number", 0, 1000, "m/s²", "robot"],
  ["horizon_s", "number", 0, 600, "s", "robot"],
  ["refine.safety_margin", "number", 0, 5, "m", "finish"],
  ["refine.guidance", "number", 0, 100, "", "finish"],
  ["refine.certified_margin", "number", 0, 5, "m", "finish"],
  ["seed", "integer", 0, Number.MAX_SAFE_INTEGER, "", "seed"],
]) {
  test(`${path} has the range and the unit of the schema`, () => {
    const { kind, low, high, unit, block } = named(path);
    assert.deepEqual([kind, low, high, unit, block], expected);
  });
}

test("the form has switches and choices of the schema, and no fields for programs", () => {
  for (const name of ["smooth", "project", "barrier"]) assert.equal(named(`refine.${name}`).kind, "boolean");
  assert.ok(named("sampler.method").options.includes("midpoint"));
  assert.ok(!fields.all.some(({ path }) => /^(cost_map|warm_start|budget_ms|model)/.test(path)));
});

test("a scalar field that is added to the schema appears, is sent and is read", () => {
  const property = { anyOf: [{ type: "number", minimum: 0, maximum: 4 }, { type: "null" }], default: null, description: "Distance between axles.", "x-unit": "m" };
  const more = new RequestFields(schemaWith("wheel_base", property));

  const { label, unit, text, block } = named("wheel_base", more);
  assert.deepEqual([label, unit, text, block], ["Wheel base", "m", "Distance between axles.", "more"]);
  for (const card of [mapCard, tensorCard]) {
    assert.equal(more.defaults(card).wheel_base, null);
    assert.ok(!("wheel_base" in more.toRequest(more.defaults(card), card)));
    assert.equal(more.toRequest({ wheel_base: 2.5 }, card).wheel_base, 2.5);
  }
  assert.equal(more.fromRequest({ wheel_base: 2.5 }, mapCard).wheel_base, 2.5);
});

test("ranges are those of the card, and of the contract beside it", () => {
  assert.deepEqual(rangeOf(named("v_max"), mapCard), [0.2, 6]);
  const own = { ...mapCard, conditioning: { ...mapCard.conditioning, ranges: {} } };
  assert.equal(rangeOf(named("v_max"), own), null);
  assert.ok(!("v_max" in fields.toRequest({ v_max: 1 }, own)));
  assert.deepEqual(rangeOf(named("num_samples"), tensorCard), [1, 6]);
  assert.equal(fields.defaults(tensorCard).num_samples, 6);
});

test("a request has the values of the card, and a planner without a map only its own fields", () => {
  const { safety_margin, smooth, project, guidance, barrier, certified_margin } = mapCard.finish;
  const options = fields.defaults(mapCard);
  assert.deepEqual(fields.toRequest(options, mapCard), {
    num_samples: 64, seed: 0, robot_radius: 0.25, v_max: 2, a_max: 3, cost_penalty: 3, clear_start: false,
    refine: { smooth, project, safety_margin, guidance, barrier, certified_margin },
  });
  const solver = { "sampler.method": "heun", "sampler.schedule.uniform": 3 };
  assert.deepEqual(fields.toRequest({ ...options, ...solver }, mapCard).sampler, { method: "heun", schedule: { uniform: 3 } });
  assert.ok(!("sampler" in fields.toRequest({ ...options, ...solver, "sampler.method": null }, mapCard)));
  assert.deepEqual(Object.keys(fields.toRequest(fields.defaults(tensorCard), tensorCard)).sort(), ["num_samples", "seed"]);
});

test("the named styles are the contract's", () => {
  assert.deepEqual(STYLES, references.styles);
  assert.equal(styleName([0.2, 0.5, 0.3]), "efficient");
  assert.equal(styleName([0.2, 0.4995, 0.3005]), "efficient");
  assert.equal(styleName([0.5, 0.5, 0]), "custom");
});

test("the knob weighs the corners, and stays in the triangle", () => {
  assert.deepEqual(weightsAt(120, 26), [1, 0, 0]);
  assert.deepEqual(weightsAt(120, 186), [0, 0.5, 0.5]);
  assert.deepEqual(weightsAt(-100, 300), [0, 1, 0]);
});

function sceneFor(card) {
  const scene = new Scene(fields);
  scene.useCard(card);
  scene.useMap(new Grid(50, 60, 0.1), { start: { x: -2, y: 0, vx: 0.5, vy: 0, ax: 1, ay: 0 }, goal: { x: 2, y: 0, vx: 0, vy: 0 } });
  return scene;
}

test("a bundle with many evaluations is asked for two midpoint steps", () => {
  assert.deepEqual(sceneFor(mapCard).request().sampler, { method: "midpoint", schedule: { uniform: 2 } });
  const quick = { ...mapCard, sampler: { kind: "ode", method: "euler", schedule: [0, 1] } };
  assert.ok(!("sampler" in sceneFor(quick).request()));
});

test("a bundle with headings is asked with them", () => {
  const { x_curr, x_goal } = sceneFor({ ...mapCard, answer: tensorCard.answer }).request();
  assert.deepEqual(x_curr, [-2, 0, 0, 0.5, 0, 0, 1, 0, 0]);
  assert.deepEqual(x_goal, [2, 0, 0, 0, 0, 0]);
});

test("strokes are undone", () => {
  const scene = sceneFor(mapCard);
  assert.equal(scene.grid.gap(2, 0), Infinity);
  scene.remember();
  scene.grid.stroke([2.15, 0], [2.15, 0], 0.05, OCCUPIED);
  assert.ok(scene.grid.gap(2, 0) < 0.25);
  scene.undo();
  assert.equal(scene.grid.gap(2, 0), Infinity);
});

const bundles = { like: (name) => (["flowmp", "student"].includes(name) ? { ...mapCard, name } : undefined) };
const free = { data: [range(50).map(() => Array(60).fill(0))], resolution: 0.1 };
const place = { cost_map: free, x_curr: [-2, 0, 0.5, 0.25, 1, -0.5], x_goal: [2, 0, 0, 0] };
const open = (request) => readScene("a.json", typeof request === "string" ? request : JSON.stringify(request), mapCard, bundles, fields);

test("a saved scene opens as it was", () => {
  const scene = sceneFor(mapCard);
  scene.grid.stroke([0, 1], [0, 2], 0.1, OCCUPIED);
  scene.grid.stroke([0, -1], [0, -2], 0.1, 0.7, "traversability");
  scene.grid.stroke([1, -1], [1, -2], 0.1, 0.4, "risk");
  Object.assign(scene.options, { num_samples: 8, seed: 7, horizon_s: 20, "refine.barrier": true });
  scene.style = STYLES.efficient;
  scene.people = [{ x: 1, y: -2, vx: 0.5, vy: 0.25, radius: 0.3 }, { x: 0, y: 9, vx: 0, vy: 0, radius: 0.4 }];
  const request = scene.request();

  const { card, grid, ends, people, style, options, left } = open(toJson(request));
  const again = new Scene(fields);
  again.useCard(card);
  Object.assign(again.options, options);
  Object.assign(again, { style });
  again.useMap(grid, ends, people);

  assert.deepEqual(left, []);
  assert.deepEqual(request.obstacles, { position: [[1, -2], [0, 9]], velocity: [[0.5, 0.25], [0, 0]], radius: [0.3, 0.4] });
  assert.deepEqual(again.request(), request);
  assert.deepEqual(JSON.parse(toJson(request)), request);
});

test("soft costs are further channels, with the neutral values of the contract, and are undone", () => {
  const scene = sceneFor(mapCard);
  const at = ([channel]) => scene.request().cost_map.data.map((rows) => rows[25][30 + channel]);
  assert.equal(scene.request().cost_map.data.length, 1);
  scene.remember();
  scene.grid.stroke([0.05, 0.05], [0.05, 0.05], 0.05, 0.7, "traversability");
  assert.deepEqual(at([0]), [0, 0.3]);
  scene.grid.stroke([0.05, 0.05], [0.05, 0.05], 0.05, 0.9, "further");
  assert.deepEqual([at([0]), at([5])], [[0, 0.3, 0, 0.9], [0, 1, 0, 0]]);
  assert.equal(scene.grid.softCost(25 * 60 + 30), 0.9);
  scene.undo();
  assert.deepEqual(at([0]), [0]);
});

test("people come and go with undo, and leave with their map", () => {
  const scene = sceneFor(mapCard);
  scene.remember();
  scene.people.push({ x: 1, y: 1, vx: 0, vy: 0, radius: 0.3 });
  scene.remember();
  scene.people[0].vx = 1;
  scene.undo();
  assert.deepEqual(scene.request().obstacles.velocity, [[0, 0]]);
  scene.undo();
  assert.ok(!("obstacles" in scene.request()));
  scene.people.push({ x: 1, y: 1, vx: 0, vy: 0, radius: 0.3 });
  scene.useMap(new Grid(50, 60, 0.1));
  assert.deepEqual(scene.people, []);
});

test("people walk until a wall or the map's edge, and turn back there", () => {
  const grid = new Grid(50, 60, 0.1);
  grid.stroke([1, -2], [1, 2], 0.1, OCCUPIED);
  const people = [{ x: 0, y: 0, vx: 1, vy: 0.5 }, { x: 0, y: 2, vx: 0, vy: 1 }, { x: 0, y: 1, vx: 0, vy: 0 }];
  assert.equal(walk(people, 0.4, grid), false);
  close([people[0].x, people[0].y, people[1].y], [0.4, 0.2, 2.4]);
  assert.equal(walk(people, 0.6, grid), true);
  assert.deepEqual(people.map(({ vx, vy }) => [vx, vy]), [[-1, -0.5], [-0, -1], [0, 0]]);
  close([people[0].x, people[1].y], [0.4, 2.4]);
});

test("a forecast gives the velocity of its first leg, and what is left out is named", () => {
  const obstacles = { position: [[1, 2]], radius: [0.3], forecast: [[[1.5, 1], [9, 9]]], forecast_dt: 0.5, growth: 0.1 };
  const { people, left } = open({ ...place, obstacles });
  assert.deepEqual(people, [{ x: 1, y: 2, vx: 1, vy: -2, radius: 0.3 }]);
  assert.deepEqual(left, ["obstacles.forecast", "obstacles.growth"]);
});

test("a scene keeps its acceleration; null is not given", () => {
  const { ends, options, left } = open({ ...place, robot_radius: null, horizon_s: null, refine: null });
  assert.deepEqual(ends.start, { x: -2, y: 0, vx: 0.5, vy: 0.25, ax: 1, ay: -0.5 });
  assert.deepEqual([options, left], [{ "sampler.method": null }, []]);
});

test("what a scene has beyond the page is named", () => {
  const sampler = { method: "rk4", schedule: [0, 0.4, 1] };
  assert.deepEqual(open({ ...place, budget_ms: 500, sampler }).left, ["budget_ms", "sampler"]);
  assert.equal(open({ ...place, sampler: { schedule: { uniform: 3 } } }).options["sampler.method"], "rk4");
  assert.equal(open({ ...place, model: "student" }).card.name, "student");
  const unknown = open({ ...place, model: "v2x" });
  assert.deepEqual([unknown.card, unknown.left], [mapCard, ["model, as no v2x with a map is served"]]);
  const many = { ...free, data: Array(5).fill(free.data[0]), channel_weights: [1, 1, 1, 1] };
  assert.deepEqual(open({ ...place, cost_map: many }).left, ["cost_map beyond its channel 3", "cost_map.channel_weights"]);
});

for (const [request, message] of [
  ["{", "a.json: Expected a scene in JSON"],
  [{ x_curr: [1, 2] }, "a.json: x_curr: expected 6 numbers, got 2 values."],
  [{ ...place, x_curr: [0, 0, null, 0, 0, 0] }, "a.json: x_curr: expected 6 numbers"],
  [{ ...place, num_samples: "8" }, 'a.json: num_samples: expected a number, got "8".'],
  [{ ...place, robot_radius: [1] }, "a.json: robot_radius: expected a number, got 1 values."],
  [{ ...place, w_style: [1, 1] }, "a.json: w_style: expected 3 numbers, got 2 values."],
  [{ ...place, w_style: [0, 0, 0] }, "a.json: w_style: expected weights above 0"],
  [{ ...place, w_style: "fast" }, "a.json: w_style: expected conservative, balanced"],
  [{ ...place, refine: { smooth: 1 } }, "a.json: refine.smooth: expected true or false, got 1."],
  [{ ...place, obstacles: { position: [[0, 0]], radius: [0.3] } }, "a.json: obstacles.velocity: expected 2 numbers, got nothing."],
  [{ ...place, obstacles: { position: [[0, 0]], radius: [] } }, "a.json: obstacles.radius: expected as many as positions, got 0 values."],
  [{ ...place, sampler: { method: "magic" } }, "a.json: sampler.method: expected one of rk4"],
  [{ ...place, sampler: { schedule: { uniform: "2" } } }, 'a.json: sampler.schedule.uniform: expected a number, got "2".'],
  [{ ...place, cost_map: { data: [[[0, "x"]]], resolution: 0.1 } }, "a.json: cost_map.data: expected [C,H,W]"],
  [{ ...place, cost_map: { ...free, resolution: 0 } }, "a.json: cost_map.resolution: expected more than 0 m, got 0."],
  [
    { format: "anchorflow-drive", bundle: "goalflow" },
    "a.json is no scene but of the format anchorflow-drive: choose the bundle goalflow first.",
  ],
  [{ format: "anchorflow-drive" }, "a.json is no scene but of the format anchorflow-drive: choose the bundle that it is for first."],
]) {
  test(`a scene that cannot be read is explained: ${message}`, () => {
    assert.throws(() => open(request), (error) => error.message.startsWith(message));
  });
}

test("the binary form carries arrays as tensors and other fields by their path", () => {
  const warm_start = { trajectory: range(3).map((k) => [k, 0, 1, 0, 0, 0]), tau: 0.8, dt: 0.25 };
  const { header, tensors } = pack({ ...sceneFor(mapCard).request(), warm_start });
  const { inputs, parameters } = JSON.parse(new TextDecoder().decode(header));

  assert.equal(header.length % 64, 0);
  assert.deepEqual(inputs.map(({ name }) => name), ["x_curr", "x_goal", "w_style", "map_geometry", "warm_start", "cost_map"]);
  assert.deepEqual(inputs.map(({ parameters: { binary_data_size: size } }) => size), tensors.map(({ length }) => length));
  close(new Float64Array(tensors[0].buffer), [-2, 0, 0.5, 0, 1, 0]);
  const { "sampler.method": method, "refine.safety_margin": margin, "warm_start.tau": tau, v_max } = parameters;
  assert.deepEqual([method, margin, tau, v_max], ["midpoint", 0.1, 0.8, 2]);

  const scene = sceneFor(mapCard);
  scene.people = [{ x: 1, y: -2, vx: 0.5, vy: 0.25, radius: 0.3 }];
  scene.grid.stroke([0, 0], [0, 0], 0.1, 1, "risk");
  const asked = pack(scene.request());
  const tracks = JSON.parse(new TextDecoder().decode(asked.header)).inputs.slice(-4, -1);
  assert.deepEqual(tracks.map(({ name, shape }) => [name, shape]), [["obstacle_position", [1, 2]], ["obstacle_velocity", [1, 2]], ["obstacle_radius", [1]]]);
  close(new Float64Array(asked.tensors.at(-3).buffer), [0.5, 0.25]);
  const [map] = JSON.parse(new TextDecoder().decode(asked.header)).inputs.slice(-1);
  assert.deepEqual([map.name, map.shape, asked.tensors.at(-1).length], ["cost_map", [3, 50, 60], 3 * 50 * 60 * 4]);
});

test("a question that fails does not silence the planner", async () => {
  let asked = 0;
  const planner = new Planner({
    question: () => {
      asked++;
      throw new Error("no question");
    },
  });
  await assert.rejects(planner.ask(), { message: "no question" });
  await assert.rejects(planner.ask(), { message: "no question" });

  assert.deepEqual([asked, planner.busy], [2, false]);
});
