/** The ego's frame from above (x forward is up, y is to the left), with the street of a recorded drive. */

import { Surface, axisText, circle, drawAnchors, stride, stroke, toScreen } from "../drawing.js";
import { plain } from "../dom.js";

/** px between the edge of the picture and the farthest point. */
const MARGIN_PX = 34;
/** m that are always shown, also for a vehicle that stands still. */
const MIN_M = 12;
const GRID_OPACITY = 0.4;
const RASTER_OPACITY = 0.55;
const POSE_PX = 3.5;
/** Poses of an anchor that are marked, at most. */
const MAX_MARKED = 9;
const HEADING_PX = 11;
/** Colours of boxes by the type in a driving log. */
const BOX_COLOURS = ["wall", "goal", "goal", "soft"];
const RECORDED_DASH = [4, 9];
const ROUTE = { width: 10, opacity: 0.25 };
/** Share of a box's length that its nose takes. */
const NOSE = 0.22;

export class BirdsEye extends Surface {
  /** px of an anchor. */
  lineWidth = 2;
  scale = 1;
  /** x in m at the middle of the canvas. */
  middle = 0;

  constructor(canvas) {
    super(canvas);
    // A raster whose extent is known is below the anchors; the street of a drive as it is in a frame.
    Object.assign(this.show, { raster: null, street: null, frame: null, routes: [] });
    this.resize();
  }

  /** [left, top] in CSS pixels of a point in m. */
  toScreen(x, y) {
    return [this.width / 2 - y * this.scale, this.height / 2 - (x - this.middle) * this.scale];
  }

  paint() {
    const { context, colours, density, show } = this;
    const { anchors, frame, raster, street } = show;
    this.#fit();
    context.setTransform(density, 0, 0, density, 0, 0);
    context.fillStyle = colours.map;
    context.fillRect(0, 0, this.width, this.height);
    if (street) street.paintRoad(this, frame);
    if (raster?.extent) this.#paintRaster(raster);
    this.#paintGrid();
    if (street) street.paintTraffic(this, frame, show.routes);
    else this.#paintEgo();
    if (anchors) drawAnchors(context, this);
    if (street) street.paintEgo(this, frame);
    if (anchors && !show.stale) this.#paintPoses(anchors, show.focus ?? anchors.best);
    return true;
  }

  /** Scale to the ego, the anchors and the raster; to the whole street of a drive while one is open. */
  #fit() {
    const { anchors, raster, street } = this.show;
    let [bottom, top, right, left] = street?.extent ?? raster?.extent ?? [0, 0, 0, 0];
    [bottom, top, right, left] = [Math.min(bottom, 0), Math.max(top, 0), Math.min(right, 0), Math.max(left, 0)];
    const positions = street ? [] : (anchors?.positions ?? []);
    for (let k = 0; k < positions.length; k += 2) {
      [bottom, top] = [Math.min(bottom, positions[k]), Math.max(top, positions[k])];
      [right, left] = [Math.min(right, positions[k + 1]), Math.max(left, positions[k + 1])];
    }
    // The ego stays in the middle between left and right.
    const wide = 2 * Math.max(-right, left);
    this.middle = (bottom + top) / 2;
    this.scale = Math.min((this.width - 2 * MARGIN_PX) / Math.max(wide, MIN_M), (this.height - 2 * MARGIN_PX) / Math.max(top - bottom, MIN_M));
  }

  #paintRaster({ canvas, extent: [backward, forward, right, left] }) {
    const { context } = this;
    const [x0, y0] = this.toScreen(forward, left);
    const [x1, y1] = this.toScreen(backward, right);
    context.save();
    context.imageSmoothingEnabled = false;
    context.globalAlpha = RASTER_OPACITY;
    context.drawImage(canvas, x0, y0, x1 - x0, y1 - y0);
    context.restore();
  }

  /** Lines at round metres, with how far ahead or aside they are. */
  #paintGrid() {
    const { context, colours, height, width } = this;
    const step = stride(this.scale);
    for (const [middle, size, isAside] of [[this.middle, height, false], [0, width, true]]) {
      const reach = size / 2 / this.scale;
      for (let k = Math.ceil((middle - reach) / step); k <= (middle + reach) / step; k++) {
        const [left, top] = this.toScreen(isAside ? 0 : k * step, isAside ? k * step : 0).map((at) => Math.round(at) + 0.5);
        const line = isAside ? [[left, 0], [left, height]] : [[0, top], [width, top]];
        stroke(context, line, { colour: colours.unknown, width: 1, opacity: k ? GRID_OPACITY : 1 });
        // The names of the axes are in the corners.
        if (isAside && left > 40 && left < width - 60) axisText(context, this, plain(k * step), [left, height - 8], "center");
        if (!isAside && top > 36 && top < height - 24) axisText(context, this, plain(k * step), [8, top - 5], "left");
      }
    }
    axisText(context, this, "x [m]", [8, 18], "left");
    axisText(context, this, "y [m]", [width - 8, height - 8], "right");
  }

  /** The ego as an arrow head that points up. */
  #paintEgo() {
    const { context, colours } = this;
    const [left, top] = this.toScreen(0, 0);
    const points = [[0, -12], [9, 10], [0, 5], [-9, 10], [0, -12]].map(([dx, dy]) => [left + dx, top + dy]);
    stroke(context, points, { colour: colours.card, width: 2 });
    context.fillStyle = colours.start;
    context.fill();
  }

  /** The poses of one anchor with their headings. */
  #paintPoses(anchors, n) {
    const { context, colours, show } = this;
    const hasHeading = anchors.trajectories.shape[2] > 2;
    const first = 2 * n * anchors.steps;
    const screen = toScreen(this, anchors.positions.subarray(first, first + 2 * anchors.steps));
    const every = Math.ceil(anchors.steps / MAX_MARKED);
    for (let t = 0; t < anchors.steps; t++) {
      if ((t + 1) % every && t !== show.step) continue;
      const [left, top] = [screen[2 * t], screen[2 * t + 1]];
      if (hasHeading) {
        const [, , heading] = anchors.pose(n, t);
        const nose = [left - HEADING_PX * Math.sin(heading), top - HEADING_PX * Math.cos(heading)];
        stroke(context, [[left, top], nose], { colour: colours.ink, width: 1.5 });
      }
      const isLooked = t === show.step;
      const fill = isLooked ? colours.focus : colours.ink;
      circle(context, [left, top], isLooked ? POSE_PX + 2 : POSE_PX, { fill, colour: colours.map, width: 1.5 });
    }
  }
}

/** What is around the ego in a recorded drive: the road, the others, and the recorded way. */
export class Street {
  constructor({ ego, map, extent }) {
    Object.assign(this, { ego, extent });
    const [open, closed] = [false, true].map((closes) => (lines) => pathOf(lines, closes));
    this.areas = { drivable: closed(map.drivable), crosswalk: closed(map.crosswalk) };
    this.lines = { line: open(map.line), centre: open(map.centre) };
  }

  /** The road around the ego of a frame. */
  paintRoad(eye, { pose: [x, y, heading] }) {
    const { context, colours, scale } = eye;
    const [along, across] = [scale * Math.cos(heading), scale * Math.sin(heading)];
    const [left, top] = eye.toScreen(0, 0);
    context.fillStyle = colours.verge;
    context.fillRect(0, 0, eye.width, eye.height);
    context.save();
    context.transform(across, -along, -along, -across, left - across * x + along * y, top + along * x + across * y);
    context.fillStyle = colours.road;
    context.fill(this.areas.drivable, "evenodd");
    context.fillStyle = colours.zebra;
    context.fill(this.areas.crosswalk);
    // Widths in m, as the drawing is scaled.
    context.lineWidth = 1.2 / scale;
    context.strokeStyle = colours.unknown;
    context.stroke(this.lines.line);
    context.setLineDash([1.5, 2.5]);
    context.stroke(this.lines.centre);
    context.restore();
  }

  /** The boxes of the others, over routes of places x0, y0, x1, y1, … */
  paintTraffic(eye, { boxes }, routes) {
    for (const places of routes) {
      const points = Array.from({ length: places.length / 2 }, (_, k) => eye.toScreen(places[2 * k], places[2 * k + 1]));
      stroke(eye.context, points, { colour: eye.colours.start, ...ROUTE });
    }
    for (const [x, y, heading, length, width, type] of boxes) {
      paintBox(eye, [x, y, heading, length, width], eye.colours[BOX_COLOURS[type] ?? "soft"]);
    }
  }

  /** The ego, and its recorded way from here on. */
  paintEgo(eye, { recorded }) {
    const { context, colours } = eye;
    const points = [[0, 0], ...recorded].map(([x, y]) => eye.toScreen(x, y));
    stroke(context, points, { colour: colours.card, width: 4.5, dash: RECORDED_DASH });
    stroke(context, points, { colour: colours.start, width: 2.5, dash: RECORDED_DASH });
    paintBox(eye, this.ego, colours.start);
  }
}

/** A box with a nose, by its middle, heading, length and width. */
function paintBox(eye, [x, y, heading, length, width], colour) {
  const { context, colours, scale } = eye;
  const [half, side] = [(scale * length) / 2, (scale * width) / 2];
  context.save();
  context.translate(...eye.toScreen(x, y));
  context.rotate(-heading);
  Object.assign(context, { fillStyle: colour, strokeStyle: colours.card, lineWidth: 1.5 });
  context.beginPath();
  context.roundRect(-side, -half, 2 * side, 2 * half, Math.min(side, half) / 2);
  context.fill();
  context.stroke();
  const nose = -half + 2 * NOSE * half;
  stroke(context, [[-0.7 * side, nose], [0, -0.85 * half], [0.7 * side, nose]], { colour: colours.card, width: 1.5 });
  context.restore();
}

/** A path of lines x0, y0, x1, y1, … */
function pathOf(lines, closes) {
  const path = new Path2D();
  for (const line of lines) {
    path.moveTo(line[0], line[1]);
    for (let k = 2; k < line.length; k += 2) path.lineTo(line[k], line[k + 1]);
    if (closes) path.closePath();
  }
  return path;
}
