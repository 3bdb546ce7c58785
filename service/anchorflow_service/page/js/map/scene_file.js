/** Scenes as files and as programs. A file is the JSON of POST /anchors, so that it can be sent as it is. */

import { WHEELS, described } from "../fields.js";
import { pythonProgram } from "../share.js";
import { bodyOf } from "./body.js";
import { Grid, OCCUPIED, SOFT_LAYERS } from "./grid.js";
import { STYLES } from "./scene.js";

/** Fields that the page can ask beside those of the form. */
const CARRIED = ["cost_map", "x_curr", "x_goal", "w_style", "obstacles", "footprint"];
/** Channels of a map that the page paints. */
const CHANNELS = 1 + Object.keys(SOFT_LAYERS).length;
/** How the drawing of a program tells tenths of a channel. */
const TENTHS = "0123456789X";

/** A request as a file, with one line for each row of the map. */
export function toJson({ cost_map: { data, ...place }, ...rest }) {
  const inner = (object) => JSON.stringify(object).slice(1, -1);
  const channels = data.map((rows) => `[\n${rows.map((row) => JSON.stringify(row)).join(",\n")}]`).join(",");
  return `{"cost_map": {"data": [${channels}],\n${inner(place)}},\n${inner(rest)}}\n`;
}

/**
 * {card, grid, ends, people, body, style, options, left} of a scene file, for the bundle that it names if `bundles`
 * has it, else for `chosen`; `left` names what the page cannot ask. Throws an Error that names the file.
 */
export function readScene(name, text, chosen, bundles, fields) {
  const naming = (read) => {
    try {
      return read();
    } catch (cause) {
      throw new Error(`${name}: ${cause.message}`, { cause });
    }
  };
  const { format, bundle, model, ...request } = naming(() => parse(text));
  if (typeof format === "string") {
    const wanted = typeof bundle === "string" ? `the bundle ${bundle}` : "the bundle that it is for";
    throw new Error(`${name} is no scene but of the format ${format}: choose ${wanted} first.`);
  }
  const named = bundles.like(model);
  const card = named ?? chosen;
  const scene = naming(() => fromRequest(request, card, fields));
  if (model && !named) scene.left.push(`model, as no ${model} with a map is served`);
  return { card, ...scene };
}

/** The request in a file, without its nulls, which mean "not given". */
function parse(text) {
  const withoutNull = function (_, value) {
    return value === null && !Array.isArray(this) ? undefined : value;
  };
  try {
    return JSON.parse(text, withoutNull) ?? {};
  } catch (cause) {
    throw new Error(`Expected a scene in JSON: ${cause.message}.`, { cause });
  }
}

function fromRequest(request, card, fields) {
  const body = bodyOf(request.footprint);
  const hasBody = body.shape !== "disc" || WHEELS.includes(request.kinematics?.kind);
  const dim = hasBody ? 3 : card.answer.components.length;
  const state = numbers(request.x_curr, "x_curr", 3 * dim);
  const goal = numbers(request.x_goal, "x_goal", 2 * dim);
  const end = (values) => ({ x: values[0], y: values[1], vx: values[dim], vy: values[dim + 1], ...(hasBody ? { heading: values[2] } : {}) });
  const start = { ...end(state), ax: state[2 * dim], ay: state[2 * dim + 1], ...(hasBody ? { turn: state[5], spin: state[8] } : {}) };
  const grid = readGrid(request.cost_map);
  const style = readStyle(request.w_style);
  const given = Object.entries(fields.fromRequest(request, card)).filter(([, value]) => value !== null);
  const options = Object.fromEntries(given);
  const left = Object.keys(request).filter((name) => !CARRIED.includes(name) && !fields.names.has(name));
  // The page knows uniform schedules only; without one it leaves the sampler to the bundle.
  const isUniform = "sampler.schedule.uniform" in options;
  options["sampler.method"] = isUniform ? (options["sampler.method"] ?? "rk4") : null;
  if (request.sampler && !isUniform) left.push("sampler");
  if (request.cost_map.data.length > CHANNELS) left.push(`cost_map beyond its channel ${CHANNELS - 1}`);
  if (request.cost_map.channel_weights) left.push("cost_map.channel_weights");
  if (dim === 3 && !hasBody) left.push("headings");
  const people = readPeople(request.obstacles, left);
  return { people, grid, body, ends: { start, goal: end(goal) }, style, options, left };
}

function numbers(values, field, count) {
  const isGood = Array.isArray(values) && values.length === count && values.every(Number.isFinite);
  if (!isGood) throw new Error(`${field}: expected ${count} numbers, got ${described(values)}.`);
  return values;
}

function readGrid({ data, resolution, origin } = {}) {
  const channel = data?.[0];
  const isRow = (row) => Array.isArray(row) && row.length === channel[0].length && row.every(Number.isFinite);
  const isChannel = (rows) => Array.isArray(rows) && rows.length > 0 && rows.length === channel.length && rows.every(isRow);
  if (!Array.isArray(data) || !data.every(isChannel)) throw new Error("cost_map.data: expected [C,H,W], the occupancy in its first channel.");
  if (!(Number.isFinite(resolution) && resolution > 0)) throw new Error(`cost_map.resolution: expected more than 0 m, got ${described(resolution)}.`);
  const grid = new Grid(channel.length, channel[0].length, resolution, origin && numbers(origin, "cost_map.origin", 2));
  channel.forEach((row, r) => row.forEach((value, c) => { if (value >= 0.5) grid.set(r, c, OCCUPIED); }));
  Object.entries(SOFT_LAYERS).forEach(([name, neutral], k) => {
    data[k + 1]?.forEach((row, r) => row.forEach((value, c) => { if (value !== neutral) grid.setSoft(name, r, c, Math.abs(neutral - value)); }));
  });
  return grid;
}

/** People with the velocity of their forecast's first leg if they have one; `left` gets what they lose. */
function readPeople({ position = [], velocity, radius = [], forecast, forecast_dt: dt, growth } = {}, left) {
  if (forecast) left.push("obstacles.forecast");
  if (growth) left.push("obstacles.growth");
  if (!Array.isArray(position) || radius?.length !== position.length) throw new Error(`obstacles.radius: expected as many as positions, got ${described(radius)}.`);
  return position.map((place, k) => {
    const [x, y] = numbers(place, "obstacles.position", 2);
    const [vx, vy] = forecast ? numbers(forecast[k]?.[0], "obstacles.forecast", 2).map((value, axis) => (value - place[axis]) / dt)
      : numbers(velocity?.[k], "obstacles.velocity", 2);
    return { x, y, vx, vy, radius: numbers([radius[k]], "obstacles.radius", 1)[0] };
  });
}

/** Weights that sum to 1; undefined if the request gives no style. */
function readStyle(asked) {
  if (asked === undefined) return undefined;
  if (typeof asked === "string" && !(asked in STYLES)) throw new Error(`w_style: expected ${Object.keys(STYLES).join(", ")} or weights, got ${described(asked)}.`);
  const style = STYLES[asked] ?? numbers(asked, "w_style", 3);
  const sum = style.reduce((a, b) => a + b);
  if (!(sum > 0)) throw new Error(`w_style: expected weights above 0, got a sum of ${sum}.`);
  return style.map((weight) => weight / sum);
}

/** A request as a program in Python, with the map as a drawing. */
export function toPython({ cost_map: { data, ...place }, ...rest }) {
  // The top line of a drawing is the last row of the map.
  const drawing = (rows, mark) => rows.map((row) => row.map(mark).join("")).reverse().join("\n");
  const soft = data.slice(1).map((rows) => `"""
${drawing(rows, (value) => TENTHS[Math.round(10 * value)])}
""",
`);
  return pythonProgram({
    imports: "import numpy as np\nfrom anchorflow_client import AnchorClient\n",
    before: `drawn = """
${drawing(data[0], (cell) => (cell ? "#" : "."))}
""".split()
# Row 0 of a map has the smallest y, so the drawing is turned over.
occupancy = np.array([[cell == "#" for cell in row] for row in reversed(drawn)], float)
${soft.length ? `# ${Object.keys(SOFT_LAYERS).slice(0, soft.length).join(", ")}: tenths, X is 1.
layers = [
${soft.join("")}]
soft = [
    [["${TENTHS}".index(cell) / 10 for cell in row] for row in reversed(layer.split())]
    for layer in layers
]
` : ""}`,
    named: soft.length ? "        cost_map=np.stack([occupancy, *soft]),\n" : "        cost_map=occupancy,\n",
    fields: { ...place, ...rest },
    after: 'print(f"{anchors.safe.sum()} of {anchors.safe.size} anchors are safe")',
  });
}
