/** The replay: how the flow carries noise to trajectories, and what the finish makes of them. */

import { ask } from "../service.js";
import { byId, make } from "../dom.js";

const PLAY_MS = 3200;
/** Share of the bar that belongs to the flow; the rest is the finish. */
const FLOW_SHARE = 0.85;
const MOST_ANCHORS = 64;

/** `onEnd()` is called when the replay is over. */
export class Replay {
  #states = null;
  /** Counts what was begun, so that what is over does not come back. */
  #run = 0;

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

  /** Show how `anchors` came from what `question` asked. Rejects with the service's refusal. */
  async begin(question, anchors) {
    const run = ++this.#run;
    const asked = { ...question.body, seed: anchors.seed, num_samples: Math.min(MOST_ANCHORS, anchors.count) };
    const { times, positions } = await ask("page/flow", asked);
    if (run !== this.#run) return;
    this.anchors = anchors;
    this.times = times;
    // [K][N,T,2]; what is beyond MOST_ANCHORS stays as it came back.
    this.#states = positions.map((state) => Float32Array.from([...state.flat(2), ...anchors.positions.subarray(2 * state.length * anchors.steps)]));
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
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const run = ++this.#run;
    const begun = performance.now();
    const step = () => {
      if (run !== this.#run) return;
      const share = still ? 0 : Math.min(1, (performance.now() - begun) / PLAY_MS);
      byId("flow-time").value = share;
      this.#showAt(share);
      if (share < 1 && !still) requestAnimationFrame(step);
    };
    step();
  }

  /** The picture at a share of the bar: straight between the states that the solver visited. */
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
