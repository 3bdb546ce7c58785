/** How many anchors come back, and from which seed: asked of every planner. */

import { byId, clamp, showFill } from "./dom.js";

/** Seeds that the button draws are below; short enough to be read out. */
const SHORT_SEED = 1e6;

/** `onChange({num} or {seed}, time)` is told what was chosen. */
export class Amount {
  constructor(onChange) {
    byId("num").addEventListener("input", (event) => onChange({ num: Number(byId("num").value) }, event.timeStamp));
    byId("seed").addEventListener("change", () => onChange({ seed: wholeNumber(byId("seed"), this.shown.seed) }));
    byId("reseed").addEventListener("click", () => onChange({ seed: Math.floor(Math.random() * SHORT_SEED) }));
  }

  /** Show what is asked: {num, most, seed}. */
  show({ num, most, seed }) {
    this.shown = { num, most, seed };
    Object.assign(byId("num"), { max: most, value: num });
    // A planner of one leaves nothing to choose.
    byId("num").hidden = most === 1;
    byId("num-value").value = num;
    showFill(byId("num"));
    byId("seed").value = seed;
  }
}

/** A whole number within the input's own range; `before` where something else was typed. */
export function wholeNumber(input, before) {
  const value = Number(input.value);
  const whole = input.value !== "" && Number.isFinite(value) ? Math.round(value) : before;
  return clamp(whole, Number(input.min), Number(input.max));
}
