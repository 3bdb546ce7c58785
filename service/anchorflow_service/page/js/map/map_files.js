/** Maps in files: map_server's YAML with its PGM or PNG picture, or a picture alone. Nothing is uploaded. */

import { FREE, Grid, OCCUPIED, UNKNOWN } from "./grid.js";

/** On a larger map several cells become one, which is occupied if one of them is. */
const MAX_CELLS = 160;
const MIN_CELLS = 16;
/** A larger picture would cost gigabytes for a map that is made coarser anyway. */
const MAX_PIXELS = 128e6;
/** Rows of a PNG that are converted at a time. */
const STRIP = 256;
const PNG_SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
/** Bytes of a PNG up to the end of its width and height, and where these are. */
const [PNG_HEAD, WIDTH_AT, HEIGHT_AT] = [24, 16, 20];
/** For a picture without a YAML file, as `map_saver` writes them. */
const DEFAULTS = { resolution: 0.05, origin: [0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.25, mode: "trinary" };
const MODES = ["trinary", "scale", "raw"];
/** Percent of an obstacle; what is below it is dear, and free on this page. */
const LETHAL = 100;
/** m, as in the contract. */
const MAX_COORDINATE = 1e7;
/** rad, of a map that counts as not turned: what savers write as 0 may be -3e-17. */
const MAX_YAW = 1e-9;
/** Numbers as yaml-cpp reads them, and words of YAML 1.1. */
const NUMBER = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i;
const WORDS = { true: true, yes: true, on: true, false: false, no: false, off: false, null: null, "~": null, "": null };

/** {grid, note} of the files [File] of one map. Throws an Error for the user. */
export async function readMap(files) {
  const yaml = files.find(({ name }) => /\.ya?ml$/i.test(name));
  const fields = yaml ? readYaml(await yaml.text(), yaml.name) : DEFAULTS;
  const wanted = fields.image?.split("/").at(-1);
  const picture = files.find(({ name }) => (yaml ? name === wanted : /\.(pgm|png)$/i.test(name)));
  if (!picture) throw new Error(`${yaml.name} names the picture ${fields.image}: choose both files together.`);
  const greys = /\.pgm$/i.test(picture.name) ? readPgm(new Uint8Array(await picture.arrayBuffer()), picture.name) : await readPng(picture);
  const grid = reduced(toGrid(greys, fields), picture.name);
  const [width, height] = grid.size.map((metres) => metres.toFixed(1));
  const guess = yaml ? "" : `, taking ${DEFAULTS.resolution} m a pixel for want of a .yaml file`;
  return { grid, note: `${picture.name}: ${width} × ${height} m, ${grid.resolution.toFixed(2)} m a cell${guess}.` };
}

/**
 * {image, resolution, origin: [x, y], negate, mode, free_thresh, occupied_thresh} of a YAML file, which is
 * refused as `anchorflow plan` refuses it. Throws an Error that names the field.
 */
export function readYaml(text, name) {
  const lines = text.replace(/^\ufeff/, "").split(/\r?\n/).map((line) => line.replace(/(^|\s)#.*$/, ""));
  if (/^(---)?\s*\{/.test(lines.join("\n").trim())) throw new Error(`${name}: expected a line for each field; a flow mapping, {…}, is not read here.`);
  const found = topLevel(lines);
  if (!Object.keys(found).length) throw new Error(`${name}: expected a map_server YAML file with named fields.`);
  const fields = { mode: "trinary", negate: 0, ...found };
  const require = (isGood, key, expected, got = fields[key]) => {
    if (!isGood) throw new Error(`${name}: ${key}: expected ${expected}, got ${JSON.stringify(got ?? null)}.`);
  };
  const isNumber = (value) => typeof value === "number";
  const isWithin = (key, low, high) => isNumber(fields[key]) && fields[key] >= low && fields[key] <= high;
  if (typeof fields.mode === "string") fields.mode = fields.mode.toLowerCase();
  const { image, mode, negate, origin } = fields;
  require(typeof image === "string", "image", "a file name");
  require(MODES.includes(mode), "mode", `one of ${MODES.join(", ")}`);
  for (const key of ["free_thresh", "occupied_thresh"]) require(isWithin(key, 0, 1), key, "a number from 0 to 1");
  require(fields.free_thresh < fields.occupied_thresh, "free_thresh", "less than occupied_thresh");
  require([0, 1, false, true].includes(negate), "negate", "one of 0, 1");
  require(isWithin("resolution", 1e-6, 100), "resolution", "a number from 1e-06 to 100");
  require(Array.isArray(origin) && origin.length === 3 && origin.every(isNumber), "origin", "three numbers x, y, yaw");
  require(Math.abs(origin[2] - 2 * Math.PI * Math.round(origin[2] / (2 * Math.PI))) <= MAX_YAW, "origin", "a yaw of 0 (turned maps are not supported)", origin[2]);
  require(origin.every((value) => Math.abs(value) <= MAX_COORDINATE), "origin", "numbers in [-1e+07, 1e+07] m");
  return { ...fields, origin: origin.slice(0, 2) };
}

/** {key: value} of the keys that are not indented, if their values are scalars or lists. */
function topLevel(lines) {
  const values = {};
  let last;
  for (const line of lines) {
    const [, key, value] = line.match(/^(\w+)\s*:(?:\s+(.*))?$/) ?? [];
    if (key) values[(last = key)] = [value ?? ""];
    else values[last]?.push(line);
  }
  return Object.fromEntries(Object.entries(values).map(([key, parts]) => [key, valueOf(parts.join("\n").trim())]));
}

function valueOf(text) {
  if (text.startsWith("- ")) return text.split(/^\s*-\s+/m).slice(1).map(scalar);
  if (text.startsWith("[")) return text.replace(/^\[|,?\s*\]$/g, "").split(",").map(scalar);
  return scalar(text);
}

function scalar(text) {
  const word = text.trim();
  const plain = word.replace(/^(["'])(.*)\1$/, "$2");
  if (NUMBER.test(plain)) return Number(plain);
  const known = WORDS[word.toLowerCase()];
  return known === undefined ? plain : known;
}

function checkSize(width, height, name) {
  if (width * height > MAX_PIXELS) throw new Error(`${name}: expected at most ${MAX_PIXELS / 1e6} million pixels, got ${width} × ${height}.`);
}

/**
 * {width, height, grey: [H*W], white} of a PGM, P2 (text) or P5 (bytes), 8 or 16 bits a pixel, top row
 * first. Throws an Error that names the file.
 */
export function readPgm(bytes, name) {
  const wrong = (expected) => new Error(`${name}: expected ${expected}.`);
  let at = 0;
  // Words of the header; a comment runs from # to the end of its line.
  const word = () => {
    let text = "";
    while (at < bytes.length) {
      const character = String.fromCharCode(bytes[at++]);
      if (character === "#") while (at < bytes.length && bytes[at++] !== 10);
      else if (!/\s/.test(character)) text += character;
      else if (text) break;
    }
    return text;
  };
  const kind = word();
  if (kind !== "P5" && kind !== "P2") throw wrong("a PGM picture that begins with P5 or P2");
  const [width, height, white] = [word(), word(), word()].map(Number);
  const isSize = (value) => Number.isInteger(value) && value > 0;
  if (!isSize(width) || !isSize(height) || !(white > 0 && white < 65536)) throw wrong("width, height and greatest value");
  checkSize(width, height, name);
  const size = white < 256 ? 1 : 2;
  if (kind === "P5" && bytes.length - at < width * height * size) throw wrong(`${width} × ${height} pixels, but the file ends before`);
  if (kind === "P5" && size === 1) return { width, height, white, grey: bytes.subarray(at, at + width * height) };
  const grey = new Uint16Array(width * height);
  for (let k = 0; k < grey.length; k++) {
    const value = kind === "P5" ? 256 * bytes[at++] + bytes[at++] : Number(word() || NaN);
    if (!(value >= 0 && value < 65536)) throw wrong(`${width} × ${height} numbers`);
    grey[k] = value;
  }
  return { width, height, white, grey };
}

/** {width, height, grey: [H*W], white, transparent} of a PNG, top row first. */
async function readPng(file) {
  const wrong = (cause) => new Error(`${file.name}: expected a PNG picture.`, { cause });
  const head = new Uint8Array(await file.slice(0, PNG_HEAD).arrayBuffer());
  if (head.length < PNG_HEAD || PNG_SIGNATURE.some((byte, k) => head[k] !== byte)) throw wrong();
  const view = new DataView(head.buffer);
  checkSize(view.getUint32(WIDTH_AT), view.getUint32(HEIGHT_AT), file.name);
  const bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" }).catch((cause) => {
    throw wrong(cause);
  });
  const { width, height } = bitmap;
  const [white, transparent] = [3 * 255, 3 * 255 + 1];
  const grey = new Uint16Array(width * height);
  const context = new OffscreenCanvas(width, Math.min(height, STRIP)).getContext("2d", { willReadFrequently: true });
  for (let top = 0; top < height; top += STRIP) {
    const rows = Math.min(STRIP, height - top);
    context.clearRect(0, 0, width, rows);
    context.drawImage(bitmap, 0, -top);
    const { data } = context.getImageData(0, 0, width, rows);
    for (let k = 0; k < width * rows; k++) {
      const [red, green, blue, opacity] = [data[4 * k], data[4 * k + 1], data[4 * k + 2], data[4 * k + 3]];
      grey[top * width + k] = opacity === 255 ? red + green + blue : transparent;
    }
  }
  bitmap.close();
  return { width, height, white, transparent, grey };
}

/** A grid of what map_server reads in the grey levels; its first row is the last of the picture. */
function toGrid({ width, height, grey, white, transparent }, fields) {
  const grid = new Grid(height, width, fields.resolution, [...fields.origin]);
  const table = Uint8Array.from({ length: 256 ** grey.BYTES_PER_ELEMENT }, (_, level) => cellOf(level / white, fields));
  if (transparent) table[transparent] = UNKNOWN;
  for (let row = 0; row < height; row++) {
    const above = (height - 1 - row) * width;
    for (let column = 0; column < width; column++) grid.cells[row * width + column] = table[grey[above + column]];
  }
  return grid;
}

function cellOf(shade, { mode, negate, occupied_thresh: occupied, free_thresh: free }) {
  if (mode === "raw") {
    const percent = Math.round(255 * shade);
    if (percent > 100) return UNKNOWN;
    return percent === LETHAL ? OCCUPIED : FREE;
  }
  const darkness = negate ? shade : 1 - shade;
  if (mode === "scale") return Math.round((100 * (darkness - free)) / (occupied - free)) >= LETHAL ? OCCUPIED : FREE;
  if (darkness >= occupied) return OCCUPIED;
  return darkness <= free ? FREE : UNKNOWN;
}

/** The grid without the unknown margin that mapping programs leave, of at most MAX_CELLS a side. */
function reduced(grid, name) {
  const { rows, columns, cells } = grid;
  let [bottom, top, left, right] = [rows, -1, columns, -1];
  for (let row = 0; row < rows; row++) {
    const [begin, end] = [row * columns, (row + 1) * columns];
    let [first, last] = [begin, end - 1];
    while (first < end && cells[first] === UNKNOWN) first++;
    if (first === end) continue;
    while (cells[last] === UNKNOWN) last--;
    [bottom, top] = [Math.min(bottom, row), row];
    [left, right] = [Math.min(left, first - begin), Math.max(right, last - begin)];
  }
  if (top < 0) throw new Error(`${name}: every cell of this map is unknown.`);
  const span = (low, high, count) => {
    const [from, to] = [Math.max(0, low - 2), Math.min(count, high + 3)];
    return [from, Math.max(to - from, MIN_CELLS)];
  };
  const [row, height] = span(bottom, top, rows);
  const [column, width] = span(left, right, columns);
  const factor = Math.ceil(Math.max(height, width) / MAX_CELLS);
  const side = (count) => Math.max(MIN_CELLS, Math.ceil(count / factor));
  const origin = [grid.origin[0] + column * grid.resolution, grid.origin[1] + row * grid.resolution];
  const window = new Grid(side(height), side(width), factor * grid.resolution, origin);
  for (let r = 0; r < window.rows; r++) {
    for (let c = 0; c < window.columns; c++) window.set(r, c, worst(grid, row + r * factor, column + c * factor, factor));
  }
  return window;
}

/** The worst of size × size cells: occupied, then unknown, as all cells beyond the grid are. */
function worst({ rows, columns, cells }, top, left, size) {
  let found = top + size > rows || left + size > columns ? UNKNOWN : FREE;
  for (let row = top; row < Math.min(top + size, rows); row++) {
    for (let column = left; column < Math.min(left + size, columns); column++) {
      const cell = cells[row * columns + column];
      if (cell === OCCUPIED) return OCCUPIED;
      if (cell === UNKNOWN) found = UNKNOWN;
    }
  }
  return found;
}
