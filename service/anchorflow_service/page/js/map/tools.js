/** What the pointer and the keyboard do on the map: paint, erase and push what is there, put people, move ends and people. */

import { byId, clamp, isTyping, make, showFill } from "../dom.js";
import { FREE, OCCUPIED } from "./grid.js";
import { MAX_PACE, MAX_PEOPLE, RADIUS } from "./people.js";

const TOOL_KEYS = { b: "paint", e: "erase", v: "move", p: "person" };
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
/** m or m/s that an arrow key moves an end or its velocity; Shift makes it five times as much. */
const KEY_STEP = 0.1;
const SHIFT_STEPS = 5;
/** rad that an arrow key turns a heading. */
const TURN_STEP = Math.PI / 36;
const [MIN_BRUSH, MAX_BRUSH] = [0.1, 1.6];

/**
 * Tools on the canvas; `onHover(left, top)` gets the place of an idle pointer, null if it leaves,
 * `onPlace(at)` that of any pointer in m, and `onPerson()` is called when a person was put on the
 * map, the last of the scene's. `zoom` gets the pointers that move the map.
 */
export class Painting {
  tool = "paint";
  /** Radius in m. */
  brush = 0.2;
  /** The soft layer that is painted, null for obstacles, and how dear it becomes. */
  layer = null;
  cost = 1;
  /** [x, y] in m of the cursor that arrow keys move. */
  #cursor = null;
  #stroke = null;

  constructor(stage, scene, zoom, { onHover, onPlace, onPerson }) {
    Object.assign(this, { stage, scene, zoom, onHover, onPlace, onPerson });
    const listeners = {
      pointerdown: (event) => this.#begin(event),
      pointermove: (event) => this.#move(event),
      pointerup: (event) => this.#end(event),
      pointercancel: (event) => this.#end(event),
      pointerleave: () => this.#leave(),
      contextmenu: (event) => event.preventDefault(),
      dblclick: () => { if (this.tool === "move") stage.showAll(); },
      keydown: (event) => this.#key(event),
      blur: () => this.#leave(),
    };
    for (const [type, listener] of Object.entries(listeners)) stage.canvas.addEventListener(type, listener);
    document.addEventListener("keydown", (event) => this.#shortcut(event));
    this.buttons = [...document.querySelectorAll("[data-tool][aria-pressed]")];
    for (const button of this.buttons) button.addEventListener("click", () => this.#choose(button.dataset.tool));
    byId("brush").addEventListener("input", () => this.#resize(Number(byId("brush").value)));
    byId("layer").addEventListener("change", () => {
      this.layer = byId("layer").value || null;
      byId("cost").parentElement.hidden = !this.layer;
    });
    byId("cost").addEventListener("input", () => {
      this.cost = Number(byId("cost").value);
      byId("cost-value").value = this.cost.toFixed(1);
      showFill(byId("cost"));
    });
    showFill(byId("cost"));
    byId("undo").addEventListener("click", () => scene.undo());
    scene.onChange(() => { byId("undo").disabled = !scene.canUndo; });
    showFill(byId("brush"));
  }

  #choose(tool) {
    this.tool = tool;
    byId("board").dataset.tool = tool;
    for (const button of this.buttons) button.setAttribute("aria-pressed", button.dataset.tool === tool);
    this.#showBrush(null);
  }

  #resize(width) {
    this.brush = width / 2;
    byId("brush").value = width;
    byId("brush-value").value = `${width.toFixed(1)} m`;
    showFill(byId("brush"));
  }

  #begin(event) {
    if (event.button > 2) return;
    const { pointerId: pointer } = event;
    this.stage.canvas.setPointerCapture(pointer);
    this.#cursor = null;
    if (this.zoom.begin(event, this.#place(event))) {
      // A second finger pinches, so the stroke of the first was not meant.
      if (this.#stroke) this.scene.undo();
      this.#stroke = null;
      this.#showBrush(null);
      return;
    }
    const at = this.#where(event);
    const { grid } = this.scene;
    if (this.tool === "move") {
      const from = grid.toCells(...at).map(Math.floor);
      const cells = grid.obstacleAt(...from);
      if (!cells.length) {
        this.zoom.grab();
        return;
      }
      this.scene.remember();
      this.#stroke = { pointer, cells, before: grid.cells.slice(), from, moved: [0, 0] };
    } else if (this.tool === "person") {
      if (!this.#put(at)) return;
      this.#stroke = { pointer, person: this.scene.people.at(-1) };
    } else {
      this.scene.remember();
      this.#stroke = { pointer, last: at, value: this.#value(this.#erases(event)) };
      this.#paintTo(at);
    }
  }

  #move(event) {
    if (this.zoom.move(event, this.#place(event))) return;
    if (this.#stroke && this.#stroke.pointer !== event.pointerId) return;
    const at = this.#where(event);
    this.onPlace(at);
    if (!this.#stroke) {
      this.#showBrush(this.tool === "move" ? null : at, this.#erases(event));
      this.onHover(...this.#place(event));
    } else if (this.#stroke.cells) {
      this.#push(at);
    } else if (this.#stroke.person) {
      const { person } = this.#stroke;
      [person.vx, person.vy] = this.stage.arrowVelocity(person, ...this.#place(event), MAX_PACE);
      this.scene.changed("people");
    } else {
      for (const point of event.getCoalescedEvents?.() ?? [event]) this.#paintTo(this.#where(point));
      this.#showBrush(at, this.#stroke.value === FREE);
    }
  }

  #end(event) {
    this.zoom.end(event);
    if (this.#stroke?.pointer !== event.pointerId) return;
    if (this.#stroke.person) this.onPerson();
    this.#stroke = null;
  }

  #leave() {
    this.#cursor = null;
    this.#showBrush(null);
    this.onHover(null);
    this.onPlace(null);
  }

  #paintTo(at) {
    const { scene, brush } = this;
    scene.grid.stroke(this.#stroke.last, at, brush, this.#stroke.value, this.layer);
    if (this.#stroke.value === FREE) scene.people = scene.people.filter(({ x, y, radius }) => Math.hypot(x - at[0], y - at[1]) > radius + brush);
    this.#stroke.last = at;
    this.scene.changed("map");
  }

  /** Put a person at rest on the map; returns whether there is room for one more. */
  #put([x, y]) {
    if (this.scene.people.length === MAX_PEOPLE) return false;
    this.scene.remember();
    this.scene.people.push({ x, y, vx: 0, vy: 0, radius: RADIUS });
    this.scene.changed("people");
    return true;
  }

  /** Move the obstacle under the pointer by whole cells. */
  #push(at) {
    const { grid } = this.scene;
    const { cells, before, from, moved } = this.#stroke;
    const now = grid.toCells(...at).map((value, axis) => Math.floor(value) - from[axis]);
    if (now[0] === moved[0] && now[1] === moved[1]) return;
    this.#stroke.moved = now;
    grid.cells.set(before);
    for (const index of cells) grid.cells[index] = FREE;
    for (const index of cells) grid.set(Math.floor(index / grid.columns) + now[0], (index % grid.columns) + now[1], OCCUPIED);
    this.scene.changed("map");
  }

  /** Arrow keys move a cursor, Space and Enter paint, erase or put a person under it. */
  #key(event) {
    const { grid, start } = this.scene;
    if (event.key in ARROWS) {
      event.preventDefault();
      const [x, y] = this.#cursor ?? [start.x, start.y];
      const [dx, dy] = steps(event, grid.resolution);
      this.#cursor = grid.inside(x + dx, y + dy);
      this.stage.reveal(...this.#cursor);
      this.onPlace(this.#cursor);
      this.#showBrush(this.#cursor, this.tool === "erase");
      this.onHover(...this.stage.toScreen(...this.#cursor));
    } else if (this.#cursor && (event.key === " " || event.key === "Enter")) {
      event.preventDefault();
      if (this.tool === "move") return;
      if (this.tool === "person") {
        if (this.#put(this.#cursor)) this.onPerson();
        return;
      }
      this.scene.remember();
      grid.stroke(this.#cursor, this.#cursor, this.brush, this.#value(this.tool === "erase"), this.layer);
      this.scene.changed("map");
    }
  }

  #shortcut(event) {
    if (isTyping(event) || event.altKey || !this.stage.width) return;
    if (event.ctrlKey || event.metaKey) {
      if (event.key === "z") this.scene.undo();
    } else if (event.key in TOOL_KEYS) {
      this.#choose(TOOL_KEYS[event.key]);
    } else if (event.key === "[" || event.key === "]") {
      this.#resize(clamp(2 * this.brush + (event.key === "]" ? 0.1 : -0.1), MIN_BRUSH, MAX_BRUSH));
    }
  }

  #showBrush(at, erase) {
    const radius = this.tool === "person" ? RADIUS : this.brush;
    this.stage.show.brush = at && { x: at[0], y: at[1], radius, erase };
    this.stage.drawTop();
  }

  /** What a stroke sets: a cell's value, or a soft cost. */
  #value(erases) {
    if (erases) return FREE;
    return this.layer ? this.cost : OCCUPIED;
  }

  #erases(event) {
    return this.tool === "erase" || event.shiftKey || event.button === 2 || (event.buttons & 2) > 0;
  }

  /** In CSS pixels of the canvas; coalesced events have no offsetX. */
  #place({ clientX, clientY }) {
    const { left, top } = this.stage.canvas.getBoundingClientRect();
    return [clientX - left, clientY - top];
  }

  #where(event) {
    return this.stage.toWorld(...this.#place(event));
  }
}

const steps = ({ key, shiftKey }, step) => ARROWS[key].map((sign) => sign * step * (shiftKey ? SHIFT_STEPS : 1));

const degrees = (heading) => `${Math.round((heading * 180) / Math.PI)}°`;

/** Start, goal, people and the tips of their velocity arrows: buttons over the canvas that one drags. */
export class Handles {
  constructor(stage, scene) {
    Object.assign(this, { stage, scene });
    this.handles = [...document.querySelectorAll("[data-handle]")].map((button) => {
      const [end, tip] = button.dataset.handle.split("-");
      return this.#listen({ button, name: end === "start" ? "Start" : "Goal", end: () => scene[end], isTip: Boolean(tip) });
    });
    /** Two each, the person and the velocity. */
    this.people = [];
    scene.onChange(() => this.place());
  }

  /** Select the last person. */
  selectLast() {
    this.people.at(-2).button.focus();
  }

  #listen(handle) {
    handle.button.addEventListener("pointerdown", (event) => this.#drag(event, handle));
    handle.button.addEventListener("keydown", (event) => this.#key(event, handle));
    return handle;
  }

  /** As many buttons as there are people. */
  #matchPeople() {
    const { scene, people } = this;
    for (let k = people.length / 2; k < scene.people.length; k++) {
      for (const isTip of [false, true]) {
        const button = make("button", { type: "button", className: `handle person${isTip ? " tip" : ""}` });
        button.dataset.handle = `person-${k + 1}${isTip ? "-velocity" : ""}`;
        byId("people").append(button);
        people.push(this.#listen({ button, name: `Person ${k + 1}`, end: () => scene.people[k], isTip, person: k }));
      }
    }
    for (const { button } of people.splice(2 * scene.people.length)) button.remove();
  }

  /** Move the buttons to where the ends are. */
  place() {
    const { stage, scene } = this;
    if (!scene.grid || !stage.width) return;
    this.#matchPeople();
    for (const { button, name, end, isTip, person } of [...this.handles, ...this.people]) {
      const { x, y, vx, vy } = end();
      const [left, top] = isTip ? stage.arrowTip(end()) : stage.toScreen(x, y);
      // What is beyond the part of the map that is shown has no handle at its edge.
      button.hidden = stage.zoom > 1 && !stage.contains(left, top) && button !== document.activeElement;
      button.style.transform = `translate(${clamp(left, 8, stage.width - 8)}px, ${clamp(top, 8, stage.height - 8)}px)`;
      const turns = isTip && this.#turns(person);
      const text = (isTip ? [vx, vy] : [x, y]).map((number) => number.toFixed(2)).join(", ");
      button.setAttribute("aria-label", turns ? `${name} heading ${degrees(scene.headingOf(end()))}, speed ${Math.hypot(vx, vy).toFixed(2)} m/s`
        : `${name} ${isTip ? "velocity" : "position"} ${text} ${isTip ? "m/s" : "m"}`);
      button.title = turns ? `${name} heading: drag the tip round, and out for a speed` : isTip ? `${name} velocity: drag the tip` : `${name}: drag it${person === undefined ? "" : ", or press Delete"}`;
    }
  }

  #drag(event, { button, end, isTip, person }) {
    if (event.button === 1) return;
    button.focus({ focusVisible: false });
    button.setPointerCapture(event.pointerId);
    const board = byId("board");
    const frame = board.getBoundingClientRect();
    // The point of the button that was grabbed stays under the pointer.
    const place = button.getBoundingClientRect();
    const slip = [event.clientX - (place.left + place.width / 2), event.clientY - (place.top + place.height / 2)];
    const done = new AbortController();
    const { signal } = done;
    button.addEventListener("pointermove", (move) => {
      const left = move.clientX - slip[0] - frame.left - board.clientLeft;
      const top = move.clientY - slip[1] - frame.top - board.clientTop;
      if (!end()) done.abort(); // deleted meanwhile
      else if (isTip && this.#turns(person)) this.#point(end(), left, top);
      else if (isTip) this.#setVelocity(end(), this.stage.arrowVelocity(end(), left, top, this.#fastest(person)));
      else this.scene.put(end(), this.stage.toWorld(left, top));
    }, { signal });
    for (const type of ["pointerup", "pointercancel"]) button.addEventListener(type, () => done.abort(), { signal });
  }

  #key(event, { end, isTip, person }) {
    if (person !== undefined && (event.key === "Delete" || event.key === "Backspace")) this.#remove(person);
    if (!(event.key in ARROWS)) return;
    event.preventDefault();
    const [dx, dy] = steps(event, KEY_STEP);
    const { x, y, vx, vy } = end();
    if (isTip && this.#turns(person)) {
      const heading = this.scene.headingOf(end()) - Math.sign(dx) * TURN_STEP * (event.shiftKey ? SHIFT_STEPS : 1);
      this.scene.turn(end(), heading, clamp(Math.hypot(vx, vy) + dy, 0, this.#fastest(person)));
    } else if (isTip) {
      const share = Math.min(1, this.#fastest(person) / (Math.hypot(vx + dx, vy + dy) || 1));
      this.#setVelocity(end(), [(vx + dx) * share, (vy + dy) * share]);
    } else {
      this.scene.put(end(), [x + dx, y + dy]);
      this.stage.reveal(end().x, end().y);
    }
  }

  /** The next person is selected then. */
  #remove(person) {
    this.scene.remember();
    this.scene.people.splice(person, 1);
    this.scene.changed("people");
    (this.people.length ? this.people.at(2 * person) ?? this.people.at(-2) : { button: this.stage.canvas }).button.focus();
  }

  /** Whether the tip of an end turns the robot: it has a body. */
  #turns(person) {
    return person === undefined && this.scene.hasBody;
  }

  /** Turn an end to a point in CSS pixels; far from it there is a speed too. */
  #point(end, left, top) {
    const [x, y] = this.stage.toWorld(left, top);
    this.scene.turn(end, Math.atan2(y - end.y, x - end.x), Math.hypot(...this.stage.arrowVelocity(end, left, top)));
  }

  #fastest(person) {
    return person === undefined ? this.scene.limits.v_max : MAX_PACE;
  }

  #setVelocity(end, velocity) {
    [end.vx, end.vy] = velocity;
    this.scene.changed("ends");
  }
}
