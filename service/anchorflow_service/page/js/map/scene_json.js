/** Scenes in and out: the JSON of POST /anchors is the file format, so that a file can be sent as it is. */

import { python, pythonArguments, pythonClient } from "../exchange.js";
import { Grid, OCCUPIED } from "./grid.js";
import { STYLES } from "./styles.js";

/** The scene as a file; one line a row of the map. */
export function toJson(request) {
  const rows = request.cost_map.data[0].map((row) => JSON.stringify(row)).join(",\n");
  const { cost_map: { data, ...place }, ...rest } = request;
  return `{"cost_map": {"data": [[\n${rows}]],\n${inner(place)}},\n${inner(rest)}}\n`;
}

const inner = (object) => JSON.stringify(object).slice(1, -1);

/** Fields that this page can ask. */
const CARRIED = ["cost_map", "x_curr", "x_goal", "w_style", "num_samples", "model", "seed", "robot_radius", "v_max", "a_max", "horizon_s", "sampler", "refine"];

/** The request of a file, without what is null: that is not given. Throws an Error. */
export function parse(text) {
  try {
    return JSON.parse(text, withoutNull) ?? {};
  } catch (cause) {
    throw new Error(`Expected a scene in JSON: ${cause.message}.`, { cause });
  }
}

function withoutNull(_, value) {
  return value === null && !Array.isArray(this) ? undefined : value;
}

/**
 * {grid, ends, options, left} of a request, D = `dim`; `left` names what of it this page cannot ask.
 * Throws an Error that names the field.
 */
export function fromRequest(request, dim) {
  const state = numbers(request.x_curr, "x_curr", 3 * dim);
  const goal = numbers(request.x_goal, "x_goal", 2 * dim);
  const end = (values) => ({ x: values[0], y: values[1], vx: values[dim], vy: values[dim + 1] });
  const start = { ...end(state), ax: state[2 * dim], ay: state[2 * dim + 1] };
  const grid = readGrid(request.cost_map);
  const options = readOptions(request);
  const left = Object.keys(request).filter((field) => !CARRIED.includes(field));
  if (request.sampler && options.sampler === "card") left.push("sampler");
  if (request.cost_map.data.length > 1) left.push("cost_map beyond its first channel");
  if (dim === 3) left.push("headings");
  return { grid, ends: { start, goal: end(goal) }, options, left };
}

function numbers(values, field, count) {
  const good = Array.isArray(values) && values.length === count && values.every(Number.isFinite);
  if (!good) throw new Error(`${field}: expected ${count} numbers, got ${describe(values)}.`);
  return values;
}

/** One number, or undefined where none is given. */
function number(value, field) {
  if (value !== undefined && !Number.isFinite(value)) throw new Error(`${field}: expected a number, got ${describe(value)}.`);
  return value;
}

function truth(value, field) {
  if (value !== undefined && typeof value !== "boolean") throw new Error(`${field}: expected true or false, got ${describe(value)}.`);
  return value;
}

function describe(value) {
  if (Array.isArray(value)) return `${value.length} values`;
  return value === undefined ? "nothing" : JSON.stringify(value).slice(0, 40);
}

function readGrid(map) {
  const channel = map?.data?.[0];
  const isRow = (row) => Array.isArray(row) && row.length === channel[0].length && row.every(Number.isFinite);
  const good = Array.isArray(channel) && channel.length > 0 && channel.every(isRow);
  if (!good) throw new Error("cost_map.data: expected [C,H,W], the occupancy in its first channel.");
  if (!(number(map.resolution, "cost_map.resolution") > 0)) throw new Error(`cost_map.resolution: expected more than 0 m, got ${describe(map.resolution)}.`);
  const origin = map.origin && numbers(map.origin, "cost_map.origin", 2);
  const grid = new Grid(channel.length, channel[0].length, map.resolution, origin);
  channel.forEach((row, r) => row.forEach((value, c) => { if (value >= 0.5) grid.set(r, c, OCCUPIED); }));
  return grid;
}

/** Weights that sum to 1; undefined where no style is given. */
function readStyle(asked) {
  if (asked === undefined) return undefined;
  if (typeof asked === "string" && !(asked in STYLES)) throw new Error(`w_style: expected ${Object.keys(STYLES).join(", ")} or weights, got ${describe(asked)}.`);
  const style = STYLES[asked] ?? numbers(asked, "w_style", 3);
  const sum = style.reduce((a, b) => a + b);
  if (!(sum > 0)) throw new Error(`w_style: expected weights above 0, got a sum of ${sum}.`);
  return style.map((weight) => weight / sum);
}

/** The options that a request gives; a schedule that is no uniform one is left to the bundle. */
function readOptions({ w_style: style, num_samples: num, seed, robot_radius: radius, v_max, a_max, horizon_s: horizon, sampler, refine = {} }) {
  const steps = number(sampler?.schedule?.uniform, "sampler.schedule.uniform");
  const read = {
    style: readStyle(style),
    num: number(num, "num_samples"),
    seed: number(seed, "seed"),
    radius: number(radius, "robot_radius"),
    v_max: number(v_max, "v_max"),
    a_max: number(a_max, "a_max"),
    horizon: number(horizon, "horizon_s"),
    fixed: horizon !== undefined,
    sampler: steps ? (sampler.method ?? "rk4") : "card",
    steps,
    margin: number(refine.safety_margin, "refine.safety_margin"),
    smooth: truth(refine.smooth, "refine.smooth"),
    project: truth(refine.project, "refine.project"),
    guidance: number(refine.guidance, "refine.guidance"),
    barrier: truth(refine.barrier, "refine.barrier"),
    certified: number(refine.certified_margin, "refine.certified_margin"),
  };
  return Object.fromEntries(Object.entries(read).filter(([, value]) => value !== undefined));
}

/** The same request for Python, with a map that one can read. */
export function toPython(request) {
  const { cost_map: map, ...rest } = request;
  // Written as one sees it: the top line is the map's last row.
  const lines = map.data[0].map((row) => row.map((cell) => (cell ? "#" : ".")).join("")).reverse();
  const { imports, opened } = pythonClient();
  return `${imports}import numpy as np
from anchorflow_client import AnchorClient

drawn = """
${lines.join("\n")}
""".split()
# Row 0 of a map has the smallest y, so the drawing is turned over.
occupancy = np.array([[cell == "#" for cell in row] for row in reversed(drawn)], float)

with ${opened} as client:
    anchors = client.plan(
        cost_map=occupancy,
        resolution=${python(map.resolution)},
        origin=${python(map.origin)},
${pythonArguments(rest, " ".repeat(8))}    )

print(f"{anchors.safe.sum()} of {anchors.safe.size} anchors are safe")
print(anchors.trajectories[anchors.best])
`;
}
