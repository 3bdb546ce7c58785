/**
 * The simulated robot: it follows an anchor while people walk and the page asks again ten times a second.
 *
 * It keeps its plan until the map, the goal, the people's velocities or the options change or the service finds no safe way;
 * then it takes the best anchor of the newest response. If it took every new anchor, it would slow
 * down for ever with anchors that all span the horizon, and change its mind at every tie with
 * anchors that have their own duration.
 */

const PERIOD_MS = 100;
/** Between two frames: the planner may share its cores with this page. */
const FRAME_MS = 30;
/** Without a response for this time the robot brakes. */
const MAX_SILENCE_MS = 1000;
/** Distance and speed at which the goal counts as reached. */
const ARRIVED_M = 0.25;
const ARRIVED_MPS = 0.35;
/** A new plan may be this far from the robot when it arrives: m, and m for each m/s. */
const MAX_GAP_M = 0.05;
const MAX_GAP_S = 0.03;
const TRAIL_POINTS = 600;
const WARM_START_TAU = 0.8;
/** Share of a_max with which the robot brakes. */
const BRAKING = 0.8;

/** The motion along anchor n: cubic polynomials between its samples. */
export class Plan {
  constructor(anchors, n) {
    const { steps, hasOwnTime } = anchors;
    const part = (flat) => flat.slice(2 * n * steps, 2 * (n + 1) * steps);
    Object.assign(this, { steps, hasOwnTime, dt: anchors.dts[n], safe: anchors.safe[n] });
    this.positions = part(anchors.positions);
    this.velocities = part(anchors.velocities);
    this.accelerations = part(anchors.accelerations);
    if (!anchors.headings) return;
    const turned = (flat) => flat.slice(n * steps, (n + 1) * steps);
    Object.assign(this, { headings: turned(anchors.headings), turns: turned(anchors.turns), spins: turned(anchors.spins) });
  }

  /** {x, y, vx, vy, ax, ay}, of poses also heading, turn and spin (rad, rad/s, rad/s²), after `seconds`; the last state after its end. */
  at(seconds) {
    const place = Math.min(Math.max(0, seconds / this.dt), this.steps - 1 - 1e-9);
    const k = Math.floor(place);
    const share = place - k;
    const [x, y] = [0, 1].map((axis) => this.#hermite(this.positions, this.velocities, 2 * k + axis, 2, share));
    const [vx, vy] = [0, 1].map((axis) => this.#hermite(this.velocities, this.accelerations, 2 * k + axis, 2, share));
    const [ax, ay] = [2 * k, 2 * k + 1].map((at) => {
      return this.accelerations[at] + share * (this.accelerations[at + 2] - this.accelerations[at]);
    });
    if (!this.headings) return { x, y, vx, vy, ax, ay };
    const [heading, turn] = [this.#hermite(this.headings, this.turns, k, 1, share), this.#hermite(this.turns, this.spins, k, 1, share)];
    return { x, y, vx, vy, ax, ay, heading, turn, spin: this.spins[k] + share * (this.spins[k + 1] - this.spins[k]) };
  }

  /**
   * A warm start's {trajectory, dt}: [T,6] p, v, a of what is left after `seconds`, dt s apart. If all
   * anchors have the same duration, the last state is repeated up to the horizon.
   */
  rest(seconds) {
    const left = Math.max((this.steps - 1) * this.dt - seconds, this.dt);
    const dt = this.hasOwnTime ? left / (this.steps - 1) : this.dt;
    const trajectory = Array.from({ length: this.steps }, (_, t) => {
      return Object.values(this.at(seconds + t * dt)).map((value) => Number(value.toFixed(4)));
    });
    return { trajectory, dt };
  }

  isOver(seconds) {
    return seconds >= (this.steps - 1) * this.dt;
  }

  /** [[x, y]] of the path that is left after `seconds`. */
  path(seconds) {
    const { x, y } = this.at(seconds);
    const points = [[x, y]];
    for (let t = Math.floor(seconds / this.dt) + 1; t < this.steps; t++) {
      points.push([this.positions[2 * t], this.positions[2 * t + 1]]);
    }
    return points;
  }

  /** Cubic Hermite interpolation between a number and the one `stride` places after it. */
  #hermite(values, slopes, a, stride, s) {
    const b = a + stride;
    const r = 1 - s;
    return values[a] * r * r * (1 + 2 * s) + values[b] * s * s * (1 + 2 * r)
      + this.dt * s * r * (slopes[a] * r - slopes[b] * s);
  }
}

/** Braking in a straight line, then standing still. */
export class Stop {
  safe = false;

  constructor(state, { a_max }) {
    const speed = Math.hypot(state.vx, state.vy);
    const pull = BRAKING * a_max;
    Object.assign(this, { state, speed, pull, seconds: speed / pull });
  }

  isOver(seconds) {
    return seconds >= this.seconds;
  }

  at(seconds) {
    const { x, y, vx, vy, heading } = this.state;
    const t = Math.min(seconds, this.seconds);
    const share = this.speed > 0 ? 1 / this.speed : 0;
    const [along, across] = [vx * share, vy * share];
    const length = this.speed * t - (this.pull * t * t) / 2;
    const speed = this.speed - this.pull * t;
    const pull = seconds < this.seconds ? -this.pull : 0;
    return {
      x: x + length * along, y: y + length * across,
      vx: speed * along, vy: speed * across,
      ax: pull * along, ay: pull * across,
      ...(heading === undefined ? {} : { heading, turn: 0, spin: 0 }),
    };
  }
}

export class Robot {
  active = false;
  #plan;
  /** When the plan began, and when the last response arrived, ms. */
  #since = 0;
  #heardAt = 0;
  #shownAt = 0;
  #walkedAt = 0;
  #answerTimes = [];

  /** `ask()` sends the next request; `onFrame(note)` is called for each frame. */
  constructor(stage, scene, { ask, onFrame }) {
    Object.assign(this, { stage, scene, ask, onFrame });
  }

  begin() {
    const now = performance.now();
    this.active = true;
    const { scene } = this;
    // A heading that follows the straight way would change while the robot drives.
    if (scene.hasBody) for (const end of [scene.start, scene.goal]) end.heading = scene.headingOf(end);
    this.home = { ...scene.start };
    this.#plan = new Stop(this.home, this.scene.limits);
    this.#since = this.#heardAt = this.#walkedAt = now;
    this.#answerTimes = [];
    this.numTaken = 0;
    this.stage.show.trail = [];
    this.ask();
    this.timer = setInterval(this.ask, PERIOD_MS);
    requestAnimationFrame(() => this.#frame());
  }

  /** Stop; the robot's place is the start of the next request. */
  end() {
    this.active = false;
    clearInterval(this.timer);
    Object.assign(this.stage.show, { robot: null, path: null, trail: [] });
  }

  /** A request from the robot's own state, with the rest of its plan as a warm start while that holds. */
  question() {
    const at = performance.now();
    this.#letWalk(at);
    const body = this.scene.request(this.#state(at));
    if (this.#holds && !this.#plan.headings && this.scene.dim === 2) {
      body.warm_start = { ...this.#plan.rest((at - this.#since) / 1e3), tau: WARM_START_TAU };
    }
    return { body, at, plan: this.#plan, isOver: this.#isOver(at), version: this.scene.version };
  }

  /** Whether the plan was made for the scene as it is. */
  get #holds() {
    return this.#plan.safe && this.plannedVersion === this.scene.version;
  }

  /** Take the best anchor of the response to `question` if a new plan is needed; brake if none is safe. */
  take(anchors, question) {
    const now = performance.now();
    this.#answerTimes = [...this.#answerTimes.filter((time) => now - time < 1000), now];
    this.#heardAt = now;
    this.trouble = anchors.reason;
    // A robot that has braked since is not where the response begins.
    if (this.#holds || question.plan !== this.#plan) return;
    if (!anchors.numSafe) {
      this.#brake(now);
      return;
    }
    // A response to a question from before it stood still would roll it back.
    if (this.#plan instanceof Stop && !question.isOver) return;
    const plan = new Plan(anchors, anchors.best);
    // A robot at rest begins now. Otherwise both plans share the state at the time of the question,
    // so that the change is smooth unless the response is so late that they have parted.
    const since = question.isOver ? now : question.at;
    const state = this.#state(now);
    const planned = plan.at((now - since) / 1e3);
    const maxGap = MAX_GAP_M + MAX_GAP_S * Math.hypot(state.vx, state.vy);
    if (Math.hypot(planned.x - state.x, planned.y - state.y) > maxGap) {
      this.#brake(now);
      return;
    }
    this.#plan = plan;
    this.#since = since;
    this.plannedVersion = question.version;
    this.numTaken++;
  }

  /** The service refuses if the robot or the goal is in an obstacle. */
  refused(message) {
    this.#heardAt = performance.now();
    this.trouble = message;
    this.#brake(this.#heardAt);
  }

  #brake(now) {
    if (this.#plan instanceof Stop) return;
    this.#plan = new Stop(this.#state(now), this.scene.limits);
    this.#since = now;
  }

  #state(now) {
    return this.#plan.at((now - this.#since) / 1e3);
  }

  #isOver(now) {
    return this.#plan.isOver((now - this.#since) / 1e3);
  }

  #frame() {
    if (!this.active) return;
    requestAnimationFrame(() => this.#frame());
    const now = performance.now();
    if (now - this.#shownAt < FRAME_MS) return;
    this.#shownAt = now;
    if (now - this.#heardAt > MAX_SILENCE_MS || this.#isOver(now)) this.#brake(now);
    this.#letWalk(now);
    const robot = this.#state(now);
    const { x, y, vx, vy, heading } = robot;
    this.scene.start = { x, y, vx, vy, ...(heading === undefined ? {} : { heading }) };
    Object.assign(this.stage.show, { robot, path: this.#plan.path?.((now - this.#since) / 1e3) ?? null });
    this.#leaveTrail(robot);
    if (this.#hasArrived(robot, now)) this.#turnBack();
    this.onFrame(this.#note(robot));
    this.stage.drawTop();
  }

  /** People walk while the robot drives. */
  #letWalk(now) {
    this.scene.walk((now - this.#walkedAt) / 1e3);
    this.#walkedAt = now;
  }

  #leaveTrail({ x, y }) {
    const { trail } = this.stage.show;
    const last = trail.at(-1);
    if (last && Math.hypot(x - last[0], y - last[1]) < 0.02) return;
    trail.push([x, y]);
    if (trail.length > TRAIL_POINTS) trail.shift();
  }

  /** A body drives its plan to the end: it may have to turn or to back up near the goal. */
  #hasArrived({ x, y, vx, vy }, now) {
    const { goal, hasBody } = this.scene;
    const isSlow = Math.hypot(vx - goal.vx, vy - goal.vy) < ARRIVED_MPS && (!hasBody || this.#isOver(now));
    return isSlow && Math.hypot(x - goal.x, y - goal.y) < ARRIVED_M;
  }

  #turnBack() {
    const { goal } = this.scene;
    this.scene.goal = { ...this.home, vx: 0, vy: 0 };
    this.home = { ...goal };
    this.scene.changed("ends");
  }

  #note({ vx, vy }) {
    if (this.#plan instanceof Stop && this.trouble) return `Braking: ${this.trouble.replace(/\.$/, "")}.`;
    return `${Math.hypot(vx, vy).toFixed(2)} m/s · ${this.#answerTimes.length} plans/s · ${this.numTaken} taken`;
  }
}
