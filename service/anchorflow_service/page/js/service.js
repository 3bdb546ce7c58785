/** Requests to the service: bodies in JSON and in binary, error responses, and the bearer token. */

import { byId } from "./dom.js";

const TIMEOUT_MS = 30_000;
const TOKEN_KEY = "anchorflow-token";
/** Characters that no header can carry, such as an invisible space that was copied along. */
const NOT_LATIN_1 = /[^ -\xff]/u;
/** Bytes to which the header of the binary form is padded. */
const ALIGNMENT = 64;
const HEADER_LENGTH = "Inference-Header-Content-Length";
const ARRAYS = { FP32: Float32Array, FP64: Float64Array, BOOL: Uint8Array, INT64: BigInt64Array };

/** An error response of the contract. */
export class Refusal extends Error {
  constructor({ code, message, field }, retryAfterS) {
    super(message);
    Object.assign(this, { code, field, retryAfterS });
  }

  /** Whether the same request may succeed later. */
  get isTransient() {
    return this.code === "overloaded" || this.code === "not_ready";
  }

  /** Whether the service answers requests without the field already. */
  get isPartly() {
    return this.code === "not_ready" && Boolean(this.field);
  }
}

/** There is no response, or none that follows the contract. */
export class Unreachable extends Error {}

/** GET, or POST if there is a `body`, as JSON; returns the parsed response. */
export function ask(path, body) {
  const post = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  return send(path, body === undefined ? {} : post, (response) => response.json());
}

/** Send a request, read its response with `read`. Rejects with a `Refusal` or an `Unreachable`. */
async function send(path, options, read) {
  for (;;) {
    try {
      return await sendOnce(path, options, read);
    } catch (error) {
      if (error.code !== "unauthorized") throw error;
      await askForToken(error.message);
    }
  }
}

async function sendOnce(path, options, read) {
  let response, answer;
  try {
    const headers = { ...options.headers, ...authorization() };
    response = await fetch(path, { ...options, headers, signal: AbortSignal.timeout(TIMEOUT_MS), cache: "no-store" });
    answer = await (response.ok ? read(response) : response.json());
  } catch (cause) {
    throw new Unreachable("The service does not answer.", { cause });
  }
  if (response.ok) return answer;
  if (!answer?.error?.message) throw new Unreachable(`Status ${response.status} without the contract's error JSON.`);
  throw new Refusal(answer.error, Number(response.headers.get("Retry-After")) || undefined);
}

/** The {Authorization} header, if a token was entered; the token is kept until the tab is closed. */
export function authorization() {
  const token = sessionStorage.getItem(TOKEN_KEY);
  return token ? { Authorization: `Bearer ${token}` } : {};
}

let entered = null;

/** Show the token form with a reason; resolves when a token was entered, for all pending requests. */
function askForToken(reason) {
  byId("token-why").textContent = reason;
  entered ??= new Promise((resolve) => {
    const form = byId("token-form");
    form.hidden = false;
    byId("token").focus();
    form.onsubmit = (event) => {
      event.preventDefault();
      const token = byId("token").value.trim();
      const wrong = token.match(NOT_LATIN_1);
      if (wrong) {
        const code = wrong[0].codePointAt(0).toString(16).toUpperCase().padStart(4, "0");
        byId("token-why").textContent = `token: expected characters of Latin-1, got U+${code} in place ${wrong.index + 1}`;
        return;
      }
      sessionStorage.setItem(TOKEN_KEY, token);
      form.hidden = true;
      entered = null;
      resolve();
    };
  });
  return entered;
}

/**
 * POST /anchors about a map, in the binary form of the contract, which is a third of JSON's size:
 * a JSON header, then the tensors that it lists. Resolves with {trajectories: {shape, values}, …}.
 */
export async function plan(request) {
  const { header, tensors } = pack(request);
  const headers = { "Content-Type": "application/octet-stream", [HEADER_LENGTH]: header.length };
  const body = await new Blob([header, ...tensors]).arrayBuffer();
  return send("anchors", { method: "POST", headers, body }, unpack);
}

/** Arrays become tensors, all other fields parameters named by their JSON path. */
export function pack({ cost_map: map, x_curr: start, x_goal: goal, w_style: style, warm_start: warm, obstacles, footprint, ...rest }) {
  const [rows] = map.data;
  const cells = [map.data.length, rows.length, rows[0].length];
  const inputs = [
    ["x_curr", "FP64", [start.length], start],
    ["x_goal", "FP64", [goal.length], goal],
    ["w_style", "FP64", [style.length], style],
    ["map_geometry", "FP64", [3], [...map.origin, map.resolution]],
    ...(warm ? [["warm_start", "FP64", [warm.trajectory.length, warm.trajectory[0].length], warm.trajectory.flat()]] : []),
    ...(obstacles ? tracksOf(obstacles) : []),
    ...(footprint ? [["footprint", "FP64", [footprint.length, 2], footprint.flat()]] : []),
    ["cost_map", "FP32", cells, map.data.flat(2)],
  ];
  const tensors = inputs.map(([, datatype, , values]) => new Uint8Array(ARRAYS[datatype].from(values).buffer));
  const entries = inputs.map(([name, datatype, shape], k) => {
    return { name, datatype, shape, parameters: { binary_data_size: tensors[k].length } };
  });
  const warmStart = warm && { "warm_start.tau": warm.tau, "warm_start.dt": warm.dt };
  const text = JSON.stringify({ parameters: { binary_data_output: true, ...flatten(rest), ...warmStart }, inputs: entries });
  const padded = text.padEnd(Math.ceil(text.length / ALIGNMENT) * ALIGNMENT);
  return { header: new TextEncoder().encode(padded), tensors };
}

/** The tensors of obstacles with a velocity. */
function tracksOf({ position, velocity, radius }) {
  return [
    ["obstacle_position", "FP64", [position.length, 2], position.flat()],
    ["obstacle_velocity", "FP64", [velocity.length, 2], velocity.flat()],
    ["obstacle_radius", "FP64", [radius.length], radius],
  ];
}

/** {"sampler.method": "rk4"} from {sampler: {method: "rk4"}}. */
function flatten(fields, prefix = "") {
  return Object.assign({}, ...Object.entries(fields).map(([name, value]) => {
    const isGroup = value && typeof value === "object";
    return isGroup ? flatten(value, `${prefix}${name}.`) : { [prefix + name]: value };
  }));
}

async function unpack(response) {
  const buffer = await response.arrayBuffer();
  const length = Number(response.headers.get(HEADER_LENGTH));
  const { outputs, parameters } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 0, length)));
  const answer = {};
  for (const [name, value] of Object.entries(parameters)) {
    const [group, key] = name.split(".");
    if (key) (answer[group] ??= {})[key] = value;
    else answer[name] = value;
  }
  let at = length;
  for (const { name, datatype, shape, parameters: { binary_data_size: size } } of outputs) {
    const values = new ARRAYS[datatype](buffer.slice(at, at + size));
    answer[name] = { shape, values: datatype === "INT64" ? Float64Array.from(values, Number) : values };
    at += size;
  }
  return answer;
}
