/** The robot's outline: a disc, a rectangle, or the polygon of a scene, and its control in the form. */

import { byId, make, plain, showFill } from "../dom.js";

/** Sliders of a rectangle, m: label, ends and hint. `behind` is the part of it behind the origin. */
const SIDES = {
  length: { label: "Length", low: 0.2, high: 2, hint: "Along the heading." },
  width: { label: "Width", low: 0.2, high: 1.5, hint: "Across it." },
  behind: { label: "Behind the origin", low: 0, high: 2, hint: "How far it reaches behind the point that turns, such as the axle." },
};
const STEP = 0.01;
/** The origin is inside the outline by so many m. */
const LEAST_INSIDE = 0.02;
/** m up to which a polygon counts as a rectangle. */
const SAME = 1e-6;
const DECIMALS = 4;
/** m that a robot's outline drawn along an anchor is apart at least, in lengths of it. */
const SPACING = 0.3;

export const DISC = { shape: "disc", length: 0.9, width: 0.62, behind: 0.45, corners: null };

/** [[x, y]] m of the outline, x forward, counter-clockwise; null for a disc. */
export function cornersOf({ shape, length, width, behind, corners }) {
  if (shape === "disc") return null;
  if (shape === "polygon") return corners;
  const [back, front] = [-behind, length - behind];
  const rectangle = [[front, width / 2], [back, width / 2], [back, -width / 2], [front, -width / 2]];
  return rectangle.map((corner) => corner.map((value) => Number(value.toFixed(DECIMALS))));
}

/** The body of a request's `footprint`; a rectangle if it is one along its heading. Throws an Error that names the field. */
export function bodyOf(footprint) {
  if (footprint === undefined) return { ...DISC };
  const isGood = Array.isArray(footprint) && footprint.length >= 3 && footprint.every((corner) => corner?.length === 2 && corner.every(Number.isFinite));
  if (!isGood) throw new Error("footprint: expected corners [K,2] in m.");
  const [xs, ys] = [0, 1].map((axis) => footprint.map((corner) => corner[axis]));
  const [back, front, half] = [Math.min(...xs), Math.max(...xs), Math.max(...ys)];
  const isEdge = ([x, y]) => Math.min(Math.abs(x - back), Math.abs(x - front)) < SAME && Math.abs(Math.abs(y) - half) < SAME;
  const rectangle = { shape: "rectangle", length: front - back, width: 2 * half, behind: -back, corners: null };
  return footprint.length === 4 && footprint.every(isEdge) ? rectangle : { ...DISC, shape: "polygon", corners: footprint };
}

/** [inner, outer] m: of the disc about the origin inside an outline, and of the one around it. */
export function radiiOf(corners) {
  const gaps = corners.map(([x, y], k) => {
    const [toX, toY] = corners[(k + 1) % corners.length];
    return Math.abs(x * toY - y * toX) / Math.hypot(toX - x, toY - y);
  });
  return [Math.min(...gaps), Math.max(...corners.map(([x, y]) => Math.hypot(x, y)))];
}

/** [[x, y]] m of an outline at a pose. */
export function placed(corners, { x, y, heading }) {
  const [cosine, sine] = [Math.cos(heading), Math.sin(heading)];
  return corners.map(([forward, left]) => [x + cosine * forward - sine * left, y + sine * forward + cosine * left]);
}

/**
 * Poses along anchor n, far enough apart to tell them from each other, the last one included, each with
 * its gear: 1 forwards, -1 backwards, 0 on the spot; and the places where the robot drives the other way.
 */
export function posesAlong(anchors, n, length) {
  const poses = [];
  const cusps = [];
  let last = null;
  let driven = 0;
  for (let t = 0; t < anchors.steps; t++) {
    const pose = { ...anchors.stateAt(n, t), gear: anchors.gear(n, t) };
    if (pose.gear && driven && pose.gear !== driven) cusps.push(anchors.stateAt(n, t - 1));
    if (pose.gear) driven = pose.gear;
    const apart = last ? Math.hypot(pose.x - last.x, pose.y - last.y) + (Math.abs(pose.heading - last.heading) * length) / 2 : Infinity;
    if (apart < SPACING * length && t + 1 < anchors.steps) continue;
    poses.push(pose);
    last = pose;
  }
  return { poses, cusps };
}

/** The choice of a shape and its sides above the fields of the robot; calls `onChange(body)`. */
export class BodyControl {
  #body;

  constructor(onChange) {
    this.onChange = onChange;
    byId("shape").addEventListener("change", () => this.#change({ shape: byId("shape").value }));
    this.rows = Object.fromEntries(Object.entries(SIDES).map(([name, side]) => [name, this.#row(name, side)]));
    byId("sides").replaceChildren(...Object.values(this.rows).map(({ element }) => element));
  }

  show(body) {
    this.#body = body;
    byId("shape-polygon").hidden = body.shape !== "polygon";
    byId("shape").value = body.shape;
    byId("sides").hidden = body.shape !== "rectangle";
    for (const [name, { input, output }] of Object.entries(this.rows)) {
      input.max = name === "behind" ? body.length - LEAST_INSIDE : Math.max(SIDES[name].high, body[name]);
      if (name === "behind") input.min = LEAST_INSIDE;
      input.value = body[name];
      output.value = `${plain(body[name])} m`;
      showFill(input);
    }
  }

  #row(name, { label, low, high, hint }) {
    const input = make("input", { id: `body-${name}`, type: "range", min: low, max: high, step: STEP });
    const output = make("output");
    const note = make("p", { className: "hint", id: `body-${name}-hint` }, hint);
    input.setAttribute("aria-describedby", note.id);
    input.addEventListener("input", () => this.#change({ [name]: Number(input.value) }));
    const field = make("label", { className: "field", htmlFor: input.id }, make("span", {}, label), output, input);
    return { input, output, element: make("div", { className: "row" }, field, note) };
  }

  /** The origin keeps its share of the length. */
  #change(part) {
    const body = { ...this.#body, ...part };
    if ("length" in part) body.behind = Number(((this.#body.behind / this.#body.length) * part.length).toFixed(2));
    this.onChange(body);
  }
}
