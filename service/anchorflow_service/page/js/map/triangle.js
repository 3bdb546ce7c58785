/** The style as a point in a triangle: how much each of its corners weighs. */

import { byId } from "../dom.js";

const NAMES = ["safety", "energy", "smooth"];
/** Corners in the drawing's own units, in the order of `w_style`. */
const CORNERS = [[120, 26], [24, 186], [216, 186]];
const STEP = 0.05;
/** What a key brings nearer: a corner, or for Down both of the others. */
const KEYS = { ArrowUp: [1, 0, 0], ArrowDown: [0, 0.5, 0.5], ArrowLeft: [0, 1, 0], ArrowRight: [0, 0, 1] };

export class StyleTriangle {
  /** `onChange(weights, time)` is told what was chosen. */
  constructor(onChange) {
    Object.assign(this, { onChange, drawing: byId("triangle"), knob: byId("knob") });
    this.drawing.addEventListener("pointerdown", (event) => this.#take(event));
    this.drawing.addEventListener("pointermove", (event) => {
      if (this.drawing.hasPointerCapture(event.pointerId)) this.#follow(event);
    });
    this.knob.addEventListener("keydown", (event) => this.#key(event));
    for (const corner of this.drawing.querySelectorAll("[data-corner]")) {
      const index = Number(corner.dataset.corner);
      corner.setAttribute("aria-label", `All weight on ${NAMES[index]}`);
      corner.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        this.#toCorner(event, index);
      });
    }
  }

  /** Show weights [3] that sum to 1. */
  place(weights) {
    this.weights = weights;
    const [x, y] = [0, 1].map((axis) => CORNERS.reduce((sum, corner, k) => sum + weights[k] * corner[axis], 0));
    this.knob.setAttribute("cx", x);
    this.knob.setAttribute("cy", y);
    const percent = weights.map((weight) => Math.round(100 * weight));
    this.knob.setAttribute("aria-valuenow", percent[0]);
    this.knob.setAttribute("aria-valuetext", NAMES.map((name, k) => `${name} ${percent[k]} %`).join(", "));
    byId("style-text").value = percent.join(" · ");
  }

  #take(event) {
    const corner = event.target.closest("[data-corner]");
    if (corner) {
      this.#toCorner(event, Number(corner.dataset.corner));
      return;
    }
    this.drawing.setPointerCapture(event.pointerId);
    this.#follow(event);
  }

  #follow(event) {
    const matrix = this.drawing.getScreenCTM().inverse();
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix);
    const [[x0, y0], [x1, y1], [x2, y2]] = CORNERS;
    const area = (y1 - y2) * (x0 - x2) + (x2 - x1) * (y0 - y2);
    const safety = ((y1 - y2) * (x - x2) + (x2 - x1) * (y - y2)) / area;
    const energy = ((y2 - y0) * (x - x2) + (x0 - x2) * (y - y2)) / area;
    this.#choose([safety, energy, 1 - safety - energy], event.timeStamp);
  }

  #key(event) {
    const towards = KEYS[event.key];
    if (!towards) return;
    event.preventDefault();
    this.#choose(this.weights.map((weight, k) => weight + STEP * (towards[k] - weight)), event.timeStamp);
  }

  #toCorner(event, index) {
    this.#choose(CORNERS.map((_, k) => (k === index ? 1 : 0)), event.timeStamp);
  }

  /** Points beside the triangle come to its edge. */
  #choose(weights, time) {
    const inside = weights.map((weight) => Math.max(0, weight));
    const sum = inside.reduce((a, b) => a + b);
    const rounded = inside.map((weight) => Math.round((1000 * weight) / sum) / 1000);
    this.place(rounded);
    this.onChange(rounded, time);
  }
}
