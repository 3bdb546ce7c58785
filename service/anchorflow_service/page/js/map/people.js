/** People who walk: discs of a constant velocity, and the time bar that shows where they will be. */

import { byId, clamp, press, showFill } from "../dom.js";

/** m, and m/s at most. */
export const RADIUS = 0.3;
export const MAX_PACE = 3;
/** A request takes no more obstacles. */
export const MAX_PEOPLE = 128;
const DECIMALS = 4;

/** [x, y] in m of a person who keeps the velocity, after `seconds`. */
export const placeAt = ({ x, y, vx, vy }, seconds) => [x + vx * seconds, y + vy * seconds];

/** The field `obstacles` of a request; {} if there is nobody. */
export function toRequest(people) {
  const vectors = (first, second) => people.map((person) => [first, second].map((name) => Number(person[name].toFixed(DECIMALS))));
  const radius = people.map((person) => person.radius);
  return people.length ? { obstacles: { position: vectors("x", "y"), velocity: vectors("vx", "vy"), radius } } : {};
}

/** Move people on; who comes to a wall or to the map's edge turns back. Returns whether somebody did. */
export function walk(people, seconds, grid) {
  let hasTurned = false;
  for (const person of people) {
    const isFree = ([x, y]) => !grid.at(...grid.toCells(x, y).map(Math.floor));
    const next = placeAt(person, seconds);
    if (isFree(next) || !isFree([person.x, person.y])) {
      [person.x, person.y] = grid.inside(...next);
    } else {
      [person.vx, person.vy] = [-person.vx, -person.vy];
      hasTurned = true;
    }
  }
  return hasTurned;
}

/** From now to the end of the longest anchor: the `time` and `longest` of `stage.show`; time is null without a bar. */
export class TimeBar {
  #playing = false;

  constructor(stage, scene) {
    Object.assign(this, { stage, scene, slider: byId("walk-time") });
    this.slider.addEventListener("input", () => {
      this.#play(false);
      this.#showAt(Number(this.slider.value));
    });
    byId("walk-play").addEventListener("click", () => this.#play(!this.#playing));
    scene.onChange(() => this.fit());
  }

  /** Show the bar if there are people and anchors; `longest` is the duration of the longest, s. */
  fit(longest = this.longest) {
    this.longest = longest;
    const isShown = Boolean(longest && this.scene.people.length);
    byId("walk").hidden = !isShown;
    if (!isShown) this.#play(false);
    this.slider.max = longest ?? 0;
    this.#showAt(isShown ? clamp(Number(this.slider.value), 0, longest) : null);
  }

  /** Stop at the beginning: what is drawn is now. */
  rewind() {
    this.#play(false);
    this.slider.value = 0;
    this.fit();
  }

  #play(playing) {
    if (playing === this.#playing) return;
    this.#playing = playing;
    press("walk-play", playing, playing ? "Stop" : "Play", playing ? "stop" : "play");
    if (!playing) return;
    const first = Number(this.slider.value) < this.longest ? Number(this.slider.value) : 0;
    const begun = performance.now();
    const step = () => {
      if (!this.#playing) return;
      const time = first + (performance.now() - begun) / 1e3;
      this.#showAt(Math.min(time, this.longest));
      if (time < this.longest) requestAnimationFrame(step);
      else this.#play(false);
    };
    step();
  }

  #showAt(time) {
    Object.assign(this.stage.show, { time, longest: this.longest });
    this.slider.value = time ?? 0;
    showFill(this.slider);
    byId("walk-text").value = `${(time ?? 0).toFixed(1)} s`;
    this.stage.drawTop();
  }
}
