/** The scene that is asked: a map, a start, a goal, a style and the options of the form. */

import { placeEnds } from "./grid.js";
import { WHEELS } from "../fields.js";
import { DISC, cornersOf, radiiOf } from "./body.js";
import { toRequest, walk } from "./people.js";

/** The named styles of the contract: weights of safety, energy and smoothness. */
export const STYLES = {
  conservative: [0.7, 0.1, 0.2],
  balanced: [0.4, 0.3, 0.3],
  efficient: [0.2, 0.5, 0.3],
  comfortable: [0.3, 0.2, 0.5],
};
/** Evaluations of the vector field for a step of each method. */
const EVALUATIONS = { euler: 1, midpoint: 2, heun: 2, rk4: 4, ab2: 1 };
/** A bundle that takes more evaluations is asked for two midpoint steps, which keep up with a drag. */
const MAX_EVALUATIONS = 8;
const QUICK_SAMPLER = { "sampler.method": "midpoint", "sampler.schedule.uniform": 2 };
const MAX_UNDO = 40;
/** Fields of which the search of poses makes no use. */
const OF_THE_FLOW = ["sampler.method", "sampler.schedule.uniform", "refine.smooth", "refine.project", "refine.safety_margin", "refine.guidance", "refine.barrier"];
/** m, of a car of which nothing else is known. */
const TYPICAL_TURN = 0.8;
/** s, to place a goal in reach if neither the card nor the form has a duration. */
const TYPICAL_DURATION = 8;
/** Share of v_max · horizon_s that the way between start and goal may take. */
const EASY_SHARE = 0.5;

/** Calls its listeners with "map", "ends", "people" or "options" when a response to the old scene is outdated. */
export class Scene {
  /** m, m/s, rad: {x, y, vx, vy, heading}; without a heading it is that of the straight way. */
  start = { x: 0, y: 0, vx: 0, vy: 0 };
  goal = { x: 0, y: 0, vx: 0, vy: 0 };
  /** Who walks there: {x, y, vx, vy, radius} each. */
  people = [];
  style = STYLES.balanced;
  /** The robot's outline, of body.js. */
  body = { ...DISC };
  /** Fields of the form by path. */
  options = {};
  /** Counts changes of anything but the start, which moves by itself while the robot drives. */
  version = 0;
  #undo = [];
  #listeners = [];

  /** `fields`: the `RequestFields` of the form. */
  constructor(fields) {
    this.fields = fields;
  }

  onChange(listener) {
    this.#listeners.push(listener);
  }

  /** Take the values of a bundle's card; the number of anchors and the seed stay. */
  useCard(card) {
    this.card = card;
    const { num_samples, seed } = this.options;
    const wheels = Object.entries(this.options).filter(([path]) => path.startsWith("kinematics."));
    this.options = this.fields.defaults(card);
    if (num_samples) Object.assign(this.options, { num_samples, seed }, Object.fromEntries(wheels));
    const { method, schedule } = card.sampler;
    const isQuick = EVALUATIONS[method] * (schedule?.length - 1) <= MAX_EVALUATIONS;
    if (card.sampler.kind === "ode" && !isQuick) Object.assign(this.options, QUICK_SAMPLER);
  }

  /** {horizon_s, v_max, a_max, robot_radius} that are asked; a horizon_s of null: each anchor has its own. */
  get limits() {
    const names = Object.keys(this.card.conditioning.limits);
    return Object.fromEntries(names.map((name) => [name, this.options[name] ?? null]));
  }

  /** D: 2 (x, y), or 3 with a heading. */
  get dim() {
    return this.hasBody ? 3 : this.card.answer.components.length;
  }

  /** [[x, y]] m of the robot's outline, or null for a disc. */
  get corners() {
    return cornersOf(this.body);
  }

  /** Whether poses are asked: the robot has an outline or wheels. */
  get hasBody() {
    return this.body.shape !== "disc" || WHEELS.includes(this.options["kinematics.kind"]);
  }

  /** Fields of the form that mean nothing to the robot as it is. */
  get unused() {
    return [...(this.hasBody ? OF_THE_FLOW : []), ...(this.corners ? ["robot_radius"] : [])];
  }

  /** Take options of the form; a car has to have a turning radius. */
  choose(options) {
    Object.assign(this.options, options);
    if (options["kinematics.kind"] === "ackermann") this.options["kinematics.min_turning_radius"] ||= TYPICAL_TURN;
  }

  /** m from an obstacle at which the robot's middle cannot be, whatever its heading. */
  get innerRadius() {
    return this.corners ? radiiOf(this.corners)[0] : this.options.robot_radius;
  }

  /** The heading of an end in rad. */
  headingOf(end) {
    const { start, goal } = this;
    return end.heading ?? Math.atan2(goal.y - start.y, goal.x - start.x);
  }

  /** Put an end at [x, y] in m, or at the nearest point on the map. */
  put(end, point) {
    [end.x, end.y] = this.grid.inside(...point);
    this.changed("ends");
  }

  /** Turn an end to a heading in rad, with a speed along it. */
  turn(end, heading, speed) {
    Object.assign(end, { heading, vx: speed * Math.cos(heading), vy: speed * Math.sin(heading) });
    this.changed("ends");
  }

  /** Whether the anchors come from a flow, which can be replayed. */
  get hasFlow() {
    return this.card.sampler.kind === "ode" && !this.hasBody && !this.people.length;
  }

  /** Another map, with a start and a goal that fit it unless they are given. */
  useMap(grid, ends, people = []) {
    Object.assign(this, { grid, people });
    const { v_max: fastest, horizon_s: horizon } = this.limits;
    const radius = this.innerRadius;
    const room = this.corners ? radiiOf(this.corners)[1] : radius;
    const reach = EASY_SHARE * fastest * (horizon ?? TYPICAL_DURATION);
    Object.assign(this, ends ?? placeEnds(grid, { radius, reach, room }));
    this.#undo.length = 0;
    this.changed("map");
  }

  changed(what) {
    this.version++;
    for (const listener of this.#listeners) listener(what);
  }

  get canUndo() {
    return this.#undo.length > 0;
  }

  /** Keep the map and the people for `undo`, before they change. */
  remember() {
    this.#undo.push({ map: this.grid.snapshot(), people: this.people.map((person) => ({ ...person })) });
    if (this.#undo.length > MAX_UNDO) this.#undo.shift();
  }

  undo() {
    const before = this.#undo.pop();
    if (!before) return;
    this.grid.restore(before.map);
    this.people = before.people;
    this.changed("map");
  }

  /** Let people walk; a turn is a change that no plan has foreseen. */
  walk(seconds) {
    if (walk(this.people, seconds, this.grid)) this.version++;
  }

  /** The fields of POST /anchors. `state`: {x, y, vx, vy, ax, ay, heading, turn, spin} in place of the start. */
  request(state = this.start) {
    const { card, goal, grid, corners } = this;
    const { x, y, vx, vy, ax = 0, ay = 0, turn = 0, spin = 0 } = state;
    const straight = Math.atan2(goal.y - y, goal.x - x);
    const options = this.fields.toRequest(this.options, card);
    if (this.hasBody) delete options.sampler;
    return {
      cost_map: { data: grid.channels(), resolution: grid.resolution, origin: grid.origin },
      x_curr: [...this.#vector([x, y], state.heading ?? straight), ...this.#vector([vx, vy], turn), ...this.#vector([ax, ay], spin)],
      x_goal: [...this.#vector([goal.x, goal.y], goal.heading ?? straight), ...this.#vector([goal.vx, goal.vy])],
      w_style: this.style,
      ...toRequest(this.people),
      ...(corners ? { footprint: corners } : {}),
      model: card.name,
      ...options,
    };
  }

  /** [D], with the heading (or its rate) if the bundle has one. */
  #vector(planar, heading = 0) {
    return [...planar, ...(this.dim === 3 ? [heading] : [])].map((value) => Number(value.toFixed(4)));
  }
}
