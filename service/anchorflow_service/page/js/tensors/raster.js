/** A tensor as a picture: RGB, grey, classes, or layers that lie on each other. */

import { typeText } from "../card.js";
import { byId, make } from "../dom.js";

/** The extra that is such a picture. */
export const RASTER = "bev_semantics";

export class Raster {
  /**
   * `spec`: of the tensor; `tensor`: {shape, values} [C,H,W], or [H,W] of classes; `palette`:
   * colours [r, g, b]; `layered`: whether many channels are layers rather than classes.
   */
  constructor(spec, { shape, values }, palette, layered = false) {
    const [height, width] = shape.slice(-2);
    const channels = shape.length > 2 ? shape.at(-3) : 0;
    Object.assign(this, { spec, height, width, channels, values, palette, layered });
    /** [x_min, x_max, y_min, y_max] m in the ego's frame, where the card says it. */
    this.extent = spec.extent ?? null;
    this.classes = [];
    this.canvas = new OffscreenCanvas(width, height);
    this.canvas.getContext("2d").putImageData(new ImageData(this.#pixels(), width, height), 0, 0);
  }

  /** Show it by itself, with what its colours stand for. */
  showBeside() {
    const canvas = byId("raster");
    Object.assign(canvas, { width: this.width, height: this.height });
    canvas.getContext("2d").drawImage(this.canvas, 0, 0);
    const what = { 0: "classes", 1: "grey levels", 3: "red, green, blue" }[this.channels] ?? `the strongest of ${this.channels} classes`;
    byId("raster-note").textContent = `${typeText(this.spec)}: ${what}. The card does not say how many metres it spans, so it is not under the anchors.`;
    byId("raster-key").replaceChildren(...this.classes.map((index) => {
      const mark = make("i");
      mark.style.background = `rgb(${this.#colour(index).join(" ")})`;
      return make("li", {}, mark, String(index));
    }));
  }

  #pixels() {
    const pixels = new Uint8ClampedArray(4 * this.width * this.height);
    const colourOf = this.channels === 3 ? this.#rgb() : this.channels === 1 ? this.#grey() : this.layered ? this.#byLayer() : this.#byClass();
    for (let k = 0; k < this.width * this.height; k++) pixels.set([...colourOf(k), 255], 4 * k);
    return pixels;
  }

  /** A value as 0 to 255 of the range that the card says; of the picture's own where it says none. */
  #level() {
    const [low, high] = this.spec.range ?? [];
    const least = low ?? this.values.reduce((a, b) => Math.min(a, b), Infinity);
    const most = high ?? this.values.reduce((a, b) => Math.max(a, b), -Infinity);
    return (value) => (255 * (value - least)) / (most - least || 1);
  }

  #rgb() {
    const level = this.#level();
    const plane = this.width * this.height;
    return (k) => [0, 1, 2].map((channel) => level(this.values[channel * plane + k]));
  }

  #grey() {
    const level = this.#level();
    return (k) => Array(3).fill(level(this.values[k]));
  }

  /** Each channel covers those before it, as much as its value says. */
  #byLayer() {
    const level = this.#level();
    const plane = this.width * this.height;
    const mixed = new Float32Array(3 * plane);
    for (let c = 0; c < this.channels; c++) {
      const colour = this.#colour(c);
      for (let k = 0; k < plane; k++) {
        const share = level(this.values[c * plane + k]) / 255;
        if (!share) continue;
        for (let axis = 0; axis < 3; axis++) mixed[3 * k + axis] += share * (colour[axis] - mixed[3 * k + axis]);
      }
    }
    return (k) => mixed.subarray(3 * k, 3 * k + 3);
  }

  #byClass() {
    const plane = this.width * this.height;
    const classOf = (k) => {
      if (!this.channels) return Math.round(this.values[k]);
      let best = 0;
      for (let c = 1; c < this.channels; c++) if (this.values[c * plane + k] > this.values[best * plane + k]) best = c;
      return best;
    };
    const classes = Array.from({ length: plane }, (_, k) => classOf(k));
    this.classes = [...new Set(classes)].sort((a, b) => a - b);
    return (k) => this.#colour(classes[k]);
  }

  #colour(index) {
    return this.palette[((index % this.palette.length) + this.palette.length) % this.palette.length];
  }
}
