/** What is asked: the map, both ends and the options; and the contract's JSON of it. */

import { clamp } from "../dom.js";
import { placeEnds } from "./ends.js";
import { STYLES } from "./styles.js";

/** Evaluations of the field for each step of a method. */
const STAGES = { euler: 1, midpoint: 2, heun: 2, rk4: 4, ab2: 1 };
/** More than so many are asked for on purpose only: with fewer, answers keep up with a hand. */
const FEW_EVALUATIONS = 8;
const MOST_UNDO = 40;
/** s, the duration that one sees first where one is fixed and the card has none of its own. */
const SOME_DURATION = 8;
/** Share of v_max · horizon_s that a way between start and goal may take to be done in comfort. */
const COMFORTABLE = 0.5;

/** Fires "change" whenever an answer to the old scene would no longer do; `detail` says what. */
export class Scene extends EventTarget {
  /** m, m/s: {x, y, vx, vy} */
  start = { x: 0, y: 0, vx: 0, vy: 0 };
  goal = { x: 0, y: 0, vx: 0, vy: 0 };
  options = { style: STYLES.balanced, num: 64, sampler: "card", steps: 2, seed: 0 };
  /** Counts changes of anything but the start, which moves by itself while the robot drives. */
  version = 0;
  /** When the last change came in, in ms of `performance.now()`. */
  changedAt = 0;
  #undo = [];

  /** The card of the chosen bundle; its limits and defaults become the options'. */
  useCard(card) {
    this.card = card;
    const { safety_margin: margin, smooth, project, guidance = 0, barrier = false, certified_margin: certified = 0 } = card.finish;
    const { robot_radius: radius, v_max, a_max } = card.conditioning.limits;
    Object.assign(this.options, { radius, v_max, a_max, fixed: false, horizon: this.#ownHorizon });
    Object.assign(this.options, { margin, smooth, project, guidance, barrier, certified, sampler: "card" });
    if (this.hasFlow && !(this.evaluations <= FEW_EVALUATIONS)) Object.assign(this.options, { sampler: "midpoint", steps: 2 });
  }

  /** {horizon_s, v_max, a_max, robot_radius} as asked; a horizon_s of null: each anchor has its own. */
  get limits() {
    const { limits } = this.card.conditioning;
    const { radius, v_max, a_max, fixed, horizon } = this.options;
    return { v_max, a_max, robot_radius: radius, horizon_s: fixed ? horizon : limits.horizon_s };
  }

  /** [least, greatest] that a request may ask of a limit; null where it is the bundle's own. */
  range(name) {
    return this.card.conditioning.ranges[name] ?? null;
  }

  /** s that anchors last where nothing is asked, or that one would ask first. */
  get #ownHorizon() {
    const [low, high] = this.range("horizon_s") ?? [0, Infinity];
    return this.card.conditioning.limits.horizon_s ?? clamp(SOME_DURATION, low, high);
  }

  /** D: 2 (x, y), or 3 with a heading. */
  get dim() {
    return this.card.answer.components.length;
  }

  /** Whether the anchors come out of a flow, whose solver can be chosen. */
  get hasFlow() {
    return this.card.sampler.kind === "ode";
  }

  /** Whether splines are fitted and pushed out of obstacles. */
  get hasFinish() {
    return this.card.finish.kind === "spline";
  }

  /** {method, steps} as asked, or the bundle's own. */
  get sampler() {
    const { method, schedule } = this.card.sampler;
    const { sampler, steps } = this.options;
    return sampler === "card" ? { method, steps: schedule.length - 1 } : { method: sampler, steps };
  }

  /** Evaluations of the field for an answer; NaN for a method that this page does not know. */
  get evaluations() {
    return (STAGES[this.sampler.method] ?? NaN) * this.sampler.steps;
  }

  /** Another map, with a start and a goal that fit it unless they are given. */
  useMap(grid, ends) {
    this.grid = grid;
    const { horizon_s: asked, v_max: fastest } = this.limits;
    const horizon = asked ?? this.#ownHorizon;
    const robot = { radius: this.options.radius, reach: COMFORTABLE * fastest * horizon };
    Object.assign(this, ends ?? placeEnds(grid, robot));
    this.#undo.length = 0;
    this.changed("map");
  }

  /** To be called after a change; `at` is the time of the event that brought it. */
  changed(what, at = performance.now()) {
    this.version++;
    this.changedAt = at;
    this.dispatchEvent(new CustomEvent("change", { detail: what }));
  }

  get canUndo() {
    return this.#undo.length > 0;
  }

  /** To be called before cells change. */
  remember() {
    this.#undo.push(this.grid.cells.slice());
    if (this.#undo.length > MOST_UNDO) this.#undo.shift();
  }

  undo() {
    const cells = this.#undo.pop();
    if (!cells) return;
    this.grid.cells.set(cells);
    this.changed("map");
  }

  /** Which end no robot of this radius can stand at, in words; "" where both are clear. */
  get tightEnd() {
    for (const name of ["start", "goal"]) {
      const gap = this.grid.gap(this[name].x, this[name].y);
      const { radius } = this.options;
      if (gap < radius) return `the ${name} is ${gap.toFixed(2)} m from an obstacle, the robot needs ${radius.toFixed(2)} m`;
    }
    return "";
  }

  /** The fields of POST /anchors. `state`: {x, y, vx, vy, ax, ay} in place of the start. */
  request(state = this.start) {
    const { options, card, goal, grid } = this;
    const { x, y, vx, vy, ax = 0, ay = 0 } = state;
    const place = (point) => this.#vector(point, Math.atan2(goal.y - y, goal.x - x));
    return {
      cost_map: { data: [grid.occupancy()], resolution: grid.resolution, origin: grid.origin },
      x_curr: [...place([x, y]), ...this.#vector([vx, vy], 0), ...this.#vector([ax, ay], 0)],
      x_goal: [...place([goal.x, goal.y]), ...this.#vector([goal.vx, goal.vy], 0)],
      w_style: options.style,
      num_samples: options.num,
      model: card.name,
      seed: options.seed,
      ...(this.range("robot_radius") && { robot_radius: options.radius }),
      ...(this.range("v_max") && { v_max: options.v_max }),
      ...(this.range("a_max") && { a_max: options.a_max }),
      ...(this.range("horizon_s") && options.fixed && { horizon_s: options.horizon }),
      ...(options.sampler !== "card" && {
        sampler: { method: options.sampler, schedule: { uniform: options.steps } },
      }),
      ...(this.hasFinish && {
        refine: {
          smooth: options.smooth,
          project: options.project,
          safety_margin: options.margin,
          ...(this.hasFlow && { guidance: options.guidance }),
          barrier: options.barrier,
          certified_margin: options.certified,
        },
      }),
    };
  }

  /** [D] with the heading (or its rate) of a bundle that has one. */
  #vector(planar, heading) {
    return [...planar, ...(this.dim === 3 ? [heading] : [])].map((value) => Number(value.toFixed(4)));
  }
}
