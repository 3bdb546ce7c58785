/** The ego's frame from above: x forward is up, y is to the left, a grid in metres. */

import { drawAnchors, toScreen } from "../lines.js";
import { plain } from "../dom.js";
import { Surface } from "../surface.js";

/** Between the picture's edge and what is farthest out. */
const MARGIN_PX = 34;
/** m that are shown at least, so that a car that stands still is not looked at through a glass. */
const LEAST_M = 12;
/** px between two lines of the grid, at least. */
const LEAST_STRIDE_PX = 56;
const STRIDES_M = [1, 2, 5, 10, 20, 50, 100, 200, 500];
const GRID_OPACITY = 0.4;
const POSE_PX = 3.5;
const HEADING_PX = 11;

export class BirdsEye extends Surface {
  /**
   * What is drawn, as `lines.js` takes it; `raster` lies below where its extent is known, and of
   * the drive that is open its `street` as it is in a `frame`, and the `routes` that it tells.
   */
  show = { anchors: null, raster: null, street: null, frame: null, routes: [], colourBy: "score", focus: null, step: null, stale: false, replayed: null, robot: null };
  /** px of an anchor. */
  lineWidth = 2;
  #middle = [0, 0];
  scale = 1;

  constructor(canvas) {
    super(canvas);
    this.resize();
  }

  /** [left, top] in CSS pixels of a point in m. */
  toScreen(x, y) {
    return [this.width / 2 - (y - this.#middle[1]) * this.scale, this.height / 2 - (x - this.#middle[0]) * this.scale];
  }

  paint() {
    const { context, colours, density, show } = this;
    this.#fit();
    context.setTransform(density, 0, 0, density, 0, 0);
    context.fillStyle = colours.map;
    context.fillRect(0, 0, this.width, this.height);
    if (show.street) show.street.paintRoad(this, show.frame);
    if (show.raster?.extent) this.#paintRaster(show.raster);
    this.#paintGrid();
    if (show.street) {
      show.street.paintRoutes(this, show.routes);
      show.street.paintOthers(this, show.frame);
    } else this.#paintEgo();
    if (show.anchors) drawAnchors(context, this, show);
    if (show.street) show.street.paintEgo(this, show.frame);
    if (show.anchors && !show.stale) this.#paintPoses(show.anchors, show.focus ?? show.anchors.best);
    return true;
  }

  /** The ego and all anchors, and the picture below them, fit; a drive stays as large as it is. */
  #fit() {
    const { street, raster } = this.show;
    const anchors = street ? null : this.show.anchors;
    const [xs, ys] = [[0], [0]];
    if (street) {
      xs.push(...street.extent.slice(0, 2));
      ys.push(...street.extent.slice(2));
    }
    for (let k = 0; k < (anchors?.positions.length ?? 0); k += 2) {
      xs.push(anchors.positions[k]);
      ys.push(anchors.positions[k + 1]);
    }
    if (raster?.extent && !street) {
      xs.push(...raster.extent.slice(0, 2));
      ys.push(...raster.extent.slice(2));
    }
    const [[left, right], [bottom, top]] = [ys, xs].map((values) => values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [0, 0]));
    // The ego stays in the middle between left and right.
    const wide = 2 * Math.max(-left, right);
    this.#middle = [(bottom + top) / 2, 0];
    this.scale = Math.min((this.width - 2 * MARGIN_PX) / Math.max(wide, LEAST_M), (this.height - 2 * MARGIN_PX) / Math.max(top - bottom, LEAST_M));
  }

  #paintRaster({ canvas, extent: [backward, forward, right, left] }) {
    const { context } = this;
    const [x0, y0] = this.toScreen(forward, left);
    const [x1, y1] = this.toScreen(backward, right);
    context.imageSmoothingEnabled = false;
    context.globalAlpha = 0.55;
    context.drawImage(canvas, x0, y0, x1 - x0, y1 - y0);
    context.globalAlpha = 1;
  }

  /** Lines at round metres, and how far ahead or aside they are. */
  #paintGrid() {
    const { context, colours } = this;
    const stride = STRIDES_M.find((metres) => metres * this.scale >= LEAST_STRIDE_PX) ?? STRIDES_M.at(-1);
    const reach = [this.height, this.width].map((size) => size / 2 / this.scale);
    context.font = `11px ${getComputedStyle(this.canvas).fontFamily}`;
    context.lineWidth = 1;
    for (const axis of [0, 1]) {
      const from = Math.ceil((this.#middle[axis] - reach[axis]) / stride);
      const to = Math.floor((this.#middle[axis] + reach[axis]) / stride);
      for (let k = from; k <= to; k++) {
        const [left, top] = axis ? this.toScreen(0, k * stride) : this.toScreen(k * stride, 0);
        context.strokeStyle = colours.unknown;
        context.globalAlpha = k ? GRID_OPACITY : 1;
        context.beginPath();
        if (axis) context.rect(Math.round(left) + 0.5, 0, 0, this.height);
        else context.rect(0, Math.round(top) + 0.5, this.width, 0);
        context.stroke();
        context.globalAlpha = 1;
        this.#write(plain(k * stride), axis, axis ? left : top);
      }
    }
    context.textAlign = "left";
    context.fillText("x [m]", 8, 18);
    context.textAlign = "right";
    context.fillText("y [m]", this.width - 8, this.height - 8);
  }

  /** A number at a line of the grid, unless the axis' name stands there. */
  #write(text, axis, at) {
    const { context, height, width } = this;
    context.fillStyle = this.colours.soft;
    context.textAlign = axis ? "center" : "left";
    if (axis && at > 40 && at < width - 60) context.fillText(text, at, height - 8);
    if (!axis && at > 36 && at < height - 24) context.fillText(text, 8, at - 5);
  }

  /** Where the planner sits, looking up. */
  #paintEgo() {
    const { context, colours } = this;
    const [left, top] = this.toScreen(0, 0);
    context.fillStyle = colours.start;
    context.strokeStyle = colours.card;
    context.lineWidth = 2;
    context.lineJoin = "round";
    context.beginPath();
    context.moveTo(left, top - 12);
    context.lineTo(left + 9, top + 10);
    context.lineTo(left, top + 5);
    context.lineTo(left - 9, top + 10);
    context.closePath();
    context.fill();
    context.stroke();
  }

  /** The poses of one anchor, and where each of them looks. */
  #paintPoses(anchors, n) {
    const { context, colours } = this;
    const hasHeading = anchors.trajectories.shape[2] > 2;
    const first = 2 * n * anchors.steps;
    const screen = toScreen(this, anchors.positions.subarray(first, first + 2 * anchors.steps));
    context.lineWidth = 1.5;
    for (let t = 0; t < anchors.steps; t++) {
      const [left, top] = [screen[2 * t], screen[2 * t + 1]];
      if (hasHeading) {
        const [, , heading] = anchors.pose(n, t);
        context.strokeStyle = colours.ink;
        context.beginPath();
        context.moveTo(left, top);
        context.lineTo(left - HEADING_PX * Math.sin(heading), top - HEADING_PX * Math.cos(heading));
        context.stroke();
      }
      context.fillStyle = t === this.show.step ? colours.focus : colours.ink;
      context.strokeStyle = colours.map;
      context.beginPath();
      context.arc(left, top, t === this.show.step ? POSE_PX + 2 : POSE_PX, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }
  }
}
