/** One anchor as a motion in time, and the way to stand still when there is none. */

/** Share of a_max with which the robot brakes. */
const BRAKING = 0.8;

/** The motion along anchor n: [p, v, a] at any time, between its samples by cubic polynomials. */
export class Plan {
  constructor(anchors, n) {
    const { steps, hasOwnTime } = anchors;
    const dt = anchors.dts[n];
    const part = (flat) => flat.slice(2 * n * steps, 2 * (n + 1) * steps);
    Object.assign(this, { steps, dt, hasOwnTime, safe: anchors.safe[n] });
    this.positions = part(anchors.positions);
    this.velocities = part(anchors.velocities);
    this.accelerations = part(anchors.accelerations);
  }

  /** {x, y, vx, vy, ax, ay} after `seconds`; at its end for good when they have passed. */
  at(seconds) {
    const place = Math.min(Math.max(0, seconds / this.dt), this.steps - 1 - 1e-9);
    const k = Math.floor(place);
    const [x, y] = [0, 1].map((axis) => this.#between(this.positions, this.velocities, k, axis, place - k));
    const [vx, vy] = [0, 1].map((axis) => this.#between(this.velocities, this.accelerations, k, axis, place - k));
    const [ax, ay] = [0, 1].map((axis) => {
      const at = 2 * k + axis;
      return this.accelerations[at] + (place - k) * (this.accelerations[at + 2] - this.accelerations[at]);
    });
    return { x, y, vx, vy, ax, ay };
  }

  /**
   * A warm start's {trajectory, dt}: [T,6] p, v, a of what is left after `seconds`, dt s apart. Where
   * all anchors last as long, its end is drawn out to the whole horizon.
   */
  rest(seconds) {
    const left = Math.max((this.steps - 1) * this.dt - seconds, this.dt);
    const dt = this.hasOwnTime ? left / (this.steps - 1) : this.dt;
    const trajectory = Array.from({ length: this.steps }, (_, t) => {
      const { x, y, vx, vy, ax, ay } = this.at(seconds + t * dt);
      return [x, y, vx, vy, ax, ay].map((value) => Number(value.toFixed(4)));
    });
    return { trajectory, dt };
  }

  /** Whether nothing is left of it after `seconds`. */
  isOver(seconds) {
    return seconds >= (this.steps - 1) * this.dt;
  }

  /** [[x, y]] still to go after `seconds`. */
  way(seconds) {
    const { x, y } = this.at(seconds);
    const points = [[x, y]];
    for (let t = Math.floor(seconds / this.dt) + 1; t < this.steps; t++) {
      points.push([this.positions[2 * t], this.positions[2 * t + 1]]);
    }
    return points;
  }

  /** Cubic Hermite interpolation between samples k and k + 1. */
  #between(values, slopes, k, axis, share) {
    const [a, b] = [2 * k + axis, 2 * k + 2 + axis];
    const [s, r] = [share, 1 - share];
    return values[a] * r * r * (1 + 2 * s) + values[b] * s * s * (1 + 2 * r)
      + this.dt * s * r * (slopes[a] * r - slopes[b] * s);
  }
}

/** Straight on, slower and slower, then at rest. */
export class Stop {
  safe = false;

  /** `limits`: as they are asked for. */
  constructor(state, limits) {
    const speed = Math.hypot(state.vx, state.vy);
    const pull = BRAKING * limits.a_max;
    Object.assign(this, { state, speed, pull, seconds: speed / pull });
  }

  /** Whether it stands still after `seconds`. */
  isOver(seconds) {
    return seconds >= this.seconds;
  }

  at(seconds) {
    const { x, y, vx, vy } = this.state;
    const t = Math.min(seconds, this.seconds);
    const share = this.speed > 0 ? 1 / this.speed : 0;
    const [along, across] = [vx * share, vy * share];
    const gone = this.speed * t - (this.pull * t * t) / 2;
    const speed = this.speed - this.pull * t;
    const pull = seconds < this.seconds ? -this.pull : 0;
    return {
      x: x + gone * along, y: y + gone * across,
      vx: speed * along, vy: speed * across,
      ax: pull * along, ay: pull * across,
    };
  }
}
