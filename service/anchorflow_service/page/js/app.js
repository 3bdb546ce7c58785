/** Puts the page together: the scene asks, the planner answers, the stage shows. */

import { Anchors } from "./anchors.js";
import { drawCharts } from "./charts.js";
import { Controls } from "./controls.js";
import { byId, figure } from "./dom.js";
import { Drive } from "./drive.js";
import { Files } from "./files.js";
import { Handles } from "./handles.js";
import { colourScale, pick } from "./lines.js";
import { Notices } from "./notices.js";
import { Painting } from "./painting.js";
import { showBest, showSummary, showTimes } from "./panels.js";
import { Planner } from "./planner.js";
import { Replay } from "./replay.js";
import { sampleMap } from "./samples.js";
import { Scene } from "./scene.js";
import { Unreachable, ask } from "./service.js";
import { Stage } from "./stage.js";

/** Samples of each kind that one sees first; later ones are counted on from here. */
const FIRST_SAMPLE = { forest: 5, rooms: 4, city: 5, maze: 2, empty: 0 };
/** Measurements that are kept for whoever opens the browser's profiler. */
const MOST_MEASURES = 500;

class App {
  constructor(cards) {
    this.scene = new Scene();
    this.controls = new Controls(this.scene, cards);
    this.scene.useMap(sampleMap("forest", FIRST_SAMPLE.forest));
    this.numbers = { ...FIRST_SAMPLE };
    this.stage = new Stage(byId("canvas"), this.scene);
    this.planner = new Planner(() => this.#question());
    this.handles = new Handles(this.stage, this.scene);
    this.painting = new Painting(this.stage, this.scene, (left, top) => this.#hover(left, top));
    this.notices = new Notices(this.planner, this.stage, this.scene);
    this.files = new Files(this.scene, this.controls);
    this.replay = new Replay(this.stage, () => this.#press("replay", false, "Replay the flow"));
    this.drive = new Drive(this.stage, this.scene, {
      ask: () => this.planner.busy || this.planner.ask(),
      onFrame: (note) => this.#showDrive(note),
    });
    this.kept = null;
    this.#listen();
    this.planner.ask();
  }

  #listen() {
    this.scene.addEventListener("change", (event) => this.#changed(event.detail));
    this.planner.addEventListener("answer", (event) => this.#answered(event.detail));
    this.planner.addEventListener("refusal", (event) => this.#refused(event.detail));
    this.planner.addEventListener("up", () => this.#refreshCards());
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

  /** What the planner sends: the newest scene, at the moment of sending. */
  #question() {
    const { scene, drive } = this;
    const { card, changedAt } = scene;
    const asked = drive.active ? drive.question() : { body: scene.request() };
    return { ...asked, card, changedAt, driven: drive.active };
  }

  #changed(what) {
    this.replay.end();
    if (what !== "ends") this.stage.redrawGround();
    if (what === "map") this.kept = null;
    this.stage.drawTop();
    if (!this.drive.active) this.planner.ask();
  }

  async #answered({ question, answer, sentAt }) {
    if (question.driven !== this.drive.active || this.replay.active) return;
    const anchors = new Anchors(answer, question.card);
    this.question = question;
    this.notices.clear();
    if (this.drive.active) this.drive.take(anchors, question);
    if (this.kept >= anchors.count) this.kept = null;
    Object.assign(this.stage.show, { anchors, stale: false, focus: this.kept, step: null });
    this.#showAnchors();
    const shownAt = await this.stage.draw();
    showTimes(anchors.timing, shownAt - sentAt);
    this.#measure({ question, sentAt, shownAt, engineMs: anchors.timing.total });
  }

  #refused({ error }) {
    if (error.code === "unknown_model") this.#refreshCards();
    if (this.drive.active) this.drive.refused(error.message);
    this.stage.show.stale = true;
    this.notices.refuse(error);
    this.stage.draw();
  }

  /** All figures of the answer that is shown. */
  #showAnchors() {
    const { anchors, focus, step, colourBy } = this.stage.show;
    if (!anchors) return;
    showSummary(anchors, this.scene);
    const looked = focus ?? anchors.best;
    drawCharts(anchors, looked, step);
    byId("anchor-name").textContent = focus === null ? "Best anchor" : `Anchor ${focus}`;
    byId("anchor-figures").textContent = anchors.safe[looked] ? `score ${figure(anchors.scores[looked])}` : "not safe";
    showBest(this.stage, anchors, {
      by: colourBy,
      focus: looked,
      onLook: (n) => this.#look(n, null),
      onKeep: (n) => { this.kept = this.kept === n ? null : n; this.#look(this.kept, null); },
    });
    const { low, high, unit, digits } = colourScale(anchors, colourBy);
    byId("legend").dataset.by = colourBy;
    byId("legend-low").textContent = figure(low, digits);
    byId("legend-high").textContent = `${figure(high, digits)} ${unit}`.trim();
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
      await this.replay.begin(this.question, anchors);
    } catch (error) {
      this.notices.say(error.message);
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
    byId("replay").disabled = false;
    this.scene.changed("ends");
  }

  #press(id, pressed, text) {
    byId(id).setAttribute("aria-pressed", pressed);
    byId(id).querySelector("span").textContent = text;
    if (id === "drive") byId(id).querySelector("use").setAttribute("href", pressed ? "#i-stop" : "#i-play");
  }

  /** Bundles come and go, with a service that was started again or in one that runs. */
  async #refreshCards() {
    try {
      this.controls.useCards(await cards());
    } catch (error) {
      this.notices.say(error.message);
    }
  }

  /** For the browser's profiler, and for whoever tests the page. */
  #measure({ question, sentAt, shownAt, engineMs }) {
    const detail = { engineMs, roundTripMs: shownAt - sentAt, num: question.body.num_samples };
    performance.measure("anchors-on-screen", { start: Math.min(question.changedAt, sentAt), end: shownAt, detail });
    if (performance.getEntriesByName("anchors-on-screen").length > MOST_MEASURES) performance.clearMeasures("anchors-on-screen");
  }
}

/** The cards of all bundles that are served. */
async function cards() {
  const { models } = await ask("v2/models");
  if (!models.length) throw new Unreachable("The service serves no bundle at present.");
  return models;
}

/** The page needs the cards before it can ask; it waits for a service that is still starting. */
async function begin() {
  for (let wait = 250; ; wait = Math.min(2 * wait, 4000)) {
    try {
      return new App(await cards());
    } catch (error) {
      byId("link-text").textContent = "Waiting for the service";
      byId("banner").hidden = false;
      byId("banner-text").textContent = error.message;
      await new Promise((resolve) => setTimeout(resolve, wait));
    }
  }
}

await begin();
