/** Start, goal and the tips of their velocity arrows: buttons over the canvas that one drags. */

import { byId, clamp } from "../dom.js";

const STEP_M = 0.1;
const STEP_MPS = 0.1;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

export class Handles {
  constructor(stage, scene) {
    Object.assign(this, { stage, scene });
    this.buttons = [...document.querySelectorAll("[data-handle]")];
    for (const button of this.buttons) {
      button.addEventListener("pointerdown", (event) => this.#take(event, button));
      button.addEventListener("keydown", (event) => this.#key(event, button));
    }
    scene.addEventListener("change", () => this.place());
    stage.canvas.addEventListener("fit", () => this.place());
  }

  /** Bring the buttons to where they belong. */
  place() {
    if (!this.scene.grid || !this.stage.width) return;
    for (const button of this.buttons) {
      const { name, end, isTip } = this.#meaning(button);
      const [left, top] = isTip ? this.stage.arrowTip(end, this.#restDirection) : this.stage.toScreen(end.x, end.y);
      const [x, y] = [clamp(left, 8, this.stage.width - 8), clamp(top, 8, this.stage.height - 8)];
      button.style.transform = `translate(${x}px, ${y}px)`;
      const value = isTip ? [end.vx, end.vy] : [end.x, end.y];
      const text = value.map((number) => number.toFixed(2)).join(", ");
      button.setAttribute("aria-label", `${name} ${isTip ? "velocity" : "position"} ${text} ${isTip ? "m/s" : "m"}`);
      button.title = isTip ? `${name} velocity: drag the tip` : `${name}: drag it`;
    }
  }

  /** An arrow without length points from start to goal. */
  get #restDirection() {
    const { start, goal } = this.scene;
    return Math.atan2(goal.y - start.y, goal.x - start.x);
  }

  #meaning(button) {
    const [which, tip] = button.dataset.handle.split("-");
    return { name: which === "start" ? "Start" : "Goal", end: this.scene[which], isTip: Boolean(tip) };
  }

  #take(event, button) {
    button.setPointerCapture(event.pointerId);
    const frame = byId("board").getBoundingClientRect();
    // Where it was taken hold of stays under the pointer.
    const place = button.getBoundingClientRect();
    const slip = [event.clientX - (place.left + place.width / 2), event.clientY - (place.top + place.height / 2)];
    const drag = (move) => {
      const left = move.clientX - slip[0] - frame.left - byId("board").clientLeft;
      const top = move.clientY - slip[1] - frame.top - byId("board").clientTop;
      this.#moveTo(button, left, top, move.timeStamp);
    };
    const drop = () => {
      button.removeEventListener("pointermove", drag);
      button.removeEventListener("pointerup", drop);
      button.removeEventListener("pointercancel", drop);
    };
    button.addEventListener("pointermove", drag);
    button.addEventListener("pointerup", drop);
    button.addEventListener("pointercancel", drop);
  }

  #moveTo(button, left, top, time) {
    const { end, isTip } = this.#meaning(button);
    if (isTip) [end.vx, end.vy] = this.stage.arrowVelocity(end, left, top);
    else [end.x, end.y] = this.scene.grid.inside(...this.stage.toWorld(left, top));
    this.scene.changed("ends", time);
  }

  #key(event, button) {
    if (!(event.key in ARROWS)) return;
    event.preventDefault();
    const { end, isTip } = this.#meaning(button);
    const times = event.shiftKey ? 5 : 1;
    const [dx, dy] = ARROWS[event.key].map((sign) => sign * times);
    if (isTip) {
      const [vx, vy] = [end.vx + dx * STEP_MPS, end.vy + dy * STEP_MPS];
      const share = Math.min(1, this.scene.limits.v_max / (Math.hypot(vx, vy) || 1));
      [end.vx, end.vy] = [vx * share, vy * share];
    } else {
      [end.x, end.y] = this.scene.grid.inside(end.x + dx * STEP_M, end.y + dy * STEP_M);
    }
    this.scene.changed("ends", event.timeStamp);
  }
}
