/** Maps out of files: map_server's YAML with its picture, or a picture alone. Nothing is uploaded. */

import { FREE, Grid, OCCUPIED, UNKNOWN } from "./grid.js";
import { checkSize, readPgm } from "./pgm.js";
import { readYaml } from "./yaml.js";

/** Larger maps have several of their cells in one, which is occupied where one of them is. */
const MOST_CELLS = 160;
const LEAST_CELLS = 16;
/** Of a PNG: its signature, and where its width and height are. */
const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
const [WIDTH_AT, HEIGHT_AT, SIZE_END] = [16, 20, 24];
/** Of a picture that comes without a YAML file, as `map_saver` writes them. */
const DEFAULTS = { resolution: 0.05, origin: [0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.25, mode: "trinary" };

/** {grid, note} of the files [File] of one map. Throws an Error whose message is for the reader. */
export async function readMap(files) {
  const yaml = files.find(({ name }) => /\.ya?ml$/i.test(name));
  const fields = yaml ? readYaml(await yaml.text(), yaml.name) : DEFAULTS;
  const wanted = fields.image?.split("/").at(-1);
  const picture = files.find(({ name }) => (yaml ? name === wanted : /\.(pgm|png)$/i.test(name)));
  if (!picture) throw new Error(`${yaml.name} names the picture ${fields.image}: choose both files together.`);
  const shades = /\.pgm$/i.test(picture.name) ? readPgm(new Uint8Array(await picture.arrayBuffer()), picture.name) : await readPng(picture);
  const grid = pooled(trimmed(toGrid(shades, fields), picture.name));
  const [width, height] = grid.size.map((metres) => metres.toFixed(1));
  const guess = yaml ? "" : `, taking ${DEFAULTS.resolution} m a pixel for want of a .yaml file`;
  return { grid, note: `${picture.name}: ${width} × ${height} m, ${grid.resolution.toFixed(2)} m a cell${guess}.` };
}

/** {width, height, shade: [H*W] in [0, 1], opaque: [H*W]} of a PNG, top row first. */
async function readPng(file) {
  const wrong = (cause) => new Error(`${file.name}: expected a PNG picture.`, { cause });
  const head = new Uint8Array(await file.slice(0, SIZE_END).arrayBuffer());
  if (head.length < SIZE_END || SIGNATURE.some((byte, k) => head[k] !== byte)) throw wrong();
  const told = new DataView(head.buffer);
  checkSize(told.getUint32(WIDTH_AT), told.getUint32(HEIGHT_AT), file.name);
  let bitmap;
  try {
    bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (cause) {
    throw wrong(cause);
  }
  const { width, height } = bitmap;
  const context = new OffscreenCanvas(width, height).getContext("2d");
  context.drawImage(bitmap, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  const pixel = (of) => Float32Array.from({ length: width * height }, (_, k) => of(4 * k));
  return {
    width,
    height,
    shade: pixel((k) => (data[k] + data[k + 1] + data[k + 2]) / 765),
    opaque: pixel((k) => (data[k + 3] === 255 ? 1 : 0)),
  };
}

/** A grid of map_server's meaning of shades; its first row is the picture's last. */
function toGrid({ width, height, shade, opaque }, fields) {
  const grid = new Grid(height, width, fields.resolution, [...fields.origin]);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const k = (height - 1 - row) * width + column;
      grid.set(row, column, opaque && !opaque[k] ? UNKNOWN : meaning(shade[k], fields));
    }
  }
  return grid;
}

function meaning(shade, { mode, negate, occupied_thresh: occupied, free_thresh: free }) {
  if (mode === "raw") {
    const percent = Math.round(255 * shade);
    if (percent > 100) return UNKNOWN;
    return percent >= 50 ? OCCUPIED : FREE;
  }
  const darkness = negate ? shade : 1 - shade;
  // The contract takes a cell for an obstacle from an occupancy of 0.5 on.
  if (mode === "scale") return (darkness - free) / (occupied - free) >= 0.5 ? OCCUPIED : FREE;
  if (darkness > occupied) return OCCUPIED;
  return darkness < free ? FREE : UNKNOWN;
}

/** Without the unknown margin that mapping programs leave. */
function trimmed(grid, name) {
  const rows = { low: Infinity, high: -1 };
  const columns = { low: Infinity, high: -1 };
  const widen = (range, value) => {
    range.low = Math.min(range.low, value);
    range.high = Math.max(range.high, value);
  };
  grid.cells.forEach((cell, k) => {
    if (cell === UNKNOWN) return;
    widen(rows, Math.floor(k / grid.columns));
    widen(columns, k % grid.columns);
  });
  if (rows.high < 0) throw new Error(`${name}: every cell of this map is unknown.`);
  const span = ({ low, high }, most) => {
    const [from, to] = [Math.max(0, low - 2), Math.min(most, high + 3)];
    return [from, Math.max(to - from, LEAST_CELLS)];
  };
  const [top, height] = span(rows, grid.rows);
  const [left, width] = span(columns, grid.columns);
  return resampled(grid, { top, left, height, width, factor: 1 });
}

function pooled(grid) {
  const factor = Math.ceil(Math.max(grid.rows, grid.columns) / MOST_CELLS);
  const side = (cells) => Math.max(LEAST_CELLS, Math.ceil(cells / factor));
  return resampled(grid, { top: 0, left: 0, height: side(grid.rows), width: side(grid.columns), factor });
}

/** A window of `height` × `width` cells, each the worst of factor × factor of the old. */
function resampled(grid, { top, left, height, width, factor }) {
  const origin = [grid.origin[0] + left * grid.resolution, grid.origin[1] + top * grid.resolution];
  const window = new Grid(height, width, factor * grid.resolution, origin);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      let worst = FREE;
      for (let k = 0; k < factor * factor; k++) {
        const [r, c] = [top + row * factor + Math.floor(k / factor), left + column * factor + (k % factor)];
        const cell = grid.contains(r, c) ? grid.at(r, c) : UNKNOWN;
        if (cell === OCCUPIED || (cell === UNKNOWN && worst === FREE)) worst = cell;
      }
      window.set(row, column, worst);
    }
  }
  return window;
}
