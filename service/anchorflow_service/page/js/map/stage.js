/**
 * The canvas of the map: cells with metres along them, anchors, and on top the robot, velocity arrows and the brush.
 *
 * Cells and anchors are kept on layers of their own, which are drawn again only after a change.
 */

import { Surface, anchorColour, axisText, circle, drawAnchors, stride, stroke } from "../drawing.js";
import { clamp, plain } from "../dom.js";
import { placed, posesAlong } from "./body.js";
import { OCCUPIED, UNKNOWN } from "./grid.js";
import { placeAt } from "./people.js";

/** Opacity of ground of soft cost 1. */
const DEAREST = 0.75;
/** m of arrow for each m/s, and px between a point and the foot of its arrow. */
const ARROW_M_PER_MPS = 0.45;
const ARROW_FOOT_PX = 13;
/** Corners of a robot without an outline where it has a heading. */
const DISC_CORNERS = 24;
/** px of the mark of a cusp, from its middle. */
const CUSP_PX = 5;
/** px of the dot on an anchor where the robot would be at the time of the time bar. */
const DOT_PX = 2.5;
/** px of a metre at most; the whole map is the least. */
const MAX_SCALE = 1200;
/** px between a label of an axis and the edge. */
const AXIS_PX = 7;

export class Stage extends Surface {
  /** px of an anchor. */
  lineWidth = 1.3;
  /** How many times larger than the whole map, and the point in m in the middle; null: the map's. */
  zoom = 1;
  #middle = null;
  #groundIsOld = true;
  #linesAreOld = true;

  constructor(canvas, scene) {
    const [ground, lines] = [new OffscreenCanvas(1, 1), new OffscreenCanvas(1, 1)];
    super(canvas, [ground, lines]);
    Object.assign(this, { scene, ground, lines });
    Object.assign(this.show, {
      /** [[x, y]] where the robot has been, and where its plan leads. */
      trail: [],
      path: null,
      /** {x, y, radius, erase}, m. */
      brush: null,
      /** s from now at which people and the robot are drawn too, or null, and the greatest. */
      time: null,
      longest: 0,
    });
    this.resize();
  }

  /** CSS pixels a metre; without zoom the whole map fits. */
  get scale() {
    return this.zoom * this.#fitting;
  }

  get #fitting() {
    const [width, height] = this.scene.grid.size;
    return Math.min(this.width / width, this.height / height);
  }

  /** [x, y] in m in the middle of the canvas. */
  get middle() {
    const { origin, size } = this.scene.grid;
    return this.#middle ?? origin.map((at, axis) => at + size[axis] / 2);
  }

  /** [left, top] in CSS pixels of a point in m. */
  toScreen(x, y) {
    const [middleX, middleY] = this.middle;
    return [this.width / 2 + (x - middleX) * this.scale, this.height / 2 - (y - middleY) * this.scale];
  }

  /** [x, y] in m of a point in CSS pixels. */
  toWorld(left, top) {
    const [middleX, middleY] = this.middle;
    return [middleX + (left - this.width / 2) / this.scale, middleY - (top - this.height / 2) / this.scale];
  }

  /** Whether a point in CSS pixels is on the canvas. */
  contains(left, top) {
    return left >= 0 && top >= 0 && left <= this.width && top <= this.height;
  }

  /** Show the map larger by a factor, with the point at [left, top] where it is; returns whether it changed. */
  zoomBy(factor, left = this.width / 2, top = this.height / 2) {
    const zoom = clamp(this.zoom * factor, 1, MAX_SCALE / this.#fitting);
    if (zoom === this.zoom) return false;
    const [x, y] = this.toWorld(left, top);
    this.zoom = zoom;
    this.#show(x - (left - this.width / 2) / this.scale, y + (top - this.height / 2) / this.scale);
    return true;
  }

  /** Move the map by CSS pixels. */
  panBy(right, down) {
    const [x, y] = this.middle;
    this.#show(x - right / this.scale, y + down / this.scale);
  }

  /** Move the map so far that a point in m is on the canvas. */
  reveal(x, y) {
    const [left, top] = this.toScreen(x, y);
    if (!this.contains(left, top)) this.panBy(this.width / 2 - left, this.height / 2 - top);
  }

  /** Show the whole map again. */
  showAll() {
    this.zoom = 1;
    this.#show();
  }

  /** The canvas stays within the map, as far as the map fills it. */
  #show(...middle) {
    const { origin, size } = this.scene.grid;
    const half = [this.width, this.height].map((pixels) => pixels / this.scale / 2);
    const within = (value, axis) => {
      const [low, high] = [origin[axis] + half[axis], origin[axis] + size[axis] - half[axis]];
      return low < high ? clamp(value, low, high) : (low + high) / 2;
    };
    this.#middle = middle.length && this.zoom > 1 ? middle.map(within) : null;
    this.redraw();
    this.onFit();
  }

  /** The tip of an end's velocity arrow in CSS pixels; a body's points along its heading, others at rest from start to goal. */
  arrowTip(end) {
    const { scene } = this;
    const { x, y, vx, vy } = end;
    const speed = Math.hypot(vx, vy);
    const turns = scene.hasBody && (end === scene.start || end === scene.goal);
    const direction = turns || speed <= 1e-6 ? scene.headingOf(turns ? end : {}) : Math.atan2(vy, vx);
    const length = 2 * ARROW_FOOT_PX + speed * ARROW_M_PER_MPS * this.scale;
    const [left, top] = this.toScreen(x, y);
    return [left + length * Math.cos(direction), top - length * Math.sin(direction)];
  }

  /** The velocity [vx, vy] whose arrow ends at a point in CSS pixels, at most `fastest` m/s. */
  arrowVelocity(end, left, top, fastest = this.scene.limits.v_max) {
    const [footLeft, footTop] = this.toScreen(end.x, end.y);
    const [dx, dy] = [left - footLeft, footTop - top];
    const length = Math.hypot(dx, dy);
    const speed = Math.max(0, length - 2 * ARROW_FOOT_PX) / (ARROW_M_PER_MPS * this.scale);
    const share = clamp(speed, 0, fastest) / (length || 1);
    return [dx * share, dy * share];
  }

  /** Draw the anchors and what is on top of them. */
  draw() {
    this.#linesAreOld = true;
    return super.draw();
  }

  /** Draw what is on top of the anchors. */
  drawTop() {
    super.draw();
  }

  redraw() {
    this.#groundIsOld = true;
    this.draw();
  }

  paint() {
    if (!this.scene.grid) return false;
    if (this.#groundIsOld) this.#paintGround();
    if (this.#linesAreOld) this.#paintLines();
    const { context, colours, density, show, scene } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.ground, 0, 0);
    context.drawImage(this.lines, 0, 0);
    context.setTransform(density, 0, 0, density, 0, 0);
    const onScreen = (points) => points.map((point) => this.toScreen(...point));
    if (show.trail.length > 1) stroke(context, onScreen(show.trail), { colour: colours.start, width: 2, opacity: 0.35 });
    if (show.path) {
      stroke(context, onScreen(show.path), { colour: colours.outline, width: 6 });
      stroke(context, onScreen(show.path), { colour: colours.focus, width: 3 });
    }
    this.#paintEnd(scene.goal, colours.goal);
    if (show.robot) this.#paintRobot(show.robot);
    else this.#paintEnd(scene.start, colours.start);
    for (const person of scene.people) this.#paintPerson(person);
    if (show.time && show.anchors && !show.stale) this.#paintAnchorsAt(show.time);
    if (show.brush) this.#paintBrush(show.brush);
    return true;
  }

  #paintLines() {
    this.#linesAreOld = false;
    const context = this.lines.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.lines.width, this.lines.height);
    context.setTransform(this.density, 0, 0, this.density, 0, 0);
    if (!this.show.anchors) return;
    drawAnchors(context, this);
    if (this.show.anchors.headings && !this.show.stale && !this.show.robot) this.#paintAlong(context);
  }

  /** The robot's outline along the anchor in focus, and where it drives the other way. */
  #paintAlong(context) {
    const { colours, show: { anchors, focus } } = this;
    const corners = this.scene.corners ?? disc(this.scene.options.robot_radius);
    const { poses, cusps } = posesAlong(anchors, focus ?? anchors.best, lengthOf(corners));
    const tones = { 1: colours.ink, [-1]: colours.bad, 0: colours.person };
    for (const pose of poses) outline(context, this, corners, pose, { colour: tones[pose.gear], width: 1, opacity: 0.55 });
    for (const { x, y } of cusps) {
      const [left, top] = this.toScreen(x, y);
      const mark = [[0, -1], [1, 0], [0, 1], [-1, 0], [0, -1]].map(([right, down]) => [left + CUSP_PX * right, top + CUSP_PX * down]);
      stroke(context, mark, { colour: colours.outline, width: 5 });
      stroke(context, mark, { colour: colours.bad, width: 2.5 });
    }
  }

  #paintGround() {
    this.#groundIsOld = false;
    const { colours, density, scale, scene: { grid, innerRadius } } = this;
    const context = this.ground.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colours.halo;
    context.fillRect(0, 0, this.ground.width, this.ground.height);
    // From here on in cells, row upwards.
    const [left, bottom] = this.toScreen(...grid.origin);
    const cell = density * scale * grid.resolution;
    context.setTransform(cell, 0, 0, -cell, density * left, density * bottom);
    context.save();
    context.beginPath();
    context.rect(0, 0, grid.columns, grid.rows);
    context.clip();
    context.fillStyle = colours.map;
    context.fill();
    const [wall, unknown] = [OCCUPIED, UNKNOWN].map((value) => cellsOf(grid, (row, column) => grid.at(row, column) === value));
    // The band where the robot's middle must not be.
    Object.assign(context, { strokeStyle: colours.halo, lineJoin: "round", lineWidth: (2 * innerRadius) / grid.resolution });
    context.stroke(wall);
    context.stroke(unknown);
    this.#paintSoftCosts(context);
    this.#paintMetres(context);
    context.fillStyle = colours.unknown;
    context.fill(unknown);
    context.fillStyle = colours.wall;
    context.fill(wall);
    context.restore();
    context.setTransform(density, 0, 0, density, 0, 0);
    this.#paintAxes(context);
  }

  /** Soft costs as a heat map, in tenths. */
  #paintSoftCosts(context) {
    const { grid } = this.scene;
    if (!Object.keys(grid.soft).length) return;
    const costs = Array.from(grid.cells, (_, index) => Math.round(10 * grid.softCost(index)));
    context.fillStyle = this.colours.dear;
    for (let tenths = 1; tenths <= 10; tenths++) {
      context.globalAlpha = tenths * DEAREST / 10;
      context.fill(cellsOf(grid, (row, column) => costs[row * grid.columns + column] === tenths));
    }
    context.globalAlpha = 1;
  }

  /** A dot where the metres of both axes meet, in cells. */
  #paintMetres(context) {
    const { grid } = this.scene;
    const size = 2 / (this.scale * grid.resolution);
    context.fillStyle = this.colours.unknown;
    for (const x of this.#ticks(0)) {
      for (const y of this.#ticks(1)) {
        const [row, column] = grid.toCells(x, y);
        context.fillRect(column - size / 2, row - size / 2, size, size);
      }
    }
  }

  /** Round metres of an axis that are on the map and on the canvas. */
  #ticks(axis) {
    const { origin, size } = this.scene.grid;
    const [low, high] = [this.toWorld(0, this.height)[axis], this.toWorld(this.width, 0)[axis]];
    const step = stride(this.scale);
    const first = Math.ceil(Math.max(low, origin[axis]) / step);
    const last = Math.floor(Math.min(high, origin[axis] + size[axis]) / step);
    return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) => Number(((first + k) * step).toFixed(3)));
  }

  /** Metres along the lower and the left edge. */
  #paintAxes(context) {
    const { height, width } = this;
    for (const x of this.#ticks(0)) {
      const [left] = this.toScreen(x, 0);
      if (left > 40 && left < width - 20) axisText(context, this, plain(x), [left, height - AXIS_PX], "center");
    }
    for (const y of this.#ticks(1)) {
      const [, top] = this.toScreen(0, y);
      if (top > 20 && top < height - 30) axisText(context, this, plain(y), [AXIS_PX, top + 4], "left");
    }
    axisText(context, this, "m", [AXIS_PX, height - AXIS_PX], "left");
  }

  /** The velocity arrow of the start or the goal, and the robot's outline there. */
  #paintEnd(end, colour) {
    const place = this.toScreen(end.x, end.y);
    const dash = Math.hypot(end.vx, end.vy) > 1e-6 ? [] : [1, 4];
    stroke(this.context, [place, this.arrowTip(end)], { colour, width: 2, dash });
    if (this.scene.corners) {
      outline(this.context, this, this.scene.corners, { ...end, heading: this.scene.headingOf(end) }, { colour, width: 1.5, opacity: 0.7 });
      return;
    }
    circle(this.context, place, this.scene.options.robot_radius * this.scale, { colour, width: 1, opacity: 0.5 });
  }

  /** Now with the velocity's arrow, and later along the track: a disc each. */
  #paintPerson(person) {
    const { context, colours: { person: colour, card }, show: { time, longest } } = this;
    const radius = person.radius * this.scale;
    const place = this.toScreen(person.x, person.y);
    const isWalking = Math.hypot(person.vx, person.vy) > 1e-6;
    if (isWalking && time !== null) stroke(context, [place, this.toScreen(...placeAt(person, longest))], { colour, width: 1.5, dash: [2, 5], opacity: 0.7 });
    stroke(context, [place, this.arrowTip(person)], { colour, width: 2, dash: isWalking ? [] : [1, 4] });
    circle(context, place, radius, { fill: colour, colour, width: 1, opacity: time ? 0.3 : 0.85 });
    if (time) circle(context, this.toScreen(...placeAt(person, time)), radius, { fill: colour, colour: card, width: 2 });
  }

  /** Where each safe anchor is at a time, and the robot on the one in focus. */
  #paintAnchorsAt(time) {
    const { context, colours, show: { anchors, colourBy, focus } } = this;
    for (const n of [...anchors.order].reverse()) {
      if (!anchors.safe[n]) continue;
      const { x, y } = anchors.at(n, time);
      circle(context, this.toScreen(x, y), DOT_PX, { fill: anchorColour(this, anchors, colourBy, n), colour: colours.outline, width: 1 });
    }
    this.#paintRobot(anchors.at(focus ?? anchors.best, time));
  }

  #paintRobot({ x, y, vx, vy, heading: turned }) {
    const { context, colours, scene: { corners } } = this;
    const place = this.toScreen(x, y);
    const heading = turned ?? Math.atan2(vy, vx);
    if (corners) {
      outline(context, this, corners, { x, y, heading }, { fill: colours.start, colour: colours.card, width: 2.5 });
      const front = Math.max(...corners.map(([forward]) => forward));
      stroke(context, [place, this.toScreen(x + front * Math.cos(heading), y + front * Math.sin(heading))], { colour: colours.card, width: 2.5 });
      return;
    }
    const radius = this.scene.options.robot_radius * this.scale;
    circle(context, place, radius, { fill: colours.start, colour: colours.card, width: 2.5 });
    const nose = [place[0] + radius * Math.cos(heading), place[1] - radius * Math.sin(heading)];
    stroke(context, [place, nose], { colour: colours.card, width: 2.5 });
  }

  #paintBrush({ x, y, radius, erase }) {
    const colour = erase ? this.colours.bad : this.colours.ink;
    circle(this.context, this.toScreen(x, y), Math.max(radius * this.scale, 3), { colour, width: 1.2, dash: erase ? [3, 3] : [] });
  }
}

/** An outline of corners in m at a pose, filled if there is a `fill`. */
function outline(context, surface, corners, pose, { fill, colour, width, opacity = 1 }) {
  context.save();
  Object.assign(context, { strokeStyle: colour, lineWidth: width, globalAlpha: opacity, lineJoin: "round" });
  context.beginPath();
  for (const [x, y] of placed(corners, pose)) context.lineTo(...surface.toScreen(x, y));
  context.closePath();
  if (fill) {
    context.fillStyle = fill;
    context.fill();
  }
  context.stroke();
  context.restore();
}

/** [[x, y]] m of a disc with a nose. */
function disc(radius) {
  const turn = (k) => (2 * Math.PI * k) / DISC_CORNERS;
  const ring = Array.from({ length: DISC_CORNERS + 1 }, (_, k) => [radius * Math.cos(turn(k)), radius * Math.sin(turn(k))]);
  return [[0, 0], ...ring];
}

const lengthOf = (corners) => Math.max(...corners.map(([x]) => x)) - Math.min(...corners.map(([x]) => x));

/** A path in cells (x = column, y = row) of the rows of cells that belong to it. */
function cellsOf(grid, belongs) {
  const path = new Path2D();
  for (let row = 0; row < grid.rows; row++) {
    for (let column = 0, first; column < grid.columns; column = first + 1) {
      first = column;
      while (first < grid.columns && belongs(row, first)) first++;
      if (first > column) path.rect(column, row, first - column, 1);
    }
  }
  return path;
}
