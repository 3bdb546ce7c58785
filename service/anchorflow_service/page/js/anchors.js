/** An answer of the contract, brought to flat arrays, and what the page works out from them. */

/** Below this speed [m/s] a curvature says nothing. */
const STANDSTILL = 0.05;

export class Anchors {
  /**
   * @param {object} answer  arrays as {shape, values} by name, and dt, first_s, seed, timing;
   *   dt is a number where all anchors are alike, else one of these arrays, or a list
   * @param {object} card  of the bundle that answered
   * @param {object} limits  that were asked for; the card's where nothing was
   */
  constructor(answer, card, limits = card.conditioning.limits) {
    const { trajectories, velocities, accelerations, scores, clearance, safe } = answer;
    this.card = card;
    /** What the anchors keep, where the card says it. */
    this.limits = limits;
    [this.count, this.steps] = trajectories.shape;
    /** [N,T,2] m, flat; likewise m/s and m/s². A heading is left out. Null: not given. */
    this.positions = planar(trajectories);
    this.velocities = velocities ? planar(velocities) : null;
    this.accelerations = accelerations ? planar(accelerations) : null;
    /** [N,T], or null. */
    this.speeds = velocities ? lengths(this.velocities) : null;
    this.pulls = accelerations ? lengths(this.accelerations) : null;
    /** [N], or null. */
    this.scores = scores ? Array.from(scores.values) : null;
    this.clearance = clearance ? Array.from(clearance.values) : null;
    /** [N]; all of them where nobody has looked. */
    this.safe = Array.from({ length: this.count }, (_, n) => !safe || Boolean(safe.values[n]));
    const { dt, first_s: first = 0, seed, timing } = answer;
    Object.assign(this, { trajectories, first, seed, timing });
    const own = typeof dt === "number" ? null : Array.isArray(dt) ? dt : dt.values;
    /** Whether each has its own duration. */
    this.hasOwnTime = own !== null;
    /** [N] s between two of an anchor's time steps. */
    this.dts = Float64Array.from({ length: this.count }, (_, n) => (own ? own[n] : dt));
    /** Safe ones first, then by score: the order in which one would take them. */
    this.order = this.safe.map((_, n) => n).sort((a, b) => this.safe[b] - this.safe[a] || this.#score(b) - this.#score(a));
    this.best = this.order[0];
    this.numSafe = this.safe.filter(Boolean).length;
  }

  #score(n) {
    return this.scores ? this.scores[n] : 0;
  }

  /** [D], one of the [N,T] poses. */
  pose(n, t) {
    const dim = this.trajectories.shape[2];
    const at = dim * (n * this.steps + t);
    return Array.from(this.trajectories.values.slice(at, at + dim));
  }

  /** s from now to time step t of anchor n. */
  time(n, t) {
    return this.first + t * this.dts[n];
  }

  /** s from now to an anchor's last time step. */
  duration(n) {
    return this.time(n, this.steps - 1);
  }

  /** "4.2 to 9.1 s" of the safe ones, of all where none is; "8.0 s" where they are alike. */
  get durationsText() {
    const told = this.order.filter((n) => this.safe[n] || !this.numSafe).map((n) => this.duration(n));
    const [least, most] = [Math.min(...told), Math.max(...told)].map((seconds) => seconds.toFixed(1));
    return least === most ? `${most} s` : `${least} to ${most} s`;
  }

  /** Length of the way in m. */
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

  /** [T] 1/m, |v × a| / |v|³; NaN where it stands still. */
  curvature(n) {
    return this.#along(n, (at, speed) => {
      if (speed < STANDSTILL) return NaN;
      const [v, a] = [this.velocities, this.accelerations];
      return Math.abs(v[at] * a[at + 1] - v[at + 1] * a[at]) / speed ** 3;
    });
  }

  /** [T] 1/m, the curvature at which going round takes all of a_max; NaN where it stands still. */
  curvatureLimit(n) {
    return this.#along(n, (_, speed) => (speed < STANDSTILL ? NaN : this.limits.a_max / speed ** 2));
  }

  /** Why no anchor is safe, in words; "" where one is. */
  get trouble() {
    if (this.numSafe) return "";
    const { v_max: fastest, horizon_s: horizon } = this.limits;
    const fast = this.order.filter((n) => this.greatest(this.speeds, n) > fastest).length;
    if (horizon !== null && fast > this.count / 2) return `the way is too long for ${horizon} s at ${fastest} m/s`;
    return "each comes too close to an obstacle or breaks a limit";
  }

  #along(n, value) {
    return Float64Array.from({ length: this.steps }, (_, t) => {
      const index = n * this.steps + t;
      return value(2 * index, this.speeds[index]);
    });
  }
}

/** x and y of [N,T,D], flat. */
function planar({ shape: [count, steps, dim], values }) {
  if (dim === 2) return values;
  return values.constructor.from({ length: 2 * count * steps }, (_, k) => values[dim * (k >> 1) + (k & 1)]);
}

function lengths(flat) {
  return Float32Array.from({ length: flat.length / 2 }, (_, k) => Math.hypot(flat[2 * k], flat[2 * k + 1]));
}
