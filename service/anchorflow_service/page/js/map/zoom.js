/** Zoom and pan of the map: wheel, pinch, drags with the middle button or Space, keys and buttons. */

import { byId, isTyping } from "../dom.js";

/** How much a wheel (in px, lines or pages) and a step of a key zoom. */
const WHEEL = [0.0016, 0.04, 0.4];
/** A pinch on a trackpad comes as a wheel with Ctrl, in smaller steps. */
const PINCH = 6;
const STEP = 1.4;

export class Zoom {
  /** Places of the pointers that are down, [left, top] by id. */
  #down = new Map();
  #moves = false;
  #space = false;

  constructor(stage) {
    this.stage = stage;
    const board = byId("board");
    board.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    // The middle button would scroll the page.
    board.addEventListener("mousedown", (event) => { if (event.button === 1) event.preventDefault(); });
    document.addEventListener("keydown", (event) => this.#key(event));
    document.addEventListener("keyup", (event) => { if (event.key === " ") this.#hold(false); });
    window.addEventListener("blur", () => this.#hold(false));
    const buttons = { "zoom-in": () => stage.zoomBy(STEP), "zoom-out": () => stage.zoomBy(1 / STEP), "zoom-all": () => stage.showAll() };
    for (const [id, act] of Object.entries(buttons)) byId(id).addEventListener("click", act);
  }

  /** Note a pointer that is pressed; returns whether it moves the map: so do a second finger, the middle button, and any with Space. */
  begin({ pointerId, button }, place) {
    this.#down.set(pointerId, place);
    if (button === 1 || this.#space || this.#down.size > 1) this.grab();
    return this.#moves;
  }

  /** The pointers that are down move the map from here on. */
  grab() {
    this.#moves = true;
  }

  /** Move the map with the pointers, if they do; returns whether they do. */
  move({ pointerId }, place) {
    if (!this.#down.has(pointerId)) return false;
    const before = this.#span();
    this.#down.set(pointerId, place);
    if (!this.#moves) return false;
    const { stage } = this;
    const { middle: [left, top], apart } = this.#span();
    stage.panBy(left - before.middle[0], top - before.middle[1]);
    if (apart && before.apart) stage.zoomBy(apart / before.apart, left, top);
    return true;
  }

  end({ pointerId }) {
    this.#down.delete(pointerId);
    if (!this.#down.size) this.#moves = false;
  }

  /** The middle of the pointers, and how far apart the first two are, in px. */
  #span() {
    const places = [...this.#down.values()];
    const middle = [0, 1].map((axis) => places.reduce((sum, place) => sum + place[axis], 0) / places.length);
    const [[x, y], [toX, toY]] = [places[0], places[1] ?? places[0]];
    return { middle, apart: Math.hypot(toX - x, toY - y) };
  }

  #wheel(event) {
    const { left, top } = this.stage.canvas.getBoundingClientRect();
    const rate = WHEEL[event.deltaMode] * (event.ctrlKey ? PINCH : 1);
    const changed = this.stage.zoomBy(Math.exp(-rate * event.deltaY), event.clientX - left, event.clientY - top);
    // With the whole map in view, the wheel scrolls on.
    if (changed || this.stage.zoom > 1 || event.ctrlKey) event.preventDefault();
  }

  #key(event) {
    const { stage } = this;
    if (!stage.width || event.defaultPrevented || event.altKey || event.ctrlKey || event.metaKey || isTyping(event)) return;
    if (event.key === "+" || event.key === "=") stage.zoomBy(STEP);
    else if (event.key === "-") stage.zoomBy(1 / STEP);
    else if (event.key === "0") stage.showAll();
    else if (event.key === " " && !event.target.closest("button, a, summary, input, [role=button], [role=slider]")) {
      event.preventDefault();
      this.#hold(true);
    }
  }

  #hold(held) {
    this.#space = held;
    byId("board").toggleAttribute("data-pan", held);
  }
}
