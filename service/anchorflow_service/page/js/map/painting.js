/** Tools on the canvas: paint, erase and move obstacles, by pointer and by keyboard. */

import { FREE, OCCUPIED } from "./grid.js";
import { byId, clamp, showFill } from "../dom.js";

const TOOL_KEYS = { b: "paint", e: "erase", v: "move" };
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Holds the tool and the brush; `onHover(left, top)` is told where a pointer without work is. */
export class Painting {
  tool = "paint";
  /** m */
  brush = 0.2;
  #stroke = null;

  constructor(stage, scene, onHover) {
    Object.assign(this, { stage, scene, onHover });
    this.cursor = null;
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (event) => this.#begin(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#end(event));
    canvas.addEventListener("pointercancel", (event) => this.#end(event));
    canvas.addEventListener("pointerleave", () => this.#leave());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("blur", () => this.#leave());
    document.addEventListener("keydown", (event) => this.#shortcut(event));
    for (const button of document.querySelectorAll("[data-tool][aria-pressed]")) {
      button.addEventListener("click", () => this.choose(button.dataset.tool));
    }
    byId("brush").addEventListener("input", () => this.#resize(Number(byId("brush").value)));
    byId("undo").addEventListener("click", () => this.scene.undo());
    scene.addEventListener("change", () => { byId("undo").disabled = !scene.canUndo; });
    showFill(byId("brush"));
  }

  choose(tool) {
    this.tool = tool;
    byId("board").dataset.tool = tool;
    for (const button of document.querySelectorAll("[data-tool][aria-pressed]")) {
      button.setAttribute("aria-pressed", button.dataset.tool === tool);
    }
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
    if (this.#stroke) {
      this.#takeBack();
      return;
    }
    const { pointerId: pointer } = event;
    const at = this.#where(event);
    const { grid } = this.scene;
    if (this.tool === "move") {
      const [row, column] = grid.toCells(...at).map(Math.floor);
      const cells = grid.obstacleAt(row, column);
      if (!cells.length) return;
      this.scene.remember();
      this.#stroke = { pointer, cells, before: grid.cells.slice(), from: [row, column], moved: [0, 0] };
    } else {
      this.scene.remember();
      this.#stroke = { pointer, last: at, value: this.#erases(event) ? FREE : OCCUPIED };
      this.#paintTo(at, event.timeStamp);
    }
    this.stage.canvas.setPointerCapture(pointer);
  }

  #move(event) {
    if (this.#stroke && this.#stroke.pointer !== event.pointerId) return;
    const at = this.#where(event);
    if (!this.#stroke) {
      this.#showBrush(this.tool === "move" ? null : { at, erase: this.#erases(event) });
      this.onHover(...this.#place(event));
    } else if (this.#stroke.cells) {
      this.#push(at, event.timeStamp);
    } else {
      for (const point of event.getCoalescedEvents?.() ?? [event]) this.#paintTo(this.#where(point), event.timeStamp);
      this.#showBrush({ at, erase: this.#stroke.value === FREE });
    }
  }

  #end(event) {
    if (this.#stroke?.pointer === event.pointerId) this.#stroke = null;
  }

  /** A second finger pinches: what the first has begun was not meant. */
  #takeBack() {
    this.#stroke = null;
    this.scene.undo();
  }

  #leave() {
    this.cursor = null;
    this.#showBrush(null);
    this.onHover(null);
  }

  #paintTo(at, time) {
    this.scene.grid.stroke(this.#stroke.last, at, this.brush, this.#stroke.value);
    this.#stroke.last = at;
    this.scene.changed("map", time);
  }

  /** Put the obstacle that was taken hold of to where the pointer is, whole cells away. */
  #push(at, time) {
    const { grid } = this.scene;
    const { cells, before, from, moved } = this.#stroke;
    const now = grid.toCells(...at).map((value, axis) => Math.floor(value) - from[axis]);
    if (now[0] === moved[0] && now[1] === moved[1]) return;
    this.#stroke.moved = now;
    grid.cells.set(before);
    for (const [row, column] of cells) grid.set(row, column, FREE);
    for (const [row, column] of cells) grid.set(row + now[0], column + now[1], OCCUPIED);
    this.scene.changed("map", time);
  }

  /** Arrow keys move a cursor, Space and Enter use the tool under it. */
  #key(event) {
    const { grid } = this.scene;
    if (event.key in ARROWS) {
      event.preventDefault();
      const [x, y] = this.cursor ?? [this.scene.start.x, this.scene.start.y];
      const step = grid.resolution * (event.shiftKey ? 5 : 1);
      const [dx, dy] = ARROWS[event.key];
      this.cursor = grid.inside(x + dx * step, y + dy * step);
      this.#showBrush({ at: this.cursor, erase: this.tool === "erase" });
      this.onHover(...this.stage.toScreen(...this.cursor));
    } else if (event.key === " " || event.key === "Enter") {
      event.preventDefault();
      if (!this.cursor || this.tool === "move") return;
      this.scene.remember();
      this.#dab();
    }
  }

  #dab() {
    this.scene.grid.stroke(this.cursor, this.cursor, this.brush, this.tool === "erase" ? FREE : OCCUPIED);
    this.scene.changed("map");
  }

  #shortcut(event) {
    const typing = event.target.matches("input:not([type=range]):not([type=checkbox]):not([type=radio]), select, textarea");
    if (typing || event.altKey || !this.stage.width) return;
    if ((event.ctrlKey || event.metaKey) && event.key === "z") this.scene.undo();
    if (event.ctrlKey || event.metaKey) return;
    if (event.key in TOOL_KEYS) this.choose(TOOL_KEYS[event.key]);
    if (event.key === "[" || event.key === "]") {
      this.#resize(clamp(2 * this.brush + (event.key === "]" ? 0.1 : -0.1), 0.1, 1.6));
    }
  }

  #showBrush(brush) {
    this.stage.show.brush = brush && { x: brush.at[0], y: brush.at[1], radius: this.brush, erase: brush.erase };
    this.stage.drawTop();
  }

  #erases(event) {
    return this.tool === "erase" || event.shiftKey || event.button === 2 || (event.buttons & 2) > 0;
  }

  /** In CSS pixels of the canvas; merged events know their place in the window only. */
  #place({ clientX, clientY }) {
    const { left, top } = this.stage.canvas.getBoundingClientRect();
    return [clientX - left, clientY - top];
  }

  #where(event) {
    return this.stage.toWorld(...this.#place(event));
  }
}
