/** The replay: how the flow carries noise to trajectories, and then the step to the finished anchors. */

import { byId, make } from "../dom.js";
import { ask } from "../service.js";

const PLAY_MS = 3200;
/** Share of the slider for the flow; the rest is for the finish. */
const FLOW_SHARE = 0.85;
/** POST /page/flow takes no more anchors. */
const MAX_ANCHORS = 64;

export class Replay {
  #states = null;
  /** Counts what was begun, so that an outdated response or animation ends. */
  #run = 0;

  /** `onEnd()` is called when the replay is over. */
  constructor(stage, onEnd) {
    Object.assign(this, { stage, onEnd });
    byId("flow-time").addEventListener("input", () => {
      this.#run++;
      this.#showAt(Number(byId("flow-time").value));
    });
  }

  get active() {
    return this.#states !== null;
  }

  /** Show how the anchors that answered `question` came about. Rejects if the service refuses. */
  async begin(question, anchors) {
    const run = ++this.#run;
    const num = Math.min(MAX_ANCHORS, anchors.count);
    const { times, positions } = await ask("page/flow", { ...question.body, seed: anchors.seed, num_samples: num });
    if (run !== this.#run) return;
    // [K][N,T,2]; further anchors stay as they are.
    const others = anchors.positions.subarray(2 * num * anchors.steps);
    this.#states = positions.map((state) => Float32Array.from([...state.flat(2), ...others]));
    Object.assign(this, { anchors, times });
    byId("board").dataset.replay = "";
    byId("scrub").hidden = false;
    byId("flow-ticks").replaceChildren(...times.map((time) => {
      const tick = make("i");
      tick.style.left = `${100 * FLOW_SHARE * time}%`;
      return tick;
    }));
    this.#play();
  }

  end() {
    this.#run++;
    this.onEnd();
    if (!this.active) return;
    this.#states = null;
    this.stage.show.replayed = null;
    delete byId("board").dataset.replay;
    byId("scrub").hidden = true;
    this.stage.draw();
  }

  #play() {
    const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const run = ++this.#run;
    const begun = performance.now();
    const step = () => {
      if (run !== this.#run) return;
      const share = isStill ? 0 : Math.min(1, (performance.now() - begun) / PLAY_MS);
      byId("flow-time").value = share;
      this.#showAt(share);
      if (share < 1 && !isStill) requestAnimationFrame(step);
    };
    step();
  }

  /** Show a share of the slider: straight lines between the states that the solver visited. */
  #showAt(share) {
    const { times, anchors } = this;
    byId("flow-time").style.setProperty("--fill", `${100 * share}%`);
    if (share >= FLOW_SHARE) {
      const finished = (share - FLOW_SHARE) / (1 - FLOW_SHARE);
      this.#mix(this.#states.at(-1), anchors.positions, finished);
      byId("flow-text").value = finished < 1 ? "finish" : "finished";
      return;
    }
    const time = share / FLOW_SHARE;
    const k = Math.max(0, times.findLastIndex((visited) => visited <= time));
    const next = Math.min(k + 1, times.length - 1);
    this.#mix(this.#states[k], this.#states[next], (time - times[k]) / (times[next] - times[k] || 1));
    byId("flow-text").value = `t = ${time.toFixed(2)}`;
  }

  #mix(from, to, share) {
    this.stage.show.replayed = from.map((value, k) => value + share * (to[k] - value));
    this.stage.draw();
  }
}
