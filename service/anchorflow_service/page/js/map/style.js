/** The style: one of four names, or weights that one sets by a knob in a triangle. */

import { byId } from "../dom.js";
import { STYLES } from "./scene.js";

const CUSTOM = "custom";
/** Weights of one style may differ by rounding. */
const TOLERANCE = 1e-3;
const NAMES = ["safety", "energy", "smooth"];
/** Corners in units of the drawing, in the order of `w_style`. */
const CORNERS = [[120, 26], [24, 186], [216, 186]];
const STEP = 0.05;
/** The weights towards which a key moves the knob. */
const KEYS = { ArrowUp: [1, 0, 0], ArrowDown: [0, 0.5, 0.5], ArrowLeft: [0, 1, 0], ArrowRight: [0, 0, 1] };

/** The name of a style with these weights. */
export function styleName(weights) {
  const isSame = ([, own]) => own.every((weight, k) => Math.abs(weight - weights[k]) < TOLERANCE);
  return Object.entries(STYLES).find(isSame)?.[0] ?? CUSTOM;
}

/** The weights [3] of a point in the drawing; a point beside the triangle gets those of its edge. */
export function weightsAt(x, y) {
  const [[x0, y0], [x1, y1], [x2, y2]] = CORNERS;
  const area = (y1 - y2) * (x0 - x2) + (x2 - x1) * (y0 - y2);
  const safety = ((y1 - y2) * (x - x2) + (x2 - x1) * (y - y2)) / area;
  const energy = ((y2 - y0) * (x - x2) + (x0 - x2) * (y - y2)) / area;
  return rounded([safety, energy, 1 - safety - energy]);
}

/** Weights of at least 0 that sum to 1, with three decimals. */
function rounded(weights) {
  const positive = weights.map((weight) => Math.max(0, weight));
  const sum = positive.reduce((a, b) => a + b);
  return positive.map((weight) => Math.round((1000 * weight) / sum) / 1000);
}

export class StyleControl {
  /** Calls `onChange(weights)`. */
  constructor(onChange) {
    Object.assign(this, { onChange, drawing: byId("triangle"), knob: byId("knob"), name: byId("style-name") });
    const options = [...Object.keys(STYLES), CUSTOM].map((name) => new Option(name[0].toUpperCase() + name.slice(1), name));
    this.name.replaceChildren(...options);
    this.name.addEventListener("change", () => onChange(STYLES[this.name.value]));
    this.drawing.addEventListener("pointerdown", (event) => {
      if (event.target.closest("[data-corner]")) return;
      this.drawing.setPointerCapture(event.pointerId);
      this.#follow(event);
    });
    this.drawing.addEventListener("pointermove", (event) => {
      if (this.drawing.hasPointerCapture(event.pointerId)) this.#follow(event);
    });
    this.knob.addEventListener("keydown", (event) => {
      const towards = KEYS[event.key];
      if (!towards) return;
      event.preventDefault();
      onChange(rounded(this.weights.map((weight, k) => weight + STEP * (towards[k] - weight))));
    });
    this.drawing.querySelectorAll("[data-corner]").forEach((corner, index) => {
      const choose = () => onChange(CORNERS.map((_, k) => (k === index ? 1 : 0)));
      corner.setAttribute("aria-label", `All weight on ${NAMES[index]}`);
      corner.addEventListener("click", choose);
      corner.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        choose();
      });
    });
  }

  /** Show weights [3] that sum to 1. */
  show(weights) {
    this.weights = weights;
    const name = styleName(weights);
    this.name.value = name;
    this.name.querySelector(`[value=${CUSTOM}]`).hidden = name !== CUSTOM;
    const [x, y] = [0, 1].map((axis) => CORNERS.reduce((sum, corner, k) => sum + weights[k] * corner[axis], 0));
    const percent = weights.map((weight) => Math.round(100 * weight));
    const text = NAMES.map((part, k) => `${part} ${percent[k]} %`).join(", ");
    const attributes = { cx: x, cy: y, "aria-valuenow": percent[0], "aria-valuetext": text };
    for (const [attribute, value] of Object.entries(attributes)) this.knob.setAttribute(attribute, value);
    byId("style-text").value = percent.join(" · ");
  }

  #follow(event) {
    const matrix = this.drawing.getScreenCTM().inverse();
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix);
    this.onChange(weightsAt(x, y));
  }
}
