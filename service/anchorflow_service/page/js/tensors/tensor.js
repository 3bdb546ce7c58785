/** Tensors as the contract's JSON has them: nested lists, or their bytes in base64. */

/** What holds numbers of a type. */
export const ARRAYS = { bool: Uint8Array, uint8: Uint8Array, int64: BigInt64Array, float32: Float32Array, float64: Float64Array };
/** Bytes that one call of `String.fromCharCode` takes. */
const CHUNK = 0x8000;

/** The axes of one scene: those of the card without the leading B. */
export const axesOf = (spec) => spec.shape.slice(1);

/** How many numbers one scene has; an axis of any length has one. */
export const countOf = (spec) => axesOf(spec).reduce((count, size) => count * (Number.isInteger(size) ? size : 1), 1);

/** The value nearest to 0 that the range of an input allows. */
export function neutral({ range }) {
  const [low, high] = range ?? [null, null];
  return Math.min(high ?? Infinity, Math.max(low ?? -Infinity, 0));
}

/** {dtype, shape, base64} of a tensor that has the same value everywhere. */
export function filled(spec) {
  const shape = axesOf(spec).map((size) => (Number.isInteger(size) ? size : 1));
  const values = new ARRAYS[spec.dtype](countOf(spec)).fill(spec.dtype === "int64" ? BigInt(Math.ceil(neutral(spec))) : neutral(spec));
  return { dtype: spec.dtype, shape, base64: base64(new Uint8Array(values.buffer)) };
}

/** {shape, values} of nested lists, as an answer in JSON brings them. */
export function unnest(nested) {
  const shape = [];
  for (let part = nested; Array.isArray(part); part = part[0]) shape.push(part.length);
  return { shape, values: Float64Array.from(shape.length > 1 ? nested.flat(shape.length - 1) : nested) };
}

/** {shape, values} of {dtype, shape, base64}. */
export function unpacked({ dtype, shape, base64: text }) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return { shape, values: new ARRAYS[dtype](bytes.buffer) };
}

/** Whether an input is places [P, 2] in m, such as a route. */
export const isPlaces = (spec) => spec.unit === "m" && axesOf(spec).length === 2 && axesOf(spec)[1] === 2;

/** Bytes in base64. */
export function base64(bytes) {
  let text = "";
  for (let at = 0; at < bytes.length; at += CHUNK) text += String.fromCharCode(...bytes.subarray(at, at + CHUNK));
  return btoa(text);
}
