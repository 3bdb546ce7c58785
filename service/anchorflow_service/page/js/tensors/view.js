/** The view of planners that are asked with the inputs on their card: images, numbers, texts. */

import { Anchors } from "../anchors.js";
import { limitsText, typeText } from "../card.js";
import { byId, make } from "../dom.js";
import { listenForCopies, toCurl } from "../exchange.js";
import { pick, showLegend } from "../lines.js";
import { clearAnswer, columnsOf, fadeFigures, nameAnchor, say, showBest, showTimes } from "../panels.js";
import { ask } from "../service.js";
import { BirdsEye } from "./birds_eye.js";
import { Drive } from "./drive.js";
import { END, showExtras, showPoses } from "./figures.js";
import { Inputs } from "./inputs.js";
import { RASTER, Raster } from "./raster.js";
import { toJson, toPython } from "./request_text.js";
import { unnest } from "./tensor.js";

/** Anchors of a large vocabulary that are asked for unless one wants more. */
const FEW_ANCHORS = 64;
/** What the contract takes, where the card says nothing. */
const MOST_ANCHORS = 512;

export class TensorView {
  active = false;
  options = { num: FEW_ANCHORS, seed: 0 };
  /** Counts changes of what is asked. */
  version = 0;
  kept = null;

  constructor(planner, amount) {
    Object.assign(this, { planner, amount });
    this.inputs = new Inputs(() => this.#changed());
    this.eye = new BirdsEye(byId("birds-eye"));
    this.drive = new Drive({
      inputs: this.inputs,
      eye: this.eye,
      isShown: () => this.active,
      version: () => this.version,
      onFilled: () => this.planner.ask(),
      onClose: () => this.planner.ask(),
    });
    byId("ask").addEventListener("submit", () => {
      if (this.active) this.planner.ask();
    });
    const { canvas } = this.eye;
    canvas.addEventListener("pointermove", ({ offsetX, offsetY }) => this.#hover(offsetX, offsetY));
    canvas.addEventListener("pointerleave", () => this.#look(null, null));
    canvas.addEventListener("click", ({ offsetX, offsetY }) => this.#keep(this.#under(offsetX, offsetY)?.anchor ?? null));
    canvas.addEventListener("theme", () => this.#showAnchors());
    const body = () => {
      const { body: asked } = this.question();
      if (!asked) throw new Error("One of the inputs is no value yet.");
      return asked;
    };
    listenForCopies(() => this.active, { curl: () => toCurl(toJson(body())), python: () => toPython(body()) });
  }

  useCard(card) {
    const { kind, size = MOST_ANCHORS, candidates = kind === "vocabulary" ? size : 0 } = card.sampler;
    Object.assign(this, { card, active: true, most: size, kept: null });
    this.options.num = Math.min(FEW_ANCHORS, size);
    Object.assign(this.eye.show, { anchors: null, raster: null, focus: null, step: null });
    this.eye.request();
    this.inputs.useCard(card);
    this.#listExtras(card.answer.extras);
    this.#clearFigures();
    const { steps, first_s: first, dt } = card.time;
    const lasting = dt === null ? "each anchor in its own time" : `up to ${(first + (steps - 1) * dt).toFixed(1)} s`;
    byId("bundle-hint").textContent = `What answers: ${steps} poses ${lasting}${candidates > 1 ? `, the best of ${candidates}` : ""}.`;
    this.amount.show({ ...this.options, most: this.most });
    this.drive.useCard(card);
    if (!this.drive.isOpen) this.planner.ask();
  }

  leave() {
    this.active = false;
  }

  /** `options` {num} or {seed} have been chosen. */
  choose(options) {
    Object.assign(this.options, options);
    this.amount.show({ ...this.options, most: this.most });
    this.#changed();
    if (this.drive.isOpen) this.planner.ask();
  }

  /** What the planner sends: the inputs as they are now; no body where one of them is no value. */
  question() {
    const { card, options, version } = this;
    const { values: inputs, wrong } = this.inputs.values();
    if (wrong) {
      say(`Not asked. ${wrong}.`);
      return {};
    }
    const outputs = [...byId("outputs").querySelectorAll("input:checked")].map((box) => box.value);
    const body = { inputs, num_samples: options.num, seed: options.seed, model: card.name, ...(outputs.length && { outputs }) };
    return { body, card, version, held: this.drive.held, send: (asked) => ask("anchors", asked) };
  }

  async answered({ question, answer, sentAt }) {
    if (question.card !== this.card || question.held?.drive !== this.drive.held?.drive) return;
    const { arrays, extras } = parts(answer, question.body.outputs ?? []);
    const anchors = new Anchors({ ...answer, ...arrays, timing: answer.timing_ms }, question.card);
    const spec = this.card.answer.extras.find(({ name }) => name === RASTER);
    const raster = extras[RASTER] ? new Raster(spec, unnest(extras[RASTER]), this.eye.colours.classes) : null;
    if (this.kept >= anchors.count) this.kept = null;
    const stale = question.version !== this.version;
    Object.assign(this.eye.show, { anchors, raster, stale, focus: this.kept, step: null });
    fadeFigures(stale);
    this.drive.answered(question);
    this.#showAnchors();
    this.#showExtras(extras, raster);
    const shownAt = await this.eye.request();
    if (!this.active || question.card !== this.card) return; // another bundle was chosen meanwhile
    showTimes(anchors.timing, shownAt - sentAt);
    this.drive.shown(question.held);
  }

  /** Beside the input that it is about, or in the place of the answer. */
  refused({ error }) {
    this.down();
    if (!this.inputs.refuse(error)) say(error.message);
    else say("The service refused an input.");
  }

  /** What is shown is old. */
  down() {
    this.drive.silent();
    this.#fade();
  }

  #fade() {
    this.eye.show.stale = true;
    fadeFigures(true);
    this.eye.request();
  }

  #changed() {
    this.version++;
    if (!this.eye.show.anchors) {
      say("Press Plan to ask.");
      return;
    }
    say("What is asked has changed: plan again.");
    this.#fade();
  }

  #listExtras(specs) {
    byId("outputs-block").hidden = !specs.length;
    byId("outputs").replaceChildren(...specs.map((spec) => {
      const box = make("input", { type: "checkbox", value: spec.name, checked: spec.name === RASTER });
      box.setAttribute("role", "switch");
      box.addEventListener("change", () => this.#changed());
      const text = make("span", {}, spec.name, make("span", { className: "type" }, [typeText(spec), limitsText(spec)].filter(Boolean).join(", ")));
      return make("label", { className: "switch" }, text, box);
    }));
  }

  #clearFigures() {
    say("");
    clearAnswer();
    byId("poses").replaceChildren();
    byId("birds-eye-legend").hidden = true;
    this.#showExtras({}, null);
  }

  #showExtras(extras, raster) {
    byId("extras-block").hidden = !Object.keys(extras).length;
    showExtras(extras);
    byId("raster-block").hidden = !raster || Boolean(raster.extent);
    if (raster && !raster.extent) raster.showBeside();
  }

  #showAnchors() {
    const { anchors, focus, step, stale, colourBy } = this.eye.show;
    if (!anchors || !this.active) return;
    if (!stale) say(anchors.count === 1 ? "1 anchor, in gold." : `${anchors.count} anchors, the ${anchors.scores ? "best by score" : "first"} in gold.`);
    const looked = focus ?? anchors.best;
    nameAnchor(anchors, focus);
    showPoses(anchors, looked, step);
    showLegend(byId("birds-eye-legend"), anchors, colourBy);
    showBest(this.eye, anchors, {
      columns: columnsOf(anchors, END),
      by: colourBy,
      focus: looked,
      onLook: (n) => this.#look(n, null),
      onKeep: (n) => this.#keep(n),
    });
  }

  #under(left, top) {
    const { anchors } = this.eye.show;
    return anchors && pick(this.eye, anchors, left, top);
  }

  #hover(left, top) {
    const found = this.#under(left, top);
    this.#look(found?.anchor ?? null, found?.step ?? null);
  }

  /** A click keeps an anchor in focus, or lets it go. */
  #keep(n) {
    this.kept = this.kept === n ? null : n;
    this.#look(this.kept, null);
  }

  /** Bring anchor n into focus; null: the one that was clicked, or the best. */
  #look(n, step) {
    const { show } = this.eye;
    const focus = n ?? this.kept;
    if (show.focus === focus && show.step === step) return;
    Object.assign(show, { focus, step });
    this.#showAnchors();
    this.eye.request();
  }
}

/** The arrays of an answer in JSON, flat, and its extras as they came. */
function parts(answer, outputs) {
  const names = Object.keys(answer).filter((name) => Array.isArray(answer[name]));
  const arrays = names.filter((name) => !outputs.includes(name)).map((name) => [name, unnest(answer[name])]);
  const extras = outputs.filter((name) => names.includes(name)).map((name) => [name, answer[name]]);
  return { arrays: Object.fromEntries(arrays), extras: Object.fromEntries(extras) };
}
