/** Canvases that follow their size and the theme, and the anchors on them. */

import { clamp, figure } from "./dom.js";

/** Colours of a ramp; lines of one shade are drawn in one stroke. */
const SHADES = 24;
const COLOURS = ["map", "wall", "halo", "unknown", "outline", "focus", "start", "goal", "person", "dear", "ink", "soft", "accent", "bad", "card", "verge", "road", "zebra"];
const RAMPS = ["score", "speed", "clearance"];
const UNSAFE_DASH = [5, 4];
/** Share of the anchors that may lie below the low end of the colour scale. */
const OUTLIERS = 0.1;
/** Distance in px within which the pointer picks a line. */
const PICK_PX = 14;

/** Colours of the style sheet in the current theme: {map, …, ramps: {score: [SHADES], …}, classes: [[r, g, b]]}. */
function readColours() {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => style.getPropertyValue(`--${name}`).trim();
  const list = (name) => read(name).split(/,\s*/).map(channels);
  const ramps = Object.fromEntries(RAMPS.map((name) => [name, interpolated(list(`ramp-${name}`))]));
  return { ...Object.fromEntries(COLOURS.map((name) => [name, read(name)])), ramps, classes: list("classes") };
}

/** [r, g, b] of "#rrggbb". */
const channels = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));

function interpolated(stops) {
  return Array.from({ length: SHADES }, (_, k) => {
    const place = (k / (SHADES - 1)) * (stops.length - 1);
    const at = Math.min(Math.floor(place), stops.length - 2);
    const mixed = stops[at].map((low, axis) => Math.round(low + (place - at) * (stops[at + 1][axis] - low)));
    return `rgb(${mixed.join(" ")})`;
  });
}

/** Index of the shade for a value between low and high. */
export function shade(value, low, high) {
  const share = high > low ? (value - low) / (high - low) : 1;
  return clamp(Math.floor(share * SHADES), 0, SHADES - 1);
}

/**
 * A canvas that is painted at most once a frame. Subclasses map points in m to CSS pixels with
 * `toScreen(x, y)` and draw in `paint()`, which returns whether there was something to draw.
 */
export class Surface {
  #drawn = [];
  #requested = false;
  /** What is drawn; owners change it, then call `draw()`. `focus` and `step` are an anchor and a time step. */
  show = { anchors: null, colourBy: "score", focus: null, step: null, stale: false, replayed: null, robot: null };

  /** `layers` are further canvases of the same size; calls `onTheme()` when the theme changes, `onFit()` after a resize. */
  constructor(canvas, layers = []) {
    Object.assign(this, { canvas, layers, onTheme() {}, onFit() {} });
    this.context = canvas.getContext("2d");
    this.colours = readColours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colours = readColours();
      this.redraw();
      this.onTheme();
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  resize() {
    const density = Math.min(window.devicePixelRatio || 1, 2);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    for (const canvas of [this.canvas, ...this.layers]) {
      canvas.width = Math.round(width * density);
      canvas.height = Math.round(height * density);
    }
    Object.assign(this, { density, width, height });
    this.redraw();
    this.onFit();
  }

  /** Draw everything again, layers included. */
  redraw() {
    this.draw();
  }

  /** Paint before the next frame; resolves with the time at which that frame is on the screen. */
  draw() {
    if (!this.#requested) {
      this.#requested = true;
      requestAnimationFrame(() => {
        this.#requested = false;
        if (!this.width || !this.paint()) return;
        const drawn = this.#drawn.splice(0);
        // The next frame begins after this one was shown.
        requestAnimationFrame(() => drawn.forEach((resolve) => resolve(performance.now())));
      });
    }
    return new Promise((resolve) => this.#drawn.push(resolve));
  }
}

/** px between two labels of an axis, at least, and their distances in m. */
const MIN_STRIDE_PX = 56;
const STRIDES_M = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500];

/** m between two labels of an axis with so many px a metre. */
export const stride = (scale) => STRIDES_M.find((metres) => metres * scale >= MIN_STRIDE_PX) ?? STRIDES_M.at(-1);

/** A label of an axis, legible on all that is below it. */
export function axisText(context, { canvas, colours }, text, [left, top], align) {
  context.save();
  context.font = `11px ${getComputedStyle(canvas).fontFamily}`;
  Object.assign(context, { textAlign: align, lineJoin: "round", lineWidth: 3, strokeStyle: colours.map, fillStyle: colours.soft });
  context.strokeText(text, left, top);
  context.fillText(text, left, top);
  context.restore();
}

/** A stroke along points [[left, top]] in CSS pixels. */
export function stroke(context, points, { colour, width, dash = [], opacity = 1 }) {
  context.save();
  context.lineJoin = context.lineCap = "round";
  Object.assign(context, { strokeStyle: colour, lineWidth: width, globalAlpha: opacity });
  context.setLineDash(dash);
  context.beginPath();
  for (const point of points) context.lineTo(...point);
  context.stroke();
  context.restore();
}

/** A disc or, without a `fill`, a circle round a point in CSS pixels. */
export function circle(context, [left, top], radius, { fill, colour, width, dash = [], opacity = 1 }) {
  context.save();
  Object.assign(context, { strokeStyle: colour, lineWidth: width, globalAlpha: opacity });
  context.setLineDash(dash);
  context.beginPath();
  context.arc(left, top, radius, 0, 2 * Math.PI);
  if (fill) {
    context.fillStyle = fill;
    context.fill();
  }
  context.stroke();
  context.restore();
}

/** What the colours mean: {low, high, unit, digits, all} with the arguments of `figure`; null if they mean nothing. */
function colourScale(anchors, by) {
  if (by === "speed") {
    const { v_max: high } = anchors.limits ?? {};
    return anchors.speeds && { low: 0, high, unit: "m/s", digits: Number.isInteger(high) ? 0 : 2, all: null };
  }
  const values = by === "score" ? anchors.scores : anchors.clearance;
  if (!values) return null;
  // Scores of anchors through walls, and a few outliers, would leave one colour for all the others.
  const shown = anchors.numSafe ? values.filter((_, n) => anchors.safe[n]) : values;
  const sorted = [...shown].sort((a, b) => a - b);
  const low = sorted[Math.floor(OUTLIERS * sorted.length)];
  return { low, high: sorted.at(-1), unit: by === "clearance" ? "m" : "", digits: 2, all: by === "score" ? values : null };
}

/** The colour of a whole anchor. */
export function anchorColour({ colours }, anchors, by, n) {
  const scale = colourScale(anchors, by);
  if (!scale) return colours.accent;
  const values = { score: anchors.scores, clearance: anchors.clearance }[by];
  const value = values ? values[n] : anchors.greatest(anchors.speeds, n);
  return colours.ramps[by][shade(value, scale.low, scale.high)];
}

/** Fill a legend with what the colours mean, or hide it. */
export function showLegend(legend, anchors, by) {
  const scale = anchors && colourScale(anchors, by);
  legend.hidden = !scale;
  if (!scale) return;
  legend.dataset.by = by;
  const { low, high, unit, digits, all } = scale;
  legend.firstElementChild.textContent = figure(low, digits, all);
  legend.lastElementChild.textContent = `${figure(high, digits, all)} ${unit}`.trim();
}

/** Draw the anchors of `surface.show`, the worst first, so that good ones are on top. */
export function drawAnchors(context, surface) {
  const { anchors, colourBy: by, focus, step, stale, replayed, robot } = surface.show;
  const { colours } = surface;
  const screen = toScreen(surface, replayed ?? anchors.positions);
  const bySpeed = by === "speed" && anchors.speeds && !replayed;
  const inFocus = robot ? null : (focus ?? anchors.best);
  const line = (n, colour) => {
    context.strokeStyle = colour;
    context.setLineDash(anchors.safe[n] ? [] : UNSAFE_DASH);
    context.beginPath();
    for (let k = 2 * n * anchors.steps; k < 2 * (n + 1) * anchors.steps; k += 2) context.lineTo(screen[k], screen[k + 1]);
    context.stroke();
  };
  const draw = (n, colour) => (bySpeed ? drawBySpeed(context, surface, screen, n) : line(n, colour ?? anchorColour(surface, anchors, by, n)));
  context.save();
  context.lineJoin = context.lineCap = "round";
  context.globalAlpha = stale ? 0.22 : focus === null ? 0.9 : 0.35;
  context.lineWidth = surface.lineWidth;
  for (const n of [...anchors.order].reverse()) if (n !== inFocus || stale) draw(n);
  context.globalAlpha = 1;
  if (!stale && !robot) {
    context.lineWidth = 6;
    line(inFocus, colours.outline);
    context.lineWidth = 3;
    draw(inFocus, colours.focus);
    const k = 2 * (inFocus * anchors.steps + step);
    if (step !== null && !replayed) circle(context, [screen[k], screen[k + 1]], 4.5, { fill: colours.card, colour: colours.outline, width: 2 });
  }
  context.restore();
}

/** Runs of one shade are one stroke; dashes go on from run to run. */
function drawBySpeed(context, { colours, show: { anchors } }, screen, n) {
  const first = n * anchors.steps;
  const shadeAt = (t) => shade(anchors.speeds[first + t], 0, anchors.limits.v_max * (1 + 1 / SHADES));
  context.setLineDash(anchors.safe[n] ? [] : UNSAFE_DASH);
  let length = 0;
  for (let t = 0; t + 1 < anchors.steps; ) {
    const run = shadeAt(t);
    context.strokeStyle = colours.ramps.speed[run];
    context.lineDashOffset = length;
    context.beginPath();
    context.moveTo(screen[2 * (first + t)], screen[2 * (first + t) + 1]);
    do {
      const k = 2 * (first + t);
      context.lineTo(screen[k + 2], screen[k + 3]);
      length += Math.hypot(screen[k + 2] - screen[k], screen[k + 3] - screen[k + 1]);
      t++;
    } while (t + 1 < anchors.steps && shadeAt(t) === run);
    context.stroke();
  }
  context.lineDashOffset = 0;
}

/** [N,T,2] in CSS pixels. */
export function toScreen(surface, positions) {
  // A metre along x and y on the screen, from the first point: maps may be far from the origin.
  const [x0, y0] = positions;
  const [left0, top0] = surface.toScreen(x0, y0);
  const [alongX, alongY] = [surface.toScreen(x0 + 1, y0), surface.toScreen(x0, y0 + 1)].map(([left, top]) => [left - left0, top - top0]);
  const screen = new Float32Array(positions.length);
  for (let k = 0; k < positions.length; k += 2) {
    const [x, y] = [positions[k] - x0, positions[k + 1] - y0];
    screen[k] = left0 + x * alongX[0] + y * alongY[0];
    screen[k + 1] = top0 + x * alongX[1] + y * alongY[1];
  }
  return screen;
}

/** {anchor, step} under a point in CSS pixels, or null. */
export function pick(surface, anchors, left, top) {
  const screen = toScreen(surface, anchors.positions);
  let best = null;
  let nearest = PICK_PX ** 2;
  for (let n = 0; n < anchors.count; n++) {
    for (let t = 0; t + 1 < anchors.steps; t++) {
      const k = 2 * (n * anchors.steps + t);
      const [dx, dy] = [screen[k + 2] - screen[k], screen[k + 3] - screen[k + 1]];
      const along = ((left - screen[k]) * dx + (top - screen[k + 1]) * dy) / (dx * dx + dy * dy || 1);
      const share = clamp(along, 0, 1);
      const gap = (screen[k] + share * dx - left) ** 2 + (screen[k + 1] + share * dy - top) ** 2;
      if (gap >= nearest) continue;
      nearest = gap;
      best = { anchor: n, step: share < 0.5 ? t : t + 1 };
    }
  }
  return best;
}
