/** Why the service has refused, beside the place on the map that it is about. */

import { byId, clamp, make } from "../dom.js";

/** Fields of the contract that have a place on the map. */
const PLACES = { x_goal: "goal", x_curr: "start" };

export class Bubble {
  constructor(stage, scene) {
    Object.assign(this, { stage, scene });
    scene.addEventListener("change", () => this.#place());
    stage.canvas.addEventListener("fit", () => this.#place());
  }

  /** Nothing is wrong any more. */
  clear() {
    byId("bubble").hidden = true;
    this.at = null;
  }

  /** The service's own words. */
  refuse(error) {
    this.at = PLACES[error.field?.split(".")[0]] ?? null;
    const bubble = byId("bubble");
    const title = this.at ? `The ${this.at} cannot be there.` : "The service refused.";
    bubble.replaceChildren(make("b", {}, title), make("span", {}, error.message));
    bubble.hidden = false;
    this.#place();
  }

  /** Keep it inside the board, above or below what it is about. */
  #place() {
    const bubble = byId("bubble");
    if (bubble.hidden) return;
    const { width, height } = this.stage;
    const end = this.at && this.scene[this.at];
    const [left, top] = end ? this.stage.toScreen(end.x, end.y) : [width / 2, 60];
    const [wide, tall] = [bubble.offsetWidth, bubble.offsetHeight];
    const x = clamp(left - wide / 2, 10, Math.max(10, width - wide - 10));
    const y = top - tall - 26 > 8 ? top - tall - 26 : top + 26;
    bubble.style.transform = `translate(${x}px, ${clamp(y, 8, Math.max(8, height - tall - 8))}px)`;
  }
}
