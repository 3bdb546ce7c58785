/**
 * The canvas: map, anchors, and on top robot, arrows and cursor.
 *
 * Map and anchors are kept as pictures of their own and drawn again only when they have changed.
 */

import { drawAnchors, drawPath } from "../lines.js";
import { Surface } from "../surface.js";
import { OCCUPIED, UNKNOWN } from "./grid.js";
import { outline } from "./outline.js";

/** m of arrow for each m/s, and the gap between an end and its arrow's foot. */
const ARROW_M_PER_MPS = 0.45;
const ARROW_FOOT_PX = 13;

export class Stage extends Surface {
  /** px of an anchor. */
  lineWidth = 1.3;
  /** What is drawn; set by others, who then call `draw()`. */
  show = {
    /** @type {?Anchors} */ anchors: null,
    colourBy: "score",
    /** Index of the anchor that is looked at, and the time step under the pointer. */
    focus: null,
    step: null,
    /** The picture is older than the scene, and there is no newer one. */
    stale: false,
    /** [N,T,2] in place of the anchors' own positions while the flow is replayed. */
    replayed: null,
    /** {x, y, vx, vy} and the way it came, [[x, y]], while the robot drives. */
    robot: null,
    trail: [],
    /** [[x, y]] that it has taken and not yet gone. */
    path: null,
    /** {x, y, radius, value} m, of the brush. */
    brush: null,
  };

  constructor(canvas, scene) {
    const [ground, lines] = [new OffscreenCanvas(1, 1), new OffscreenCanvas(1, 1)];
    super(canvas, [ground, lines]);
    Object.assign(this, { scene, ground, lines });
    this.resize();
  }

  /** CSS pixels a metre; the whole map fits, with a little air. */
  get scale() {
    const [width, height] = this.scene.grid.size;
    return Math.min(this.width / width, this.height / height);
  }

  /** [left, top] in CSS pixels of a point in m. */
  toScreen(x, y) {
    const { grid } = this.scene;
    const [width, height] = grid.size;
    const left = (this.width - width * this.scale) / 2;
    const top = (this.height - height * this.scale) / 2;
    return [left + (x - grid.origin[0]) * this.scale, top + (grid.origin[1] + height - y) * this.scale];
  }

  /** [x, y] in m of a point in CSS pixels. */
  toWorld(left, top) {
    const { grid } = this.scene;
    const [x0, y0] = this.toScreen(...grid.origin);
    return [grid.origin[0] + (left - x0) / this.scale, grid.origin[1] + (y0 - top) / this.scale];
  }

  /** Where the tip of an end's velocity arrow is, in CSS pixels; `at rest` it shows a direction. */
  arrowTip(end, restDirection) {
    const speed = Math.hypot(end.vx, end.vy);
    const direction = speed > 1e-6 ? Math.atan2(end.vy, end.vx) : restDirection;
    const length = 2 * ARROW_FOOT_PX + speed * ARROW_M_PER_MPS * this.scale;
    const [left, top] = this.toScreen(end.x, end.y);
    return [left + length * Math.cos(direction), top - length * Math.sin(direction)];
  }

  /** The velocity [vx, vy] whose arrow ends at a point in CSS pixels. */
  arrowVelocity(end, left, top) {
    const [footLeft, footTop] = this.toScreen(end.x, end.y);
    const [dx, dy] = [left - footLeft, footTop - top];
    const length = Math.hypot(dx, dy);
    const speed = Math.max(0, length - 2 * ARROW_FOOT_PX) / (ARROW_M_PER_MPS * this.scale);
    const share = Math.min(speed, this.scene.limits.v_max) / (length || 1);
    return [dx * share, dy * share];
  }

  /** Draw anchors and what is on top; the promise tells when they have been put on the screen. */
  draw() {
    this.linesAreOld = true;
    return this.drawTop();
  }

  /** The same where map and anchors have stayed as they are. */
  drawTop() {
    return this.request();
  }

  /** Draw the map again too. */
  redraw() {
    this.groundIsOld = true;
    this.draw();
  }

  /** Whether there was something to paint. */
  paint() {
    if (!this.scene.grid) return false;
    if (this.groundIsOld) this.#paintGround();
    if (this.linesAreOld) this.#paintLines();
    const { context, density, show } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.ground, 0, 0);
    context.drawImage(this.lines, 0, 0);
    context.setTransform(density, 0, 0, density, 0, 0);
    if (show.trail.length > 1) this.#paintTrail();
    if (show.path) drawPath(context, this, show.path);
    this.#paintArrow(this.scene.goal, this.colours.goal);
    if (show.robot) this.#paintRobot(show.robot);
    else this.#paintArrow(this.scene.start, this.colours.start);
    if (show.brush) this.#paintBrush(show.brush);
    return true;
  }

  #paintLines() {
    this.linesAreOld = false;
    const context = this.lines.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.lines.width, this.lines.height);
    context.setTransform(this.density, 0, 0, this.density, 0, 0);
    if (this.show.anchors) drawAnchors(context, this, this.show);
  }

  #paintGround() {
    this.groundIsOld = false;
    const { colours, density, scene, scale } = this;
    const context = this.ground.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colours.halo;
    context.fillRect(0, 0, this.ground.width, this.ground.height);
    // From here on in cells, row upwards.
    const [left, bottom] = this.toScreen(...scene.grid.origin);
    const cell = density * scale * scene.grid.resolution;
    context.setTransform(cell, 0, 0, -cell, density * left, density * bottom);
    context.beginPath();
    context.rect(0, 0, scene.grid.columns, scene.grid.rows);
    context.save();
    context.clip();
    context.fillStyle = colours.map;
    context.fill();
    const wall = outline(scene.grid, OCCUPIED);
    const unknown = outline(scene.grid, UNKNOWN);
    // Where the robot's middle must not go.
    context.strokeStyle = colours.halo;
    context.lineJoin = "round";
    context.lineWidth = (2 * scene.options.radius) / scene.grid.resolution;
    context.stroke(wall);
    context.stroke(unknown);
    this.#paintMetres(context);
    context.fillStyle = colours.unknown;
    context.fill(unknown);
    context.fillStyle = colours.wall;
    context.fill(wall);
    context.restore();
  }

  /** A dot at every whole metre, in cells. */
  #paintMetres(context) {
    const { grid } = this.scene;
    const [width, height] = grid.size;
    const size = 2 / (this.scale * grid.resolution);
    context.fillStyle = this.colours.unknown;
    for (let y = Math.ceil(grid.origin[1]); y < grid.origin[1] + height; y++) {
      for (let x = Math.ceil(grid.origin[0]); x < grid.origin[0] + width; x++) {
        const [row, column] = grid.toCells(x, y);
        context.fillRect(column - size / 2, row - size / 2, size, size);
      }
    }
  }

  #paintArrow(end, colour) {
    const [left, top] = this.toScreen(end.x, end.y);
    const rest = Math.atan2(this.scene.goal.y - this.scene.start.y, this.scene.goal.x - this.scene.start.x);
    const [tipLeft, tipTop] = this.arrowTip(end, rest);
    const { context } = this;
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.lineCap = "round";
    context.setLineDash(Math.hypot(end.vx, end.vy) > 1e-6 ? [] : [1, 4]);
    context.beginPath();
    context.moveTo(left, top);
    context.lineTo(tipLeft, tipTop);
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 0.5;
    context.lineWidth = 1;
    context.beginPath();
    context.arc(left, top, this.scene.options.radius * this.scale, 0, 2 * Math.PI);
    context.stroke();
    context.globalAlpha = 1;
  }

  #paintRobot({ x, y, vx, vy }) {
    const { context, colours } = this;
    const [left, top] = this.toScreen(x, y);
    const radius = this.scene.options.radius * this.scale;
    context.fillStyle = colours.start;
    context.strokeStyle = colours.card;
    context.lineWidth = 2.5;
    context.beginPath();
    context.arc(left, top, radius, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
    const heading = Math.atan2(vy, vx);
    context.beginPath();
    context.moveTo(left, top);
    context.lineTo(left + radius * Math.cos(heading), top - radius * Math.sin(heading));
    context.stroke();
  }

  #paintTrail() {
    const { context, show } = this;
    context.strokeStyle = this.colours.start;
    context.globalAlpha = 0.35;
    context.lineWidth = 2;
    context.beginPath();
    for (const point of show.trail) context.lineTo(...this.toScreen(...point));
    context.stroke();
    context.globalAlpha = 1;
  }

  #paintBrush({ x, y, radius, erase }) {
    const { context } = this;
    const [left, top] = this.toScreen(x, y);
    context.strokeStyle = erase ? this.colours.bad : this.colours.ink;
    context.lineWidth = 1.2;
    context.setLineDash(erase ? [3, 3] : []);
    context.beginPath();
    context.arc(left, top, Math.max(radius * this.scale, 3), 0, 2 * Math.PI);
    context.stroke();
    context.setLineDash([]);
  }
}
