/** A canvas that follows its size and the theme, and is painted at most once a frame. */

import { readColours } from "./colours.js";

/**
 * Whoever extends it says how points in m lie on the screen, `toScreen(x, y)` in CSS pixels, and
 * paints in `paint()`. Fires "fit" and "theme" on the canvas.
 */
export class Surface {
  #drawn = [];
  #requested = false;

  /** `layers`: further canvases that are to have the same size. */
  constructor(canvas, layers = []) {
    Object.assign(this, { canvas, layers });
    this.context = canvas.getContext("2d");
    this.colours = readColours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colours = readColours();
      this.redraw();
      canvas.dispatchEvent(new Event("theme"));
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  resize() {
    const density = Math.min(window.devicePixelRatio || 1, 2);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    for (const canvas of [this.canvas, ...this.layers]) {
      canvas.width = Math.round(width * density);
      canvas.height = Math.round(height * density);
    }
    Object.assign(this, { density, width, height });
    this.redraw();
    this.canvas.dispatchEvent(new Event("fit"));
  }

  /** Draw everything again; whoever keeps layers says more. */
  redraw() {
    this.request();
  }

  /** Paint before the next frame; the promise tells when that frame has been put on the screen. */
  request() {
    if (!this.#requested) {
      this.#requested = true;
      requestAnimationFrame(() => {
        this.#requested = false;
        if (!this.width || !this.paint()) return;
        const drawn = this.#drawn.splice(0);
        // The frame after this one begins when this one has been shown.
        requestAnimationFrame(() => drawn.forEach((resolve) => resolve(performance.now())));
      });
    }
    return new Promise((resolve) => this.#drawn.push(resolve));
  }
}
