/** Anchors as lines: coloured, the ones that are not safe dashed, one of them in focus. */

import { SHADES, shade } from "./colours.js";
import { figure } from "./dom.js";

const DASH = [5, 4];
/** Share of the anchors below the scale's low end. */
const STRAGGLERS = 0.1;
/** px from a line at which the pointer means it. */
const NEAR_PX = 14;

/** What the colours stand for: {low, high, unit, digits, all} as `figure` takes them; null where they stand for nothing. */
export function colourScale(anchors, by) {
  if (by === "speed") return anchors.speeds && { low: 0, high: anchors.limits.v_max, unit: "m/s", digits: Number.isInteger(anchors.limits.v_max) ? 0 : 2 };
  const values = by === "score" ? anchors.scores : anchors.clearance;
  if (!values) return null;
  // The scores of anchors through walls would leave one colour to all the others.
  const shown = anchors.numSafe ? values.filter((_, n) => anchors.safe[n]) : values;
  const sorted = [...shown].sort((a, b) => a - b);
  // A few stragglers would do the same; they share the lowest colour.
  const low = sorted[Math.floor(STRAGGLERS * sorted.length)];
  return { low, high: sorted.at(-1), unit: by === "clearance" ? "m" : "", digits: 2, all: by === "score" ? values : null };
}

/** The colour of a whole anchor. */
export function anchorColour(stage, anchors, by, n) {
  const scale = colourScale(anchors, by);
  if (!scale) return stage.colours.accent;
  const values = { score: anchors.scores, clearance: anchors.clearance }[by];
  const value = values ? values[n] : anchors.greatest(anchors.speeds, n);
  return stage.colours.ramps[by][shade(value, scale.low, scale.high)];
}

/** Shows what the colours stand for in a legend; none where they stand for nothing. */
export function showLegend(legend, anchors, by) {
  const scale = colourScale(anchors, by);
  legend.hidden = !scale;
  if (!scale) return;
  legend.dataset.by = by;
  const { low, high, unit, digits, all } = scale;
  legend.firstElementChild.textContent = figure(low, digits, all);
  legend.lastElementChild.textContent = `${figure(high, digits, all)} ${unit}`.trim();
}

/** Draws them, worst first so that good ones lie on top. */
export function drawAnchors(context, stage, show) {
  const { anchors, colourBy: by, focus, stale, replayed, robot } = show;
  const screen = toScreen(stage, replayed ?? anchors.positions);
  const bySpeed = by === "speed" && anchors.speeds && !replayed;
  const inFocus = robot ? null : (focus ?? anchors.best);
  context.lineJoin = context.lineCap = "round";
  context.globalAlpha = stale ? 0.22 : focus === null ? 0.9 : 0.35;
  context.lineWidth = stage.lineWidth;
  for (const n of [...anchors.order].reverse()) {
    if (n === inFocus && !stale) continue;
    if (bySpeed) drawBySpeed(context, stage, { anchors, screen, n });
    else drawWhole(context, { anchors, screen, n, colour: anchorColour(stage, anchors, by, n) });
  }
  context.globalAlpha = 1;
  if (stale || robot) return;
  context.lineWidth = 6;
  drawWhole(context, { anchors, screen, n: inFocus, colour: stage.colours.outline });
  context.lineWidth = 3;
  if (bySpeed) drawBySpeed(context, stage, { anchors, screen, n: inFocus });
  else drawWhole(context, { anchors, screen, n: inFocus, colour: stage.colours.focus });
  if (show.step !== null && !replayed) drawStep(context, stage, screen, inFocus * anchors.steps + show.step);
}

/** The way that a robot has taken, as the anchor in focus is drawn. */
export function drawPath(context, stage, points) {
  const { colours } = stage;
  context.lineJoin = context.lineCap = "round";
  for (const [colour, width] of [[colours.outline, 6], [colours.focus, 3]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    for (const point of points) context.lineTo(...stage.toScreen(...point));
    context.stroke();
  }
}

/** [N,T,2] in CSS pixels. */
export function toScreen(stage, positions) {
  // How a metre lies on the screen, seen from the first point: maps may lie far from zero.
  const [x0, y0] = positions;
  const [left0, top0] = stage.toScreen(x0, y0);
  const [alongX, alongY] = [stage.toScreen(x0 + 1, y0), stage.toScreen(x0, y0 + 1)].map(([left, top]) => [left - left0, top - top0]);
  const screen = new Float32Array(positions.length);
  for (let k = 0; k < positions.length; k += 2) {
    const [x, y] = [positions[k] - x0, positions[k + 1] - y0];
    screen[k] = left0 + x * alongX[0] + y * alongY[0];
    screen[k + 1] = top0 + x * alongX[1] + y * alongY[1];
  }
  return screen;
}

function drawWhole(context, { anchors, screen, n, colour }) {
  context.strokeStyle = colour;
  context.setLineDash(anchors.safe[n] ? [] : DASH);
  context.beginPath();
  for (let k = 2 * n * anchors.steps; k < 2 * (n + 1) * anchors.steps; k += 2) context.lineTo(screen[k], screen[k + 1]);
  context.stroke();
  context.setLineDash([]);
}

/** Runs of one shade are one stroke; dashes go on from run to run. */
function drawBySpeed(context, stage, { anchors, screen, n }) {
  const shades = stage.colours.ramps.speed;
  const first = n * anchors.steps;
  const shadeAt = (t) => shade(anchors.speeds[first + t], 0, anchors.limits.v_max * (1 + 1 / SHADES));
  context.setLineDash(anchors.safe[n] ? [] : DASH);
  let gone = 0;
  for (let t = 0; t + 1 < anchors.steps; ) {
    const run = shadeAt(t);
    context.strokeStyle = shades[run];
    context.lineDashOffset = gone;
    context.beginPath();
    context.moveTo(screen[2 * (first + t)], screen[2 * (first + t) + 1]);
    do {
      const k = 2 * (first + t);
      context.lineTo(screen[k + 2], screen[k + 3]);
      gone += Math.hypot(screen[k + 2] - screen[k], screen[k + 3] - screen[k + 1]);
      t++;
    } while (t + 1 < anchors.steps && shadeAt(t) === run);
    context.stroke();
  }
  context.lineDashOffset = 0;
  context.setLineDash([]);
}

/** A bead at one of the [N,T] points. */
function drawStep(context, { colours }, screen, point) {
  const k = 2 * point;
  context.fillStyle = colours.card;
  context.strokeStyle = colours.outline;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(screen[k], screen[k + 1], 4.5, 0, 2 * Math.PI);
  context.fill();
  context.stroke();
}

/** {anchor, step} under a point in CSS pixels, or null. */
export function pick(stage, anchors, left, top) {
  const screen = toScreen(stage, anchors.positions);
  let best = null;
  let nearest = NEAR_PX ** 2;
  for (let n = 0; n < anchors.count; n++) {
    for (let t = 0; t + 1 < anchors.steps; t++) {
      const k = 2 * (n * anchors.steps + t);
      const [dx, dy] = [screen[k + 2] - screen[k], screen[k + 3] - screen[k + 1]];
      const along = ((left - screen[k]) * dx + (top - screen[k + 1]) * dy) / (dx * dx + dy * dy || 1);
      const share = Math.min(1, Math.max(0, along));
      const gap = (screen[k] + share * dx - left) ** 2 + (screen[k + 1] + share * dy - top) ** 2;
      if (gap >= nearest) continue;
      nearest = gap;
      best = { anchor: n, step: share < 0.5 ? t : t + 1 };
    }
  }
  return best;
}
