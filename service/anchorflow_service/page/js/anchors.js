/** The anchors of a response in flat arrays, and the figures that the page derives from them. */

import { clamp } from "./dom.js";

/** At lower speeds [m/s] the curvature is not defined well enough to show. */
const STANDSTILL = 0.05;
/** m/s along its heading below which a robot stands. */
const RESTING = 0.02;

export class Anchors {
  /**
   * @param {object} answer  arrays as {shape, values} by name, and dt, first_s, seed, timing_ms;
   *   dt is a number if all anchors are alike, else one of these arrays or a list
   * @param {object} card  of the bundle that answered
   * @param {object} limits  of the request; by default those of the card
   */
  constructor(answer, card, limits = card.conditioning.limits) {
    const { trajectories, velocities, accelerations, scores, clearance, safe } = answer;
    const { dt, first_s: first = 0, seed, timing_ms: timing, reason = "" } = answer;
    [this.count, this.steps] = trajectories.shape;
    /** `reason`: why no anchor is safe; "" if one is, or if the planner does not say. */
    Object.assign(this, { card, limits, trajectories, first, seed, timing, reason });
    /** [N,T,2] m, flat, without a heading; likewise in m/s and m/s². Null: not in the response. */
    this.positions = planar(trajectories);
    this.velocities = velocities ? planar(velocities) : null;
    this.accelerations = accelerations ? planar(accelerations) : null;
    /** [N,T] rad, and its derivatives; null without a heading. */
    this.headings = heading(trajectories);
    this.turns = velocities ? heading(velocities) : null;
    this.spins = accelerations ? heading(accelerations) : null;
    /** [N,T] norms, or null. */
    this.speeds = velocities ? norms(this.velocities) : null;
    this.pulls = accelerations ? norms(this.accelerations) : null;
    /** [N], or null. */
    this.scores = scores ? Array.from(scores.values) : null;
    this.clearance = clearance ? Array.from(clearance.values) : null;
    /** [N]; all true if the planner does not check. */
    this.safe = Array.from({ length: this.count }, (_, n) => !safe || Boolean(safe.values[n]));
    const own = typeof dt === "number" ? null : Array.isArray(dt) ? dt : dt.values;
    /** Whether each anchor has its own duration. */
    this.hasOwnTime = own !== null;
    /** [N] s between two time steps. */
    this.dts = Float64Array.from({ length: this.count }, (_, n) => (own ? own[n] : dt));
    const score = (n) => this.scores?.[n] ?? 0;
    /** Indices, safe anchors first, then by score. */
    this.order = this.safe.map((_, n) => n).sort((a, b) => this.safe[b] - this.safe[a] || score(b) - score(a));
    this.best = this.order[0];
    this.numSafe = this.safe.filter(Boolean).length;
  }

  /** [D], the pose of anchor n at time step t. */
  pose(n, t) {
    const dim = this.trajectories.shape[2];
    const at = dim * (n * this.steps + t);
    return Array.from(this.trajectories.values.slice(at, at + dim));
  }

  /** s from now to time step t of anchor n. */
  time(n, t) {
    return this.first + t * this.dts[n];
  }

  /** s from now to the last time step of anchor n. */
  duration(n) {
    return this.time(n, this.steps - 1);
  }

  /** {x, y, vx, vy}, of poses also the heading, of anchor n after `seconds`, straight between its time steps; the last place after its end. */
  at(n, seconds) {
    const place = clamp((seconds - this.first) / this.dts[n], 0, this.steps - 1);
    const step = Math.min(Math.floor(place), this.steps - 2);
    const k = 2 * (n * this.steps + step);
    const [x, y, toX, toY] = this.positions.subarray(k, k + 4);
    const share = place - step;
    const [vx, vy] = [(toX - x) / this.dts[n], (toY - y) / this.dts[n]];
    const state = { x: x + share * (toX - x), y: y + share * (toY - y), vx, vy };
    if (!this.headings) return state;
    const [from, to] = this.headings.subarray(k / 2, k / 2 + 2);
    return { ...state, heading: from + share * (to - from) };
  }

  /** {x, y, heading} of anchor n at time step t, of a response with headings. */
  stateAt(n, t) {
    const at = n * this.steps + t;
    return { x: this.positions[2 * at], y: this.positions[2 * at + 1], heading: this.headings[at] };
  }

  /** 1 forwards or sideways, -1 backwards, 0 on the spot or at rest: anchor n at time step t. */
  gear(n, t) {
    const at = n * this.steps + t;
    const along = this.velocities[2 * at] * Math.cos(this.headings[at]) + this.velocities[2 * at + 1] * Math.sin(this.headings[at]);
    const speed = Math.hypot(this.velocities[2 * at], this.velocities[2 * at + 1]);
    if (speed < RESTING) return 0;
    return along < -Math.SQRT1_2 * speed ? -1 : 1;
  }

  /** "4.2 to 9.1 s" over the safe anchors, or over all if none is; "8.0 s" if they are alike. */
  get durationsText() {
    const seconds = this.order.filter((n) => this.safe[n] || !this.numSafe).map((n) => this.duration(n));
    const [least, most] = [Math.min(...seconds), Math.max(...seconds)].map((value) => value.toFixed(1));
    return least === most ? `${most} s` : `${least} to ${most} s`;
  }

  /** Length of the path of anchor n in m. */
  length(n) {
    let sum = 0;
    for (let t = 1; t < this.steps; t++) {
      const at = 2 * (n * this.steps + t);
      sum += Math.hypot(this.positions[at] - this.positions[at - 2], this.positions[at + 1] - this.positions[at - 1]);
    }
    return sum;
  }

  /** Greatest of the [N,T] values of anchor n. */
  greatest(values, n) {
    return Math.max(...values.subarray(n * this.steps, (n + 1) * this.steps));
  }

  /** [T] 1/m, |v × a| / |v|³; NaN at a standstill. */
  curvature(n) {
    return this.#along(n, (at, speed) => {
      const [v, a] = [this.velocities, this.accelerations];
      return Math.abs(v[at] * a[at + 1] - v[at + 1] * a[at]) / speed ** 3;
    });
  }

  /** [T] 1/m, the curvature at which the turn alone takes all of a_max; NaN at a standstill. */
  curvatureLimit(n) {
    return this.#along(n, (_, speed) => this.limits.a_max / speed ** 2);
  }

  #along(n, value) {
    return Float64Array.from({ length: this.steps }, (_, t) => {
      const index = n * this.steps + t;
      return this.speeds[index] < STANDSTILL ? NaN : value(2 * index, this.speeds[index]);
    });
  }
}

/** x and y of [N,T,D], flat. */
function planar({ shape: [count, steps, dim], values }) {
  if (dim === 2) return values;
  return values.constructor.from({ length: 2 * count * steps }, (_, k) => values[dim * (k >> 1) + (k & 1)]);
}

/** The third of [N,T,3], flat; null of [N,T,2]. */
function heading({ shape: [count, steps, dim], values }) {
  return dim === 2 ? null : values.constructor.from({ length: count * steps }, (_, k) => values[dim * k + 2]);
}

function norms(flat) {
  return Float32Array.from({ length: flat.length / 2 }, (_, k) => Math.hypot(flat[2 * k], flat[2 * k + 1]));
}
