/** The bundles that are served, and which of them is asked. */

import { byId } from "./dom.js";
import { Unreachable, ask } from "./service.js";

/** Fires "choose" with the card of the bundle that is asked from now on. */
export class Models extends EventTarget {
  card = null;
  #cards = [];

  constructor() {
    super();
    byId("bundle").addEventListener("change", () => this.choose(this.#named(byId("bundle").value)));
  }

  /** Read the cards of what is served now; the chosen one stays where it can, in its version of now. */
  async refresh() {
    const { models } = await ask("v2/models");
    if (!models.length) throw new Unreachable("The service serves no bundle at present.");
    this.#cards = models;
    byId("bundle").replaceChildren(...models.map(({ name, version }) => new Option(`${name} ${version}`, name)));
    const card = this.#named(this.card?.name) ?? models[0];
    if (card.sha256 === this.card?.sha256) byId("bundle").value = card.name;
    else this.choose(card);
  }

  /** The card of this name, where it is served and asked with what the chosen one is. */
  like(name) {
    const card = this.#named(name);
    return card?.conditioning.kind === this.card.conditioning.kind ? card : undefined;
  }

  #named(name) {
    return this.#cards.find((card) => card.name === name);
  }

  /** Ask this one from now on. */
  choose(card) {
    this.card = card;
    byId("bundle").value = card.name;
    this.dispatchEvent(new CustomEvent("choose", { detail: card }));
  }
}
