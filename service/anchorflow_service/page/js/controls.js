/** The form: options of the scene, and what each of them means. */

import { byId, clamp, showFill } from "./dom.js";
import { StyleTriangle } from "./triangle.js";

const METRES = (value) => `${Number(value).toFixed(2)} m`;
const RANGES = { num: String, radius: METRES, margin: METRES };

export class Controls {
  /** @param {object[]} cards  of the bundles that are served */
  constructor(scene, cards) {
    Object.assign(this, { scene, cards });
    this.triangle = new StyleTriangle((style, time) => this.#set({ style }, time));
    for (const [name, text] of Object.entries(RANGES)) {
      byId(name).addEventListener("input", (event) => {
        this.#set({ [name]: Number(byId(name).value) }, event.timeStamp);
        byId(`${name}-value`).value = text(byId(name).value);
      });
    }
    for (const name of ["smooth", "project"]) {
      byId(name).addEventListener("change", () => this.#set({ [name]: byId(name).checked }));
    }
    for (const name of ["steps", "seed"]) {
      byId(name).addEventListener("change", () => this.#setWhole(name));
    }
    byId("sampler").addEventListener("change", () => this.#set({ sampler: byId("sampler").value }));
    byId("reseed").addEventListener("click", () => this.#set({ seed: Math.floor(Math.random() * 1e6) }));
    byId("bundle").addEventListener("change", () => this.useBundle(byId("bundle").value));
    byId("ask").addEventListener("submit", (event) => event.preventDefault());
    this.useCards(cards);
  }

  /** The bundles that are served now; the chosen one stays where it can. */
  useCards(cards) {
    this.cards = cards;
    byId("bundle").replaceChildren(...cards.map(({ name, version }) => new Option(`${name} ${version}`, name)));
    const chosen = cards.find((card) => card.sha256 === this.scene.card?.sha256);
    if (chosen) this.show();
    else this.useBundle(cards[0].name);
  }

  useBundle(name) {
    this.scene.useCard(this.cards.find((card) => card.name === name));
    this.show();
    if (this.scene.grid) this.scene.changed("options");
  }

  /** Bring every control to the scene's options. */
  show() {
    const { card, options } = this.scene;
    this.triangle.place(options.style);
    for (const [name, text] of Object.entries(RANGES)) {
      byId(name).value = options[name];
      byId(`${name}-value`).value = text(options[name]);
      showFill(byId(name));
    }
    for (const name of ["smooth", "project"]) byId(name).checked = options[name];
    for (const name of ["steps", "seed", "sampler"]) byId(name).value = options[name];
    byId("bundle").value = card.name;
    byId("radius").disabled = !card.adjustable.includes("robot_radius");
    byId("steps").disabled = options.sampler === "card";
    byId("sampler-hint").textContent = this.#samplerHint();
    byId("bundle-hint").textContent =
      `What answers: ${card.horizon_s} s in ${card.T} steps, at most ${card.v_max} m/s, ${card.a_max} m/s².`;
  }

  #samplerHint() {
    const { evaluations, options, sampler } = this.scene;
    const looks = evaluations ? `: ${evaluations} looks at the network` : "";
    const own = options.sampler === "card" ? ` (${sampler.method}, ${sampler.steps} steps)` : "";
    return `From noise to trajectories${looks}${own}.`;
  }

  /** A whole number within the input's own range; anything else puts the old one back. */
  #setWhole(name) {
    const input = byId(name);
    const value = Number(input.value);
    const whole = input.value !== "" && Number.isFinite(value) ? Math.round(value) : this.scene.options[name];
    this.#set({ [name]: clamp(whole, Number(input.min), Number(input.max)) });
  }

  #set(options, time) {
    Object.assign(this.scene.options, options);
    this.show();
    this.scene.changed("options", time);
  }
}
