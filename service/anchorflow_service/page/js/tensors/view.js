/** The view of planners without a map: one fills in the inputs on their card and presses Plan. */

import { Anchors } from "../anchors.js";
import { limitsText, typeText } from "../bundles.js";
import { byId, figure, make, plain } from "../dom.js";
import { heading, say } from "../figures.js";
import { ask } from "../service.js";
import { listenForCopies, python, pythonProgram, toCurl } from "../share.js";
import { AnchorView } from "../view.js";
import { BirdsEye } from "./birds_eye.js";
import { Inputs } from "./inputs.js";
import { Recording } from "./recording.js";
import { drawPicture, toPicture, unnest } from "./tensor.js";

/** The extra output that is a picture from above. */
const RASTER = "bev_semantics";
const UNITS = { x: "m", y: "m", heading: "rad" };
/** Columns for the last pose of an anchor: ahead of the ego, and to its left. */
const END = [
  { name: "Ahead", unit: "m", value: (anchors, n) => anchors.pose(n, anchors.steps - 1)[0] },
  { name: "Left", unit: "m", value: (anchors, n) => anchors.pose(n, anchors.steps - 1)[1] },
];

export class TensorView extends AnchorView {
  options = {};
  /** Counts changes of what is asked. */
  version = 0;
  /** Whether anything has been asked of the planner on the card. */
  #hasAsked = false;

  constructor({ planner, form }) {
    super(new BirdsEye(byId("birds-eye")), byId("birds-eye-legend"), END);
    Object.assign(this, { planner, form });
    this.inputs = new Inputs(() => this.#changed());
    this.recording = new Recording(this, () => planner.ask());
    byId("ask").addEventListener("submit", () => {
      if (this.active) planner.ask();
    });
    const { canvas } = this.surface;
    canvas.addEventListener("pointermove", ({ offsetX, offsetY }) => this.hover(offsetX, offsetY));
    canvas.addEventListener("pointerleave", () => this.hover(null));
    canvas.addEventListener("click", ({ offsetX, offsetY }) => this.keep(this.under(offsetX, offsetY)?.anchor ?? null));
    const body = () => {
      const { body: asked } = this.question();
      if (!asked) throw new Error("One of the inputs is no value yet.");
      return asked;
    };
    listenForCopies(() => this.active, { curl: () => toCurl(toJson(body())), python: () => toPython(body()) });
  }

  useCard(card) {
    Object.assign(this, { card, active: true });
    this.#hasAsked = false;
    this.options = this.form.fields.defaults(card);
    this.clear();
    Object.assign(this.surface.show, { raster: null });
    this.inputs.useCard(card);
    this.#listExtras(card.answer.extras);
    this.#showExtras({}, null);
    const { kind, size = 0, candidates = kind === "vocabulary" ? size : 0 } = card.sampler;
    const { steps, first_s: first, dt } = card.time;
    const duration = dt === null ? "each anchor in its own time" : `up to ${(first + (steps - 1) * dt).toFixed(1)} s`;
    byId("bundle-hint").textContent = `What answers: ${steps} poses ${duration}${candidates > 1 ? `, the best of ${candidates}` : ""}.`;
    this.form.show(this.options, card);
    this.recording.useCard(card);
  }

  leave() {
    this.active = false;
  }

  /** Nothing is asked of a planner that would see nothing; who has pressed Plan meanwhile knows. */
  hasNoSample() {
    if (!this.#hasAsked) say("No sample fits this planner: fill in what it sees and press Plan.");
  }

  /** Take options of the form. */
  choose(options) {
    Object.assign(this.options, options);
    this.form.show(this.options, this.card);
    this.#changed();
    if (this.recording.drive) this.planner.ask();
  }

  /** The request with the inputs as they are now; without a body if one of them has no value. */
  question() {
    const { card, options, version } = this;
    this.#hasAsked = true;
    const { values: inputs, wrong } = this.inputs.values();
    if (wrong) {
      say(`Not asked. ${wrong}.`);
      return {};
    }
    const outputs = [...byId("outputs").querySelectorAll("input:checked")].map((box) => box.value);
    const body = { inputs, ...this.form.fields.toRequest(options, card), model: card.name, ...(outputs.length && { outputs }) };
    return { body, card, version, empty: this.inputs.empty, held: this.recording.held, send: (asked) => ask("anchors", asked) };
  }

  async answered({ question, answer, sentAt }) {
    if (question.card !== this.card || question.held?.drive !== this.recording.held?.drive) return;
    const { arrays, extras } = partsOf(answer, question.body.outputs ?? []);
    const anchors = new Anchors({ ...answer, ...arrays }, question.card);
    const raster = extras[RASTER] ? this.#rasterOf(extras[RASTER]) : null;
    this.#showExtras(extras, raster);
    this.recording.answered(question);
    const stale = question.version !== this.version;
    const isCurrent = await this.present(anchors, { card: question.card, sentAt, stale, raster, empty: question.empty });
    if (isCurrent) this.recording.shown(question.held);
  }

  /** The reason is shown beside the input, or in place of the summary. */
  refused({ error }) {
    this.down();
    say(this.inputs.refuse(error) ? "The service refused an input." : error.message);
  }

  down() {
    this.recording.silent();
    this.fade();
  }

  #changed() {
    this.version++;
    if (!this.surface.show.anchors) {
      say("Press Plan to ask.");
      return;
    }
    say("What is asked has changed: plan again.");
    this.fade();
  }

  summarize({ count, scores }) {
    const { empty } = this.surface.show;
    const blind = empty.length ? ` The planner saw nothing in ${empty.join(", ")}.` : "";
    say(`${count === 1 ? "1 anchor, in gold" : `${count} anchors, the ${scores ? "best by score" : "first"} in gold`}.${blind}`);
  }

  /** The poses of anchor n by time; `step` is the one under the pointer. */
  showDetails(anchors, n, step) {
    const { components } = anchors.card.answer;
    const heads = [{ name: "Time", unit: "s" }, ...components.map((name) => ({ name, unit: UNITS[name] }))].map(heading);
    const rows = Array.from({ length: anchors.steps }, (_, t) => {
      const cells = [anchors.time(n, t), ...anchors.pose(n, t)].map((value) => make("td", {}, figure(value)));
      const row = make("tr", {}, ...cells);
      row.setAttribute("aria-current", t === step);
      return row;
    });
    byId("poses").replaceChildren(make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...rows));
  }

  #listExtras(specs) {
    byId("outputs-block").hidden = !specs.length;
    byId("outputs").replaceChildren(...specs.map((spec) => {
      const box = make("input", { type: "checkbox", value: spec.name, checked: spec.name === RASTER });
      box.setAttribute("role", "switch");
      box.addEventListener("change", () => this.#changed());
      const type = [typeText(spec), limitsText(spec)].filter(Boolean).join(", ");
      return make("label", { className: "switch" }, make("span", {}, spec.name, make("span", { className: "type" }, type)), box);
    }));
  }

  #rasterOf(nested) {
    const spec = this.card.answer.extras.find(({ name }) => name === RASTER);
    const picture = toPicture(spec, unnest(nested), this.surface.colours.classes);
    return { ...picture, spec, extent: spec.extent ?? null, canvas: drawPicture(new OffscreenCanvas(1, 1), picture) };
  }

  /** List the extras with their ranges of values; show the raster by itself if its extent is not known. */
  #showExtras(extras, raster) {
    byId("extras-block").hidden = !Object.keys(extras).length;
    byId("extras").replaceChildren(...Object.entries(extras).map(([name, nested]) => {
      const { shape, values } = unnest(nested);
      const [low, high] = values.reduce(([least, most], value) => [Math.min(least, value), Math.max(most, value)], [Infinity, -Infinity]);
      return make("li", {}, make("b", {}, name), ` [${shape.join(", ")}] `, make("span", {}, `${plain(low)} to ${plain(high)}`));
    }));
    byId("raster-block").hidden = !raster || raster.extent !== null;
    if (byId("raster-block").hidden) return;
    drawPicture(byId("raster"), raster);
    const kind = { 0: "classes", 1: "grey levels", 3: "red, green, blue" }[raster.channels] ?? `the strongest of ${raster.channels} classes`;
    byId("raster-note").textContent = `${typeText(raster.spec)}: ${kind}. The card does not say how many metres it spans, so it is not under the anchors.`;
    byId("raster-key").replaceChildren(...raster.classes.map((index) => {
      const mark = make("i");
      mark.style.background = `rgb(${raster.colour(index).join(" ")})`;
      return make("li", {}, mark, String(index));
    }));
  }
}

/** The arrays of a response in JSON, flat, and the extras that were asked, nested. */
function partsOf(answer, outputs) {
  const names = Object.keys(answer).filter((name) => Array.isArray(answer[name]));
  const arrays = names.filter((name) => !outputs.includes(name)).map((name) => [name, unnest(answer[name])]);
  const extras = outputs.filter((name) => names.includes(name)).map((name) => [name, answer[name]]);
  return { arrays: Object.fromEntries(arrays), extras: Object.fromEntries(extras) };
}

/** A request as JSON, an input a line. */
function toJson({ inputs, ...rest }) {
  const lines = Object.entries(inputs).map(([name, value]) => `  ${JSON.stringify(name)}: ${JSON.stringify(value)}`);
  return `{"inputs": {\n${lines.join(",\n")}},\n${JSON.stringify(rest).slice(1)}\n`;
}

/** A request as a program in Python; only JSON carries files, the client's binary form carries pixels. */
function toPython({ inputs, ...fields }) {
  const lines = Object.entries(inputs).map(([name, value]) => `            ${python(name)}: ${python(value)},\n`);
  const hasFiles = Object.values(inputs).some((value) => value?.png ?? value?.jpeg);
  return pythonProgram({
    imports: `from anchorflow_client import AnchorClient${hasFiles ? ", JsonCodec" : ""}`,
    options: hasFiles ? ["codec=JsonCodec()"] : [],
    named: `        inputs={\n${lines.join("")}        },\n`,
    fields,
    after: 'print(f"{len(anchors.trajectories)} anchors, the best:")',
  });
}
