/** The view of planners with a cost map: the scene asks, the planner answers, the stage shows. */

import { Anchors } from "../anchors.js";
import { byId } from "../dom.js";
import { pick, showLegend } from "../lines.js";
import { clearAnswer, columnsOf, fadeFigures, nameAnchor, say, showBest, showTimes } from "../panels.js";
import { Bubble } from "./bubble.js";
import { drawCharts } from "./charts.js";
import { Controls } from "./controls.js";
import { Drive } from "./drive.js";
import { Files } from "./files.js";
import { Handles } from "./handles.js";
import { Painting } from "./painting.js";
import { Replay } from "./replay.js";
import { sampleMap } from "./samples.js";
import { Scene } from "./scene.js";
import { Stage } from "./stage.js";
import { plan } from "./wire.js";

/** Samples of each kind that one sees first; later ones are counted on from here. */
const FIRST_SAMPLE = { forest: 5, rooms: 4, city: 5, maze: 2, empty: 0 };
/** Measurements that are kept for whoever opens the browser's profiler. */
const MOST_MEASURES = 500;
/** What an anchor can be coloured by, and the array of the answer that says it. */
const COLOURED = { score: "scores", speed: "velocities", clearance: "clearance" };

export class MapView {
  active = false;
  /** The question whose answer is shown, and the anchor that was clicked. */
  shown = null;
  kept = null;

  constructor(planner, amount, models) {
    this.planner = planner;
    this.scene = new Scene();
    this.controls = new Controls(this.scene, amount);
    this.numbers = { ...FIRST_SAMPLE };
    this.stage = new Stage(byId("canvas"), this.scene);
    this.handles = new Handles(this.stage, this.scene);
    this.painting = new Painting(this.stage, this.scene, (left, top) => this.#hover(left, top));
    this.bubble = new Bubble(this.stage, this.scene);
    this.files = new Files(this.scene, this.controls, models, { isShown: () => this.active, onOpen: () => this.#rest() });
    this.replay = new Replay(this.stage, () => this.#press("replay", false, "Replay the flow"));
    this.drive = new Drive(this.stage, this.scene, {
      ask: () => this.planner.busy || this.planner.ask(),
      onFrame: (note) => this.#showDrive(note),
    });
    this.#listen();
  }

  #listen() {
    this.scene.addEventListener("change", (event) => this.#changed(event.detail));
    byId("drive").addEventListener("click", () => this.#toggleDrive());
    byId("replay").addEventListener("click", () => this.#toggleReplay());
    byId("sample").addEventListener("change", () => this.#showSample(0));
    byId("another").addEventListener("click", () => this.#showSample(1));
    document.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.#rest();
    });
    this.stage.canvas.addEventListener("theme", () => this.#showAnchors());
    for (const radio of document.querySelectorAll("[name=colour]")) {
      radio.addEventListener("change", () => this.#colour(radio.value));
    }
  }

  /** Another bundle; the map stays. */
  useCard(card) {
    this.active = true;
    this.#rest();
    this.#clear();
    this.scene.useCard(card);
    this.controls.show();
    const gives = (...names) => names.every((name) => card.answer.arrays.includes(name));
    byId("drive").disabled = !gives("velocities", "accelerations");
    byId("replay").disabled = !this.scene.hasFlow;
    for (const [by, array] of Object.entries(COLOURED)) document.querySelector(`[name=colour][value=${by}]`).disabled = !gives(array);
    if (this.scene.grid) this.scene.changed("options");
    else this.scene.useMap(sampleMap("forest", FIRST_SAMPLE.forest));
  }

  leave() {
    this.active = false;
    this.#rest();
  }

  /** `options` of the scene have been chosen outside of its own controls. */
  choose(options, time) {
    this.controls.set(options, time);
  }

  /** What the planner sends: the newest scene, at the moment of sending. */
  question() {
    const { scene, drive } = this;
    const { card, changedAt, limits } = scene;
    const asked = drive.active ? drive.question() : { body: scene.request() };
    return { ...asked, send: plan, card, limits, changedAt, driven: drive.active };
  }

  #changed(what) {
    this.replay.end();
    if (what !== "ends") this.stage.redraw();
    if (what === "map") this.kept = null;
    this.stage.drawTop();
    if (this.active && !this.drive.active) this.planner.ask();
  }

  async answered({ question, answer, sentAt }) {
    if (question.card !== this.scene.card || question.driven !== this.drive.active) return;
    this.replay.end();
    const anchors = new Anchors(answer, question.card, question.limits);
    this.shown = question;
    this.bubble.clear();
    if (this.drive.active) this.drive.take(anchors, question);
    if (this.kept >= anchors.count) this.kept = null;
    Object.assign(this.stage.show, { anchors, stale: false, focus: this.kept, step: null });
    fadeFigures(false);
    this.#showAnchors();
    const shownAt = await this.stage.draw();
    if (!this.active || question.card !== this.scene.card) return; // another bundle was chosen meanwhile
    showTimes(anchors.timing, shownAt - sentAt);
    this.#measure({ question, sentAt, shownAt, engineMs: anchors.timing.total });
  }

  refused({ error }) {
    if (this.drive.active) this.drive.refused(error.message);
    this.bubble.refuse(error);
    this.#fade("The service refused");
  }

  down() {
    this.#fade("Waiting for the service");
  }

  /** What is shown is old; `why` begins the sentence that says so. */
  #fade(why) {
    const { show } = this.stage;
    show.stale = true;
    say(`${why}${show.anchors ? ": what is shown is its last answer" : ""}.`);
    fadeFigures(true);
    this.stage.draw();
  }

  /** Nothing has come back of this bundle. */
  #clear() {
    this.kept = null;
    Object.assign(this.stage.show, { anchors: null, stale: false, focus: null, step: null });
    this.bubble.clear();
    say("");
    clearAnswer();
    byId("charts").replaceChildren();
    byId("legend").hidden = true;
    this.stage.draw();
  }

  /** All figures of the answer that is shown. */
  #showAnchors() {
    const { anchors, focus, step, stale, colourBy } = this.stage.show;
    if (!anchors || !this.active) return;
    const { count, numSafe, trouble } = anchors;
    if (!stale) say(numSafe ? `${numSafe} of ${count} anchors are safe, ${anchors.durationsText}.` : `No anchor is safe: ${this.scene.tightEnd || trouble}.`);
    const looked = focus ?? anchors.best;
    drawCharts(anchors, looked, step);
    nameAnchor(anchors, focus);
    showBest(this.stage, anchors, {
      columns: columnsOf(anchors),
      by: colourBy,
      focus: looked,
      onLook: (n) => this.#look(n, null),
      onKeep: (n) => { this.kept = this.kept === n ? null : n; this.#look(this.kept, null); },
    });
    showLegend(byId("legend"), anchors, colourBy);
  }

  #hover(left, top) {
    const { anchors } = this.stage.show;
    if (!anchors || this.replay.active || this.drive.active) return;
    const found = left === null ? null : pick(this.stage, anchors, left, top);
    this.#look(found?.anchor ?? null, found?.step ?? null);
  }

  /** Bring anchor n into focus; null: the one that was clicked, or the best. */
  #look(n, step) {
    const { show } = this.stage;
    const focus = n ?? this.kept;
    if (show.focus === focus && show.step === step) return;
    Object.assign(show, { focus, step });
    this.#showAnchors();
    this.stage.draw();
  }

  #colour(by) {
    this.stage.show.colourBy = by;
    this.#showAnchors();
    this.stage.draw();
  }

  #showSample(further) {
    const kind = byId("sample").value === "own" ? "forest" : byId("sample").value;
    this.#rest();
    this.numbers[kind] += further;
    byId("sample").value = kind;
    this.scene.useMap(sampleMap(kind, this.numbers[kind]));
  }

  #toggleDrive() {
    if (this.drive.active) {
      this.#rest();
      return;
    }
    this.replay.end();
    this.kept = null;
    this.stage.show.focus = null;
    byId("board").dataset.drive = "";
    this.#press("drive", true, "Stop");
    byId("replay").disabled = true;
    this.drive.begin();
  }

  #showDrive(note) {
    byId("drive-note").hidden = false;
    if (byId("drive-note").textContent !== note) byId("drive-note").textContent = note;
    this.handles.place();
  }

  async #toggleReplay() {
    const { anchors } = this.stage.show;
    const isOpen = byId("replay").getAttribute("aria-pressed") === "true";
    this.replay.end();
    if (isOpen || !anchors) return;
    this.#press("replay", true, "Close");
    try {
      await this.replay.begin(this.shown, anchors);
    } catch (error) {
      say(error.message);
      this.#press("replay", false, "Replay the flow");
    }
  }

  /** Neither drive nor replay. */
  #rest() {
    this.replay.end();
    if (!this.drive.active) return;
    this.drive.end();
    delete byId("board").dataset.drive;
    byId("drive-note").hidden = true;
    this.#press("drive", false, "Drive");
    byId("replay").disabled = !this.scene.hasFlow;
    this.scene.changed("ends");
  }

  #press(id, pressed, text) {
    byId(id).setAttribute("aria-pressed", pressed);
    byId(id).querySelector("span").textContent = text;
    if (id === "drive") byId(id).querySelector("use").setAttribute("href", pressed ? "#i-stop" : "#i-play");
  }

  /** For the browser's profiler, and for whoever tests the page. */
  #measure({ question, sentAt, shownAt, engineMs }) {
    const detail = { engineMs, roundTripMs: shownAt - sentAt, num: question.body.num_samples };
    performance.measure("anchors-on-screen", { start: Math.min(question.changedAt, sentAt), end: shownAt, detail });
    if (performance.getEntriesByName("anchors-on-screen").length > MOST_MEASURES) performance.clearMeasures("anchors-on-screen");
  }
}
