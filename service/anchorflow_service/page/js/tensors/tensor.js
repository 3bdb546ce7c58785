/** Tensors as the contract's JSON has them (nested lists, or bytes in base64), and as pictures. */

/** The typed array for each dtype. */
export const ARRAYS = { bool: Uint8Array, uint8: Uint8Array, int64: BigInt64Array, float32: Float32Array, float64: Float64Array };
/** Bytes for one call of `String.fromCharCode`. */
const CHUNK = 0x8000;

/** The axes of one scene: those of the card without the leading B. */
export const axesOf = (spec) => spec.shape.slice(1);

/** The count of numbers in one scene; an axis of any length has one. */
export const countOf = (spec) => axesOf(spec).reduce((count, size) => count * (Number.isInteger(size) ? size : 1), 1);

/** Whether an input is a list of places [P, 2] in m, such as a route. */
export const isPlaces = (spec) => spec.unit === "m" && axesOf(spec).length === 2 && axesOf(spec)[1] === 2;

/** The value nearest to 0 in the range of an input. */
export function neutral({ range }) {
  const [low, high] = range ?? [null, null];
  return Math.min(high ?? Infinity, Math.max(low ?? -Infinity, 0));
}

/** {dtype, shape, base64} of a tensor with the neutral value everywhere. */
export function filled(spec) {
  const shape = axesOf(spec).map((size) => (Number.isInteger(size) ? size : 1));
  const value = spec.dtype === "int64" ? BigInt(Math.ceil(neutral(spec))) : neutral(spec);
  const values = new ARRAYS[spec.dtype](countOf(spec)).fill(value);
  return { dtype: spec.dtype, shape, base64: toBase64(new Uint8Array(values.buffer)) };
}

/** {shape, values} of nested lists. */
export function unnest(nested) {
  const shape = [];
  for (let part = nested; Array.isArray(part); part = part[0]) shape.push(part.length);
  return { shape, values: Float64Array.from(shape.length > 1 ? nested.flat(shape.length - 1) : nested) };
}

/** {shape, values} of {dtype, shape, base64}. */
export function unpack({ dtype, shape, base64 }) {
  return { shape, values: new ARRAYS[dtype](fromBase64(base64).buffer) };
}

export function toBase64(bytes) {
  let text = "";
  for (let at = 0; at < bytes.length; at += CHUNK) text += String.fromCharCode(...bytes.subarray(at, at + CHUNK));
  return btoa(text);
}

export const fromBase64 = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

/**
 * {width, height, pixels (RGBA), classes} of a tensor {shape, values} [C,H,W], or [H,W] of classes:
 * three channels are RGB, one is grey, more are classes or, if `layered`, layers that cover each other.
 * `palette` has colours [r, g, b] for classes and layers.
 */
export function toPicture({ range }, { shape, values }, palette, layered = false) {
  const [height, width] = shape.slice(-2);
  const plane = width * height;
  const channels = shape.length > 2 ? shape.at(-3) : 0;
  const [low, high] = range ?? [];
  const least = low ?? values.reduce((a, b) => Math.min(a, b), Infinity);
  const most = high ?? values.reduce((a, b) => Math.max(a, b), -Infinity);
  const level = (channel, k) => (255 * (values[channel * plane + k] - least)) / (most - least || 1);
  const colour = (index) => palette[((index % palette.length) + palette.length) % palette.length];
  const pixels = new Uint8ClampedArray(4 * plane);
  const paint = (colourOf) => {
    for (let k = 0; k < plane; k++) pixels.set([...colourOf(k), 255], 4 * k);
  };
  let classes = [];
  if (channels === 3) paint((k) => [0, 1, 2].map((channel) => level(channel, k)));
  else if (channels === 1) paint((k) => Array(3).fill(level(0, k)));
  else if (layered) {
    paint((k) => {
      let mixed = [0, 0, 0];
      for (let channel = 0; channel < channels; channel++) {
        const share = level(channel, k) / 255;
        if (share) mixed = mixed.map((value, axis) => value + share * (colour(channel)[axis] - value));
      }
      return mixed;
    });
  } else {
    const strongest = Array.from({ length: plane }, (_, k) => strongestClass(values, channels, plane, k));
    classes = [...new Set(strongest)].sort((a, b) => a - b);
    paint((k) => colour(strongest[k]));
  }
  return { width, height, channels, pixels, classes, colour };
}

function strongestClass(values, channels, plane, k) {
  if (!channels) return Math.round(values[k]);
  let best = 0;
  for (let c = 1; c < channels; c++) if (values[c * plane + k] > values[best * plane + k]) best = c;
  return best;
}

/** Draw a picture on a canvas, which takes its size. */
export function drawPicture(canvas, { width, height, pixels }) {
  Object.assign(canvas, { width, height });
  canvas.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
  return canvas;
}
