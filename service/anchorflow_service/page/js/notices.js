/** What the reader is told when something does not go: beside the goal, in the banner, in the corner. */

import { byId, clamp, make } from "./dom.js";

/** Fields of the contract that have a place on the map. */
const PLACES = { x_goal: "goal", x_curr: "start" };

export class Notices {
  #counting = null;

  constructor(planner, stage, scene) {
    Object.assign(this, { stage, scene });
    planner.addEventListener("down", (event) => this.#down(event.detail));
    planner.addEventListener("up", () => this.#up());
    byId("retry").addEventListener("click", () => planner.retry());
    scene.addEventListener("change", () => this.#place());
    stage.canvas.addEventListener("fit", () => this.#place());
    this.#up();
  }

  /** An answer has come: nothing is wrong any more. */
  clear() {
    byId("bubble").hidden = true;
    this.at = null;
    this.#state("up", this.#name);
  }

  /** The service's own words, beside what they are about. */
  refuse(error) {
    this.#state("up", this.#name);
    this.at = PLACES[error.field?.split(".")[0]] ?? null;
    const bubble = byId("bubble");
    const title = this.at ? `The ${this.at} cannot be there.` : "The service refused.";
    bubble.replaceChildren(make("b", {}, title), make("span", {}, error.message));
    bubble.hidden = false;
    this.#place();
  }

  /** A passing remark. */
  say(text) {
    byId("summary").textContent = text;
  }

  get #name() {
    const { name, version } = this.scene.card;
    return `${name} ${version}`;
  }

  #down({ error, waitMs }) {
    const until = performance.now() + waitMs;
    clearInterval(this.#counting);
    byId("banner").hidden = false;
    this.stage.show.stale = true;
    this.stage.draw();
    const count = () => {
      const left = Math.max(0, Math.ceil((until - performance.now()) / 1e3));
      byId("banner-text").textContent = `${error.message} ${left ? `Trying again in ${left} s.` : "Trying again."}`;
    };
    count();
    this.#counting = setInterval(count, 250);
    this.#state("down", "Not connected");
  }

  #up() {
    clearInterval(this.#counting);
    byId("banner").hidden = true;
    this.#state("up", this.#name);
  }

  #state(state, text) {
    byId("link").dataset.state = state;
    byId("link-text").textContent = text;
  }

  /** Keep the bubble inside the board, above or below what it is about. */
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
