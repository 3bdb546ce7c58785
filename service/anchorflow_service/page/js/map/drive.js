/**
 * The live mode: a robot drives along the best anchor and plans again ten times a second.
 *
 * It keeps the plan it has until map, goal or options change or the service finds no safe way; then
 * it takes the best anchor of the newest answer. Where all anchors have the whole horizon to reach the
 * goal, a robot which took each of them would slow down for ever; where each has its own duration, it
 * would change its mind at every tie.
 */

import { Plan, Stop } from "./plan.js";

const PERIOD_MS = 100;
/** Between two pictures: the planner may share its cores with this page. */
const FRAME_MS = 30;
/** Without an answer for so long the robot does not trust its plan any more. */
const PATIENCE_MS = 1000;
/** Near enough to the goal, and slow enough, to turn back. */
const ARRIVED_M = 0.25;
const ARRIVED_MPS = 0.35;
/** A plan that lies farther from the robot by the time it comes is not taken: m, and s at its speed. */
const NEAR_M = 0.05;
const NEAR_S = 0.03;
const TRAIL_POINTS = 600;
const TAU = 0.8;

export class Drive {
  active = false;
  #plan;
  /** When the plan's first state holds, and when the last good answer came, ms. */
  #since = 0;
  #heard = 0;
  #shown = 0;
  #answers = [];

  /** `ask()` puts the next question; `onFrame(note)` is called for every picture. */
  constructor(stage, scene, { ask, onFrame }) {
    Object.assign(this, { stage, scene, ask, onFrame });
  }

  begin() {
    const now = performance.now();
    this.active = true;
    this.home = { ...this.scene.start };
    this.#plan = new Stop(this.home, this.scene.limits);
    this.#since = this.#heard = now;
    this.#answers = [];
    this.taken = 0;
    this.stage.show.trail = [];
    this.ask();
    this.timer = setInterval(() => this.ask(), PERIOD_MS);
    requestAnimationFrame(() => this.#frame());
  }

  /** The robot's place becomes the start of what is asked next. */
  end() {
    this.active = false;
    clearInterval(this.timer);
    Object.assign(this.stage.show, { robot: null, path: null, trail: [] });
  }

  /** What is asked now: from the robot's own state, starting from its plan where that still holds. */
  question() {
    const at = performance.now();
    const body = this.scene.request(this.#state(at));
    if (this.#holds && this.scene.dim === 2) {
      body.warm_start = { ...this.#plan.rest((at - this.#since) / 1e3), tau: TAU };
    }
    return { body, at, plan: this.#plan, isOver: this.#isOver(at), version: this.scene.version };
  }

  /** Whether the plan was made for the scene as it is. */
  get #holds() {
    return this.#plan.safe && this.planned === this.scene.version;
  }

  /** An answer to `question`: its best anchor where a plan is needed; brake where none is safe. */
  take(anchors, question) {
    const now = performance.now();
    this.#answers = [...this.#answers.filter((time) => now - time < 1000), now];
    this.#heard = now;
    this.trouble = anchors.trouble;
    // Whoever has braked since is no longer where the answer begins.
    if (this.#holds || question.plan !== this.#plan) return;
    if (!anchors.numSafe) {
      this.#brake(now);
      return;
    }
    // What was asked while it braked begins with the braking, and would roll back.
    if (this.#plan instanceof Stop && !question.isOver) return;
    const plan = new Plan(anchors, anchors.best);
    // Whoever has stood since begins now. Else both plans share the state at the moment of asking, so
    // the change is not felt, unless the answer was so late that they have parted.
    const since = question.isOver ? now : question.at;
    const state = this.#state(now);
    const near = NEAR_M + NEAR_S * Math.hypot(state.vx, state.vy);
    if (apart(plan.at((now - since) / 1e3), state) > near) {
      this.#brake(now);
      return;
    }
    this.#plan = plan;
    this.#since = since;
    this.planned = question.version;
    this.taken++;
  }

  /** The service refused: the robot is somewhere it must not be, or the goal is. */
  refused(message) {
    this.#heard = performance.now();
    this.trouble = message;
    this.#brake(this.#heard);
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
    if (now - this.#shown < FRAME_MS) return;
    this.#shown = now;
    if (now - this.#heard > PATIENCE_MS || this.#isOver(now)) this.#brake(now);
    const state = this.#state(now);
    this.scene.start = { x: state.x, y: state.y, vx: state.vx, vy: state.vy };
    this.stage.show.robot = state;
    this.stage.show.path = this.#plan.way?.((now - this.#since) / 1e3) ?? null;
    this.#leaveTrail(state);
    if (this.#hasArrived(state)) this.#turnBack();
    this.onFrame(this.#note(state));
    this.stage.drawTop();
  }

  #leaveTrail({ x, y }) {
    const { trail } = this.stage.show;
    const last = trail.at(-1);
    if (last && Math.hypot(x - last[0], y - last[1]) < 0.02) return;
    trail.push([x, y]);
    if (trail.length > TRAIL_POINTS) trail.shift();
  }

  #hasArrived({ x, y, vx, vy }) {
    const { goal } = this.scene;
    const slow = Math.hypot(vx - goal.vx, vy - goal.vy) < ARRIVED_MPS;
    return slow && Math.hypot(x - goal.x, y - goal.y) < ARRIVED_M;
  }

  /** Where it came from is the next goal. */
  #turnBack() {
    const { goal } = this.scene;
    this.scene.goal = { ...this.home, vx: 0, vy: 0 };
    this.home = { ...goal };
    this.scene.changed("ends");
  }

  #note({ vx, vy }) {
    if (this.#plan instanceof Stop && this.trouble) return `Braking: ${this.trouble}.`.replace("..", ".");
    const speed = Math.hypot(vx, vy).toFixed(2);
    return `${speed} m/s · ${this.#answers.length} plans/s · ${this.taken} taken`;
  }
}

/** m between two states. */
const apart = (a, b) => Math.hypot(a.x - b.x, a.y - b.y);
