/** A file of `anchorflow data frames`: the inputs of a planner along a recorded drive, by time. */

import { typeText } from "../bundles.js";
import { ARRAYS, axesOf, fromBase64, toBase64 } from "./tensor.js";

const FORMAT = "anchorflow-drive";
const VERSION = 1;

const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
const isNumbers = (count) => (values) => Array.isArray(values) && values.length === (count ?? values.length) && values.every(Number.isFinite);
const isListOf = (isGood) => (values) => Array.isArray(values) && values.every(isGood);
const isInput = (input) => typeof input?.name === "string" && typeof input.dtype === "string" && Array.isArray(input.shape);
const LINES = ["lists of numbers", isListOf(isNumbers())];
/** The parts of a drive, of its map and of each frame that the page reads: [expected, test]. */
const DRIVE = {
  inputs: ["a list of name, dtype and shape", isListOf(isInput)],
  ego: ["5 numbers", isNumbers(5)],
  map: ["an object", isObject],
  frames: ["a list of frames", (frames) => Array.isArray(frames) && frames.length > 0],
};
const MAP = { drivable: LINES, crosswalk: LINES, line: LINES, centre: LINES };
const FRAME = {
  time_s: ["a number", Number.isFinite],
  pose: ["3 numbers", isNumbers(3)],
  recorded: ["a list of 3 numbers each", isListOf(isNumbers(3))],
  boxes: ["a list of 6 numbers each", isListOf(isNumbers(6))],
  inputs: ["an object", isObject],
};

/** m around the ego that are always shown. */
const SHOWN = { behind: 12, ahead: 36, aside: 20 };
/** The view reaches farther than the recording by this factor, as anchors may be faster. */
const REACH_FACTOR = 1.3;

/** The drive lacks an input of the card, or has it in another shape. */
export class InputMismatch extends Error {
  constructor(name, message) {
    super(`${name}: ${message}`);
    Object.assign(this, { field: `inputs.${name}` });
  }
}

export class DriveFile {
  /** Throws an Error that names the file and the part that is wrong. */
  constructor(text, name) {
    let held;
    try {
      held = JSON.parse(text);
    } catch (cause) {
      throw new Error(`${name}: expected JSON: ${cause.message}`, { cause });
    }
    if (held?.format !== FORMAT || held.version !== VERSION) throw new Error(`${name}: expected a drive that "anchorflow data frames" has made, "format": "${FORMAT}", "version": ${VERSION}.`);
    check(held, DRIVE, name);
    check(held.map, MAP, `${name}: map`);
    held.frames.forEach((frame, index) => check(frame, FRAME, `${name}: frame ${index}`));
    Object.assign(this, held, { name });
  }

  /** Throws an `InputMismatch` for the first input of a card that the drive cannot fill in. */
  checkFits(card) {
    for (const spec of card.inputs) {
      const wanted = { dtype: spec.dtype, shape: axesOf(spec) };
      const held = this.inputs.find(({ name }) => name === spec.name);
      if (!held) throw new InputMismatch(spec.name, `the drive has no such input; it was made for ${this.bundle}, with ${this.inputs.map(({ name }) => name).join(", ")}.`);
      const fits = held.dtype === wanted.dtype && held.shape.length === wanted.shape.length && wanted.shape.every((size, axis) => !Number.isInteger(size) || size === held.shape[axis]);
      if (!fits) throw new InputMismatch(spec.name, `expected ${typeText(wanted)}, the drive has ${typeText(held)}; it was made for ${this.bundle}.`);
    }
  }

  /** {name: value} of the inputs of a card in a frame, as the contract's JSON has them. */
  async values(index, card) {
    const { inputs } = this.frames[index];
    const entries = card.inputs.map(async ({ name }) => [name, await unpack(inputs[name], `${this.name}: frame ${index}: ${name}`)]);
    return Object.fromEntries(await Promise.all(entries));
  }

  /** [x_min, x_max, y_min, y_max] m around the ego to show, the same for all frames. */
  get extent() {
    const driven = this.frames.flatMap(({ recorded }) => recorded.map(([x]) => x));
    return [-SHOWN.behind, Math.max(SHOWN.ahead, REACH_FACTOR * Math.max(...driven)), -SHOWN.aside, SHOWN.aside];
  }
}

function check(held, parts, place) {
  for (const [part, [expected, isGood]] of Object.entries(parts)) {
    if (!isGood(held?.[part])) throw new Error(`${place}: ${part}: expected ${expected}.`);
  }
}

/** Inflate a value if its bytes are deflated. */
async function unpack(value, place) {
  if (value === undefined || value === null) throw new Error(`${place}: expected a value, got none.`);
  if (!value.zlib) return value;
  const { dtype, shape, zlib } = value;
  if (!(dtype in ARRAYS && isNumbers()(shape))) throw new Error(`${place}: expected dtype and shape of a tensor.`);
  const bytes = await inflate(zlib).catch((cause) => {
    throw new Error(`${place}: expected deflated bytes in base64.`, { cause });
  });
  const expected = shape.reduce((count, size) => count * size, ARRAYS[dtype].BYTES_PER_ELEMENT);
  if (bytes.length !== expected) throw new Error(`${place}: expected ${expected} bytes, got ${bytes.length}.`);
  return { dtype, shape, base64: toBase64(bytes) };
}

async function inflate(text) {
  const stream = new Blob([fromBase64(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
