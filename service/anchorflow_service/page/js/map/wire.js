/**
 * POST /anchors in the contract's binary form, a third of JSON's bytes: the Open Inference Protocol
 * with binary tensors. A JSON header, padded with spaces, and the tensors that it lists.
 */

import { send } from "../service.js";

const ALIGNMENT = 64;
const HEADER_LENGTH = "Inference-Header-Content-Length";
const ARRAYS = { FP32: Float32Array, FP64: Float64Array, BOOL: Uint8Array };

/** Asks what the contract's JSON `request` says; {trajectories: {shape, values}, …, dt, seed, …}. */
export function plan(request) {
  const { header, tensors } = pack(request);
  const body = join([header, ...tensors]);
  const headers = { "Content-Type": "application/octet-stream", [HEADER_LENGTH]: header.length };
  return send("anchors", { method: "POST", headers, body }, unpack);
}

/** Arrays as tensors, everything else as parameters by its JSON path. */
function pack({ cost_map: map, x_curr: start, x_goal: goal, w_style: style, warm_start: warm, ...rest }) {
  const [rows] = map.data;
  const inputs = [
    ["x_curr", "FP64", [start.length], start],
    ["x_goal", "FP64", [goal.length], goal],
    ["w_style", "FP64", [style.length], style],
    ["map_geometry", "FP64", [3], [...map.origin, map.resolution]],
    ...(warm ? [["warm_start", "FP64", [warm.trajectory.length, warm.trajectory[0].length], warm.trajectory.flat()]] : []),
    ["cost_map", "FP32", [1, rows.length, rows[0].length], rows.flat()],
  ];
  const tensors = inputs.map(([, datatype, , values]) => new Uint8Array(ARRAYS[datatype].from(values).buffer));
  const parameters = { binary_data_output: true, ...flatten(rest), ...(warm && { "warm_start.tau": warm.tau, "warm_start.dt": warm.dt }) };
  const entries = inputs.map(([name, datatype, shape], k) => {
    return { name, datatype, shape, parameters: { binary_data_size: tensors[k].length } };
  });
  const text = JSON.stringify({ parameters, inputs: entries });
  const padded = text.padEnd(Math.ceil(text.length / ALIGNMENT) * ALIGNMENT);
  return { header: new TextEncoder().encode(padded), tensors };
}

/** {"sampler.method": "rk4"} of {sampler: {method: "rk4"}}. */
function flatten(fields, prefix = "") {
  return Object.assign({}, ...Object.entries(fields).map(([name, value]) => {
    const isGroup = value && typeof value === "object";
    return isGroup ? flatten(value, `${prefix}${name}.`) : { [prefix + name]: value };
  }));
}

function join(parts) {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  parts.reduce((at, part) => {
    whole.set(part, at);
    return at + part.length;
  }, 0);
  return whole;
}

async function unpack(response) {
  const buffer = await response.arrayBuffer();
  const length = Number(response.headers.get(HEADER_LENGTH));
  const { outputs, parameters } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 0, length)));
  const answer = { timing: {}, model: {} };
  for (const [name, value] of Object.entries(parameters)) {
    const [group, stage] = name.split(".");
    if (group === "timing_ms") answer.timing[stage] = value;
    else if (group === "model") answer.model[stage] = value;
    else answer[name] = value;
  }
  let at = length;
  for (const { name, datatype, shape, parameters: { binary_data_size: size } } of outputs) {
    answer[name] = { shape, values: new ARRAYS[datatype](buffer.slice(at, at + size)) };
    at += size;
  }
  return answer;
}
