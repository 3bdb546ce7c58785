/** The form: options of the scene, and what each of them means. */

import { wholeNumber } from "../amount.js";
import { byId, plain, showFill } from "../dom.js";
import { CUSTOM, STYLES, styleName } from "./styles.js";
import { StyleTriangle } from "./triangle.js";

const metres = (value) => `${Number(value).toFixed(2)} m`;
const speed = (value) => `${Number(value).toFixed(2)} m/s`;
const pull = (value) => `${Number(value).toFixed(2)} m/s²`;
const seconds = (value) => `${Number(value).toFixed(1)} s`;
/** Options that are numbers, and how they are told; the ids of their inputs are their names. */
const SLIDERS = { radius: metres, v_max: speed, a_max: pull, horizon: seconds, margin: metres, guidance: plain, certified: metres };
/** Those that the card gives a range, by the request's fields. */
const LIMITS = { radius: "robot_radius", v_max: "v_max", a_max: "a_max", horizon: "horizon_s" };
const SWITCHES = ["smooth", "project", "barrier", "fixed"];
const MOST_ANCHORS = 256;

export class Controls {
  constructor(scene, amount) {
    Object.assign(this, { scene, amount });
    this.triangle = new StyleTriangle((style, time) => this.set({ style }, time));
    byId("style-name").addEventListener("change", () => this.set({ style: STYLES[byId("style-name").value] }));
    for (const name of Object.keys(SLIDERS)) {
      byId(name).addEventListener("input", (event) => this.set({ [name]: Number(byId(name).value) }, event.timeStamp));
    }
    for (const name of SWITCHES) {
      byId(name).addEventListener("change", () => this.set({ [name]: byId(name).checked }));
    }
    byId("steps").addEventListener("change", () => this.set({ steps: wholeNumber(byId("steps"), scene.options.steps) }));
    byId("sampler").addEventListener("change", () => this.set({ sampler: byId("sampler").value }));
  }

  /** Bring every control to the scene's options. */
  show() {
    const { scene } = this;
    const { options } = scene;
    this.amount.show({ ...options, most: scene.card.sampler.size ?? MOST_ANCHORS });
    this.triangle.place(options.style);
    this.#showStyle();
    for (const [name, field] of Object.entries(LIMITS)) this.#showRange(name, field);
    byId("horizon").disabled ||= !options.fixed;
    byId("fixed").disabled = scene.range("horizon_s") === null;
    for (const [name, text] of Object.entries(SLIDERS)) {
      byId(name).value = options[name];
      byId(`${name}-value`).value = text(options[name]);
      showFill(byId(name));
    }
    if (!options.fixed && scene.limits.horizon_s === null) byId("horizon-value").value = "each its own";
    for (const name of SWITCHES) byId(name).checked = options[name];
    for (const name of ["steps", "sampler"]) byId(name).value = options[name];
    byId("steps").disabled = options.sampler === "card";
    byId("solver").hidden = byId("guided").hidden = !scene.hasFlow;
    byId("finish").hidden = !scene.hasFinish;
    byId("sampler-hint").textContent = scene.hasFlow ? this.#samplerHint() : "";
    byId("bundle-hint").textContent = this.#bundleHint();
  }

  #showStyle() {
    const name = styleName(this.scene.options.style);
    byId("style-name").value = name;
    byId("style-name").querySelector(`[value=${CUSTOM}]`).hidden = name !== CUSTOM;
  }

  /** What the card lets a limit be; no choice where it is the bundle's own. */
  #showRange(name, field) {
    const range = this.scene.range(field);
    byId(name).disabled = range === null;
    const [low, high] = range ?? [0, 2 * this.scene.options[name]];
    Object.assign(byId(name), { min: low, max: high });
    const unit = SLIDERS[name](0).split(" ")[1];
    byId(`${name}-range`).textContent = range ? `${plain(low)} to ${plain(high)} ${unit}.` : "The bundle's own.";
  }

  #bundleHint() {
    const { limits } = this.scene.card.conditioning;
    const lasting = limits.horizon_s === null ? "each anchor in its own time" : `${limits.horizon_s} s`;
    return `What answers: ${lasting}, in ${this.scene.card.time.steps} steps.`;
  }

  #samplerHint() {
    const { evaluations, options, sampler } = this.scene;
    const looks = evaluations ? `: ${evaluations} looks at the network` : "";
    const own = options.sampler === "card" ? ` (${sampler.method}, ${sampler.steps} steps)` : "";
    return `From noise to trajectories${looks}${own}.`;
  }

  /** Change options of the scene; `time` is that of the event that brought it. */
  set(options, time) {
    Object.assign(this.scene.options, options);
    this.show();
    this.scene.changed("options", time);
  }
}
