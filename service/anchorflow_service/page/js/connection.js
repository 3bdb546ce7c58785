/** Whether the service answers: the mark in the corner, and a banner while it is silent. */

import { byId } from "./dom.js";
import { Refusal } from "./service.js";

export class Connection {
  #counting = null;
  /** null until a bundle is known. */
  #card = null;

  constructor(planner) {
    planner.addEventListener("down", (event) => this.#down(event.detail));
    planner.addEventListener("up", () => this.up());
    byId("retry").addEventListener("click", () => planner.retry());
  }

  /** Whose answers come from now on. */
  useCard(card) {
    this.#card = card;
    this.up();
  }

  /** It answers. */
  up() {
    clearInterval(this.#counting);
    byId("banner").hidden = true;
    if (this.#card) this.#state("up", `${this.#card.name} ${this.#card.version}`);
    else this.#state("wait", "Connecting");
  }

  /** It has not answered yet. */
  wait(message) {
    byId("link-text").textContent = "Waiting for the service";
    byId("banner").hidden = false;
    byId("banner-text").textContent = message;
  }

  #down({ error, waitMs }) {
    const until = performance.now() + waitMs;
    clearInterval(this.#counting);
    byId("banner").hidden = false;
    const why = error.message.replace(/; try again in \d+ s$|\.$/, ""); // which is counted here
    const count = () => {
      const left = Math.max(0, Math.ceil((until - performance.now()) / 1e3));
      byId("banner-text").textContent = `${why}. ${left ? `Trying again in ${left} s.` : "Trying again."}`;
    };
    count();
    this.#counting = setInterval(count, 250);
    // Who refuses is there.
    if (error instanceof Refusal) this.#state("wait", "Waiting for the service");
    else this.#state("down", "Not connected");
  }

  #state(state, text) {
    byId("link").dataset.state = state;
    byId("link-text").textContent = text;
  }
}
