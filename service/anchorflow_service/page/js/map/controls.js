/** The form: options of the scene, and what each of them means. */

import { wholeNumber } from "../amount.js";
import { byId, showFill } from "../dom.js";
import { StyleTriangle } from "./triangle.js";

const METRES = (value) => `${Number(value).toFixed(2)} m`;
const RANGES = { radius: METRES, margin: METRES };
const MOST_ANCHORS = 256;

export class Controls {
  constructor(scene, amount) {
    Object.assign(this, { scene, amount });
    this.triangle = new StyleTriangle((style, time) => this.set({ style }, time));
    for (const [name, text] of Object.entries(RANGES)) {
      byId(name).addEventListener("input", (event) => {
        this.set({ [name]: Number(byId(name).value) }, event.timeStamp);
        byId(`${name}-value`).value = text(byId(name).value);
      });
    }
    for (const name of ["smooth", "project"]) {
      byId(name).addEventListener("change", () => this.set({ [name]: byId(name).checked }));
    }
    byId("steps").addEventListener("change", () => this.set({ steps: wholeNumber(byId("steps"), scene.options.steps) }));
    byId("sampler").addEventListener("change", () => this.set({ sampler: byId("sampler").value }));
  }

  /** Bring every control to the scene's options. */
  show() {
    const { limits, options } = this.scene;
    this.amount.show({ ...options, most: this.scene.card.sampler.size ?? MOST_ANCHORS });
    this.triangle.place(options.style);
    for (const [name, text] of Object.entries(RANGES)) {
      byId(name).value = options[name];
      byId(`${name}-value`).value = text(options[name]);
      showFill(byId(name));
    }
    for (const name of ["smooth", "project"]) byId(name).checked = options[name];
    for (const name of ["steps", "sampler"]) byId(name).value = options[name];
    byId("radius").disabled = !this.scene.takesRadius;
    byId("steps").disabled = options.sampler === "card";
    byId("solver").hidden = !this.scene.hasFlow;
    byId("finish").hidden = !this.scene.hasFinish;
    byId("sampler-hint").textContent = this.scene.hasFlow ? this.#samplerHint() : "";
    byId("bundle-hint").textContent =
      `What answers: ${limits.horizon_s} s in ${this.scene.card.time.steps} steps, at most ${limits.v_max} m/s, ${limits.a_max} m/s².`;
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
