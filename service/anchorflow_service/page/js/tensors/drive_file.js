/** A drive that `anchorflow data frames` has made: what a planner is asked along a way, by time. */

import { typeText } from "../card.js";
import { ARRAYS, axesOf, base64 } from "./tensor.js";

const FORMAT = "anchorflow-drive";
const VERSION = 1;
const PARTS = ["inputs", "ego", "map", "frames"];

/** m that are shown around the ego at least. */
const SHOWN = { behind: 12, ahead: 36, aside: 20 };
/** How much farther one sees than was driven: proposals may be faster. */
const BEYOND = 1.3;

/** An input of the card that the drive does not have as the card wants it. */
export class InputMismatch extends Error {
  constructor(name, message) {
    super(`${name}: ${message}`);
    Object.assign(this, { field: `inputs.${name}` });
  }
}

export class DriveFile {
  /** `text`: of the file. Throws an Error that says what is wrong with it. */
  constructor(text, name) {
    let held;
    try {
      held = JSON.parse(text);
    } catch (cause) {
      throw new Error(`${name}: expected JSON: ${cause.message}`, { cause });
    }
    if (held?.format !== FORMAT || held.version !== VERSION) throw new Error(`${name}: expected a drive that "anchorflow data frames" has made, "format": "${FORMAT}", "version": ${VERSION}.`);
    const missing = PARTS.find((part) => !held[part]) ?? (held.frames.length ? undefined : "frames");
    if (missing) throw new Error(`${name}: expected ${missing}, got none.`);
    Object.assign(this, held, { name });
  }

  /** Throws an `InputMismatch` about the first input of a card that the drive cannot fill in. */
  checkFits(card) {
    for (const spec of card.inputs) {
      const wanted = { dtype: spec.dtype, shape: axesOf(spec) };
      const held = this.inputs.find(({ name }) => name === spec.name);
      if (!held) throw new InputMismatch(spec.name, `the drive has no such input; it was made for ${this.bundle}, with ${this.inputs.map(({ name }) => name).join(", ")}.`);
      const fits = held.dtype === wanted.dtype && held.shape.length === wanted.shape.length && wanted.shape.every((size, axis) => !Number.isInteger(size) || size === held.shape[axis]);
      if (!fits) throw new InputMismatch(spec.name, `expected ${typeText(wanted)}, the drive has ${typeText(held)}; it was made for ${this.bundle}.`);
    }
  }

  /** {name: value} of a frame, as the contract's JSON has them, of the inputs that a card lists. */
  async values(index, card) {
    const { inputs } = this.frames[index];
    const entries = card.inputs.map(async ({ name }) => [name, await unpack(inputs[name], `frame ${index}: ${name}`)]);
    return Object.fromEntries(await Promise.all(entries));
  }

  /** [least x, greatest x, least y, greatest y] m of the ego's frame, the same for all frames. */
  get extent() {
    const driven = this.frames.flatMap(({ recorded }) => recorded.map(([x]) => x));
    return [-SHOWN.behind, Math.max(SHOWN.ahead, BEYOND * Math.max(...driven)), -SHOWN.aside, SHOWN.aside];
  }
}

/** Deflated bytes become bytes in base64; everything else is what it is. */
async function unpack(value, place) {
  if (value === undefined) throw new Error(`${place}: expected a value, got none.`);
  if (!value.zlib) return value;
  const { dtype, shape, zlib } = value;
  const bytes = await inflate(zlib);
  const expected = shape.reduce((count, size) => count * size, ARRAYS[dtype].BYTES_PER_ELEMENT);
  if (bytes.length !== expected) throw new Error(`${place}: expected ${expected} bytes, got ${bytes.length}.`);
  return { dtype, shape, base64: base64(bytes) };
}

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
