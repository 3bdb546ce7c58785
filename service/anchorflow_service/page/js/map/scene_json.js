/** Scenes in and out: the JSON of POST /anchors is the file format, so that a file can be sent as it is. */

import { python, pythonArguments, serviceUrl } from "../exchange.js";
import { Grid, OCCUPIED } from "./grid.js";
import { STYLES } from "./styles.js";

/** The scene as a file; one line a row of the map. */
export function toJson(request) {
  const rows = request.cost_map.data[0].map((row) => JSON.stringify(row)).join(",\n");
  const { cost_map: { data, ...place }, ...rest } = request;
  return `{"cost_map": {"data": [[\n${rows}]],\n${inner(place)}},\n${inner(rest)}}\n`;
}

const inner = (object) => JSON.stringify(object).slice(1, -1);

/** {grid, ends, options} of a request's JSON, D = `dim`. Throws an Error that names the field. */
export function fromJson(text, dim) {
  let request;
  try {
    request = JSON.parse(text);
  } catch (cause) {
    throw new Error(`Expected a scene in JSON: ${cause.message}.`, { cause });
  }
  const state = numbers(request?.x_curr, "x_curr", 3 * dim);
  const goal = numbers(request?.x_goal, "x_goal", 2 * dim);
  const end = (values) => ({ x: values[0], y: values[1], vx: values[dim], vy: values[dim + 1] });
  return { grid: readGrid(request.cost_map), ends: { start: end(state), goal: end(goal) }, options: readOptions(request) };
}

function numbers(values, field, count) {
  const good = Array.isArray(values) && values.length === count && values.every(Number.isFinite);
  if (!good) throw new Error(`${field}: expected ${count} numbers, got ${describe(values)}.`);
  return values;
}

function describe(value) {
  if (Array.isArray(value)) return `${value.length} values`;
  return value === undefined ? "nothing" : JSON.stringify(value).slice(0, 40);
}

function readGrid(map) {
  const channel = map?.data?.[0];
  const good = Array.isArray(channel) && channel.length > 0 && channel.every((row) => row?.length === channel[0].length && Number.isFinite(row[0]));
  if (!good) throw new Error("cost_map.data: expected [C,H,W], the occupancy in its first channel.");
  if (!(map.resolution > 0)) throw new Error(`cost_map.resolution: expected more than 0 m, got ${describe(map.resolution)}.`);
  const origin = map.origin && numbers(map.origin, "cost_map.origin", 2);
  const grid = new Grid(channel.length, channel[0].length, map.resolution, origin ?? undefined);
  channel.forEach((row, r) => row.forEach((value, c) => { if (value >= 0.5) grid.set(r, c, OCCUPIED); }));
  return grid;
}

/** The options that a request gives; a schedule that is no uniform one is left to the bundle. */
function readOptions({ w_style: asked, num_samples: num, seed, robot_radius: radius, v_max, a_max, horizon_s: horizon, sampler, refine = {} }) {
  const steps = sampler?.schedule?.uniform;
  const style = typeof asked === "string" ? STYLES[asked] : asked;
  if (asked && !style) throw new Error(`w_style: expected ${Object.keys(STYLES).join(", ")} or weights, got ${describe(asked)}.`);
  const sum = style?.reduce((a, b) => a + b);
  const read = {
    style: style?.map((weight) => weight / sum),
    num,
    seed,
    radius,
    v_max,
    a_max,
    horizon,
    fixed: horizon !== undefined,
    sampler: steps ? (sampler.method ?? "rk4") : "card",
    steps,
    margin: refine.safety_margin,
    smooth: refine.smooth,
    project: refine.project,
    guidance: refine.guidance,
    barrier: refine.barrier,
    certified: refine.certified_margin,
  };
  return Object.fromEntries(Object.entries(read).filter(([, value]) => value !== undefined));
}

/** The same request for Python, with a map that one can read. */
export function toPython(request) {
  const { cost_map: map, ...rest } = request;
  // Written as one sees it: the top line is the map's last row.
  const lines = map.data[0].map((row) => row.map((cell) => (cell ? "#" : ".")).join("")).reverse();
  return `import numpy as np
from anchorflow_client import AnchorClient

drawn = """
${lines.join("\n")}
""".split()
# Row 0 of a map has the smallest y, so the drawing is turned over.
occupancy = np.array([[cell == "#" for cell in row] for row in reversed(drawn)], float)

with AnchorClient("${serviceUrl()}") as client:
    anchors = client.plan(
        cost_map=occupancy,
        resolution=${python(map.resolution)},
        origin=${python(map.origin)},
${pythonArguments(rest, " ".repeat(8))}    )

print(f"{anchors.safe.sum()} of {anchors.safe.size} anchors are safe")
print(anchors.trajectories[anchors.best])
`;
}
