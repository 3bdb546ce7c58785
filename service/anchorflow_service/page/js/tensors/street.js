/** What lies around the ego in a drive, from above: the road, the others, and what was driven. */

/** Types of boxes as a driving log has them, by the colour that they are drawn in. */
const BOX_COLOURS = ["wall", "goal", "goal", "soft"];
const DRIVEN_DASH = [4, 9];
/** How a route is drawn: px wide, and how much of it one sees. */
const [ROUTE_PX, ROUTE_OPACITY] = [10, 0.25];
/** Share of its length that a box's nose takes. */
const NOSE = 0.22;

export class Street {
  /** `drive`: a `DriveFile`. */
  constructor(drive) {
    const { ego, map } = drive;
    Object.assign(this, { ego, extent: drive.extent });
    this.areas = { drivable: closed(map.drivable), crosswalk: closed(map.crosswalk) };
    this.lines = { line: open(map.line), centre: open(map.centre) };
  }

  /** The road, as it lies around the ego of a frame. */
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
    // Metres wide: the drawing is scaled.
    context.lineWidth = 1.2 / scale;
    context.strokeStyle = colours.unknown;
    context.stroke(this.lines.line);
    context.setLineDash([1.5, 2.5]);
    context.stroke(this.lines.centre);
    context.restore();
  }

  /** Inputs that are places [P, 2] around the ego: x0, y0, x1, y1, … each. */
  paintRoutes(eye, routes) {
    const { context, colours } = eye;
    context.lineJoin = context.lineCap = "round";
    context.lineWidth = ROUTE_PX;
    context.strokeStyle = colours.start;
    context.globalAlpha = ROUTE_OPACITY;
    for (const places of routes) {
      context.beginPath();
      for (let k = 0; k < places.length; k += 2) context.lineTo(...eye.toScreen(places[k], places[k + 1]));
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  /** The boxes of the others. */
  paintOthers(eye, { boxes }) {
    const { colours } = eye;
    for (const [x, y, heading, length, width, type] of boxes) {
      paintBox(eye, [x, y, heading, length, width], colours[BOX_COLOURS[type] ?? "soft"]);
    }
  }

  /** The ego, and its way as it was driven from here on. */
  paintEgo(eye, { recorded }) {
    const { context, colours } = eye;
    context.lineJoin = context.lineCap = "round";
    context.setLineDash(DRIVEN_DASH);
    for (const [colour, width] of [[colours.card, 4.5], [colours.start, 2.5]]) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.beginPath();
      for (const [x, y] of [[0, 0], ...recorded]) context.lineTo(...eye.toScreen(x, y));
      context.stroke();
    }
    context.setLineDash([]);
    paintBox(eye, this.ego, colours.start);
  }
}

/** A box with a nose; its middle and heading, its length and width. */
function paintBox(eye, [x, y, heading, length, width], colour) {
  const { context, colours, scale } = eye;
  const [left, top] = eye.toScreen(x, y);
  const [half, side] = [(scale * length) / 2, (scale * width) / 2];
  context.save();
  context.translate(left, top);
  context.rotate(-heading);
  context.fillStyle = colour;
  context.strokeStyle = colours.card;
  context.lineWidth = 1.5;
  context.beginPath();
  context.roundRect(-side, -half, 2 * side, 2 * half, Math.min(side, half) / 2);
  context.fill();
  context.stroke();
  context.beginPath();
  context.moveTo(-0.7 * side, -half + 2 * NOSE * half);
  context.lineTo(0, -0.85 * half);
  context.lineTo(0.7 * side, -half + 2 * NOSE * half);
  context.stroke();
  context.restore();
}

const open = (lines) => pathOf(lines, false);
const closed = (rings) => pathOf(rings, true);

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
